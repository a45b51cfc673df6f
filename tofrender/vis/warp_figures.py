"""Figure of a warp: points above the verdict of the chi-square test."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..runtime import checks
from ..runtime.canvas import figure_width, in_style
from ..runtime.plots import PictureGrid, few_ticks
from ..sampling.verdicts import Verdict, caption, density_panels


@in_style()
def warp_figure(points: Any, verdict: Verdict, title: str = "points") -> Figure:
    """Draw warped points and their expected density, above the verdict of a chi-square test.

    Args:
        points: Warped points, shape (2, n) in the plane or (3, n) on the sphere. A hemisphere is
            drawn from above, and a sphere is drawn over azimuth and cosine.
        verdict: Result of `chi_square_test` for the warp.
        title: Title of the first panel.

    Example:
        >>> from tofrender.sampling import grid, warp_case
        >>> case = warp_case("tent")
        >>> verdict = case.test(samples=10_000, resolution=21)
        >>> figure = warp_figure(np.array(case.sample(grid(64))), verdict)
        >>> [axes.get_title() for axes in figure.axes[:4]]
        ['points', 'expected density', 'observed density', 'difference']
    """
    # Check the arguments
    checks.instance("verdict", verdict, Verdict, "a result of chi_square_test")
    checks.instance("title", title, str, "text")
    points = checks.real_array("points", points, np.float64)
    valid = points.ndim == 2 and len(points) in (2, 3) and points.size
    checks.shape("points", points, valid, "(2, n) or (3, n)")

    # Draw the points, and the densities of the test
    grid = PictureGrid(figure_width(5.5), 2, 2, 1.0, own_y=True, **caption(verdict))
    _points(grid.axes(0, 0, title), points, verdict, grid.wide)
    names = ("expected density", "observed density", "difference")
    density_panels(grid, verdict, [(0, 1), (1, 0), (1, 1)], names)
    return grid.figure


def _points(axes: Axes, points: np.ndarray, verdict: Verdict, wide: float) -> None:
    """Draw points on axes with a width of `wide` inches. Many points have small dots."""
    size = (wide / 4.5) ** 2 * float(np.clip(600 / np.sqrt(points.shape[1]), 0.2, 12))
    domain = verdict.domain
    if points.shape[0] == 2:
        x, y = points
        labels = domain.labels
        xlim, ylim = zip(domain.low, domain.high, strict=True)
        ylim = ylim[::-1] if domain.down else ylim
    elif domain.upper_only:
        x, y = points[:2]
        labels = ("x (seen from above)", "y")
        radius = 1.05 * float(np.max(np.hypot(x, y), initial=0.0)) or 1.0
        xlim = ylim = (-radius, radius)
    else:
        x = np.arctan2(points[1], points[0])
        y = points[2]
        labels = ("φ [rad]", "cos θ")
        xlim = (-np.pi, np.pi)
        ylim = (-1, 1)
    axes.scatter(x, y, s=size, linewidths=0)
    few_ticks(axes)
    axes.set(xlabel=labels[0], ylabel=labels[1], xlim=xlim, ylim=ylim)
