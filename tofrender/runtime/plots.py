"""Common parts of figures: color bars with few ticks, wrapped text, grids of pictures."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from .canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN = 5.0  # figures narrower than this arrange their panels in more rows [inches]
NO_VALUE = "no light, or not finished"  # meaning of the hatch
PAD = 0.06  # margin around a figure [inches]
HATCH: dict[str, Any] = {"facecolor": "0.62", "edgecolor": "0.45", "hatch": "/////"}
DARK_HATCH: dict[str, Any] = {"facecolor": (38 / 255,) * 3, "edgecolor": "0.45", "hatch": "/////"}


def few_ticks(axes: Axes, **options: Any) -> None:
    """Limit the number of ticks on both axes, so that the labels fit."""
    axes.locator_params(nbins=5, steps=[1, 2, 5, 10], **options)


def superscript(number: int) -> str:
    """Format an integer as an exponent."""
    return str(number).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def tick_scale(largest: float) -> tuple[str, Any]:
    """Choose a power of ten for short tick labels.

    Returns:
        The power as text, "" for 1, and a formatter of ticks in units of the power.
    """
    from matplotlib.ticker import FuncFormatter

    power = 0
    if math.isfinite(largest) and largest > 0 and not 0.01 <= largest < 10_000:
        power = 3 * math.floor(math.log10(largest) / 3)
    formatter = FuncFormatter(lambda value, _: _short(value / 10.0**power))
    return f"10{superscript(power)}" if power else "", formatter


def _short(value: float) -> str:
    return f"{value:.4g}".replace("-", "−") if abs(value) > 1e-12 else "0"


def label_with_factor(label: str, factor: str) -> str:
    """Insert a factor in front of the unit in a label "name [unit]"."""
    if not factor:
        return label
    return label.replace("[", f"[{factor} ", 1) if "[" in label else f"{label} [{factor}]"


def color_bar(
    image: Any, axes: Any = None, label: str = "", below: bool = False, **options: Any
) -> Any:
    """Add a color bar with few and short numbers.

    Args:
        image: Picture that the bar belongs to.
        axes: Axes that give room to the bar.
        label: Label "name [unit]".
        below: Whether the bar is below the axes instead of to the right.
        **options: Options of Matplotlib's `colorbar`, for example the axes `cax` of the bar.
    """
    target = options.get("cax", axes)
    if target is axes:
        defaults = {"aspect": 14, "pad": 0.03} if below else {"aspect": 22, "pad": 0.02}
        options = defaults | options
    first = target if hasattr(target, "figure") else target[0]
    location = "bottom" if below else "right"
    bar = first.figure.colorbar(image, ax=axes, location=location, **options)
    low, high = image.get_clim()
    factor, formatter = tick_scale(max(abs(low), abs(high)))
    bar.set_ticks(_ticks(low, high, 3 if below else 6))
    bar.formatter = formatter
    bar.update_ticks()
    bar.set_label(label_with_factor(label, factor), fontsize=7)
    bar.outline.set_linewidth(0.6)
    return bar


def percentile_range(values: np.ndarray) -> tuple[float, float, str]:
    """Return the 1st and the 99th percentile, and the ends of the color bar that need arrows."""
    finite = values[np.isfinite(values)]
    low, high = map(float, np.percentile(finite, (1, 99))) if finite.size else (0.0, 1.0)
    return low, high, ends_beyond(values, low, high)


def ends_beyond(values: np.ndarray, low: float, high: float) -> str:
    """Return the ends of a color bar that need arrows, as the argument `extend` names them."""
    below = bool((values < low).any())
    above = bool((values > high).any())
    return ("neither", "max", "min", "both")[2 * below + above]


def _ticks(low: float, high: float, most: int) -> list[float]:
    """Return few round numbers in a range. For a symmetric range: -a, 0 and a."""
    from matplotlib.ticker import MaxNLocator

    if low == -high and high > 0:
        power = 10.0 ** math.floor(math.log10(0.95 * high))
        size = math.floor(0.95 * high / power) * power
        return [-size, 0.0, size]
    found = MaxNLocator(nbins=most, steps=[1, 2, 5, 10]).tick_values(low, high)
    tolerance = 1e-9 * (high - low)
    return [float(tick) for tick in found if low - tolerance <= tick <= high + tolerance]


def wrap_text(text: str, width: float, size: float = 9) -> str:
    """Wrap text to a width [inches] at a font size [points]."""
    most = max(12, int(width * 72 / (0.56 * size)))
    return "\n".join(textwrap.fill(line, most) for line in text.splitlines())


def hatch_patch(meaning: str, dark: bool = False) -> Any:
    """Return the legend entry of the hatch."""
    from matplotlib.patches import Patch

    return Patch(**DARK_HATCH if dark else HATCH, linewidth=0, label=meaning)


def fit_height(figure: Figure) -> None:
    """Reduce the height of a figure to the height of its contents."""
    for _ in range(2):
        figure.draw_without_rendering()
        figure.set_figheight(max(1.0, figure.get_tightbbox().height + 2 * PAD))


# Margins around pictures [inches]
LEFT = 0.5
RIGHT = 0.14
GAP = 0.17
EDGE = 0.07

# Heights of text and color bars at the font sizes of `runtime.canvas` [inches]
TITLE = 0.22
LINE = 0.125
TICKS = 0.17
LABEL = 0.16
BAR = 0.07


class PictureGrid:
    """Grid of pictures with titles above and color bars below.

    It is much faster than a layout of Matplotlib, and has small margins. Lengths are in inches.

    Args:
        width: Width of the figure.
        rows: Number of rows.
        columns: Number of columns.
        aspect: Height of a picture divided by its width.
        title: Title of the figure.
        title_color: Color of the title; None for the color of text.
        bar_lines: Number of lines of the label of a color bar.
        left: Margin to the left of the first column.
        own_y: Whether all columns have this margin, for their own y axes.
        with_x: Rows with an x axis; None for all.
        with_bars: Rows with color bars; None for all.
        hatch: Meaning of the hatch, for a legend at the bottom.

    Attributes:
        figure: The figure. Its height fits the content.
    """

    def __init__(
        self,
        width: float,
        rows: int,
        columns: int,
        aspect: float,
        *,
        title: str = "",
        title_color: str | None = None,
        bar_lines: int = 1,
        left: float = LEFT,
        own_y: bool = False,
        with_x: Collection[int] | None = None,
        with_bars: Collection[int] | None = None,
        hatch: str = "",
    ) -> None:
        self.width = width
        self.columns = columns
        self.left = left
        self.own_y = own_y
        self.gap = left + 0.05 if own_y else GAP

        # Size of a picture
        self.wide = (width - left - RIGHT - (columns - 1) * self.gap) / columns
        self.high = self.wide * aspect

        # Top of each row of pictures, and the height of the figure
        title = wrap_text(title, width - 0.1)
        top = EDGE + (0.155 * (title.count("\n") + 1) + 0.02 if title else 0.0)
        self.below = [TICKS + LABEL if with_x is None or k in with_x else 0.0 for k in range(rows)]
        self.tops: list[float] = []
        for x_axis in self.below:
            self.tops.append(top + TITLE)
            top += TITLE + self.high + x_axis + 0.06
            if with_bars is None or len(self.tops) - 1 in with_bars:
                top += BAR + TICKS + bar_lines * LINE + 0.04
        self.height = top + EDGE + (0.16 if hatch else 0.0)

        # Figure with its title and legend
        self.figure: Figure = new_figure(width, self.height, layout=None)
        if title:
            color = {"color": title_color} if title_color else {}
            self.figure.suptitle(title, y=1 - EDGE / self.height, va="top", **color)
        if hatch:
            self.figure.legend(
                handles=[hatch_patch(hatch)],
                loc="lower center",
                bbox_to_anchor=(0.5, 0.02 / self.height),
                borderaxespad=0,
                borderpad=0.1,
                frameon=False,
            )

    def axes(self, row: int, column: int, title: str, **options: Any) -> Axes:
        """Add the axes of a picture with options of `Figure.add_axes`."""
        box = self._box(self._left(column), self.tops[row] + self.high, self.wide, self.high)
        axes = self.figure.add_axes(box, **options)
        size = min(9.0, max(6.0, 71.9 * (self.wide + 0.1) / (0.56 * max(1, len(title)))))
        axes.set_title(wrap_text(title, self.wide + 0.1, size), fontsize=size)
        return axes

    def trim(self, axes: Axes, row: int, column: int) -> None:
        """Remove tick labels and axis labels without space. Call it after drawing."""
        if column and not self.own_y:
            axes.set_ylabel("")
            axes.tick_params(labelleft=False)
        if not self.below[row]:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)

    def bar(self, image: Any, row: int, column: int, label: str, span: int = 1, **options: Any):
        """Add a color bar of `image` below `span` pictures."""
        wide = self._left(column + span - 1) + self.wide - self._left(column)
        bottom = self.tops[row] + self.high + self.below[row] + 0.06 + BAR
        cax = self.figure.add_axes(self._box(self._left(column), bottom, wide, BAR))
        return color_bar(image, cax=cax, label=label, below=True, **options)

    def _left(self, column: int) -> float:
        return self.left + column * (self.wide + self.gap)

    def _box(self, left: float, bottom: float, wide: float, high: float) -> Any:
        """Convert inches from the left and top to fractions of the figure."""
        return (
            left / self.width,
            1 - bottom / self.height,
            wide / self.width,
            high / self.height,
        )
