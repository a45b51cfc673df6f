"""When the light of the course's path tracers arrives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.gallery import SCENES
from helpers.support import (
    agree,
    camera,
    film,
    largest,
    load,
    over_seeds,
    rendered,
    with_film,
)
from helpers.tracers import (
    ALBEDO,
    GLOW,
    TRACERS,
    all_equal,
    course,
    furnace,
    picture,
    steady,
    traced,
)
from oracles import films as oracles


@pytest.mark.statistical
@pytest.mark.parametrize("tracer", TRACERS)
def test_furnace_in_time(tracer):
    """Bounce n carries Le rho^n and comes after the radius and n chords."""
    edges = 0.9 + 0.2 * np.arange(31)
    expected = sum(
        GLOW * ALBEDO**n * oracles.sphere_bounce_masses(n, edges + 1, 1.0) for n in range(4)
    )
    shown = expected > 0.01  # the longest ways are too rare to judge
    assert expected[shown].sum() > 0.99 * GLOW * (1 + ALBEDO + ALBEDO**2 + ALBEDO**3)
    loaded = load(furnace(tracer, 3, film(4, 4, bins=30, start=0.9, bin_width=0.2)))
    bins = rendered(loaded, 1 << 13)[1][..., 0].reshape(16, -1)
    assert agree(bins[:, shown], expected[shown], rounding=5e-3)
    assert not agree(np.roll(bins, 1, axis=1)[:, shown], expected[shown], rounding=5e-3)


@pytest.mark.usefixtures("mitsubas_steps")
@pytest.mark.parametrize(
    ("name", "tracer"),
    [*zip(2 * ["glass", "environment map"], TRACERS, strict=True), ("environment map", "reuse")],
)
def test_bins_hold_the_picture(tracer, name):
    """Both windows add up to the picture of a film without time."""
    described = traced(SCENES[name](), tracer)
    whole = picture(steady(described), seed=3)
    parts = []
    for start, bins in [(0.0, 450), (9.0, 1500)]:
        window = {"start_opl": start, "temporal_bins": bins, "bin_width_opl": 0.02}
        total, part = rendered(with_film(described, **window), seed=3)
        assert largest(total, whole) < 1e-5
        parts.append(part.sum(axis=2))
    assert all(part.max() > 0 for part in parts)
    assert largest(sum(parts), whole) < 1e-5


@pytest.mark.statistical
def test_tracers_agree_in_time():
    """The small box bin by bin, in the sum over its pixels."""
    window = film(8, 8, bins=24, start=2.5, bin_width=0.2)
    described = course("small_box")
    described["sensor"] = described["sensor"] | {"film": window}

    def bins(integrator, spp, seeds):
        loaded = load(described | {"integrator": integrator | {"max_depth": 5}})
        return over_seeds(lambda s: rendered(loaded, spp, s)[1].mean(axis=(0, 1, 3)), seeds)

    reference = bins({"type": "transient_path"}, 256, range(100, 116))
    found = {
        tracer: bins(TRACERS[tracer], 1024 if tracer == "mats" else 256, range(16))
        for tracer in ("mats", "nee", "one_sample")
    }
    assert all_equal(found, reference)
    for tracer in found:
        assert not agree(np.roll(found[tracer], 1, axis=1), reference)


HEIGHT, POWER = 2.8, 260.0


def below_the_light(size: str, tracer: str, edges: np.ndarray) -> np.ndarray:
    """What the floor right below a sphere light of the course reflects, for 64 seeds at once.

    All pixels look at the same point, from a distance of 1.5 m.
    """
    described = course(f"sphere_light_{size}", integrator=TRACERS[tracer]["type"])
    described["integrator"] = described["integrator"] | TRACERS[tracer]
    window = film(8, 8, bins=edges.size - 1, start=edges[0] + 1.5, bin_width=edges[1] - edges[0])
    described["sensor"] = camera((0.9, 1.2, 0), (0, 0, 0), window, fov=1e-3)
    return rendered(described, spp=4096)[1][..., 0].reshape(64, -1)


@pytest.mark.statistical
@pytest.mark.parametrize("tracer", TRACERS)
def test_lights_of_equal_power_differ_in_time_alone(tracer):
    """Nearest points come first: of radius r at height h, the pole at h - r.

    What comes from the distance t arrives under the cosine (t² + h² - r²) / (2 t h), by the law of
    cosines, and this falls as t grows: E(t) = pi Le (1 - cos²(t)), until sqrt(h² - r²).
    """
    edges, total = 1.76 + np.arange(49) / 32, 0.75 / math.pi * POWER / (4 * math.pi * HEIGHT**2)
    first = {}
    for size, r in (("small", 0.03), ("medium", 0.3), ("large", 0.9)):
        if (size, tracer) == ("small", "mats"):
            continue  # one ray in 9000 finds it
        t = np.clip(edges, HEIGHT - r, math.sqrt(HEIGHT**2 - r**2))
        cosine = (t**2 + HEIGHT**2 - r**2) / (2 * t * HEIGHT)
        expected = 0.75 * POWER / (4 * math.pi**2 * r**2) * np.diff(1 - cosine**2)
        assert expected.sum() == pytest.approx(total)
        bins = below_the_light(size, tracer, edges)
        steady_light = bins.sum(axis=1, keepdims=True)
        assert agree(np.hstack([bins, steady_light]), np.append(expected, total))
        first[size] = edges[np.flatnonzero(bins.any(axis=0))[0]]
        assert first[size] <= HEIGHT - r < first[size] + 1 / 32
    assert first["large"] < first["medium"] - 0.5
