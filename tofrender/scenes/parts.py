"""Materials, media, shapes and lights of the built-in scenes, as dicts for `mi.load_dict`."""

from collections.abc import Sequence
from math import pi
from typing import Any

import mitsuba as mi

from ..runtime import checks

Dict = dict[str, Any]

X = [1, 0, 0]
Y = [0, 1, 0]

CORNELL = {
    "white": [0.885809, 0.698859, 0.666422],
    "green": [0.105421, 0.37798, 0.076425],
    "red": [0.570068, 0.0430135, 0.0443706],
}
"""Reflectances of the Cornell box's walls."""

LAMP_COLOR = [1.22, 1.02, 0.76]  # The mean of the channels is 1


def ref(name: str) -> Dict:
    """Return a reference to another part of the scene."""
    return {"type": "ref", "id": name}


def rgb(value: Sequence[float]) -> Dict:
    """Return a linear RGB color."""
    return {"type": "rgb", "value": list(value)}


def diffuse(reflectance: Sequence[float]) -> Dict:
    """Return a diffuse material with an RGB reflectance."""
    return {"type": "diffuse", "reflectance": rgb(reflectance)}


def extinction(sigma_t: float, most: float) -> float:
    """Check that an extinction coefficient is between 0 and `most` [1/m], and return it."""
    return checks.number("sigma_t", sigma_t, unit="1/m", low=0, high=most)


def medium(sigma_t: float, albedo: list[float], g: float) -> Dict:
    """Return a homogeneous medium with extinction [1/m], RGB albedo and HG phase function."""
    phase = {"type": "hg", "g": g}
    return {"type": "homogeneous", "sigma_t": sigma_t, "albedo": rgb(albedo), "phase": phase}


def pose(
    position: Sequence[float], axis: Sequence[float], angle: float, scale: Sequence[float]
) -> Any:
    """Return a transform that scales, then rotates about `axis` [degrees], then translates [m]."""
    return mi.ScalarTransform4f().translate(position).rotate(axis, angle).scale(scale)


def shape(kind: str, to_world: Any, bsdf: str) -> Dict:
    """Return a shape of a plugin `kind` with the scene's material `bsdf`."""
    return {"type": kind, "to_world": to_world, "bsdf": ref(bsdf)}


def sphere(center: Sequence[float], radius: float, bsdf: str) -> Dict:
    """Return a sphere [m] with the scene's material `bsdf`."""
    return {"type": "sphere", "center": list(center), "radius": radius, "bsdf": ref(bsdf)}


def cylinder(x: float, z: float, ys: Sequence[float], radius: float, bsdf: str) -> Dict:
    """Return a vertical cylinder without caps [m] with the scene's material `bsdf`.

    Args:
        x: Position of the axis [m].
        z: Position of the axis [m].
        ys: Heights of the two ends [m].
        radius: Radius [m].
        bsdf: Name of the material.
    """
    ends = {"p0": [x, ys[0], z], "p1": [x, ys[1], z]}
    return {"type": "cylinder", **ends, "radius": radius, "bsdf": ref(bsdf)}


def medium_boundary(to_world: Any, medium: str) -> Dict:
    """Return a cube that contains the scene's medium `medium` and does not refract light."""
    null = {"type": "null"}
    return {"type": "cube", "to_world": to_world, "bsdf": null, "interior": ref(medium)}


def area_light(radiance: Sequence[float]) -> Dict:
    """Return an area emitter with an RGB radiance [W m^-2 sr^-1]."""
    return {"type": "area", "radiance": rgb(radiance)}


def ball_light(
    center: Sequence[float], radius: float, power: float, color: Sequence[float]
) -> Dict:
    """Return a black sphere [m] that emits the power `power` times `color` [W].

    The radiance is power / (4 pi² radius²) times `color`.
    """
    radiance = power / (4 * pi**2 * radius**2)
    light = {"emitter": area_light([radiance * channel for channel in color])}
    return sphere(center, radius, "black") | light
