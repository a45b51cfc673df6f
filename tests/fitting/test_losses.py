"""Losses against NumPy, and their derivatives against differences."""

from __future__ import annotations

from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender

AXIS = {"start_opl": 1.0, "bin_width_opl": 0.5}
FREQUENCIES = [20e6, 50e6]
SHAPE = (2, 3, 7, 3)

phasor_loss = partial(tofrender.phasor_loss, frequency_hz=FREQUENCIES, **AXIS)
LOSSES = {
    "l2": tofrender.l2_loss,
    "phasor": phasor_loss,
    "wasserstein": tofrender.wasserstein_loss,
    "times": partial(tofrender.wasserstein_loss, energy_weight=0.0),
}


def cubes(seed: int = 0) -> np.ndarray:
    """What is rendered, and a target."""
    return np.random.default_rng(seed).random((2, *SHAPE)).astype(np.float32)


def number(value) -> float:
    return float(np.array(value).item())


def in_numpy(name: str, rendered: np.ndarray, target: np.ndarray) -> float:
    """The formulas, in double precision."""
    r, t = rendered.astype(float), target.astype(float)
    if name == "l2":
        return np.sum((r - t) ** 2) / np.sum(t**2)
    if name == "phasor":
        parts = [
            np.array(tofrender.transient_to_phasor(each, FREQUENCIES, *AXIS.values())[:2])
            for each in (r, t)
        ]
        return np.sum((parts[0] - parts[1]) ** 2) / np.sum(parts[1] ** 2)
    light, measured = r.sum(2), t.sum(2)
    arrived = [np.cumsum(each, axis=2) / each.sum(2, keepdims=True) for each in (r, t)]
    times = np.sum(measured / measured.sum() * np.mean((arrived[0] - arrived[1]) ** 2, axis=2))
    energy = np.sum((light - measured) ** 2) / np.sum(measured**2)
    return times + (energy if name == "wasserstein" else 0)


@pytest.mark.parametrize("name", LOSSES)
def test_is_the_formula(name):
    loss, (rendered, target) = LOSSES[name], cubes()
    found = number(loss(mi.TensorXf(rendered), target))
    assert abs(found / in_numpy(name, rendered, target) - 1) < 1e-5
    assert number(loss(target, target)) < 1e-12
    dim = number(loss(rendered * 1e-6, target * 1e-6))
    assert abs(dim / found - 1) < 1e-3
    with pytest.raises(ValueError, match=r"^target: holds no light; must have some"):
        loss(np.ones(SHAPE), np.zeros(SHAPE))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", LOSSES)
def test_derivative_is_that_of_differences(name, seed):
    rendered, target = cubes(seed)
    attached = mi.TensorXf(rendered)
    dr.enable_grad(attached)
    dr.backward(LOSSES[name](attached, target))
    gradient = np.array(dr.grad(attached), np.float64)
    direction = np.random.default_rng(seed).standard_normal(SHAPE)
    step = 1e-5
    ahead, behind = (in_numpy(name, rendered + s * direction, target) for s in (step, -step))
    expected = (ahead - behind) / (2 * step)
    assert abs(np.sum(gradient * direction) - expected) < 2e-4 * np.abs(gradient).sum()
    forward = mi.TensorXf(rendered)
    dr.enable_grad(forward)
    dr.set_grad(forward, mi.TensorXf(direction.astype(np.float32)))
    loss = LOSSES[name](forward, target)
    dr.forward_to(loss)
    assert abs(number(dr.grad(loss)) - expected) < 2e-4 * np.abs(gradient).sum()


def arrival(at: float, energy: float = 1.0, width: float = 0.15) -> np.ndarray:
    """A Gaussian pulse around a length [m], in 200 bins of 0.05 m."""
    edges = np.arange(201) * 0.05
    pulse = tofrender.GaussianPulse(width)
    masses = np.diff(np.array(pulse.cdf(mi.Float(edges - at))))
    return (energy * masses).astype(np.float32)[None, None, :, None]


def along(loss) -> np.ndarray:
    """Losses of a pulse that comes nearer, from 3 m early to its place."""
    return np.array([number(loss(arrival(x), arrival(6.0))) for x in np.linspace(3, 6, 16)])


def test_wasserstein_falls_from_afar_where_bins_are_flat():
    far = along(tofrender.wasserstein_loss)
    assert np.all(np.diff(far) < 0)
    # Of the window of 10 m: E|X - Y| - E|X - X'| for arrivals X, X' and Y
    assert abs(far[0] - (3 - 2 * 0.15 / np.pi**0.5) / 10) < 1e-4
    bins = along(tofrender.l2_loss)
    assert np.ptp(bins[:8]) < 1e-5
    assert abs(bins[0] - 2) < 1e-5


def test_phasors_fall_within_half_a_period():
    period = tofrender.SPEED_OF_LIGHT / 6.2
    loss = partial(tofrender.phasor_loss, frequency_hz=period, start_opl=0.0, bin_width_opl=0.05)
    assert np.all(np.diff(along(loss)) < 0)


def test_pixels_without_light():
    """Are neither divided by zero nor compared by their times."""
    rendered, target = cubes()
    rendered[0, 0], target[1, 1] = 0, 0
    attached = mi.TensorXf(rendered)
    dr.enable_grad(attached)
    loss = tofrender.wasserstein_loss(attached, target, energy_weight=0.0)
    dr.backward(loss)
    assert np.isfinite(number(loss))
    gradient = np.array(dr.grad(attached))
    assert np.isfinite(gradient).all()
    assert not gradient[1, 1].any()


def test_too_high_frequency_is_refused():
    with pytest.raises(ValueError, match=r"^frequency_hz = 3e\+08: must be below 2.99792e\+08"):
        tofrender.phasor_loss(*cubes(), frequency_hz=3e8, **AXIS)
