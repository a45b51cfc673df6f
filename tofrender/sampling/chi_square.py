"""Chi-square test that compares a sampler with its density.

Samples are counted in cells. The integral of the density over each cell is the expected count.
Pearson's statistic gives the probability that a difference of this size occurs by chance. The test
also checks that

- samples and density are finite,
- samples are inside the domain, and only where the density is above 0,
- the density is not negative, and integrates to one or to the fraction of valid samples,
- first and second moments of samples and density agree.

A warp and a density can be wrong in the same way. Only independent values reveal such an error:
pass them as `expected_moments`.

`mi.chi2` contains a similar test, and its domain objects are supported here. Its test accepts some
errors: points off the sphere, densities that are negative within cells, and a tent that integrates
to 0.99 (with a million samples). It also rejects a correct Beckmann density with alpha = 0.1: its
four points along a cell integrate this density to 1.14.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.special import chdtrc

from ..runtime import checks
from ..runtime.atomic import check_file
from ..runtime.canvas import FIGURE_SUFFIXES, save_figure
from . import cell_counts, domains
from .statistics import smallest_allowed
from .verdicts import Moment, SuiteVerdict, Verdict

MAX_SAMPLES = 1 << 24

# Difference of a density's integral from one that single precision explains
INTEGRAL_ROUNDING = 2e-4

# Mean relative difference of returned densities from `pdf` that single precision explains
RETURNED_ROUNDING = 1e-3


def check_chance(alpha: Any) -> None:
    """Raise a ValueError if the probability `alpha` is not between 0 and 1."""
    if not 0 < checks.number("alpha", alpha, low=0, high=1) < 1:
        raise ValueError(f"alpha = {checks.quote(alpha)}: must be a number between 0 and 1")


def chi_square_test(
    sample: Callable[[Any], Any],
    pdf: Callable[[Any], mi.Float],
    domain: Any,
    *,
    samples: int = 1_000_000,
    resolution: int = 101,
    seed: int = 0,
    alpha: float = 1e-3,
    tests: int = 1,
    name: str = "",
    sample_dimension: int = 2,
    expected_moments: Mapping[str, float] | None = None,
    figure: str | os.PathLike | None = None,
) -> Verdict:
    """Test whether `sample` has the density `pdf`.

    Args:
        sample: Function of `sample_dimension` uniform numbers per lane (`mi.Point2f` or
            `mi.Point3f`). It returns points, as `mi.Point2f` or `mi.Vector3f`. It may also return
            (points, weights), with the weight 0 for failed samples and 1 otherwise, or (points,
            weights, densities). Then the densities are compared with `pdf`.
        pdf: Density at points, per unit area or steradian.
        domain: Domain of the points: "square" or "image" ([0, 1]^2), "plane" or "disk"
            ([-1, 1]^2), "sphere", "hemisphere", or a domain object of `mi.chi2`.
        samples: Number of samples, from 1000 to 2^24. More samples find smaller errors.
        resolution: Rows of cells, from 2 to 512.
        seed: Seed of the random numbers, from 0 to 2^32 - 1.
        alpha: Probability that a correct sampler fails in any of the `tests`, between 0 and 1.
        tests: Number of tests that share `alpha`.
        name: Name of the sampler in the verdict.
        sample_dimension: Uniform numbers per sample, 2 or 3.
        expected_moments: Known moments of valid samples, for example {"z": 0.5, "xx": 0.25}.
        figure: File of a figure that is saved if the test fails.

    Returns:
        The verdict. A failed test does not raise an error.

    Raises:
        ValueError: An argument is out of range, or weights are neither 0 nor 1.

    Example:
        >>> from tofrender.sampling.warps import square_to_tent, square_to_tent_pdf
        >>> chi_square_test(square_to_tent, square_to_tent_pdf, "plane", samples=50_000).passed
        True
        >>> half = lambda p: 0.5 * square_to_tent_pdf(p)
        >>> chi_square_test(square_to_tent, half, "plane", samples=50_000).reason
        'the pdf integrates to 0.50000, not 1; ...'
    """
    # Check the arguments. `Case` checks the arguments that it stores
    Case(sample, pdf, domain, name, sample_dimension, expected_moments)
    domain = domains.find(domain)
    checks.integer("samples", samples, 1000, MAX_SAMPLES)
    checks.integer("resolution", resolution, 2, 512)
    checks.integer("seed", seed, 0, checks.MAX_SEED)
    checks.integer("tests", tests, 1, 1_000_000)
    check_chance(alpha)
    known = checks.mapping("expected_moments", expected_moments)
    for key in known:
        checks.one_of("expected_moments", key, cell_counts.MOMENTS[domain.dimensions])
    path = None
    if figure is not None:
        path = check_file(figure, *FIGURE_SUFFIXES, overwrite=True, name="figure")
    if path is not None and not path.parent.is_dir():
        raise ValueError(f"figure = {path}: {path.parent} must be a folder that exists")

    # Draw samples and count them in cells. A pilot run determines the edges of the cells
    pilot = _draw(sample, sample_dimension, max(1000, samples // 16), seed ^ 0x9E3779B9)
    drawn = _draw(sample, sample_dimension, samples, seed)
    if drawn.points.shape[0] != domain.dimensions:
        raise ValueError(
            f"sample: it returns points of {drawn.points.shape[0]} dimensions. This domain "
            f"requires {domain.dimensions} dimensions"
        )
    points = drawn.points[:, drawn.valid]
    edges = cell_counts.cell_edges(
        domain, domain.to_plane(pilot.points[:, pilot.valid]), resolution
    )
    cell = cell_counts.cell_of(edges, domain.to_plane(points))
    observed = np.bincount(cell, minlength=(edges[0].size - 1) * (edges[1].size - 1))

    # Integrate the density and its moments over the cells. Moments are relative to the samples'
    # mean, so that an error of the integral cancels
    density = _values(pdf, points)
    highest = np.zeros(observed.size)
    np.maximum.at(highest, cell, np.where(np.isfinite(density), density, 0.0))
    mean = cell_counts.second_moments(points).sum(axis=1, keepdims=True) / max(points.shape[1], 1)
    functions = lambda p: cell_counts.second_moments(p) - mean  # noqa: E731
    options: Any = {"samples": samples, "highest": highest, "seed": seed}
    integrals = cell_counts.integrate(pdf, functions, domain, edges, **options)
    observed = observed.reshape(integrals.cells.shape)

    # Compare counts and moments. All p-values share the probability `alpha`
    moments = cell_counts.compare_moments(points, integrals, known)
    smallest = smallest_allowed(smallest_allowed(alpha, tests), 1 + len(moments))
    chi2, freedom = cell_counts.statistic(observed, integrals, samples)
    p_value = float(chdtrc(freedom, chi2)) if freedom > 0 else math.nan
    failed_moments = [moment for moment in moments if not moment.p_value >= smallest]
    failed_moments.sort(key=lambda moment: -abs(np.nan_to_num(moment.z, nan=np.inf)))

    # List the failures
    valid = float(drawn.valid.mean())
    total = integrals.total
    bound = INTEGRAL_ROUNDING + 5 * integrals.total_error
    spread = 5 * math.sqrt(max(valid * (1 - valid), 1 / samples) / samples) if drawn.weighted else 0
    right = f"{valid:.5f}, the fraction of valid samples" if drawn.weighted else "1"
    outside = points[:, ~domain.contains(points)]
    misplaced = _where_zero(pdf, points[:, density == 0])
    pdf_error = _difference(density, drawn.density)
    differs = not pdf_error <= RETURNED_ROUNDING
    poor = integrals.total_error > 0.01
    percent = 100 * integrals.not_finite
    unlike = freedom >= 1 and not p_value >= smallest
    table: dict[str, Any] = {
        f"{drawn.bad} of {samples} samples are not finite": drawn.bad,
        f"{outside.shape[1]} samples lie outside of the domain, {_first(outside)}": outside.size,
        f"the pdf is not finite at {percent:.3g} % of the domain": percent,
        f"the pdf is negative, down to {integrals.lowest:.3g}": integrals.lowest < 0,
        "the pdf is not finite at some samples": not np.isfinite(density).all(),
        f"{misplaced.shape[1]} samples lie where the pdf is 0, {_first(misplaced)}": misplaced.size,
        f"the pdf returned with samples differs from it by {pdf_error:.2g}": differs,
        f"the pdf integrates to {total:.5f}, not {right}": abs(total - valid) > bound + spread,
        "the pdf cannot be integrated to 5 %; a higher resolution may help": poor,
        "there are too few valid samples, or cells that expect any": freedom < 1,
        f"counts do not follow the pdf (p = {p_value:.2g})": unlike,
        **{f"the mean of {_in_words(moment)}": True for moment in failed_moments[:2]},
        f"{len(failed_moments) - 2} more moments are off": len(failed_moments) > 2,
    }
    failures = [message for message, failed in table.items() if failed]

    # Describe the result
    verdict = Verdict(
        name=name,
        passed=not failures,
        reason="; ".join(failures),
        p_value=p_value,
        alpha=smallest,
        chi2=chi2,
        degrees_of_freedom=freedom,
        pdf_integral=integrals.total,
        pdf_integral_error=bound,
        valid=valid,
        moments=moments,
        observed=observed,
        expected=samples * integrals.cells,
        edges=edges,
        domain=domain,
    )
    if path is not None and not verdict.passed:
        save_figure(verdict.figure(), path)
    return verdict


@dataclass(frozen=True)
class _Drawn:
    """Samples, with the weights and densities that the sampler returned."""

    # Points, (dimensions, n)
    points: np.ndarray

    # Mask of the valid points
    valid: np.ndarray

    # Number of points that are not finite
    bad: int

    # Whether the sampler returned weights
    weighted: bool

    # Densities of the valid points, None if the sampler did not return densities
    density: np.ndarray | None


def _draw(sample: Callable[[Any], Any], dimension: int, count: int, seed: int) -> _Drawn:
    """Run the sampler with uniform numbers, and check the form of its results."""
    # Run the sampler
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    pair = sampler.next_2d()
    result = sample(pair if dimension == 2 else mi.Point3f(sampler.next_1d(), pair.x, pair.y))
    result = result if isinstance(result, tuple) else (result,)
    dr.eval(result)

    # Read points and weights
    points = domains.to_numpy(result[0], count)
    more = [np.broadcast_to(np.asarray(mi.Float(each), np.float64), count) for each in result[1:]]
    weights = more[0] if more else np.ones(count)
    odd = np.isfinite(weights) & (weights != 0) & (weights != 1)
    if odd.any():
        raise ValueError(
            f"sample: it returns the weight {weights[odd][0]:g}. Return 0 for failed samples and "
            "1 otherwise"
        )

    # Find the valid samples
    finite = np.isfinite(weights) & (np.isfinite(points).all(axis=0) | (weights == 0))
    valid = finite & (weights == 1)
    density = more[1][valid] if len(more) > 1 else None
    return _Drawn(
        points=points,
        valid=valid,
        bad=count - int(finite.sum()),
        weighted=bool(more),
        density=density,
    )


def _values(pdf: Callable[[Any], mi.Float], points: np.ndarray) -> np.ndarray:
    """Evaluate the density at points (dimensions, n)."""
    values = np.asarray(mi.Float(pdf(domains.to_drjit(points))), dtype=np.float64)
    return np.broadcast_to(values, points.shape[1])


def _where_zero(pdf: Callable[[Any], mi.Float], points: np.ndarray) -> np.ndarray:
    """Return points with the density 0, except points near an edge, where rounding explains it."""
    # Move each point a little along each axis; drop it if the density there is above 0
    for step in (1e-6, 1e-5, 1e-4):
        for axis, sign in np.ndindex(points.shape[0], 2):
            if points.size:
                moved = points.copy()
                moved[axis] += step if sign else -step
                if points.shape[0] == 3:
                    moved /= np.linalg.norm(moved, axis=0)
                points = points[:, ~(_values(pdf, moved) > 0)]
    return points


def _difference(density: np.ndarray, returned: np.ndarray | None) -> float:
    """Return the mean relative difference of returned densities from `pdf`, 0 without any."""
    if returned is None or not density.size:
        return 0.0
    return float(np.mean(np.abs(returned - density)) / max(np.mean(density), 1e-300))


def _first(points: np.ndarray) -> str:
    """Describe the first point, for messages."""
    return f"e.g. ({', '.join(f'{x:.6g}' for x in points[:, :1].ravel())})"


def _in_words(moment: Moment) -> str:
    """Describe a moment, for messages."""
    values = f"{moment.sampled:.6g}, not {moment.expected:.6g}"
    return f"{moment.name} is {values} ({moment.z:+.1f} standard errors)"


@dataclass(frozen=True)
class Case:
    """A sampler and its density. The fields are arguments of `chi_square_test`."""

    sample: Callable[[Any], Any]
    pdf: Callable[[Any], mi.Float]
    domain: Any
    name: str = ""
    sample_dimension: int = 2
    expected_moments: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        """Check the arguments."""
        checks.function("sample", self.sample)
        checks.function("pdf", self.pdf)
        domains.find(self.domain)
        checks.instance("name", self.name, str, "text")
        checks.integer("sample_dimension", self.sample_dimension, 2, 3)
        checks.mapping("expected_moments", self.expected_moments)

    def test(self, **options: Any) -> Verdict:
        """Run `chi_square_test` with further keyword arguments.

        Example:
            >>> import drjit as dr
            >>> even = lambda p: dr.full(mi.Float, 1, dr.width(p))
            >>> Case(lambda sample: sample, even, "square").test(samples=20_000).passed
            True
        """
        return chi_square_test(**vars(self), **options)


def chi_square_suite(cases: Iterable[Case], alpha: float = 1e-3, **options: Any) -> SuiteVerdict:
    """Test several samplers with a common probability of a false alarm (Šidák).

    Args:
        cases: At least one case. Each case gets a different seed.
        alpha: Probability that any test fails although all samplers are correct, between 0 and 1.
        **options: Arguments of `chi_square_test`: samples, resolution, seed.

    Example:
        >>> from tofrender.sampling import warp_case
        >>> cases = [warp_case("tent"), warp_case("beckmann", alpha=0.3)]
        >>> chi_square_suite(cases, samples=20_000).passed
        True
    """
    given = list(cases) if isinstance(cases, Iterable) else []
    if not given or not all(isinstance(each, Case) for each in given):
        raise ValueError(f"cases = {checks.quote(cases)}: must be at least one Case, no other")
    check_chance(alpha)
    first = checks.integer("seed", options.pop("seed", 0), 0, checks.MAX_SEED - len(given))
    verdicts = tuple(
        case.test(alpha=alpha, tests=len(given), seed=first + k, **options)
        for k, case in enumerate(given)
    )
    return SuiteVerdict(all(verdict.passed for verdict in verdicts), alpha, verdicts)
