"""BSDF `retroreflector`: sampling, density, value, energy, variants."""

from math import cos, pi, radians, sin

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from tofrender.sampling import bsdf_case, chi_square_suite

EXPONENTS = (0.3, 1.0, 10.0, 100.0, 1000.0)
ANGLES = (0.0, 30.0, 60.0, 80.0, 89.0, 89.9)
LANES = 1 << 18


def described(exponent: float = 100.0, reflectance: float = 0.8) -> dict:
    return {
        "type": "retroreflector",
        "reflectance": {"type": "rgb", "value": [reflectance] * 3},
        "lobe_exponent": float(exponent),
    }


def direction(degrees: float) -> list[float]:
    sine, cosine = sin(radians(degrees)), cos(radians(degrees))
    return [0.6 * sine, 0.8 * sine, cosine]


def interaction(wi, lanes: int = LANES) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, lanes)
    si.wi = mi.Vector3f(*wi)
    return si


def sampler(lanes: int = LANES, seed: int = 0):
    result = mi.load_dict({"type": "independent"})
    result.seed(seed, lanes)
    return result


def samples(bsdf, degrees: float, seed: int = 0) -> tuple:
    """Return sampled directions and their weights."""
    numbers = sampler(seed=seed)
    si = interaction(direction(degrees))
    return bsdf.sample(mi.BSDFContext(), si, numbers.next_1d(), numbers.next_2d())


