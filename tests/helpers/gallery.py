"""Small scenes with every kind of light and material, for tests that compare two renderers."""

from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from helpers.parts import area_light, diffuse, gray, plane, point_light
from helpers.support import camera, film, scene, with_sampler
from tofrender.scenes import cornell_box, cornell_box_flash, cornell_box_glass, cornell_box_mirror

SIZE = {"width": 8, "height": 8, "temporal_bins": 2000, "start_opl": 0.0, "max_depth": 12}


def _cornell(builder, **parts: Any) -> dict:
    return with_sampler(builder(**SIZE)) | parts


def _without_light(**parts: Any) -> dict:
    described = _cornell(cornell_box, **parts)
    del described["light"], described["ceiling"]
    return described


def _small_box(bsdf: dict) -> dict:
    described = _cornell(cornell_box)
    return described | {"small-box": described["small-box"] | {"bsdf": bsdf}}


def _ball_in_ball() -> dict:
    def ball(radius, inside, outside):
        glass = {"type": "dielectric", "int_ior": inside, "ext_ior": outside}
        return {"type": "sphere", "center": [0.3, -0.5, 0.4], "radius": radius, "bsdf": glass}

    described = _cornell(cornell_box, glass=ball(0.45, 1.5, 1.0), water=ball(0.3, 1.33, 1.5))
    del described["small-box"]
    return described


def _lamps() -> dict:
    """Several lights of different kinds at once."""
    at = mi.ScalarTransform4f().look_at([0, 0.5, 2], [0, -1, 0], [0, 1, 0])
    spot = {"type": "spot", "intensity": gray(20.0), "cutoff_angle": 30.0, "to_world": at}
    ball = {"type": "sphere", "center": [-0.5, 0.3, 0.6], "radius": 0.15}
    ball["emitter"] = area_light(6.0)
    return _cornell(cornell_box, spot=spot, ball=ball, lamp=point_light((0.4, 0.2, 0.7), 0.5))


PICTURE = np.linspace(0.1, 2.0, 8 * 16 * 3).reshape(8, 16, 3).astype(np.float32)
SUN = {"type": "directional", "direction": [0.2, -0.9, -0.3]}
LIGHTS = {
    "constant environment": {"type": "constant", "radiance": gray(1.0)},
    "environment map": {"type": "envmap", "bitmap": mi.Bitmap(PICTURE)},
    "directional": SUN | {"irradiance": gray(3.0)},
}
SIX = mi.ScalarTransform4f().scale([6, 6, 1])
CHECKERS = {"type": "checkerboard", "color0": gray(0.1), "color1": gray(0.9), "to_uv": SIX}
MATERIALS = {
    "texture": {"type": "diffuse", "reflectance": CHECKERS},
    "rough conductor": {"type": "roughconductor", "material": "Au", "alpha": 0.1},
    "rough plastic": {"type": "roughplastic", "alpha": 0.15},
    "rough glass": {"type": "roughdielectric", "alpha": 0.2},
    "principled": {"type": "principled", "metallic": 0.3, "roughness": 0.4},
    "mask": {"type": "mask", "opacity": 0.4, "nested": diffuse(0.8)},
}

SCENES = {
    "cornell": lambda: _cornell(cornell_box),
    "flash": lambda: _cornell(cornell_box_flash),
    "glass": lambda: _cornell(cornell_box_glass),
    "mirror": lambda: _cornell(cornell_box_mirror),
    "nested dielectrics": _ball_in_ball,
    **{name: partial(_without_light, sky=light) for name, light in LIGHTS.items()},
    "many lights": _lamps,
    **{name: partial(_small_box, bsdf) for name, bsdf in MATERIALS.items()},
}
"""Scenes of 8 x 8 pixels and 12 segments, most paths end by roulette; the window holds all."""


def emitter_grid(width: int, height: int) -> tuple[dict, np.ndarray]:
    """A picture without noise in space and time: (scene, transient without channels).

    An orthographic camera looks along -z at a glowing picture in a tilted plane: the light of
    pixel (x, y) has the value of its texel, and comes from a depth that grows by one bin (1/8 m)
    for each column.
    """
    values = (1 + np.arange(width * height).reshape(height, width)).astype(np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(values[::-1, :, None].copy()), "raw": True}
    texture |= {"filter_type": "nearest", "wrap_mode": "clamp"}
    # The camera's view is two units wide; columns go along +x, and the plane falls along +x
    tilt = np.eye(4)
    tilt[2, 0] = -width / 16
    half = mi.ScalarTransform4f().scale([1, height / width, 1])
    light = {"type": "area", "radiance": texture}
    picture = plane(mi.ScalarTransform4f(tilt) @ half, 1, emitter=light)
    window = film(width, height, bins=width, bin_width=1 / 8, start=2 - width / 16)
    sensor = camera((0, 0, 2), (0, 0, 0), window, kind="orthographic", near_clip=0.1)
    described = scene({"picture": picture}, sensor, max_depth=1)
    return described, values[:, :, None] * np.eye(width)
