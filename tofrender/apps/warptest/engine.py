"""What the warp tester computes, apart from any window: points, grids, verdicts and figures."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import mitsuba as mi
import numpy as np

from ...course.judge.client import NoAnswer
from ...runtime import backend, checks
from ...runtime.canvas import draw_figure, in_style, palette
from ...runtime.plots import PictureGrid
from ...runtime.withheld import Withheld
from ...samplers import padded_sobol
from ...sampling import points
from ...sampling.chi_square import Case
from ...sampling.domains import to_numpy
from ...sampling.verdicts import Verdict, density_panels
from ...vis.warps import warp_figure
from .sources import Library, Module, find_module, why_withheld
from .subjects import SUBJECTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar("T")
LIBRARY, MODULE = "library", "module"

CELLS = 10
"""Cells along a side of the grid that is drawn."""

STEPS = 160
"""Pieces of a line of the grid."""

NO_PROOF = (
    "Passing is no proof. Sampler and density can be wrong together, and more samples find "
    "smaller errors."
)

TROUBLE = (NoAnswer, ValueError, Withheld, FileNotFoundError)
"""What a subject may raise that is to be shown."""


def sobol(count: int, seed: int = 0) -> mi.Point2f:
    """The first points of the sampler with which this package renders.

    Example:
        >>> sorted(int(4 * x) for x in sobol(4).x)
        [0, 1, 2, 3]
    """
    checks.integer("count", count, 1, points.MAX_COUNT)
    checks.integer("seed", seed, 0, checks.MAX_SEED)
    props = mi.Properties("padded_sobol")
    props["sample_count"] = count
    sampler = padded_sobol.PaddedSobolSampler(props)
    sampler.set_samples_per_wavefront(count)
    sampler.seed(seed, count)
    return sampler.next_2d()


POINT_SETS: dict[str, Callable[[int, int], Any]] = points.POINT_SETS | {"sobol": sobol}
"""Every point set by its name, called with count and seed."""


@dataclass(frozen=True)
class Drawn:
    """Points and grid of a subject.

    Attributes:
        points: Shape (2, n) in the plane, (3, n) on the sphere, float32.
        lines: The warped grid, NaN after each line, shape (2, m) or (3, m), float32.
    """

    points: np.ndarray
    lines: np.ndarray


def draw(case: Case, kind: str, count: int, seed: int) -> Drawn:
    """Warp a point set and a grid of lines.

    Args:
        case: Sampler and density.
        kind: A name in `POINT_SETS`.
        count: Number of points.
        seed: Seed of those that are random.

    Example:
        >>> from tofrender.sampling import warp_case
        >>> draw(warp_case("tent"), "grid", 16, 0).points.shape
        (2, 16)
    """
    numbers = POINT_SETS[checks.one_of("points", kind, POINT_SETS)](count, seed)
    warped = _warped(case, to_numpy(numbers, count))
    fine = np.minimum(np.linspace(0, 1, STEPS + 1), 1 - 2.0**-24)
    level = np.minimum(np.linspace(0, 1, CELLS + 1), 1 - 2.0**-24)
    u, v = np.repeat(level, fine.size), np.tile(fine, level.size)
    square = np.concatenate([np.stack([u, v]), np.stack([v, u])], axis=1)
    lines = _warped(case, square).reshape(case_dimensions(case), -1, fine.size)
    gaps = np.full((*lines.shape[:2], 1), np.nan)
    lines = np.concatenate([lines, gaps], axis=2).reshape(lines.shape[0], -1)
    return Drawn(warped.astype(np.float32), lines.astype(np.float32))


def case_dimensions(case: Case) -> int:
    """Coordinates of a point of a case."""
    from ...sampling.domains import find

    return find(case.domain).dimensions


def _warped(case: Case, numbers: np.ndarray) -> np.ndarray:
    """Points, NaN where sampling failed."""
    result = case.sample(mi.Point2f(numbers))
    result = result if isinstance(result, tuple) else (result,)
    warped = to_numpy(result[0], numbers.shape[1])
    if len(result) > 1:
        valid = np.broadcast_to(np.asarray(mi.Float(result[1])), numbers.shape[1])
        warped[:, valid == 0] = np.nan
    return warped


# ----------------------------------------------------------------------------------- figures


@in_style
def panels(verdict: Verdict) -> str:
    """Observed and expected density and their difference as SVG, in the colours of the page."""
    grid = PictureGrid(8.0, 1, 3, 1.0, own_y=True)
    density_panels(grid, verdict, [(0, 0), (0, 1), (0, 2)])
    stream = io.StringIO()
    grid.figure.savefig(stream, format="svg", dpi=200, metadata={"Date": None})
    drawn = stream.getvalue()
    colours = palette()
    drawn = drawn[drawn.index("<svg") :].replace(f"fill: {colours.paper}", "fill: none")
    alt = "Observed density, expected density, and their difference in standard deviations"
    drawn = drawn.replace("<svg ", f'<svg role="img" aria-label="{alt}" ', 1)
    return drawn.replace(colours.ink, "currentColor")


def figure(drawn: Drawn, verdict: Verdict, title: str) -> Figure:
    """Points above the verdict.

    Args:
        drawn: Points.
        verdict: What the test found.
        title: Above the points.
    """
    there = np.isfinite(drawn.points).all(axis=0)
    return warp_figure(drawn.points[:, there], verdict, title)


def save(drawn: Drawn, verdict: Verdict, title: str, format: str) -> bytes:
    """The same as a file, "png", "pdf" or "svg"."""
    stream = io.BytesIO()
    draw_figure(figure(drawn, verdict, title), stream, f".{format}")
    return stream.getvalue()


# --------------------------------------------------------------------------------- the engine


class Engine:
    """Library and student's module, and the one thread that asks them.

    Args:
        module: A student's file or folder; by default the working folder in a student edition,
            else none.

    Raises:
        ValueError: The module cannot be used; one line.
    """

    def __init__(self, module: Any = None) -> None:
        variant = backend.activate(None)
        backend.require_vectorised()
        self.library = Library()
        self.module = None if module is None else Module(module)
        if module is None and any(map(why_withheld, SUBJECTS.values())):
            from pathlib import Path

            self.module = find_module(Path.cwd())
        self._thread = ThreadPoolExecutor(1, initializer=backend.activate, initargs=(variant,))

    @property
    def sources(self) -> list[str]:
        """Whose functions there are."""
        return [LIBRARY] + [MODULE] * (self.module is not None)

    def names(self, source: str) -> list[str]:
        """The subjects of a source."""
        those = self.library if source == LIBRARY or self.module is None else self.module
        return those.names()

    def case(self, source: str, name: str, given: Mapping[str, Any]) -> Case:
        """A subject of a source with its parameters.

        Raises:
            ValueError: A parameter is wrong; one line.
            Withheld: The library does not have it.
        """
        values = SUBJECTS[name].values(given)
        those = self.library if source == LIBRARY or self.module is None else self.module
        return those.case(name, values)

    def has_changed(self) -> bool:
        """Whether a file of the module has changed since last asked."""
        return self.module is not None and self.module.refresh()

    async def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """Call a function in the engine's thread."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._thread, function, *arguments)

    def close(self) -> None:
        """End the student's process."""
        if self.module is not None:
            try:
                self._thread.submit(self.module.close).result()
            except RuntimeError:  # The interpreter ends; its threads have
                self.module.close()
        self._thread.shutdown()
