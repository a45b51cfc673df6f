"""Next-event estimation and light tracing together: shares, and what both find."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from helpers.support import camera, diffuse, film, load
from oracles import light_paths as oracles

from tofrender.integrators.two_strategies import TransientTwoStrategies

VIEW = oracles.View(height=2.0)
LIGHT, ALBEDO = (0.5, 0.0, 3.0), 0.5


def floor() -> mi.Scene:
    plane = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale([20, 20, 1])}
    grey = {"type": "rgb", "value": [1.0, 1.0, 1.0]}
    return load(
        {
            "type": "scene",
            "sensor": camera((0, 0, 2), (0, 0, 0), film(8, 8, bins=1), fov=40.0),
            "floor": plane | {"bsdf": diffuse(ALBEDO)},
            "light": {"type": "point", "position": list(LIGHT), "intensity": grey},
        }
    )


def mean(end: str, seeds: int = 8) -> tuple[float, float]:
    """Film's mean and its standard error."""
    props = mi.Properties()
    props["max_depth"], props["end"] = 2, end
    tracer, scene = TransientTwoStrategies(props), floor()
    found = [np.array(tracer.render(scene, seed=k, spp=512)[0]).mean() for k in range(seeds)]
    return float(np.mean(found)), float(np.std(found, ddof=1) / seeds**0.5)


@pytest.mark.parametrize("end", ["both", "camera", "light"])
def test_shares_of_direct_light(end):
    x, y, _, _, _ = VIEW.points(1 << 16)
    d = np.sqrt((x - LIGHT[0]) ** 2 + y**2 + LIGHT[2] ** 2)
    radiance = ALBEDO / np.pi * LIGHT[2] / d**3
    by_camera = 1 / (oracles.window_area(40.0) * VIEW.height**2)
    by_light = LIGHT[2] / d / (4 * np.pi * d**2)
    total = by_camera**2 + by_light**2
    share = {"both": 1.0, "camera": by_camera**2 / total, "light": by_light**2 / total}[end]
    came, error = mean(end)
    assert abs(came - (radiance * share).mean()) < 5 * error + 1e-4 * came


def test_an_end_must_be_known():
    props = mi.Properties()
    props["end"] = "middle"
    with pytest.raises(ValueError, match="end = 'middle': must be one of"):
        TransientTwoStrategies(props)