def evaluated(bsdf, wi, wo, context=None, lanes: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return value and density."""
    context, wo = context or mi.BSDFContext(), mi.Vector3f(*wo)
    value, density = bsdf.eval_pdf(context, interaction(wi, lanes), wo)
    alone = bsdf.eval(context, interaction(wi, lanes), wo)
    np.testing.assert_array_equal(alone, value)
    pdf = bsdf.pdf(context, interaction(wi, lanes), wo)
    np.testing.assert_allclose(pdf, density, rtol=1e-5, atol=1e-7)
    return np.array(value), np.array(density)


@pytest.mark.statistical
@pytest.mark.parametrize("exponent", EXPONENTS)
def test_samples_have_the_density(exponent):
    """Chi-square tests at 6 angles, also grazing, with a probability of 3e-4 of a false alarm."""
    cases = [bsdf_case(described(exponent), direction(angle)) for angle in ANGLES]
    verdict = chi_square_suite(cases, alpha=3e-4, samples=100_000)
    assert verdict.passed, verdict


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("degrees", [0.0, 45.0, 89.0])
def test_weight_is_value_over_density(exponent, degrees):
    bsdf = mi.load_dict(described(exponent))
    record, weight = samples(bsdf, degrees)
    value, density = evaluated(bsdf, direction(degrees), record.wo, lanes=LANES)
    np.testing.assert_allclose(density, record.pdf, rtol=1e-6)
    np.testing.assert_allclose(np.array(weight) * density, value, rtol=1e-4, atol=1e-7)
    below = np.array(record.wo.z) <= 0
    assert (np.array(record.pdf)[below] == 0).all()
    assert (np.array(weight)[:, below] == 0).all()
    if degrees == 89.0 and exponent == 100.0:
        assert 0.3 < below.mean() < 0.5
    np.testing.assert_allclose(dr.norm(record.wo), 1, atol=3e-7)


@pytest.mark.parametrize("exponent", [1e4, 1e6])
def test_narrow_lobes_keep_their_digits(exponent):
    """The mean of 1 - cos is 1 / (n + 2), its variance is about the square: 4 sigma are 0.8 %."""
    bsdf = mi.load_dict(described(exponent))
    record, _ = samples(bsdf, 36.87)
    versine = np.array(dr.squared_norm(record.wo - mi.Vector3f(*direction(36.87))) / 2, dtype=float)
    assert versine.mean() * (exponent + 2) == pytest.approx(1, rel=8e-3)
    # the density over a cap that holds all but e^-12 of the lobe, by a regular grid of (cos, phi)
    edge = 12 / exponent
    v = (dr.arange(mi.Float, 4096) + 0.5) * (edge / 4096)
    local = mi.Vector3f(dr.sqrt(v * (2 - v)), 0, 1 - v)
    wi = mi.Vector3f(*direction(36.87))
    pdf = bsdf.pdf(mi.BSDFContext(), interaction(wi, 4096), mi.Frame3f(wi).to_world(local))
    assert np.array(pdf, dtype=float).mean() * 2 * pi * edge == pytest.approx(1, abs=2e-3)


def test_value_is_the_formula():
    """The value is reciprocal: the smaller of both cosines, over the cosine of the light."""
    bsdf = mi.load_dict(described(10.0, reflectance=0.5))
    wi, wo = direction(40), direction(20)
    lobe = 0.5 * 11 / (2 * pi) * np.dot(wi, wo) ** 10
    for one, other, expected in ((wi, wo, lobe), (wo, wi, lobe * wi[2] / wo[2])):
        np.testing.assert_allclose(evaluated(bsdf, one, other)[0].ravel(), expected, rtol=1e-5)


def test_nothing_goes_below_the_surface_or_farther_than_a_right_angle():
    bsdf = mi.load_dict(described(1.0))
    up, down = (0, 0, 1), (0, 0, -1)
    for wi, wo in ((down, down), (up, down), ((0.8, 0, 0.6), (-0.8, 0, 0.6))):
        value, density = evaluated(bsdf, wi, wo)
        assert value.max() == density.max() == 0, (wi, wo)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_albedo_is_at_most_the_reflectance(exponent):
    bsdf = mi.load_dict(described(exponent, reflectance=1.0))
    theta = (dr.arange(mi.Float, 1024) + 0.5) * (pi / 2 / 1024)
    turn = (dr.arange(mi.Float, 512) + 0.5) * (2 * pi / 512)
    theta, turn = dr.meshgrid(theta, turn)
    sine = dr.sin(theta)
    wo = mi.Vector3f(sine * dr.cos(turn), sine * dr.sin(turn), dr.cos(theta))
    for degrees in ANGLES:
        value = bsdf.eval(mi.BSDFContext(), interaction(direction(degrees), 1), wo)
        albedo = np.array(value[0] * sine, dtype=float).mean() * pi**2
        assert albedo <= 1
        _, weight = samples(bsdf, degrees)
        weight = np.array(weight, dtype=float)[0]
        assert weight.max() <= 1 + 1e-6
        error = weight.std() / np.sqrt(len(weight))
        assert abs(weight.mean() - albedo) < 5 * error + 1e-4, degrees
        if degrees == 0:
            assert albedo == pytest.approx((exponent + 1) / (exponent + 2), rel=1e-4)
    if exponent >= 100:
        assert albedo == pytest.approx(0.5, abs=0.03)  # grazing: half of the lobe is lost


def test_flags_and_text():
    bsdf = mi.load_dict(described(12.5))
    assert bsdf.flags() == mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
    assert bsdf.component_count() == 1
    assert str(bsdf).startswith("Retroreflector[lobe_exponent = 12.5, reflectance = ")
    same = mi.load_dict(described(12.5) | {"type": "tofrender_retroreflector"})
    assert str(same) == str(bsdf)
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DiffuseReflection  # Leaves the lobe out
    value, density = evaluated(bsdf, (0, 0, 1), (0, 0, 1), context)
    assert value.max() == density.max() == 0


def test_parameters_can_be_changed_and_are_checked():
    bsdf = mi.load_dict(described(10.0))
    parameters = mi.traverse(bsdf)
    for exponent in (20.0, 40.0):
        parameters["lobe_exponent"] = exponent
        parameters["reflectance.value"] = mi.Color3f(0.2, 0.4, 0.6)
        parameters.update()
        value = evaluated(bsdf, (0, 0, 1), (0, 0, 1))[0].ravel()
        np.testing.assert_allclose(value, np.array([0.2, 0.4, 0.6]) * (exponent + 1) / (2 * pi))
    parameters["lobe_exponent"] = -3.0
    with pytest.raises(ValueError, match=r"lobe_exponent = -3.0: must be a finite number above 0"):
        parameters.update()


def test_reflectance_can_be_a_texture_and_has_a_gradient():
    texture = mi.Bitmap(np.array([[[0.2] * 3, [0.8] * 3]], dtype=np.float32))
    bitmap = {"type": "bitmap", "bitmap": texture, "raw": True, "filter_type": "nearest"}
    bsdf = mi.load_dict({"type": "retroreflector", "reflectance": bitmap})
    assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.SpatiallyVarying)
    si = interaction((0, 0, 1), 2)
    si.uv = mi.Point2f(mi.Float(0.25, 0.75), 0.5)
    left, right = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1)))[0]
    assert right / left == pytest.approx(4, rel=1e-4)
    parameters = mi.traverse(bsdf)
    dr.enable_grad(parameters["reflectance.data"])
    parameters.update()
    dr.backward(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1))[0])
    assert np.array(dr.grad(parameters["reflectance.data"])).max() > 1


@pytest.mark.parametrize("variant", [v for v in mi.variants() if v.startswith("llvm")])
def test_every_variant(variant):
    mi.set_variant(variant)
    bsdf = mi.load_dict(described(30.0))
    si = interaction((0.6, 0, 0.8), 64)
    if mi.is_spectral:
        si.wavelengths = type(si.wavelengths)(550.0)
    numbers = sampler(64)
    record, weight = bsdf.sample(mi.BSDFContext(), si, numbers.next_1d(), numbers.next_2d())
    value, density = bsdf.eval_pdf(mi.BSDFContext(), si, record.wo)
    assert type(value) is type(weight) is mi.Spectrum
    weight, value = (np.array(mi.unpolarized_spectrum(x)) for x in (weight, value))
    np.testing.assert_allclose(weight * np.array(density), value, rtol=1e-4, atol=1e-6)
    assert 0.5 < weight.max() <= 0.801


@pytest.mark.parametrize("value", [1.5, -0.5])
def test_bad_parameters_are_one_line(value):
    bright = mi.Bitmap(np.full((2, 2, 3), value, dtype=np.float32))
    bitmap = {"type": "bitmap", "bitmap": bright, "raw": True}
    said = f"reflectance = {value:g}: must be a color or texture in [0, 1]"
    most = "lobe_exponent = 2000000.0: must be a finite number above 0 and at most 1e+06"
    for name, each, line in (
        ("reflectance", value, said),
        ("reflectance", bitmap, said),
        ("lobe_exponent", 2e6, most),
    ):
        with pytest.raises(RuntimeError) as error:
            mi.load_dict({"type": "retroreflector", name: each})
        assert str(error.value).splitlines()[-1] == f"ValueError: {line}"


def test_colors_out_of_range_are_refused():
    with pytest.raises(RuntimeError, match=r"must be in the range \[0, 1\]"):
        mi.load_dict(described(reflectance=1.2))
