"""The case `nlos`: captures of a hidden letter, compared with mitransient at equal time."""

from __future__ import annotations

from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

import tofrender

from .timing import Row, noise

STROKES = (((0.0, 0.35), (0.8, 0.1)), ((0.0, -0.35), (0.8, 0.1)), ((0.0, 0.0), (0.1, 0.6)))
"""Centers and sizes of the strokes of the letter [m], which is 1 m in front of the wall."""


def letter(prefix: str, size: int, mode: int, **integrator: Any) -> dict[str, Any]:
    """Describe the scene, with plugins of tofrender (`prefix` "tofrender_") or of mitransient."""
    # Describe the parts of the capture
    place = mi.ScalarTransform4f()
    white = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.8}}
    film = {
        "type": f"{prefix}transient_hdr_film",
        "width": size,
        "height": size,
        "temporal_bins": 300,
        "bin_width_opl": 0.006,
        "start_opl": 1.85,
        "rfilter": {"type": "box"},
    }
    device = [-0.5, 0.0, 0.25]
    sampler = {"type": "tofrender_padded_sobol" if prefix else "independent"}
    meter = {"type": f"{prefix}nlos_capture_meter", "sensor_origin": device}

    # Describe the laser, the relay wall and the integrator
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {
            "type": f"{prefix}transient_nlos_path",
            "nlos_laser_sampling": True,
            "nlos_hidden_geometry_sampling": True,
            "account_first_and_last_bounces": False,
            "capture_type": mode,
            "temporal_filter": "box",
            **integrator,
        },
        "wall": {
            "type": "rectangle",
            "bsdf": white,
            "meter": meter | {"film": film} | {"s": sampler},
        },
        "laser": {
            "type": "projector",
            "irradiance": 100.0,
            "fov": 0.2,
            "to_world": place.look_at(device, [0, 0, 0], [0, 1, 0]),
        },
    }

    # Add the strokes
    for k, ((x, y), (width, height)) in enumerate(STROKES):
        pose = place.translate([x, y, 1]).rotate([0, 1, 0], 180).scale([width / 2, height / 2, 1])
        scene[f"stroke{k}"] = {"type": "rectangle", "to_world": pose, "bsdf": white}
    return scene


def nlos(runs: int, quick: bool) -> list[Row]:
    """Compare variance times CPU time with mitransient, for three bounces and for all bounces."""
    try:
        import mitransient  # noqa: F401
    except ImportError:
        return []
    size, spp = (16, 16) if quick else (64, 256)

    def draw(scene: mi.Scene, seed: int) -> np.ndarray:
        return np.array(mi.render(scene, spp=spp, seed=seed + 1)[1])

    rows: list[Row] = []
    for mode, name in ((1, "single"), (2, "confocal")):
        # mitransient renders all bounces, because its filter of bounces is off by one
        peer = mi.load_dict(letter("", size, mode), optimize=False)
        for bounces, target in ((3, 10.0), (-1, 2.0)):
            described = letter("tofrender_", size, mode, filter_bounces=bounces)
            ours = tofrender.load_scene(described, optimize=False)
            functions = {"mitransient": partial(draw, peer), "ours": partial(draw, ours)}
            variance, times = noise(functions, runs)
            gain = variance["mitransient"] / variance["ours"]
            kind = "three bounces" if bounces == 3 else "all bounces"
            what = f"hidden letter, {size}x{size}, {name}, {kind}: variance x time over ours"
            rows += times["mitransient"].rows(times["ours"], what, target, target, gain)
    return rows
