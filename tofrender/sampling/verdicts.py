"""Results of the chi-square test, and figures of them."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, palette
from ..runtime.plots import COLUMN, PictureGrid, few_ticks
from .domains import Domain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANELS = ("observed density", "expected density", "difference")


@dataclass(frozen=True)
class Moment:
    """Mean over the valid samples, compared with that over the density, or with a known value.

    Attributes:
        name: "x" is the mean of x, "xy" that of x times y, and so on.
        sampled: Mean over the valid samples.
        expected: Value that it should have.
        z: Their difference in standard errors.
        p_value: Chance of a difference as large.
    """

    name: str
    sampled: float
    expected: float
    z: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Verdict:
    """Result of `chi_square_test`: `print(verdict)` sums it up, `verdict.figure()` draws it.

    Attributes:
        name: Name of the sampler.
        passed: Whether nothing speaks against the sampler.
        reason: Everything that does, "" if it passed.
        p_value: Chance of a chi-square statistic as large as this; NaN if it has none.
        alpha: Smallest p-value that passes, for the statistic and for each moment: the caller's
            alpha, divided by Šidák over the tests and over the p-values within this one.
        chi2: Pearson's statistic.
        degrees_of_freedom: Its degrees of freedom.
        pdf_integral: Integral of the density over the domain.
        pdf_integral_error: Bound on its error.
        valid: Fraction of the samples that are valid.
        moments: Moments of samples and density.
        observed: Counts of samples, shape (rows, columns).
        expected: Expected counts.
        edges: Edges of the columns and of the rows.
        domain: The domain, which names the two coordinates.
    """

    name: str
    passed: bool
    reason: str
    p_value: float
    alpha: float
    chi2: float
    degrees_of_freedom: int
    pdf_integral: float
    pdf_integral_error: float
    valid: float
    moments: tuple[Moment, ...]
    observed: np.ndarray = field(repr=False)
    expected: np.ndarray = field(repr=False)
    edges: tuple[np.ndarray, np.ndarray] = field(repr=False)
    domain: Domain = field(repr=False)

    def __str__(self) -> str:
        """Result, reasons, and the numbers behind them."""
        worst = max(self.moments, key=lambda moment: abs(moment.z))
        result = "passed" if self.passed else f"FAILED, {self.reason}"
        return (
            f"{self.name or 'sampler'}: {result}\n"
            f"  chi-square {self.chi2:.1f}, {self.degrees_of_freedom} degrees of freedom, "
            f"p = {self.p_value:.3g} (must be {self.alpha:.2g} or more)\n"
            f"  integral of the pdf {self.pdf_integral:.5f} +- {self.pdf_integral_error:.5f}, "
            f"valid samples {self.valid:.5f}, "
            f"worst moment {worst.name}: {worst.z:+.1f} standard errors"
        )

    def figure(self) -> "Figure":
        """Observed and expected density and their difference, as a figure outside of pyplot."""
        return verdict_figure(self)


@dataclass(frozen=True)
class SuiteVerdict:
    """Verdicts of several tests that share one chance of a false alarm.

    Attributes:
        passed: Whether all passed.
        alpha: Chance that any of them fails though all samplers are correct.
        verdicts: One for each case, in order.
    """

    passed: bool
    alpha: float
    verdicts: tuple[Verdict, ...]

    def __str__(self) -> str:
        """One line a case, and all of each that failed."""
        good = sum(verdict.passed for verdict in self.verdicts)
        head = f"{good} of {len(self.verdicts)} passed (chance of a false alarm {self.alpha:g})"
        lines = [
            f"{v.name or 'sampler'}: passed, p = {v.p_value:.3g}" if v.passed else str(v)
            for v in self.verdicts
        ]
        return "\n".join([head, *lines])


@in_style()
def verdict_figure(verdict: Verdict) -> "Figure":
    """Observed and expected density of a chi-square test, and their difference in each cell.

    Directions are drawn over azimuth and cosine, where equal areas are equal solid angles; rows
    without density are left out. The difference is in standard deviations: noise of size 1 with no
    pattern is what a correct sampler shows.

    Args:
        verdict: Result of `chi_square_test`.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot; `save_figure` writes it.

    Example:
        >>> from tofrender.sampling import warp_case
        >>> verdict = warp_case("tent").test(samples=10_000, resolution=21)
        >>> figure = verdict.figure()
        >>> [axes.get_title() for axes in figure.axes[:3]]
        ['observed density', 'expected density', 'difference']
    """
    checks.instance("verdict", verdict, Verdict, "a result of chi_square_test")
    width = figure_width(7.0)
    columns = 3 if width >= COLUMN else 2
    grid = PictureGrid(width, -(-3 // columns), columns, 1.0, own_y=True, **caption(verdict))
    density_panels(grid, verdict, [divmod(k, columns) for k in range(3)])
    return grid.figure


def density_panels(
    grid: PictureGrid, verdict: Verdict, cells: Sequence[tuple[int, int]], names: Any = PANELS
) -> None:
    """Draw the panels `names`, of `PANELS`, in the cells (row, column) of a grid.

    Both densities have one scale; the difference is in standard deviations.
    """
    a, b = verdict.edges
    rows = _occupied(verdict)
    directions = verdict.domain.dimensions == 3
    up = np.cos(b) if directions else b
    area = np.abs(np.multiply.outer(np.diff(up), np.diff(a)))
    total = max(float(verdict.observed.sum()), 1.0) / max(verdict.valid, 1e-9)
    area = np.maximum(area, 1e-300) * total
    observed, expected = verdict.observed / area, verdict.expected / area
    difference = (verdict.observed - verdict.expected) / np.sqrt(np.maximum(verdict.expected, 1))
    top = 1.2 * float(np.percentile(expected[rows], 99.5)) or 1.0  # room for noise above
    panels = dict(zip(PANELS, (observed, expected, difference), strict=True))
    drawn = []
    for name, (row, column) in zip(names, cells, strict=True):
        options: Any = {"cmap": "viridis", "vmin": 0, "vmax": top}
        label, extend = "density [sr⁻¹]" if directions else "density [1/area]", "max"
        if name == "difference":
            options = {"cmap": "RdBu_r", "vmin": -5, "vmax": 5}
            label, extend = "standard deviations", "both"
        axes = grid.axes(row, column, name)
        y, values = up[rows.start : rows.stop + 1], panels[name][rows]
        mesh = axes.pcolormesh(a, y, values, rasterized=True, **options)
        axes.set_xlabel(verdict.domain.labels[0])
        axes.set_ylabel("cos θ" if directions else verdict.domain.labels[1])
        if verdict.domain.down:
            axes.invert_yaxis()
        few_ticks(axes)
        grid.trim(axes, row, column)
        drawn.append((mesh, row, column, label, extend))
    for mesh, row, column, label, extend in drawn:
        grid.bar(mesh, row, column, label, extend=extend)


def caption(verdict: Verdict) -> dict[str, Any]:
    """Verdict as the title of a `PictureGrid`, in the colour of good or of bad."""
    lines = [textwrap.shorten(line, 150) for line in str(verdict).splitlines()]
    colour = palette().good if verdict.passed else palette().bad
    return {"title": "\n".join(lines), "title_color": colour}


def _occupied(verdict: Verdict) -> slice:
    """Rows that hold all points, observed or expected, but for one in ten thousand."""
    weight = (verdict.observed + np.maximum(verdict.expected, 0)).sum(axis=1)
    if verdict.domain.dimensions == 2 or not weight.sum() > 0:
        return slice(0, weight.size)
    inside = np.flatnonzero(weight > 1e-4 * weight.sum() / weight.size)
    return slice(int(inside[0]), int(inside[-1]) + 1)
