"""Results of the chi-square test, and figures of these results."""

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
    """Mean over the valid samples, compared with the density's mean or with a known value.

    Attributes:
        name: Name of the moment: "x" is the mean of x, "xy" is the mean of x times y, and so on.
        sampled: Mean over the valid samples.
        expected: Expected value.
        z: Difference of both in standard errors.
        p_value: Probability that the difference is as large by chance.
    """

    name: str
    sampled: float
    expected: float
    z: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Verdict:
    """Result of `chi_square_test`. `print(verdict)` summarizes it, `verdict.figure()` draws it.

    Attributes:
        name: Name of the sampler.
        passed: Whether no failure was found.
        reason: All failures, "" if the test passed.
        p_value: Probability of a chi-square statistic of this size, NaN without a statistic.
        alpha: Smallest p-value that passes, for the statistic and for each moment. The caller's
            alpha is divided by Šidák's formula among all tests and all p-values of a test.
        chi2: Pearson's statistic.
        degrees_of_freedom: Degrees of freedom of the statistic.
        pdf_integral: Integral of the density over the domain.
        pdf_integral_error: Bound on the error of this integral.
        valid: Fraction of the samples that are valid.
        moments: Comparisons of the moments.
        observed: Counts of samples, shape (rows, columns).
        expected: Expected counts.
        edges: Edges of the columns and of the rows.
        domain: The domain of the points.
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
        """Return the result, the failures, and the most important numbers as text."""
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
        """Draw observed and expected density and their difference, without pyplot."""
        return verdict_figure(self)


@dataclass(frozen=True)
class SuiteVerdict:
    """Verdicts of several tests that share one probability of a false alarm.

    Attributes:
        passed: Whether all tests passed.
        alpha: Probability that any test fails although all samplers are correct.
        verdicts: One verdict for each case, in order.
    """

    passed: bool
    alpha: float
    verdicts: tuple[Verdict, ...]

    def __str__(self) -> str:
        """Return one line for each case that passed, and all details of the others."""
        good = sum(verdict.passed for verdict in self.verdicts)
        head = f"{good} of {len(self.verdicts)} passed (chance of a false alarm {self.alpha:g})"
        lines = [
            f"{v.name or 'sampler'}: passed, p = {v.p_value:.3g}" if v.passed else str(v)
            for v in self.verdicts
        ]
        return "\n".join([head, *lines])


@in_style()
def verdict_figure(verdict: Verdict) -> "Figure":
    """Draw observed and expected density of a chi-square test, and their difference.

    Directions are drawn over azimuth and cosine, so that equal areas are equal solid angles. Rows
    without density are omitted. The difference is in standard deviations. For a correct sampler,
    the difference is noise of size 1 without a pattern.

    Args:
        verdict: Result of `chi_square_test`.

    Returns:
        A `matplotlib.figure.Figure`, created without pyplot. `save_figure` saves it.

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
    """Draw panels of a verdict into a grid of axes.

    Both densities share one scale. The difference is in standard deviations.

    Args:
        grid: The grid of axes.
        verdict: The verdict.
        cells: Cell (row, column) of each panel.
        names: Names of the panels, from `PANELS`.
    """
    # Area of each cell; equal areas are equal solid angles
    a, b = verdict.edges
    rows = _occupied(verdict)
    directions = verdict.domain.dimensions == 3
    up = np.cos(b) if directions else b
    area = np.abs(np.multiply.outer(np.diff(up), np.diff(a)))
    total = max(float(verdict.observed.sum()), 1.0) / max(verdict.valid, 1e-9)
    area = np.maximum(area, 1e-300) * total

    # Densities and their difference. The scale leaves room for noise
    observed = verdict.observed / area
    expected = verdict.expected / area
    difference = (verdict.observed - verdict.expected) / np.sqrt(np.maximum(verdict.expected, 1))
    top = 1.2 * float(np.percentile(expected[rows], 99.5)) or 1.0
    panels = dict(zip(PANELS, (observed, expected, difference), strict=True))

    # Draw the panels
    drawn = []
    for name, (row, column) in zip(names, cells, strict=True):
        options: Any = {"cmap": "viridis", "vmin": 0, "vmax": top}
        label = "density [sr⁻¹]" if directions else "density [1/area]"
        extend = "max"
        if name == "difference":
            options = {"cmap": "RdBu_r", "vmin": -5, "vmax": 5}
            label = "standard deviations"
            extend = "both"
        axes = grid.axes(row, column, name)
        y = up[rows.start : rows.stop + 1]
        values = panels[name][rows]
        mesh = axes.pcolormesh(a, y, values, rasterized=True, **options)
        axes.set_xlabel(verdict.domain.labels[0])
        axes.set_ylabel("cos θ" if directions else verdict.domain.labels[1])
        if verdict.domain.down:
            axes.invert_yaxis()
        few_ticks(axes)
        grid.trim(axes, row, column)
        drawn.append((mesh, row, column, label, extend))

    # Add the color bars
    for mesh, row, column, label, extend in drawn:
        grid.bar(mesh, row, column, label, extend=extend)


def caption(verdict: Verdict) -> dict[str, Any]:
    """Return the verdict as the title of a `PictureGrid`, in the color of its result."""
    lines = [textwrap.shorten(line, 150) for line in str(verdict).splitlines()]
    color = palette().good if verdict.passed else palette().bad
    return {"title": "\n".join(lines), "title_color": color}


def _occupied(verdict: Verdict) -> slice:
    """Return the rows that contain almost all observed and expected points."""
    weight = (verdict.observed + np.maximum(verdict.expected, 0)).sum(axis=1)
    if verdict.domain.dimensions == 2 or not weight.sum() > 0:
        return slice(0, weight.size)
    inside = np.flatnonzero(weight > 1e-4 * weight.sum() / weight.size)
    return slice(int(inside[0]), int(inside[-1]) + 1)
