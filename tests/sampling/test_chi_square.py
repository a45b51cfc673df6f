"""The chi-square test: its parts in closed form, false alarms, and errors that it must find."""

import math
from dataclasses import replace
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light
from helpers.processes import says
from helpers.support import ALPHA, COMPARISONS, refused

from tofrender.sampling import (
    Case,
    bsdf_case,
    chi_square_suite,
    chi_square_test,
    light_case,
    warp_case,
    warps,
)
from tofrender.sampling.cell_counts import integrate, pearson
from tofrender.sampling.domains import DOMAINS, find
from tofrender.sampling.statistics import smallest_allowed

EACH = smallest_allowed(ALPHA, COMPARISONS)
QUICK = {"samples": 50_000, "resolution": 31, "alpha": EACH}
COSINE, COSINE_PDF = warps.square_to_cosine_hemisphere, warps.square_to_cosine_hemisphere_pdf
HEMISPHERE = (COSINE, COSINE_PDF, "hemisphere")
TENT = (warps.square_to_tent, warps.square_to_tent_pdf, "plane")


@pytest.mark.parametrize("name", DOMAINS)
def test_domains_map_there_and_back(name):
    domain = find(name)
    rng = np.random.default_rng(1)
    low, high = np.array([domain.low, domain.high])[..., None]
    plane = low + (high - low) * rng.random((2, 1000))
    points = domain.to_points(plane)
    assert points.shape[0] == domain.dimensions
    assert domain.to_plane(points) == pytest.approx(plane, abs=1e-9)
    size = {"square": 1, "image": 1, "plane": 4, "disk": 4}.get(name, 4 * math.pi)
    edges = (np.linspace(low[0], high[0], 9).ravel(), np.linspace(low[1], high[1], 9).ravel())
    pdf, functions = lambda p: mi.Float(1), lambda p: np.ones((1, p.shape[1]))
    options = {"samples": 1000, "highest": np.zeros(64), "seed": 0}
    total = integrate(pdf, functions, domain, edges, **options)
    assert total.total == pytest.approx(size, abs=6 * total.total_error + 1e-9)
    assert total.moments == pytest.approx([total.total])


def test_domain_objects_of_mitsuba():
    assert find(mi.chi2.SphericalDomain()).dimensions == 3
    plane = mi.chi2.PlanarDomain(mi.ScalarBoundingBox2f([0, -1], [2, 3]))
    assert (find(plane).low, find(plane).high) == ((0, -1), (2, 3))
    for domain in (mi.chi2.SphericalDomain(), "hemisphere", find("sphere")):
        assert chi_square_test(*HEMISPHERE[:2], domain, **QUICK).passed


def test_pearson_is_scipys():
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(2)
    expected = 5 + 50 * rng.random((7, 9))
    observed = rng.poisson(expected)
    observed = np.append(observed, 100)
    expected = np.append(expected, observed.sum() - expected.sum())
    chi2, freedom = pearson(observed, expected, np.zeros(64))
    theirs = stats.chisquare(observed, expected)
    assert freedom == 63
    assert chi2 == pytest.approx(theirs.statistic)
    ours = 1 - mi.math_py.rlgamma(freedom / 2, chi2 / 2)
    assert ours == pytest.approx(theirs.pvalue, rel=1e-9)


def test_small_cells_are_pooled():
    """40 cells with an expected count of one are pooled to cells of five or more."""
    observed, expected = np.ones(40), np.ones(40)
    observed[:2] = 0, 2
    chi2, freedom = pearson(observed, expected, np.zeros(40))
    assert 2 <= freedom <= 7
    assert chi2 <= 0.4
    assert pearson(np.zeros(5), np.zeros(5), np.zeros(5))[1] == 0
    assert pearson(np.array([3, 30]), np.array([3.0, 30.0]), np.zeros(2))[1] == 0
    assert pearson(np.array([0, 5, 5]), np.array([0.0, 5, 5]), np.zeros(3)) == (0, 1)
    off = np.array([110, 90]), np.array([100.0, 100])
    assert pearson(*off, np.zeros(2)) == (2.0, 1)
    assert pearson(*off, np.full(2, 100.0)) == (1.0, 1)  # Uncertain expectations weigh less


