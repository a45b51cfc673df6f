"""The chi-square test of a sampler against the density that it claims to have.

Points are counted in cells; the density, integrated over each cell, says how many to expect; and
Pearson's statistic says how likely so large a difference is by chance. That alone does not prove
much, so the test looks at more: samples and density are finite, samples lie in the domain and never
where the density is 0, the density is nowhere negative and integrates to one (or to the share of
samples that are valid), and first and second moments of both agree.

A warp and a density can be wrong together. Only values known from elsewhere show that: pass them
as `expected_moments`.

`mi.chi2` has such a test too, and its domain objects work here. The test itself is not used: it
accepts points off the sphere, densities that are negative within cells, and, with a million
samples, a tent that integrates to 0.99; and it rejects a right Beckmann density with alpha = 0.1,
of which its four points along a cell make 1.14.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.atomic import check_file
from ..runtime.canvas import FIGURE_SUFFIXES, save_figure
from . import domains, histograms
from .statistics import smallest_allowed
from .verdicts import Moment, Verdict

MAX_SAMPLES = 1 << 24
ROUNDING = 1e-6
"""Relative difference of two moments that single precision explains."""

INTEGRAL_ROUNDING = 2e-4
"""Difference of a density's integral from one that single precision explains."""

STATED_ROUNDING = 1e-3
"""Mean relative difference of the density that a sampler returns from `pdf` of its samples."""

NAMES = {2: ("x", "y", "xx", "xy", "yy"), 3: ("x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz")}
"""First and second moments in the plane and in space."""


