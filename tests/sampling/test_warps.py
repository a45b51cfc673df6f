"""Warps of the unit square: closed forms, edges, moments, integrals, and errors that are found."""

import itertools
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.support import ALPHA, COMPARISONS, refused

from tofrender.sampling import WARPS, chi_square_test, warp_case, warps
from tofrender.sampling.domains import find, to_drjit, to_numpy
from tofrender.sampling.points import grid
from tofrender.sampling.statistics import smallest_allowed

EACH = smallest_allowed(ALPHA, COMPARISONS)

# All that need no image; the moments follow from the densities by hand.
CASES = {
    "tent": {"x": 0, "y": 0, "xx": 1 / 6, "xy": 0, "yy": 1 / 6},
    "uniform_disk": {"x": 0, "y": 0, "xx": 1 / 4, "xy": 0, "yy": 1 / 4},
    "uniform_sphere": {"x": 0, "y": 0, "z": 0, "xx": 1 / 3, "yy": 1 / 3, "zz": 1 / 3, "xz": 0},
    "uniform_hemisphere": {"x": 0, "z": 1 / 2, "xx": 1 / 3, "zz": 1 / 3, "xz": 0, "yz": 0},
    "cosine_hemisphere": {"x": 0, "z": 2 / 3, "xx": 1 / 4, "yy": 1 / 4, "zz": 1 / 2, "xy": 0},
    "beckmann 0.01": {},
    "beckmann 0.3": {},
    "beckmann 2": {},
}


def case_of(name: str):
    kind, _, alpha = name.partition(" ")
    return warp_case(kind, **({"alpha": float(alpha)} if alpha else {}))


def moments_of(name: str) -> dict[str, float]:
    """Return moments by formulas.

    For Beckmann's normals, t = tan^2 = alpha^2 s with exponential s, and z^2 = 1 / (1 + alpha^2 s).
    These moments are integrated over the quantiles of s.
    """
    alpha = name.partition(" ")[2]
    if not alpha:
        return CASES[name]
    u = (np.arange(1 << 16) + 0.5) / (1 << 16)
    square = 1 / (1 - float(alpha) ** 2 * np.log1p(-u))
    zz = float(square.mean())
    return {"z": float(np.sqrt(square).mean()), "zz": zz, "xx": (1 - zz) / 2, "yy": (1 - zz) / 2}


def chi_square(sample, pdf, domain, **options):
    return chi_square_test(sample, pdf, domain, **{"samples": 100_000, "alpha": EACH} | options)


def edges_of_the_square() -> mi.Point2f:
    """Return corners, and points on and next to the edges."""
    near = [0.0, 2.0**-24, 0.25, 0.5, 0.75, 1 - 2.0**-24, 1.0]
    u, v = np.array(list(itertools.product(near, near))).T
    return mi.Point2f(mi.Float(u), mi.Float(v))


def test_every_warp_is_tested():
    assert set(WARPS) == {name.partition(" ")[0] for name in CASES} | {"hierarchical"}


@pytest.mark.parametrize(
    ("u", "t"), [(0, -1), (1 / 8, -0.5), (1 / 2, 0), (7 / 8, 0.5), (1, 1), (0.02, -0.8)]
)
def test_points_in_the_plane(u, t):
    p = to_numpy(warps.square_to_tent(mi.Point2f(u, 1 - u)), 1)
    assert p.ravel() == pytest.approx([t, -t], abs=1e-6)
    p = to_numpy(warps.square_to_uniform_disk(mi.Point2f(u, 0.125)), 1).ravel()
    assert p == pytest.approx([math.sqrt(u / 2), math.sqrt(u / 2)], abs=1e-6)


@pytest.mark.parametrize(
    ("warp", "z"),
    [
        (warps.square_to_uniform_sphere, lambda u: 1 - 2 * u),
        (warps.square_to_uniform_hemisphere, lambda u: 1 - u),
        (warps.square_to_cosine_hemisphere, lambda u: math.sqrt(1 - u)),
        (
            lambda s: warps.square_to_beckmann(s, 0.7),
            lambda u: 1 / math.sqrt(1 - 0.49 * math.log(1 - u)),
        ),
    ],
)
@pytest.mark.parametrize(("u", "v"), [(0.0, 0.3), (0.1, 0.0), (0.5, 0.25), (0.9, 0.7)])
def test_directions(warp, z, u, v):
    x = math.sqrt(1 - z(u) ** 2) * math.cos(2 * math.pi * v)
    y = math.sqrt(1 - z(u) ** 2) * math.sin(2 * math.pi * v)
    assert to_numpy(warp(mi.Point2f(u, v)), 1).ravel() == pytest.approx([x, y, z(u)], abs=1e-6)