@pytest.mark.statistical
@pytest.mark.parametrize("case", [warp_case("tent"), warp_case("beckmann", alpha=0.1)])
def test_false_alarms(case):
    """With alpha = 5 %, more than 8 of 40 correct samplers fail once in 10 000 times."""
    verdicts = [
        case.test(samples=20_000, resolution=21, alpha=0.05, seed=seed) for seed in range(40)
    ]
    assert sum(not verdict.passed for verdict in verdicts) <= 8
    p_values = np.sort([verdict.p_value for verdict in verdicts])
    uniform = (np.arange(40) + 0.5) / 40
    assert np.abs(p_values - uniform).max() < 0.36  # Kolmogorov and Smirnov, 1e-4


def test_sidak():
    """Chi-square, five moments and known moments share the probability with other tests."""
    for known in ({}, {"x": 0}):
        options = {"alpha": 0.01, "tests": 10, "expected_moments": known}
        verdict = chi_square_test(*TENT, samples=2000, resolution=11, **options)
        assert verdict.alpha == pytest.approx(1 - 0.99 ** (1 / (60 + 10 * len(known))))


def test_same_seed_same_verdict():
    first, second, other = (chi_square_test(*TENT, **QUICK, seed=seed) for seed in (1, 1, 2))
    assert first.chi2 == second.chi2
    assert np.array_equal(first.observed, second.observed)
    assert first.chi2 != other.chi2


def test_warp_and_density_wrong_together():
    """Only known moments show that warp and density are not those of the cosine."""
    case = warp_case("uniform_hemisphere")
    uniform = (case.sample, case.pdf, case.domain)
    assert chi_square_test(*uniform, **QUICK).passed
    verdict = chi_square_test(*uniform, **QUICK, expected_moments={"z": 2 / 3})
    assert not verdict.passed
    assert "the mean of z (known) is 0." in verdict.reason
    assert chi_square_test(*HEMISPHERE, **QUICK, expected_moments={"z": 2 / 3}).passed


BUGS = [
    ({"sample": lambda v: v * 1.001}, "lie outside of the domain"),
    ({"sample": lambda v: mi.Vector3f(0.5 * v.x, 0.5 * v.y, v.z)}, "lie outside of the domain"),
    ({"sample": lambda v: dr.select(v.x > 0.99, -v, v)}, "lie outside of the domain"),
    ({"sample": lambda v: dr.select(v.x > 0.99, dr.nan, v)}, "samples are not finite"),
    (
        {"sample": lambda v: dr.select(v.x > 0.9, mi.Vector3f(0, 0, 1), v)},
        "counts do not follow the pdf",
    ),
    ({"sample": lambda v: mi.Vector3f(0, 0, 1)}, "counts do not follow the pdf"),
    ({"pdf": lambda v, p: 0.99 * p}, "the pdf integrates to 0.9"),
    ({"pdf": lambda v, p: 2 * p}, "not 1; counts do not follow the pdf"),
    ({"pdf": lambda v, p: 0 * p}, "lie where the pdf is 0"),
    ({"pdf": lambda v, p: dr.select(v.z < -0.99, dr.nan, p)}, "the pdf is not finite"),
    ({"pdf": lambda v, p: dr.select(v.z < -0.99, dr.inf, p)}, "the pdf is not finite"),
    ({"pdf": lambda v, p: dr.select(v.z < -0.99, -1e-9, p)}, "the pdf is negative, down to -1e-09"),
    ({"pdf": lambda v, p: dr.select(v.x > 0.99, 0, p)}, "samples lie where the pdf is 0"),
    ({"pdf": lambda v, p: dr.nan}, "the pdf is not finite"),
]


@pytest.mark.parametrize(("bug", "reason"), BUGS)
def test_bugs_are_named(bug, reason):
    sample, pdf, domain = HEMISPHERE
    spoil, change = bug.get("sample", lambda v: v), bug.get("pdf", lambda v, p: p)
    verdict = chi_square_test(
        lambda u: spoil(sample(u)), lambda v: change(v, pdf(v)), domain, **QUICK
    )
    assert not verdict.passed
    assert reason in verdict.reason


def test_spikes():
    """Two texels with 99 % of the light: most cells at their edges contain little of this light."""
    image = np.full((64, 64), 1e-3)
    image[5, 9], image[40, 40] = 100, 30
    right = warp_case("hierarchical", image=image)
    for seed in range(4):
        verdict = right.test(samples=200_000, alpha=EACH, seed=seed)
        assert verdict.passed, str(verdict)
    image[5, 9] = 110
    wrong = Case(right.sample, warp_case("hierarchical", image=image).pdf, "square")
    assert not wrong.test(samples=200_000, alpha=EACH).passed


