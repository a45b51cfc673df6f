"""The closed forms of gradients: their derivatives, and the numbers of section 9's table."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from oracles import films as oracles, gradients as forms

Z = np.array([0.0, 0.0, 1.0])
LAMP = (0.5, 0.0, 2.0)


VIEW = forms.View((0, 0, 2), (0, 0, 0), 20)


def central(function, x: float, step: float) -> np.ndarray:
    """Differences of fourth order."""
    near, far = (function(x + s * step) - function(x - s * step) for s in (1, 2))
    return (8 * near - far) / (12 * step)


@pytest.mark.parametrize("radius", [0.7, 1.2])
def test_g2_inside(radius):
    orders = [
        forms.derived(lambda R, n=n: forms.inside_sphere(R, 0.8, 2.0, n), radius) for n in range(3)
    ]
    totals = np.array([[np.zeros(2)] * 2] + [[o.moments(), o.d_moments()] for o in orders])
    for n, (bounce, change) in enumerate(np.diff(totals, axis=0)):
        assert bounce[0] == pytest.approx(oracles.sphere_bounce_total(n, radius, 0.8, 2.0))
        assert bounce[1] / bounce[0] == pytest.approx(radius * (2 + 4 * n / 3))
        assert change == pytest.approx([-2 * bounce[0] / radius, -bounce[1] / radius])


def floor(fov: float):
    view = forms.View((0, 0, 2), (0, 0, 0), fov)
    return lambda z: forms.lit_plane(view, z * Z, Z, LAMP, 1.0, 0.5)


def under_ceiling(z):
    view = forms.View((0, 0, 2), (0, 0, 0), 20)
    return forms.corridor(view, z, 3.0, LAMP, 1.0, (0.5, 0.4))


@pytest.mark.parametrize(
    ("form", "theta", "expected"),
    [
        (floor(1e-6), 0.0, [0.03312451, 0.06296146]),
        (floor(20), 0.0, [0.03250383, 0.06257378]),
        (under_ceiling, 0.0, [0.03571043, 0.06998518]),
        (lambda R: forms.sphere_light(R, 2.0, 0.6, 3.0, 0.7, 0.0), 0.5, [0.315, 0.45249487]),
    ],
    ids=["g1, one ray", "g1, film", "g1, with a ceiling", "g2, sphere light"],
)
def test_changes_of_sum_and_moment(form, theta, expected):
    light = forms.derived(form, theta)
    assert light.d_moments() == pytest.approx(expected, abs=3e-8)
    if theta:
        assert light.moments() == pytest.approx([0.07875, 0.12876281], abs=1e-8)


def test_g1_by_hand():
    """L = ρ H / (π r³), opl = H + r."""
    light = forms.derived(floor(1e-6), 0.0)
    assert light.d_opl == pytest.approx(-1.97014250, abs=1e-8)
    h, r = 2.0, math.sqrt(4.25)
    assert light.d_light.sum() == pytest.approx(-0.5 / math.pi * (1 / r**3 - 3 * h**2 / r**5))


def test_g3():
    straight = forms.derived(lambda n: forms.slab(n, 0.3, 0.0, 0.0, 1.0, 2), 1.5)
    assert straight.d_light == pytest.approx([-0.24576, 0.009043968])
    assert straight.d_opl == pytest.approx([0.3, 0.9])
    assert straight.light[0] == pytest.approx(oracles.slab_order(0, 1.5, 1.0))
    tilted = forms.derived(
        lambda n: forms.slab(n, 0.3, math.sin(math.radians(40)), 0.0, 1.0, 3), 1.5
    )
    assert tilted.d_opl[0] == pytest.approx(0.25734388, abs=1e-8)
    assert tilted.light == pytest.approx([0.91062428, 0.0019046309, 3.98366e-6], rel=1e-6)


def test_g4():
    phasor = forms.Phasor(20e6)
    z, change = (
        getattr(phasor, what)(forms.derived(lambda z: forms.seen_in_mirror(z, 2.0, 1.0, 3.0), 0.0))
        for what in ("value", "derivative")
    )
    phase = (z[0] * change[1] - z[1] * change[0]) / (z @ z)
    assert phase == pytest.approx(-0.83833801, abs=1e-8)


@pytest.mark.parametrize("x", [-0.3, 0.02, 0.25])
def test_g6(x):
    one = forms.Arrived(np.array([2.0]), np.array([1.0]), np.zeros(1), np.zeros(1))
    s = 0.1
    p = math.exp(-0.5 * (x / s) ** 2) / math.sqrt(2 * math.pi)
    assert forms.Gate(1 + x, s).by_width(one) == pytest.approx([2 * p / s * (x * x / s**3 - 1 / s)])
    for of, within in (
        (partial(forms.Gate, 1 + x), 1e-6),
        (partial(forms.Bins, 1 + x, 0.05, 1), 1e-8),
    ):
        found = central(lambda s, of=of: of(s).value(one), s, 1e-4)
        assert of(s).by_width(one) == pytest.approx(found, abs=within)