def test_densities():
    up, down = mi.Vector3f(0.6, 0, 0.8), mi.Vector3f(0.6, 0, -0.8)
    assert warps.square_to_uniform_disk_pdf(mi.Point2f(0.3, -0.4))[0] == pytest.approx(1 / math.pi)
    assert warps.square_to_uniform_disk_pdf(mi.Point2f(0.8, -0.7))[0] == 0
    assert warps.square_to_tent_pdf(mi.Point2f(0.25, -0.5))[0] == pytest.approx(0.375)
    for p in ((1, 0), (2, 2), (0, -1.1)):
        assert warps.square_to_tent_pdf(mi.Point2f(*p))[0] == 0
    for v in (up, down):
        assert warps.square_to_uniform_sphere_pdf(v)[0] == pytest.approx(1 / (4 * math.pi))
    assert warps.square_to_uniform_hemisphere_pdf(up)[0] == pytest.approx(1 / (2 * math.pi))
    assert warps.square_to_cosine_hemisphere_pdf(up)[0] == pytest.approx(0.8 / math.pi)
    tan2 = (0.6 / 0.8) ** 2
    beckmann = math.exp(-tan2 / 0.16) / (math.pi * 0.16 * 0.8**3)
    assert warps.square_to_beckmann_pdf(up, 0.4)[0] == pytest.approx(beckmann, rel=1e-5)


@pytest.mark.parametrize("z", [-1.0, -0.5, -1e-7, -1e-30, -0.0, 0.0, 1e-30, 1e-13, 1e-4])
def test_below_and_at_the_horizon(z):
    """The density is 0 below the horizon, 0 or its limit at the horizon, and never NaN."""
    v = mi.Vector3f(math.sqrt(1 - z * z), 0, z)
    assert warps.square_to_uniform_hemisphere_pdf(v)[0] == (
        0 if z < 0 else pytest.approx(1 / (2 * math.pi))
    )
    assert warps.square_to_cosine_hemisphere_pdf(v)[0] == pytest.approx(max(z, 0) / math.pi)
    for alpha in (1e-6, 0.01, 0.3):
        assert warps.square_to_beckmann_pdf(v, alpha)[0] == 0
    assert math.isfinite(warps.square_to_beckmann_pdf(v, 100.0)[0])


@pytest.mark.parametrize("name", CASES)
def test_edges_of_the_square(name):
    case, u = case_of(name), edges_of_the_square()
    points = to_numpy(case.sample(u), dr.width(u))
    assert np.isfinite(points).all()
    assert find(case.domain).contains(points).all()
    if points.shape[0] == 3:
        assert np.sum(points**2, axis=0) == pytest.approx(1, abs=5e-7)
    if "sphere" not in name or "hemisphere" in name:
        assert points.shape[0] == 2 or points[2].min() >= 0
    density = np.array(case.pdf(to_drjit(points)))
    assert np.isfinite(density).all()
    zero_at_the_edge = name in ("tent", "cosine_hemisphere")
    assert zero_at_the_edge or density.min() > 0


def test_alpha_from_small_to_large():
    """Angles and densities are precise where 1 - z^2 is not; one value in each lane."""
    for alpha in (1e-6, 1e-4, 0.01, 1.0, 100.0, 1e6, np.array([0.1, 0.5, 2.0])):
        given = alpha if isinstance(alpha, float) else mi.Float(alpha)
        m = warps.square_to_beckmann(mi.Point2f(mi.Float(0.1, 0.5, 0.9), 0.0), given)
        x, _, z = to_numpy(m, 3)
        tan2 = -np.log1p(-np.array([0.1, 0.5, 0.9])) * alpha**2
        assert x / z == pytest.approx(np.sqrt(tan2), rel=1e-5)
        expected = np.exp(-tan2 / alpha**2) * (1 + tan2) ** 1.5 / (math.pi * alpha**2)
        assert np.array(warps.square_to_beckmann_pdf(m, given)) == pytest.approx(expected, rel=2e-5)


@pytest.mark.parametrize("alpha", [0, -0.3, math.nan, 1e-9, "rough", True])
def test_bad_alpha(alpha):
    message = f"alpha = {alpha!r}: must be a finite number from 1e-06 to 1e\\+06"
    refused(message, warps.square_to_beckmann, mi.Point2f(0.5, 0.5), alpha)
    refused(message, warps.square_to_beckmann_pdf, mi.Vector3f(0, 0, 1), alpha)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("wrong", [-0.01, 1.001, math.nan])