def check_chance(alpha: Any) -> None:
    """Refuse an `alpha` that is no chance.

    Raises:
        ValueError: One line with its value.
    """
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
        sample: Takes `sample_dimension` uniform numbers a lane (`mi.Point2f` or `mi.Point3f`) and
            returns points: `mi.Point2f` or `mi.Vector3f`. It may return (points, weights), with
            weight 0 where sampling failed and 1 elsewhere, or (points, weights, densities), which
            are then compared with `pdf`.
        pdf: Density at points, per unit area or steradian.
        domain: Where the points lie: "square" or "image" ([0, 1]^2), "plane" or "disk"
            ([-1, 1]^2), "sphere", "hemisphere", or a domain object of `mi.chi2`.
        samples: Number of samples, from 1000 to 2^24. More find smaller errors.
        resolution: Rows of cells, from 2 to 512.
        seed: Seed of the random numbers, from 0 to 2^32 - 1.
        alpha: Chance that a right sampler fails in any of the `tests`, between 0 and 1.
        tests: Number of tests that share `alpha`.
        name: What is tested, for the verdict.
        sample_dimension: Uniform numbers a sample takes, 2 or 3.
        expected_moments: Known moments of valid samples, {"z": 0.5, "xx": 0.25} for example.
        figure: Picture to save if the test fails.

    Returns:
        The verdict. The test itself raises nothing when it fails.

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
    checks.function("sample", sample)
    checks.function("pdf", pdf)
    checks.instance("name", name, str, "text")
    domain = domains.find(domain)
    dimensions = domain.dimensions
    checks.integer("samples", samples, 1000, MAX_SAMPLES)
    checks.integer("resolution", resolution, 2, 512)
    checks.integer("seed", seed, 0, checks.MAX_SEED)
    checks.integer("tests", tests, 1, 1_000_000)
    checks.integer("sample_dimension", sample_dimension, 2, 3)
    check_chance(alpha)
    known = checks.mapping("expected_moments", expected_moments)
    for key in known:
        checks.one_of("expected_moments", key, NAMES[dimensions])
    path = None
    if figure is not None:
        path = check_file(figure, *FIGURE_SUFFIXES, overwrite=True, name="figure")
    if path is not None and not path.parent.is_dir():
        raise ValueError(f"figure = {path}: {path.parent} must be a folder that exists")

    # ------------------------------------------------------------------------ count, integrate
    pilot = _draw(sample, sample_dimension, max(1000, samples // 16), seed ^ 0x9E3779B9)
    drawn = _draw(sample, sample_dimension, samples, seed)
    wrong = [drawn.complaint] if drawn.complaint else []
    if drawn.points.shape[0] != dimensions:
        kinds = f"points of {drawn.points.shape[0]} dimensions"
        raise ValueError(f"sample: returns {kinds}, must be {dimensions} in this domain")
    points = drawn.points[:, drawn.valid]
    edges = histograms.cell_edges(domain, domain.to_plane(pilot.points[:, pilot.valid]), resolution)
    cell = histograms.cell_of(edges, domain.to_plane(points))
    observed = np.bincount(cell, minlength=(edges[0].size - 1) * (edges[1].size - 1))
    density = _values(pdf, points)
    highest = np.zeros(observed.size)
    np.maximum.at(highest, cell, np.where(np.isfinite(density), density, 0.0))
    mean = _second_moments(points).sum(axis=1, keepdims=True) / max(points.shape[1], 1)
    integrals = histograms.integrate(
        pdf,
        lambda p: _second_moments(p) - mean,  # an error of the integral itself then cancels
        domain,
        edges,
        samples=samples,
        highest=highest,
        seed=seed,
    )
    observed = observed.reshape(integrals.cells.shape)
    wrong += _off_domain(domain, points) + _bad_density(integrals)
    wrong += _without_density(pdf, points, density) + _misstated(density, drawn.stated)

    # ------------------------------------------------------------------------ compare
    valid = float(drawn.valid.mean())
    bound = INTEGRAL_ROUNDING + 5 * integrals.total_error
    spread = 5 * math.sqrt(max(valid * (1 - valid), 1 / samples) / samples) if drawn.weighted else 0
    if abs(integrals.total - valid) > bound + spread:
        share = f"{valid:.5f}, the share of valid samples" if drawn.weighted else "1"
        wrong.append(f"the pdf integrates to {integrals.total:.5f}, not {share}")
    if integrals.total_error > 0.01:
        wrong.append("the pdf cannot be integrated to 5 %; a higher resolution may help")
    moments = _compare(points, integrals, known)
    bound_p = smallest_allowed(smallest_allowed(alpha, tests), 1 + len(moments))
    chi2, freedom = _statistic(observed, integrals, samples)
    p_value = 1 - mi.math_py.rlgamma(freedom / 2, chi2 / 2) if freedom > 0 else math.nan
    if freedom < 1:
        wrong.append("there are too few valid samples, or cells that expect any")
    elif not p_value >= bound_p:
        wrong.append(f"counts do not follow the pdf (p = {p_value:.2g})")
    off = [moment for moment in moments if not moment.p_value >= bound_p]
    off.sort(key=lambda moment: -abs(np.nan_to_num(moment.z, nan=np.inf)))
    for moment in off[:2]:
        values = f"{moment.sampled:.6g}, not {moment.expected:.6g}"
        wrong.append(f"the mean of {moment.name} is {values} ({moment.z:+.1f} standard errors)")
    if len(off) > 2:
        wrong.append(f"{len(off) - 2} more moments are off")
    verdict = Verdict(
        name=name,
        passed=not wrong,
        reason="; ".join(wrong),
        p_value=p_value,
        alpha=bound_p,
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


# ------------------------------------------------------------------------------- the samples


@dataclass(frozen=True)
class _Drawn:
    """Points (dimensions, n), which of them are valid, and the densities returned for the valid."""

    points: np.ndarray
    valid: np.ndarray
    weighted: bool
    stated: np.ndarray | None
    complaint: str


def _draw(sample: Callable[[Any], Any], dimension: int, count: int, seed: int) -> _Drawn:
    """Run the sampler."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    pair = sampler.next_2d()
    result = sample(pair if dimension == 2 else mi.Point3f(sampler.next_1d(), pair.x, pair.y))
    result = result if isinstance(result, tuple) else (result,)
    dr.eval(result)
    points = domains.to_numpy(result[0], count)
    more = [np.broadcast_to(np.asarray(mi.Float(each), np.float64), count) for each in result[1:]]
    weights = more[0] if more else np.ones(count)
    odd = np.isfinite(weights) & (weights != 0) & (weights != 1)
    if odd.any():
        raise ValueError(f"sample: returns the weight {weights[odd][0]:g}, must be 0 or 1")
    finite = np.isfinite(weights) & (np.isfinite(points).all(axis=0) | (weights == 0))
    bad = count - int(finite.sum())
    valid = finite & (weights == 1)
    return _Drawn(
        points=points,
        valid=valid,
        weighted=bool(more),
        stated=more[1][valid] if len(more) > 1 else None,
        complaint=f"{bad} of {count} samples are not finite" if bad else "",
    )


def _off_domain(domain: domains.Domain, points: np.ndarray) -> list[str]:
    """A complaint if points lie off their domain."""
    off = ~domain.contains(points)
    if not off.any():
        return []
    where = ", ".join(f"{x:.6g}" for x in points[:, off][:, 0])
    return [f"{off.sum()} samples lie outside of the domain, e.g. ({where})"]


def _bad_density(integrals: histograms.Integrals) -> list[str]:
    """Complaints if the density cannot be one."""
    wrong = []
    if integrals.not_finite:
        wrong.append(f"the pdf is not finite at {100 * integrals.not_finite:.3g} % of the domain")
    if integrals.lowest < 0:
        wrong.append(f"the pdf is negative, down to {integrals.lowest:.3g}")
    return wrong


def _without_density(
    pdf: Callable[[Any], mi.Float], points: np.ndarray, density: np.ndarray
) -> list[str]:
    """Complaints if the density at samples is 0, or not finite."""
    wrong = [] if np.isfinite(density).all() else ["the pdf is not finite at some samples"]
    lost = points[:, density == 0]
    # Rounding puts a few samples on the wrong side of an edge, so look around them.
    for step in (1e-6, 1e-5, 1e-4):
        for axis, sign in np.ndindex(points.shape[0], 2):
            if lost.size:
                moved = lost.copy()
                moved[axis] += step if sign else -step
                if points.shape[0] == 3:
                    moved /= np.linalg.norm(moved, axis=0)
                lost = lost[:, ~(_values(pdf, moved) > 0)]
    if lost.size:
        where = ", ".join(f"{x:.6g}" for x in lost[:, 0])
        wrong.append(f"{lost.shape[1]} samples lie where the pdf is 0, e.g. ({where})")
    return wrong


def _misstated(density: np.ndarray, stated: np.ndarray | None) -> list[str]:
    """A complaint if samples come with another density than that at them."""
    if stated is None or not density.size:
        return []
    difference = float(np.mean(np.abs(stated - density)) / max(np.mean(density), 1e-300))
    if difference <= STATED_ROUNDING:
        return []
    return [f"the pdf returned with samples differs from it by {difference:.2g}"]


def _values(pdf: Callable[[Any], mi.Float], points: np.ndarray) -> np.ndarray:
    """Density at points (dimensions, n)."""
    values = np.asarray(mi.Float(pdf(domains.to_drjit(points))), dtype=np.float64)
    return np.broadcast_to(values, points.shape[1])


# ----------------------------------------------------------------------------- the statistics


def _second_moments(points: np.ndarray) -> np.ndarray:
    """Coordinates and their products, in the order of `NAMES`."""
    d = points.shape[0]
    products = [points[i] * points[j] for i in range(d) for j in range(i, d)]
    return np.stack([*points, *products])


def _compare(
    points: np.ndarray, integrals: histograms.Integrals, known: Mapping[str, float]
) -> tuple[Moment, ...]:
    """All moments against those of the density, and the known ones against what is known."""
    names = NAMES[points.shape[0]]
    values = _second_moments(points)
    count = max(points.shape[1], 1)
    mean, square = values.sum(axis=1) / count, (values**2).sum(axis=1) / count
    variance = np.maximum(square - mean**2, 0) / count
    total = integrals.total if integrals.total > 0 else math.nan
    differences = integrals.moments / total
    variances = variance + integrals.moments_variance / total**2
    moments = [
        _moment(name, mean[k], mean[k] + differences[k], variances[k], square[k])
        for k, name in enumerate(names)
    ]
    for name, value in known.items():
        k = names.index(name)
        moments.append(_moment(f"{name} (known)", mean[k], float(value), variance[k], square[k]))
    return tuple(moments)


def _moment(name: str, mean: float, expected: float, variance: float, square: float) -> Moment:
    """A mean with its variance against a value; `square` is the mean square, the scale of both."""
    difference = mean - expected
    if math.isnan(difference):
        return Moment(name, float(mean), math.nan, math.nan, 0.0)
    beyond = max(abs(difference) - ROUNDING * math.sqrt(square), 0.0)
    z = beyond / math.sqrt(variance) if variance > 0 else (math.inf if beyond > 0 else 0.0)
    p_value = math.erfc(z / math.sqrt(2))
    return Moment(name, float(mean), float(expected), math.copysign(z, difference), p_value)


def _statistic(
    observed: np.ndarray, integrals: histograms.Integrals, samples: int
) -> tuple[float, int]:
    """Pearson's statistic.

    Beside the cells that are resolved, all others are one cell, and so are the samples in none.
    """
    good = integrals.resolved
    cells = (observed, integrals.cells, integrals.variance)
    outside = (samples - observed.sum(), max(1 - integrals.total, 0.0), integrals.total_error**2)
    o, p, v = (
        np.concatenate([each[good], [each[~good].sum(), rest]])
        for each, rest in zip(cells, outside, strict=True)
    )
    return histograms.pearson(o, samples * np.maximum(p, 0), samples**2 * v)