def test_narrow_lobes_are_resolved():
    def sample(u):
        return warps.square_to_beckmann(u, 1e-3)

    right = (lambda m: warps.square_to_beckmann_pdf(m, 1e-3), "hemisphere")
    assert chi_square_test(sample, *right, **QUICK).passed
    wrong = chi_square_test(lambda u: sample(mi.Point2f(u.x**1.2, u.y)), *right, **QUICK)
    assert "counts do not follow the pdf" in wrong.reason


def test_mistakes_of_a_little_rounding_pass():
    """Samples that rounding moves beyond the edge of the density are not errors."""
    verdict = chi_square_test(
        lambda u: mi.Point2f(dr.select(u.x < 1e-3, 0.75, 0.25 + 0.5 * u.x), u.y),
        lambda p: dr.select((p.x >= 0.25) & (p.x < 0.75), mi.Float(2), 0),
        "square",
        **QUICK | {"resolution": 8},
    )
    assert "lie where the pdf is 0" not in verdict.reason


def failing(u):
    """Sample cosine-distributed directions, and reject directions beyond 60 degrees."""
    v = COSINE(u)
    return v, dr.select(v.z > 0.5, mi.Float(1), 0)


def cut(v):
    return dr.select(v.z > 0.5, COSINE_PDF(v), 0)


def test_failed_samples():
    """The density integrates to the fraction of valid samples, sin(60 degrees)^2."""
    verdict = chi_square_test(failing, cut, "hemisphere", **QUICK)
    assert verdict.passed, str(verdict)
    assert verdict.valid == pytest.approx(0.75, abs=0.01)
    whole = chi_square_test(failing, lambda v: cut(v) / 0.75, "hemisphere", **QUICK)
    assert whole.pdf_integral == pytest.approx(1, abs=1e-3)
    assert "the fraction of valid samples" in whole.reason
    assert not chi_square_test(lambda u: failing(u)[0], cut, "hemisphere", **QUICK).passed


def test_no_valid_samples():
    never = lambda u: (warps.square_to_tent(u), mi.Float(0))  # noqa: E731
    verdict = chi_square_test(never, lambda p: mi.Float(0), "plane", **QUICK)
    assert not verdict.passed
    assert "too few valid samples" in verdict.reason
    assert str(verdict)


def test_density_returned_with_the_sample():
    def sample(factor):
        def draw(u):
            p = warps.square_to_tent(u)
            return p, mi.Float(1), factor * warps.square_to_tent_pdf(p)

        return draw

    assert chi_square_test(sample(1), *TENT[1:], **QUICK).passed
    verdict = chi_square_test(sample(1.01), *TENT[1:], **QUICK)
    assert verdict.reason == "the pdf returned with samples differs from it by 0.01"
    assert "by nan" in chi_square_test(sample(dr.nan), *TENT[1:], **QUICK).reason


def direction(degrees: float) -> tuple[float, float, float]:
    return math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))


def check_case(case: Case) -> None:
    """Check that a sampler has its density, and that an error of the density by 2 % is found."""
    verdict = case.test(**QUICK)
    assert verdict.passed, str(verdict)
    wrong = replace(case, pdf=lambda v: 1.02 * case.pdf(v))
    assert not wrong.test(**QUICK).passed


@pytest.mark.statistical
@pytest.mark.parametrize("angle", [0, 60])
@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "diffuse"},
        {"type": "plastic"},
        {"type": "roughconductor", "alpha": 0.1, "distribution": "ggx"},
        {"type": "roughdielectric", "alpha": 0.2, "distribution": "ggx"},
    ],
    ids=lambda bsdf: bsdf["type"],
)
def test_bsdfs(bsdf, angle):
    check_case(bsdf_case(bsdf, direction(angle)))


class Sky:
    """Light as in the course: radiance from above the horizon, in proportion to the cosine."""

    def sample(self, o, sample):
        d = COSINE(sample)
        return SimpleNamespace(d=d, pdf=self.pdf(o, d), valid=d.z > 0)

    def pdf(self, o, v):
        return COSINE_PDF(v)


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("name", "light", "o"),
    [
        ("sphere", {"type": "sphere", "radius": 0.5, "emitter": area_light(1.0)}, (0, 0, 2)),
        ("rectangle", {"type": "rectangle", "emitter": area_light(1.0)}, (0.3, 0.2, 0.5)),
        ("constant", {"type": "constant"}, (0, 0, 0)),
        ("Sky", Sky(), (1, 2, 3)),
    ],
)
def test_lights(name, light, o):
    case = light_case(light, o)
    assert case.name == name
    check_case(case)