def test_debug_mode_checks_samples(name, wrong):
    case = case_of(name)
    for sample in (mi.Point2f(0.5, [0.5, wrong]), mi.Point2f(wrong, 0.5)):
        case.sample(sample)  # the caller's error; nothing is checked
        with (
            dr.scoped_set_flag(dr.JitFlag.Debug, True),
            pytest.raises(AssertionError, match=r"sample: must lie in \[0, 1\]\^2$"),
        ):
            case.sample(sample)
    with dr.scoped_set_flag(dr.JitFlag.Debug, True):
        case.sample(edges_of_the_square())


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("symbolic", [True, False])
def test_in_a_loop(name, symbolic):
    case, u = case_of(name), grid(16)

    def body(i, total):
        p = case.sample(u)
        return i + 1, total + case.pdf(p) + p.x

    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, symbolic):
        state = (mi.UInt32(0), dr.zeros(mi.Float, 16))
        _, total = dr.while_loop(state, lambda i, _: i < 3, body)
    p = case.sample(u)
    assert np.array(total) == pytest.approx(3 * np.array(case.pdf(p) + p.x), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"])
def test_other_variants(variant):
    mi.set_variant(variant)
    for name in CASES:
        case = case_of(name)
        assert dr.all(case.pdf(case.sample(grid(4))) > 0)


@pytest.mark.statistical
@pytest.mark.parametrize("name", CASES)
def test_chi_square_moments_and_integral(name):
    case = case_of(name)
    options = {"samples": 400_000, "seed": 3, "expected_moments": moments_of(name)}
    verdict = chi_square(case.sample, case.pdf, case.domain, **options)
    assert verdict.passed, str(verdict)
    assert verdict.pdf_integral == pytest.approx(1, abs=verdict.pdf_integral_error)
    assert verdict.pdf_integral_error < 1e-3


@pytest.mark.parametrize("name", CASES)
def test_moments_on_a_fine_grid(name):
    case = case_of(name)
    points = to_numpy(case.sample(grid(1 << 20)), 1 << 20)
    for key, value in moments_of(name).items():
        product = np.prod([points["xyz".index(letter)] for letter in key], axis=0)
        scale = max(abs(value), 1e-3)
        assert product.mean() == pytest.approx(value, abs=3e-4 * scale + 1e-7), key


def sheared(u):
    y = 1 - u.y + 0.2 * u.x
    return mi.Point2f(1 - u.x, y - dr.floor(y))


CHANGED_DENSITIES = {
    "too large by 1 %": lambda p, pdf: 1.01 * pdf,
    "too small by 1 %": lambda p, pdf: 0.99 * pdf,
    "leaning": lambda p, pdf: pdf * (1 + 0.1 * p.x),
}
CHANGED_NUMBERS = {
    "crowded": lambda u: mi.Point2f(u.x * u.x, u.y),
    "crowded a little": lambda u: mi.Point2f(u.x + 0.1 * u.x * (1 - u.x), u.y),
    "half": lambda u: mi.Point2f(u.x, 0.5 * u.y),
    "correlated": lambda u: mi.Point2f(u.x, dr.lerp(u.y, u.x, 0.1)),
    "wavy": lambda u: mi.Point2f(u.x, u.y + 0.1 * dr.sin(6 * math.pi * u.y) / (6 * math.pi)),
    "sheared": sheared,  # As uniform as before
}


@pytest.mark.parametrize(
    ("name", "bug"),
    [
        (name, bug)
        for i, name in enumerate(CASES)
        for j, bug in enumerate([*CHANGED_DENSITIES, *CHANGED_NUMBERS])
        if (i + j) % 3 == 0
    ],
)
def test_bugs_are_found(name, bug):
    case = case_of(name)
    density = CHANGED_DENSITIES.get(bug, lambda p, pdf: pdf)
    numbers = CHANGED_NUMBERS.get(bug, lambda u: u)
    sample, pdf = lambda u: case.sample(numbers(u)), lambda p: density(p, case.pdf(p))
    verdict = chi_square(sample, pdf, case.domain, resolution=41)
    assert verdict.passed == (bug == "sheared"), str(verdict)


CLASSICS = {
    "density mirrored below the horizon": (
        warps.square_to_cosine_hemisphere,
        lambda v: dr.abs(v.z) * dr.inv_pi,
    ),
    "Beckmann without the projected area": (
        lambda u: warps.square_to_beckmann(u, 0.3),
        lambda m: warps.square_to_beckmann_pdf(m, 0.3) / m.z,
    ),
    "Beckmann with alpha 3 % off": (
        lambda u: warps.square_to_beckmann(u, 0.3),
        lambda m: warps.square_to_beckmann_pdf(m, 0.309),
    ),
}


@pytest.mark.parametrize("bug", CLASSICS)
def test_classic_mistakes_are_found(bug):
    assert not chi_square(*CLASSICS[bug], "hemisphere", resolution=41).passed
