"""The cases `fog` and `gates-in-fog`: time relative to Mitsuba's `volpath`, and noise of gates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest import mock

import mitsuba as mi
import numpy as np

import tofrender
from tofrender.media.ellipsoidal import GatedFog

from .timing import Row, in_turn, noise, trace

DEPTH = {"max_depth": 6, "rr_depth": 50}
HAZE = {
    "type": "homogeneous",
    "sigma_t": {"type": "rgb", "value": [0.3, 0.2, 0.1]},
    "albedo": {"type": "rgb", "value": [0.9, 0.8, 0.95]},
    "phase": {"type": "hg", "g": 0.5},
}


def fog(runs: int, quick: bool) -> list[Row]:
    """Render the Cornell box in colored fog, and with a cloud, at equal samples and rays."""
    size, spp = (32, 16) if quick else (128, 64)
    rows: list[Row] = []
    for name, change in (("in colored fog", _in_fog), ("with a cloud", _with_cloud)):
        # Describe the same scene for both integrators
        steady = tofrender.cornell_box_steady_state(width=size, height=size, spp=spp)
        steady["integrator"] = {"type": "volpath", **DEPTH}
        steady["sensor"]["sampler"] = {"type": "independent", "sample_count": spp}
        ours = tofrender.cornell_box(width=size, height=size, temporal_bins=300, spp=spp)
        ours["integrator"] = {"type": "transient_volpath", "light_samples": 1, **DEPTH}

        # Measure the times
        scenes = {"volpath": steady, "ours": ours}
        loaded = {key: mi.load_dict(change(each)) for key, each in scenes.items()}
        times = in_turn({key: trace(each, spp) for key, each in loaded.items()}, runs)
        what = f"Cornell box {name}, {size}x{size} x 300 bins, {spp} spp, over volpath"
        rows += times["ours"].rows(times["volpath"], what, wall=1.15)
    return rows


def gates_in_fog(runs: int, quick: bool) -> list[Row]:
    """Compare gates without and with sampling of the path length, by variance times CPU time."""
    size, spp = (8, 64) if quick else (16, 1024)
    rows: list[Row] = []
    for sigma_t in (0.5, 2.0, 10.0):
        scene = mi.load_dict(_headlight(size, sigma_t))
        for gate in (1.0, 2.5):
            functions = {True: _gate(scene, gate, spp, True), False: _gate(scene, gate, spp, False)}
            variance, times = noise(functions, max(runs, 8))
            gain = variance[False] / variance[True] * times[False].ratio(times[True])[1]
            target = 25.0 if sigma_t == 10 else None
            what = f"{sigma_t:g} per meter, gate at {gate:g} m: plain variance x cpu time over ours"
            rows.append((what, gain, target))
    return rows


def _in_fog(scene: dict[str, Any]) -> dict[str, Any]:
    """Fill the scene with fog."""
    scene["sensor"]["medium"] = HAZE
    return scene


def _with_cloud(scene: dict[str, Any]) -> dict[str, Any]:
    """Add a cloud of random density."""
    density = np.random.default_rng(0).random((8, 8, 8, 1)).astype(np.float32) ** 2
    place = mi.ScalarTransform4f().translate([-0.5, -0.4, -0.4])
    smoke = {
        "type": "heterogeneous",
        "albedo": 0.9,
        "scale": 8.0,
        "sigma_t": {"type": "gridvolume", "grid": mi.VolumeGrid(density), "to_world": place},
    }
    scene["cloud"] = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([0, 0.1, 0.1]).scale(0.5),
        "bsdf": {"type": "null"},
        "interior": smoke,
    }
    return scene


def _headlight(size: int, sigma_t: float) -> dict[str, Any]:
    """Describe a camera in fog, with a point light in front of it and a wall at 2 m."""
    look = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -2], [0, 1, 0])
    wall = mi.ScalarTransform4f().translate([0, 0, -2]).scale(20)
    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "to_world": look,
            "fov": 40.0,
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent"},
            "medium": {
                "type": "homogeneous",
                "sigma_t": sigma_t,
                "albedo": 0.9,
                "phase": {"type": "hg", "g": 0.5},
            },
        },
        "wall": {"type": "rectangle", "to_world": wall, "bsdf": {"type": "diffuse"}},
        "lamp": {"type": "point", "position": [0.5, 0.3, -0.4], "intensity": 5.0},
    }


def _gate(scene: mi.Scene, target: float, spp: int, ahead: bool) -> Callable[[int], np.ndarray]:
    """Return a function that renders a gate [m], with sampling of the path length if `ahead`."""
    gate: Any = {"type": "time_gated_transient_path", "max_depth": 20, "rr_depth": 50}
    integrator = mi.load_dict(gate | {"pulse_width_opl": 0.03})
    sensor = scene.sensors()[0]

    def draw(seed: int) -> np.ndarray:
        with mock.patch.object(GatedFog, "serves", staticmethod(lambda _: ahead)):
            options = {"spp": spp, "seed": seed}
            return np.asarray(
                tofrender.render_at_time(scene, integrator, sensor, target, **options)
            )

    return draw
