"""Derivatives of renders: closed forms, both modes, and steps that add up.

The scenes themselves are what their forms say, values over seeds and differences of renders with
the same random numbers; so are derivatives.

False alarms: each comparison of a moment is within three standard errors of 16 seeds, which right
code misses in 0.9 % of all choices of seeds (Student, 15 degrees of freedom); seeds are fixed.
Bins are compared by `agree`, at the suite's one alpha.
"""

import math
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers import gradient_cases as cases
from helpers.gradient_of import (
    attached,
    differences,
    forward,
    moved_render,
    render,
    reverse,
    tracked,
)
from helpers.limits import lower
from helpers.support import agree, over_seeds, with_film
from oracles.gradients import Bins, Phasor, derived

from tofrender.integrators import derivatives, passes

SEEDS = range(16)
HALF_PERCENT, STANDARD_ERRORS = 5e-3, 3
ROUNDING = 2e-4  # Of lengths in single precision, which samples that are spread evenly do not hide

OF_BINS = 5e-3
"""The same of a bin, which light enters and leaves; relative to the bin that changes most."""


def forward_samples(case, seeds=SEEDS, spp: int = 0, **options) -> np.ndarray:
    return over_seeds(lambda seed: forward(case, spp=spp, seed=seed, **options), seeds)


def require_close(samples: np.ndarray, expected: float, what: str = "") -> None:
    """Within half a percent, and within three standard errors and rounding."""
    off = abs(samples.mean() - expected)
    error = samples.std(ddof=1) / math.sqrt(samples.size)
    assert off <= HALF_PERCENT * abs(expected), (what, samples.mean(), expected)
    assert off <= STANDARD_ERRORS * error + ROUNDING * abs(expected), (what, off, error)


@pytest.mark.statistical
@pytest.mark.parametrize("name", cases.CASES)
def test_derivative_is_the_closed_form(name):
    case = cases.CASES[name]
    samples, expected = forward_samples(case), case.expected()[1]
    for what, weights in case.weights().items():
        require_close(samples @ weights, float(weights @ expected), what)
    if isinstance(case.seen, Bins):
        whole = 2 * np.abs(expected).max()  # Beside which rounding of all is nothing
        assert agree(samples + whole, expected + whole, rounding=OF_BINS)


@pytest.mark.parametrize("name", cases.CASES)
def test_reverse_is_forward(name):
    """The same seed gives the same paths: all moments, and a sum of bins with random weights."""
    case = cases.CASES[name]
    found = forward(case, seed=3)
    weights = {**case.weights(), "random": np.random.default_rng(5).normal(size=found.size)}
    for what, each in weights.items():
        expected = pytest.approx(float(each @ found), abs=1e-4 * np.abs(each * found).sum())
        assert reverse(case, each, seed=3) == expected, what


@pytest.mark.parametrize("name", ["PLANE_2", "LIGHT", "CORRIDOR"])
def test_attached_sampling(name):
    case, options = getattr(cases, name), {"gradient_sampling": "attached"}
    samples, expected = forward_samples(case, **options), case.expected()[1]
    for what, weights in case.weights().items():
        require_close(samples @ weights, float(weights @ expected), what)
    weights = case.weights()["moment"]
    found = reverse(case, weights, seed=3, **options)
    assert found == pytest.approx(float(samples[3] @ weights), rel=1e-4)


NOISY = {"index": 0.2}
"""Rows whose differences are noisy, since light takes the other way at an interface: how much."""


@pytest.mark.parametrize("name", cases.CASES)
def test_renders_are_what_the_forms_say(name):
    case = cases.CASES[name]
    expected, change = case.expected()
    values, found = (
        over_seeds(lambda seed, of=of: of(case, seed=seed), range(1, 5)).mean(axis=0)
        for of in (render, differences)
    )
    for what, weights in case.weights().items():
        if not isinstance(case.seen, Phasor):
            assert weights @ values == pytest.approx(weights @ expected, rel=2e-3), what
        tolerance = NOISY.get(case.row, 5e-3)
        assert weights @ found == pytest.approx(weights @ change, rel=tolerance), what
    assert values == pytest.approx(expected, abs=3e-3 * np.abs(expected).max())
    # Differences of the form leave out as much of a curve as those of the renders
    right, left = (
        case.at(theta).seen.value(derived(case.form, theta))
        for theta in (case.theta + case.step, case.theta - case.step)
    )
    apart = (right - left) / (2 * case.step)
    tolerance = NOISY.get(case.row, 1e-2) * np.abs(apart).max()
    assert found == pytest.approx(apart, abs=tolerance)


@pytest.mark.parametrize("case", [cases.RADIUS_2, cases.LIGHT_2], ids=lambda case: case.scene)
def test_lamps_that_paths_run_into(case):
    """Without connections: a lamp that moves or grows takes the hit points of paths with it.

    Were directions kept instead, nothing would change but lengths: what enters at the lamp's edge
    would be missing, all of the sum's derivative. Half of it is missing where hits are half.
    """
    samples = forward_samples(case, range(8), emitter_sampling=False, spp=1 << 17)
    weights, expected = case.weights()["sum"], case.expected()[1]
    assert (samples @ weights).mean() == pytest.approx(weights @ expected, rel=2e-2)


