"""Materials, media, shapes and lights that the built-in scenes are made of."""

from collections.abc import Sequence
from math import pi
from typing import Any

import mitsuba as mi

from ..runtime import checks

Dict = dict[str, Any]

X, Y = [1, 0, 0], [0, 1, 0]

CORNELL = {
    "white": [0.885809, 0.698859, 0.666422],
    "green": [0.105421, 0.37798, 0.076425],
    "red": [0.570068, 0.0430135, 0.0443706],
}
"""Reflectances of the Cornell box's walls."""

LAMP_COLOUR = [1.22, 1.02, 0.76]  # its mean is 1


def ref(name: str) -> Dict:
    """A reference to another part of the scene."""
    return {"type": "ref", "id": name}


def rgb(value: Sequence[float]) -> Dict:
    """A colour, linear RGB."""
    return {"type": "rgb", "value": list(value)}


def diffuse(reflectance: Sequence[float]) -> Dict:
    """A diffuse material."""
    return {"type": "diffuse", "reflectance": rgb(reflectance)}


def extinction(sigma_t: float, most: float) -> float:
    """A checked extinction coefficient [1/m]."""
    return checks.number("sigma_t", sigma_t, unit="1/m", low=0, high=most)


def medium(sigma_t: float, albedo: list[float], g: float) -> Dict:
    """A homogeneous medium of an extinction [1/m] and an HG phase function."""
    phase = {"type": "hg", "g": g}
    return {"type": "homogeneous", "sigma_t": sigma_t, "albedo": rgb(albedo), "phase": phase}


def pose(
    position: Sequence[float], axis: Sequence[float], angle: float, scale: Sequence[float]
) -> Any:
    """Transform that scales, rotates about `axis` by `angle` degrees, moves to `position` [m]."""
    return mi.ScalarTransform4f().translate(position).rotate(axis, angle).scale(scale)


def shape(kind: str, to_world: Any, bsdf: str) -> Dict:
    """A shape that uses the scene's material `bsdf`."""
    return {"type": kind, "to_world": to_world, "bsdf": ref(bsdf)}


def sphere(center: Sequence[float], radius: float, bsdf: str) -> Dict:
    """A sphere [m] that uses the scene's material `bsdf`."""
    return {"type": "sphere", "center": list(center), "radius": radius, "bsdf": ref(bsdf)}


def cylinder(x: float, z: float, ys: Sequence[float], radius: float, bsdf: str) -> Dict:
    """An upright cylinder without caps [m] that uses the scene's material `bsdf`."""
    ends = {"p0": [x, ys[0], z], "p1": [x, ys[1], z]}
    return {"type": "cylinder", **ends, "radius": radius, "bsdf": ref(bsdf)}


def medium_boundary(to_world: Any, medium: str) -> Dict:
    """A cube that holds a medium and refracts no light."""
    null = {"type": "null"}
    return {"type": "cube", "to_world": to_world, "bsdf": null, "interior": ref(medium)}


def area_light(radiance: Sequence[float]) -> Dict:
    """Emitter of a shape; radiance [W m^-2 sr^-1]."""
    return {"type": "area", "radiance": rgb(radiance)}


def ball_light(
    center: Sequence[float], radius: float, power: float, colour: Sequence[float]
) -> Dict:
    """A black sphere that radiates `power` times `colour` [W]: radiance power / (4 pi² radius²)."""
    radiance = power / (4 * pi**2 * radius**2)
    light = {"emitter": area_light([radiance * channel for channel in colour])}
    return sphere(center, radius, "black") | light
