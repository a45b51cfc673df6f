"""Points, grids, verdicts and figures of the warp tester."""

from __future__ import annotations

import io
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from matplotlib.figure import Figure

from ...course.judge.client import NoAnswer
from ...runtime import backend, checks, variants
from ...runtime.canvas import draw_figure, in_style, palette
from ...runtime.editions import LeftOut
from ...runtime.plots import PictureGrid
from ...samplers import padded_sobol
from ...sampling import points
from ...sampling.chi_square import Case
from ...sampling.domains import find, to_numpy
from ...sampling.verdicts import Verdict, density_panels
from ...vis.warp_figures import warp_figure
from .subjects import SUBJECTS
from .warp_sources import Module, PackageWarps, find_module, is_left_out

LIBRARY = "library"
MODULE = "module"

CELLS = 10  # Cells along a side of the grid
SEGMENTS = 160  # Segments of a line of the grid

NO_PROOF = (
    "Passing is no proof. Sampler and density can be wrong together, and more samples find "
    "smaller errors."
)

# Errors of subjects, which are shown to the reader
SUBJECT_ERRORS = (NoAnswer, ValueError, LeftOut, FileNotFoundError)


def sobol(count: int, seed: int = 0) -> mi.Point2f:
    """Return the first points of the sampler of `render`."""
    checks.integer("count", count, 1, points.MAX_COUNT)
    checks.integer("seed", seed, 0, checks.MAX_SEED)
    props = mi.Properties("padded_sobol")
    props["sample_count"] = count
    sampler = padded_sobol.PaddedSobolSampler(props)
    sampler.set_samples_per_wavefront(count)
    sampler.seed(seed, count)
    return sampler.next_2d()


# Point sets by name, called with count and seed
POINT_SETS: dict[str, Callable[[int, int], Any]] = points.POINT_SETS | {"sobol": sobol}


@dataclass(frozen=True)
class Drawn:
    """Warped points and grid, float32."""

    points: np.ndarray  # Shape (2, n) in the plane, (3, n) on the sphere
    lines: np.ndarray  # Shape (2, m) or (3, m), NaN after each line


def draw(case: Case, kind: str, count: int, seed: int) -> Drawn:
    """Warp one of `POINT_SETS` and a grid of lines."""
    # Warp the points
    numbers = POINT_SETS[checks.one_of("points", kind, POINT_SETS)](count, seed)
    warped = _warped(case, to_numpy(numbers, count))

    # Warp the grid, with NaN after each line
    fine = np.minimum(np.linspace(0, 1, SEGMENTS + 1), 1 - 2.0**-24)
    level = np.minimum(np.linspace(0, 1, CELLS + 1), 1 - 2.0**-24)
    u = np.repeat(level, fine.size)
    v = np.tile(fine, level.size)
    square = np.concatenate([np.stack([u, v]), np.stack([v, u])], axis=1)
    lines = _warped(case, square).reshape(find(case.domain).dimensions, -1, fine.size)
    gaps = np.full((*lines.shape[:2], 1), np.nan)
    lines = np.concatenate([lines, gaps], axis=2).reshape(lines.shape[0], -1)
    return Drawn(warped.astype(np.float32), lines.astype(np.float32))


def _warped(case: Case, numbers: np.ndarray) -> np.ndarray:
    """Return warped points. Points are NaN if sampling failed."""
    result = case.sample(mi.Point2f(numbers))
    result = result if isinstance(result, tuple) else (result,)
    warped = to_numpy(result[0], numbers.shape[1])
    if len(result) > 1:
        valid = np.broadcast_to(np.asarray(mi.Float(result[1])), numbers.shape[1])
        warped[:, valid == 0] = np.nan
    return warped


@in_style()
def panels(verdict: Verdict) -> str:
    """Draw observed and expected density and their difference as SVG, in the colors of the page."""
    # Draw the panels
    grid = PictureGrid(8.0, 1, 3, 1.0, own_y=True)
    density_panels(grid, verdict, [(0, 0), (0, 1), (0, 2)])
    stream = io.StringIO()
    grid.figure.savefig(stream, format="svg", dpi=200, metadata={"Date": None})

    # Replace the colors of paper and ink
    drawn = stream.getvalue()
    colors = palette()
    drawn = drawn[drawn.index("<svg") :].replace(f"fill: {colors.paper}", "fill: none")
    alt = "Observed density, expected density, and their difference in standard deviations"
    drawn = drawn.replace("<svg ", f'<svg role="img" aria-label="{alt}" ', 1)
    return drawn.replace(colors.ink, "currentColor")


def figure(drawn: Drawn, verdict: Verdict, title: str) -> Figure:
    """Return a figure of the valid points, with the verdict."""
    valid = np.isfinite(drawn.points).all(axis=0)
    return warp_figure(drawn.points[:, valid], verdict, title)


def save(drawn: Drawn, verdict: Verdict, title: str, format: str) -> bytes:
    """Return the figure as the bytes of a "png", "pdf" or "svg" file."""
    stream = io.BytesIO()
    draw_figure(figure(drawn, verdict, title), stream, f".{format}")
    return stream.getvalue()


class Engine:
    """The library, a user's module, and a thread.

    Without a module, a student edition that lacks subjects uses the working folder.
    """

    def __init__(self, module: Any = None) -> None:
        variant = backend.activate(None)
        variants.require_vectorized()
        self.module = None if module is None else Module(module)
        if module is None and any(map(is_left_out, SUBJECTS.values())):
            self.module = find_module(Path.cwd())
        self.sources: dict[str, PackageWarps | Module] = {LIBRARY: PackageWarps()}
        if self.module is not None:
            self.sources[MODULE] = self.module
        self.executor = ThreadPoolExecutor(1, initializer=backend.activate, initargs=(variant,))

    def close(self) -> None:
        """End the process of the module."""
        if self.module is not None:
            try:
                self.executor.submit(self.module.close).result()
            except RuntimeError:  # The threads of the interpreter have ended already
                self.module.close()
        self.executor.shutdown()