@pytest.mark.parametrize("name", ["PLANE", "RADIUS", "DEPTH", "GATED_PLANE", "MIRROR"])
def test_steps_add_up(name, monkeypatch):
    case = getattr(cases, name)
    whole, expected = forward(case, seed=3), case.expected()[1]
    samples = case.spp // 8
    lower(monkeypatch, step_samples=samples, first_samples=samples)
    found = forward(case, seed=3)
    for what, weights in case.weights().items():
        value = float(weights @ expected)
        assert weights @ found == pytest.approx(value, rel=HALF_PERCENT), what
        assert weights @ found == pytest.approx(weights @ whole, rel=HALF_PERCENT), what
        assert reverse(case, weights, seed=3) == pytest.approx(float(weights @ found), rel=1e-4)


def test_many_samples():
    """Sums in single precision take 2^16 samples of a pixel at most, and lose nothing."""
    for what, weights in cases.PLANE.weights().items():
        value = pytest.approx(float(weights @ cases.PLANE.expected()[1]), rel=1e-3)
        assert forward(cases.PLANE, spp=1 << 17) @ weights == value, what
        assert reverse(cases.PLANE, weights, spp=1 << 17) == value, what
    few, many = (forward(cases.PLANE, seed=3, spp=spp).sum() for spp in (1 << 14, 1 << 20))
    assert many == pytest.approx(few, rel=2e-4)  # A single sum would lose 6e-4 of a million


@pytest.mark.essential
def test_hidden_lamps_that_move():
    """Camera rays go on behind them, which is no derivative of theirs; light still comes."""
    found = forward(cases.LIGHT_2, seed=3, hide_emitters=True)
    weights = cases.LIGHT_2.weights()["sum"]
    assert found @ weights == pytest.approx(cases.LIGHT_2.expected()[1] @ weights, rel=HALF_PERCENT)
    back = reverse(cases.LIGHT_2, weights, seed=3, hide_emitters=True)
    assert back == pytest.approx(found @ weights, rel=1e-3)


def test_larger_passes_of_a_gpu_have_the_same_derivative(monkeypatch):
    """LLVM stands in for the GPU, which takes all samples in one pass instead of four."""
    sizes = []

    class Counted(derivatives.Rays):
        def __init__(self, **named):
            sizes.append(named["spp"])
            super().__init__(**named)

    monkeypatch.setattr(derivatives, "Rays", Counted)
    lower(monkeypatch, gradient_samples=16, cuda_step=4)
    weights = cases.PLANE.weights()["moment"]
    on_cpu = reverse(cases.PLANE, weights, spp=64, seed=5)
    assert sizes == [16] * 4
    sizes.clear()
    monkeypatch.setattr(passes, "_on_gpu", lambda: True)
    on_gpu = reverse(cases.PLANE, weights, spp=64, seed=5)
    assert sizes == [64]
    assert on_gpu == pytest.approx(on_cpu, rel=1e-5)