def test_suite():
    bsdf = bsdf_case({"type": "diffuse"}, (0, 0, 1))
    good = [warp_case("tent"), warp_case("cosine_hemisphere"), bsdf]
    bad = Case(TENT[0], lambda p: 1.1 * TENT[1](p), "plane", "a wrong tent")
    suite = chi_square_suite(good, samples=20_000, resolution=21)
    assert suite.passed
    assert str(suite).startswith("3 of 3 passed")
    assert suite.verdicts[0].alpha == pytest.approx(smallest_allowed(1e-3, 3 * 6), rel=1e-9)
    suite = chi_square_suite([*good, bad], samples=20_000, resolution=21)
    assert not suite.passed
    assert [verdict.passed for verdict in suite.verdicts] == [True, True, True, False]
    assert "a wrong tent: FAILED, the pdf integrates to 1." in str(suite)


def test_verdict_in_words():
    verdict = chi_square_test(*TENT, **QUICK, name="a tent")
    assert str(verdict).startswith("a tent: passed\n  chi-square ")
    assert verdict.reason == ""
    assert verdict.observed.sum() == QUICK["samples"]
    assert verdict.expected.sum() == pytest.approx(QUICK["samples"], rel=1e-3)
    assert [moment.name for moment in verdict.moments] == ["x", "y", "xx", "xy", "yy"]


def test_figure_on_failure(tmp_path):
    path = tmp_path / "failure.png"
    assert chi_square_test(*HEMISPHERE, **QUICK, figure=path).passed
    assert not path.exists()
    sample, pdf, domain = HEMISPHERE
    verdict = chi_square_test(sample, lambda v: 1.1 * pdf(v), domain, **QUICK, figure=path)
    assert path.read_bytes().startswith(b"\x89PNG")
    titles = [axes.get_title() for axes in verdict.figure().axes]
    assert titles[:3] == ["observed density", "expected density", "difference"]


@pytest.mark.parametrize("bug", [lambda p: dr.nan, lambda p: 0 * p.x, lambda p: -p.x])
@pytest.mark.parametrize(("sample", "domain"), [(TENT[0], "plane"), (COSINE, "sphere")])
def test_figure_of_whatever_was_found(bug, sample, domain, tmp_path):
    verdict = chi_square_test(sample, bug, domain, **QUICK, figure=tmp_path / "figure.png")
    assert not verdict.passed
    assert (tmp_path / "figure.png").exists()


BAD = [
    (lambda: chi_square_test(*TENT[:2], "sphere"), "of 2 dimensions. This domain requires 3"),
    (
        lambda: chi_square_test(lambda u: (TENT[0](u), u.x), *TENT[1:]),
        "sample: it returns the weight .*. Return 0 for failed samples",
    ),
    (lambda: warp_case("tent", alpha=1), "name = 'tent': this warp requires no parameter, but"),
    (lambda: warp_case("beckmann"), "name = 'beckmann': this warp requires the parameter alpha"),
    (lambda: bsdf_case({"type": "conductor"}, (0, 0, 1)), "bsdf = .*: it has no density"),
    (lambda: bsdf_case({"type": "diffuse"}, (0, 0, 0)), "wi = .*: must be a direction"),
    (lambda: light_case({"type": "point"}, (0, 0, 0)), "light = 'point': must be one light"),
    (lambda: chi_square_suite([]), "cases = \\[\\]: must be at least one"),
]


@pytest.mark.parametrize(("call", "message"), BAD)
def test_bad_input(call, message):
    refused(message, call)


_DRAWN = """
import sys
from tofrender.sampling import warp_case
figure = warp_case('tent').test(samples=1000, resolution=11).figure()
assert figure.axes[0].get_title() == 'observed density'
print([name for name in sys.modules if name.startswith('tofrender.vis')])
"""


def test_a_verdict_is_drawn_without_the_packages_above():
    """`verdict.figure()` does not import `tofrender.vis`, which depends on this package."""
    assert says(_DRAWN) == ["[]"]
