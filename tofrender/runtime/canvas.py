"""Matplotlib figures outside of pyplot: one style for all of them, and one way to save them."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import checks
from .atomic import check_file, replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
STYLE_SHEET = Path(__file__).with_name("figures.mplstyle")


@dataclass(frozen=True)
class Palette:
    """Colors of a theme. Colors of text have a contrast to `paper` of at least 4.5.

    Attributes:
        ink: Text and axes.
        paper: Background.
        faint: Grid lines and secondary text.
        lines: Curves. Color-blind readers can distinguish these colors (Okabe and Ito).
        channels: Red, green and blue light.
        good: Passed tests. Color-blind readers can distinguish it from `bad`.
        bad: Failed tests.
    """

    ink: str
    paper: str
    faint: str
    lines: tuple[str, ...]
    channels: tuple[str, str, str]
    good: str
    bad: str


PALETTES = {
    "light": Palette(
        ink="#1a1a1a",
        paper="#ffffff",
        faint="#6b6b6b",
        lines=("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1a1a1a"),
        channels=("#d55e00", "#009e73", "#0072b2"),
        good="#00694e",
        bad="#b23c00",
    ),
    "dark": Palette(
        ink="#ececec",
        paper="#14161a",
        faint="#9a9a9a",
        lines=("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#d55e00", "#ececec"),
        channels=("#e66b00", "#00b388", "#56b4e9"),
        good="#3ccfa4",
        bad="#ff8a5c",
    ),
}


@dataclass(frozen=True)
class _Style:
    theme: str = "light"
    width: float | None = None


_STYLE: ContextVar[_Style] = ContextVar("style", default=_Style())  # noqa: B039, it is frozen


@contextmanager
def figure_style(*, theme: str | None = None, width: float | None = None) -> Iterator[None]:
    """Set the theme and the width of all figures that are made in the block.

    Fonts have 7 to 9 points and lines 0.6 to 1.2 points for every width, so that a figure can be
    printed without scaling: 3.4 inches for a column, 7 for a page. Narrow figures arrange their
    panels in more rows.

    Args:
        theme: "light" or "dark". None keeps the theme of an enclosing block, by default "light".
        width: Width of figures [inches], 2.5 to 40. None keeps the width of an enclosing block, by
            default the natural width of each figure. Heights change with the width.

    Raises:
        ValueError: An unknown theme, or a width out of range.

    Example:
        >>> from tofrender import vis
        >>> with figure_style(theme="dark", width=3.4):
        ...     figure = vis.plot_pixel_transient([[[0, 1, 0]]], 0, 0, 3.5, 0.02)
        >>> float(figure.get_figwidth())
        3.4
    """
    style = _STYLE.get()
    if theme is not None:
        style = replace(style, theme=checks.one_of("theme", theme, PALETTES))
    if width is not None:
        wide = checks.number("width", width, unit="inches", low=2.5, high=40.0)
        style = replace(style, width=wide)
    token = _STYLE.set(style)
    try:
        yield
    finally:
        _STYLE.reset(token)


def palette() -> Palette:
    """Return the colors of the active theme."""
    return PALETTES[_STYLE.get().theme]


def figure_width(natural: float) -> float:
    """Return the width that `figure_style` has set, by default `natural` [inches]."""
    return _STYLE.get().width or natural


@contextmanager
def in_style() -> Iterator[None]:
    """Draw with the active style in a block or a decorated function."""
    from matplotlib import rc_context

    with rc_context(_rc_params()):
        yield


@cache
def _style_sheet() -> dict[Any, Any]:
    from matplotlib import rc_params_from_file

    return dict(rc_params_from_file(STYLE_SHEET, use_default_template=False))


def _rc_params() -> dict[Any, Any]:
    """Return the parameters of the style sheet with the colors of the active theme."""
    from cycler import cycler

    colors = palette()
    inked = ("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color")
    papered = ("figure.facecolor", "axes.facecolor", "savefig.facecolor", "legend.facecolor")
    return {
        **_style_sheet(),
        **dict.fromkeys(inked, colors.ink),
        **dict.fromkeys(papered, colors.paper),
        **dict.fromkeys(("grid.color", "legend.edgecolor"), colors.faint),
        "axes.prop_cycle": cycler(color=colors.lines),
    }


def new_figure(width: float, height: float, layout: Any = "constrained") -> Figure:
    """Make a figure without pyplot. Notebooks display it.

    The figure keeps the current rcParams for later draws.

    Args:
        width: Width [inches].
        height: Height [inches].
        layout: "constrained", "compressed", or a layout engine of Matplotlib. The layout
            "compressed" keeps pictures close together and gives color bars the height of pictures.
    """
    from matplotlib import rc_context, rcParams
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    settings = {name: rcParams[name] for name in _rc_params()}

    class Picture(Figure):
        def draw(self, renderer: Any) -> None:
            with rc_context(settings):  # Matplotlib creates ticks when it draws
                super().draw(renderer)

        def savefig(self, *args: Any, **kwargs: Any) -> None:
            with rc_context(settings | _SAVED):
                super().savefig(*args, **kwargs)

        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format="png")
            return stream.getvalue()

    class Layout(ConstrainedLayoutEngine):
        def execute(self, fig: Figure) -> None:
            """Round positions to five digits, so that equal figures give equal files."""
            super().execute(fig)
            for axes in fig.axes:
                bounds = axes.get_position(original=True).bounds
                axes._set_position([round(part, 5) for part in bounds])  # pyright: ignore

    class Canvas(FigureCanvasAgg):
        def draw_idle(self, *args: Any, **kwargs: Any) -> None:
            """Do nothing. A figure without a window need not be drawn again."""

    if layout in ("constrained", "compressed"):
        layout = Layout(compress=layout == "compressed")
    figure = Picture(figsize=(width, height), layout=layout)
    Canvas(figure)
    return figure


_SAVED: dict[Any, Any] = {"svg.fonttype": "none", "pdf.fonttype": 42, "svg.hashsalt": "tofrender"}
"""Parameters of saved figures. Text stays text, and identifiers in files are always the same."""

_METADATA: dict[str, dict[str, str | None]] = {
    ".png": {"Software": "tofrender"},
    ".pdf": {"Creator": "tofrender", "CreationDate": None},
    ".svg": {"Creator": "tofrender", "Date": None},
}


def save_figure(figure: Figure, path: str | os.PathLike, *, dpi: float = 200) -> Path:
    """Write a figure as PNG, PDF or SVG.

    Equal figures give equal bytes with the same version of Matplotlib. Text in PDF and SVG stays
    text, and PDF files contain the fonts.

    Args:
        figure: A `matplotlib.figure.Figure` of this package or of another one.
        path: A file name that ends in .png, .pdf or .svg. An existing file is replaced when the
            new file is complete.
        dpi: Pixels per inch, 20 to 2400, also for images in a PDF or SVG.

    Raises:
        ValueError: Another suffix, or a resolution out of range.
        OSError: `path` may not be replaced or is not writable, or the disk is full.

    Example:
        >>> import tempfile
        >>> from tofrender import vis
        >>> figure = vis.plot_pixel_transient([[[0, 1, 0]]], 0, 0, 3.5, 0.02)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_figure(figure, folder + "/response.svg").read_text()[:5]
        '<?xml'
    """
    from matplotlib.figure import Figure

    checks.instance("figure", figure, Figure, "a figure of Matplotlib")
    target = check_file(path, *FIGURE_SUFFIXES, overwrite=True)
    dpi = checks.number("dpi", dpi, low=20, high=2400)
    kind = target.suffix.lower()
    with replacing(target) as temporary:
        draw_figure(figure, temporary, kind, dpi=dpi)
    return target


def draw_figure(figure: Figure, target: Any, kind: str, *, dpi: float = 200) -> None:
    """Draw a figure like `save_figure` into a path or a binary stream.

    Args:
        figure: The figure.
        target: Path or stream.
        kind: Suffix of the format: ".png", ".pdf" or ".svg".
        dpi: Pixels per inch.
    """
    from matplotlib import rc_context

    with rc_context(_SAVED):
        figure.savefig(target, format=kind[1:], dpi=dpi, metadata=_METADATA[kind])