@pytest.mark.essential
def test_a_loss_of_one_channel_changes_this_channel():
    """Light of a single bounce is proportional to the reflectance of its channel."""
    loaded = cases.PLANE.load()
    parameters = mi.traverse(loaded)
    reflectance = mi.Color3f(0.2, 0.5, 0.8)
    dr.enable_grad(reflectance)
    parameters["floor.bsdf.reflectance.value"] = reflectance
    parameters.update()
    transient = mi.render(loaded, parameters, spp=64, seed=5)[-1]

    # The loss is 2 G + 3 B
    light = np.array(transient).sum(axis=(0, 1, 2))
    weights = mi.Float(np.tile([0.0, 2.0, 3.0], transient.array.shape[0] // 3))
    dr.backward(dr.sum(transient.array * weights))
    expected = np.array([0.0, 2.0, 3.0]) * light / np.array([0.2, 0.5, 0.8])
    assert np.ravel(dr.grad(reflectance)) == pytest.approx(expected, rel=HALF_PERCENT, abs=1e-6)


def test_samples_for_derivatives_alone():
    theta, transient = attached(cases.PLANE, spp=4, options={"spp_grad": 1 << 12, "seed_grad": 9})
    dr.forward(theta)
    found, expected = cases.PLANE.mean(dr.grad(transient)), cases.PLANE.expected()[1]
    for what, weights in cases.PLANE.weights().items():
        assert weights @ found == pytest.approx(weights @ expected, rel=HALF_PERCENT), what


def test_steady_and_transient_have_the_same_derivative():
    """The window holds all light: bins add up to the picture, and so do their derivatives."""
    theta = tracked(0.0)
    rendered = moved_render(
        cases.PLANE.load(), cases.PLANE.key, cases.PLANE.value(theta), spp=1 << 10
    )
    dr.forward(theta)
    picture, bins = (np.array(dr.grad(each), dtype=np.float64) for each in rendered)
    assert bins.sum(axis=2) == pytest.approx(picture[..., : bins.shape[-1]], rel=1e-3)
    assert np.abs(picture).max() > 0.03


def test_a_loss_that_is_not_linear():
    """Squares of bins against a target: the chain rule, by Dr.Jit, in both modes."""
    expected, change = cases.PLANE.expected()
    target = 0.8 * expected

    def loss():
        theta, transient = attached(cases.PLANE, spp=1 << 14)
        goal = mi.TensorXf(np.repeat(target, 3).reshape(transient.shape).astype(np.float32))
        return theta, dr.sum(dr.square(transient - goal), axis=None) / 3

    value = pytest.approx(2 * float((expected - target) @ change), rel=2e-2)
    theta, squares = loss()
    dr.backward(squares)
    assert dr.grad(theta)[0] == value
    theta, squares = loss()
    dr.forward(theta)
    assert dr.grad(squares).array[0] == value


def test_two_parameters_at_once():
    loaded, z, albedo = cases.PLANE.load(), tracked(0.0), tracked(0.5)
    parameters = mi.traverse(loaded)
    cases.PLANE.set(parameters, z)
    parameters["floor.bsdf.reflectance.value"] = mi.Color3f(albedo)
    parameters.update()
    _, transient = mi.render(loaded, parameters, spp=1 << 13)
    weights = cases.PLANE.weights()["moment"]
    dr.backward(dr.sum(transient.array * cases.PLANE.tensor_weights(weights, transient.shape)))
    value, change = cases.PLANE.expected()
    assert dr.grad(z)[0] == pytest.approx(weights @ change, rel=HALF_PERCENT)
    assert dr.grad(albedo)[0] == pytest.approx(weights @ value / 0.5, rel=HALF_PERCENT)


def test_pixels_keep_their_own_derivatives():
    wide = with_film(cases.PLANE.describe(), width=4, height=4)
    case = replace(cases.PLANE, spp=1 << 8, describe=lambda: dict(wide))
    theta, transient = attached(case, seed=2)
    dr.forward(theta)
    pixels = np.array(dr.grad(transient), dtype=np.float64)
    weights = case.weights()["moment"]
    found = weights @ pixels.mean(axis=(0, 1, 3))
    assert found == pytest.approx(weights @ case.expected()[1], rel=2e-2)
    theta, transient = attached(case, seed=2)
    dr.backward(dr.sum(transient[1, 2], axis=None))
    assert dr.grad(theta)[0] == pytest.approx(pixels[1, 2].sum(), rel=1e-4)


VARIANTS = [
    "llvm_ad_mono",
    "llvm_ad_rgb",
    "llvm_ad_spectral",
    "llvm_ad_mono_polarized",
    "llvm_ad_spectral_polarized",
]
GRAY_ALBEDO = replace(cases.ALBEDO_2, value=lambda albedo: albedo)
"""In gray variants a reflectance is a single number."""


def colors(tensor) -> np.ndarray:
    """Bins of the intensity, a mean over pixels and colors: S0 comes first."""
    values = np.array(tensor, dtype=np.float64).mean(axis=(0, 1))
    count = 1 if mi.is_monochromatic else 3
    return values[..., :count].mean(axis=-1)


@pytest.mark.parametrize(
    ("variant", "case"),
    [(variant, cases.PLANE) for variant in VARIANTS]
    + [(variant, GRAY_ALBEDO) for variant in VARIANTS if "mono" in variant],
)
def test_derivative_in_all_variants(variant, case):
    mi.set_variant(variant)
    plain = case is cases.PLANE and not mi.is_spectral
    theta, transient = attached(case, spp=1 << (13 if plain else 16))
    dr.forward(theta)
    found, expected = colors(dr.grad(transient)), case.expected()[1]
    for what, weights in case.weights().items():
        value = float(weights @ expected)
        assert weights @ found == pytest.approx(value, rel=5e-3 if plain else 2e-2), what


@pytest.mark.parametrize("variant", VARIANTS)
def test_reverse_is_forward_in_all_variants(variant):
    mi.set_variant(variant)
    for case in (cases.PLANE, cases.MIRROR_2):
        theta, tensor = attached(case, spp=1 << 8, seed=3)
        weights = np.random.default_rng(1).normal(size=tensor.shape).ravel()
        dr.forward(theta)
        gradient = np.array(dr.grad(tensor), dtype=np.float64).ravel()
        theta, tensor = attached(case, spp=1 << 8, seed=3)
        dr.backward(dr.sum(tensor.array * mi.Float(weights.astype(np.float32))))
        scale = np.abs(weights * gradient).sum()
        assert scale > 0
        assert dr.grad(theta)[0] == pytest.approx(weights @ gradient, abs=1e-4 * scale), case.name


def test_colors_have_their_own_derivatives():
    red, key = tracked(0.5), "floor.bsdf.reflectance.value"
    _, transient = moved_render(cases.PLANE.load(), key, mi.Color3f(red, 0.5, 0.5), spp=1 << 10)
    dr.forward(red)
    found = np.array(dr.grad(transient), dtype=np.float64)[0, 0]
    assert found[:, 0] == pytest.approx(np.array(transient)[0, 0, :, 0] / 0.5, rel=1e-2, abs=1e-5)
    assert not found[:, 1:].any()
