"""A gate in fog: what it sees, and with how little noise."""

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from helpers.fogs import cube, filled, fog
from helpers.light_paths import spot
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate
from helpers.support import TIME, agree, camera, film, load, over_seeds, scene

import tofrender
from tofrender.media.ellipsoidal import GatedFog

pytestmark = pytest.mark.statistical
SEEDS = range(8)
WIDTH = 0.03
POINT = (0.5, 0.3, -0.4)
SPOT = spot((0.1, 0, 0), (0, 0, -2), beam=22.5, cutoff=30.0, intensity=50.0)
ASIDE = plane(
    translate(0.4, 0, 0) @ rotate((1, 0, 0), 180), 0.2, bsdf=diffuse(0.0), light=area_light(20.0)
)
LAMPS = {"point": point_light(POINT, 5.0), "spot": SPOT, "area": ASIDE}
TARGET = {"target": plane(translate(0, 0, -2), 20.0, bsdf=diffuse(0.8))}


def gated(parts: dict, medium: dict | None, depth: int, **more: Any) -> tuple[mi.Scene, Any]:
    flat = {k: v for k, v in film(4, 4).items() if k not in TIME} | {"type": "hdrfilm"}
    more |= {} if medium is None else {"medium": medium}
    view = camera((0, 0, 0), (0, 0, -2), flat, **more)
    gate = {"type": "time_gated_transient_path", "max_depth": depth, "rr_depth": 60}
    loaded = load(scene(parts, view, pulse_width_opl=WIDTH, **gate))
    return loaded, loaded.integrator()


def seen(pair: tuple, target: float, spp: int, seed: int) -> np.ndarray:
    loaded, integrator = pair
    sensor = loaded.sensors()[0]
    image = tofrender.render_at_time(loaded, integrator, sensor, target, spp=spp, seed=seed)
    return np.asarray(image, float)[..., 0]


@pytest.mark.parametrize("kind", ["even", "dense corner"])
def test_single_scattering_is_exact(kind):
    """One ray, one point light, one scattering: the closed form, seen through the pulse.

    L(l) = mu_s I exp(-mu_t l) / (4 pi d (l - p·ω)), t = (l² - p²) / (2 (l - p·ω)), d = l - t.
    """
    mu_s, mu_t, intensity, target = 0.3, 0.5, 5.0, 1.4
    pair = gated({"lamp": LAMPS["point"]}, fog(mu_t, mu_s / mu_t, 0.0, kind), 2, fov=0.05)
    length = target + WIDTH * np.linspace(-5, 5, 2001)
    pulse = np.exp(-((length - target) ** 2) / (2 * WIDTH**2)) / (WIDTH * np.sqrt(2 * np.pi))
    p2, along = np.dot(POINT, POINT), -POINT[2]
    first = (length**2 - p2) / (2 * (length - along))
    geometry = 4 * np.pi * (length - first) * (length - along)
    radiance = mu_s * intensity * np.exp(-mu_t * length) / geometry
    wanted = np.sum(radiance * pulse) * (length[1] - length[0])
    samples = over_seeds(lambda seed: seen(pair, target, 4096, seed).mean(), SEEDS)
    assert agree(samples, np.array(wanted), rounding=2e-3)


@pytest.mark.parametrize("kind", ["even", "dense corner", "box"])
@pytest.mark.parametrize("lamp", LAMPS)
def test_it_sees_what_plain_paths_do(lamp, kind, monkeypatch):
    """Up to three scatterings, on surfaces too, with lamps that turn their back on some points.

    In thin fog a pixel's variance is half of theirs or less, for most pixels.
    """
    parts = TARGET | {"lamp": LAMPS[lamp]}
    medium: Any = fog(0.5, 0.9, 0.5, "even" if kind == "box" else kind)
    if kind == "box":
        parts["fog"] = filled(cube(0.3, (0.1, 0, -1)), fog(2.0, 0.9))
        medium = None
    pair = gated(parts, medium, 4)
    samples = over_seeds(lambda seed: seen(pair, 2.5, 2048, seed).mean(), SEEDS)
    thin = gated(TARGET | {"lamp": LAMPS[lamp]}, fog(0.5, 0.9, 0.5), 8)

    def variance() -> float:
        return np.median(over_seeds(lambda seed: seen(thin, 1.0, 256, seed), SEEDS).var(0, ddof=1))

    ours = variance() if kind == "even" else None
    monkeypatch.setattr(GatedFog, "serves", staticmethod(lambda scene: False))
    reference = over_seeds(lambda seed: seen(pair, 2.5, 16384, seed + 100).mean(), SEEDS)
    assert agree(samples, reference, rounding=1e-3)
    assert ours is None or variance() > 2 * ours
