"""The scene language: plain dicts that JSON can hold. Lengths in metres, angles in degrees.

A scene has `camera`, `shapes`, `lights`, `media` (each of the latter three by name) and `segments`,
the largest number of segments of a path (-1: no limit). Everything is grey. README.md lists all
kinds and parameters.
"""

from __future__ import annotations

from typing import Any

Scene = dict[str, Any]
Vector = tuple[float, float, float]

BLACK = {"kind": "diffuse", "albedo": 0.0}
MIRROR = {"kind": "mirror"}
BOUNDARY = {"kind": "none"}


def scene(camera: dict, segments: int, **more: Any) -> Scene:
    return {"camera": camera, "segments": segments, "shapes": {}, "lights": {}, "media": {}} | more


def camera(origin: Vector, target: Vector, fov: float = 0.01, **more: Any) -> dict:
    """A pinhole camera; `width`, `height`, `up`, `crop` (x, y, width, height) and lens in `more`."""
    view = {"kind": "perspective", "origin": origin, "target": target, "up": (0.0, 1.0, 0.0)}
    return view | {"fov": fov, "width": 1, "height": 1} | more


def diffuse(albedo: float) -> dict:
    return {"kind": "diffuse", "albedo": albedo}


def glass(index: float) -> dict:
    return {"kind": "glass", "index": index}


def rectangle(center: Vector, u: Vector, v: Vector, material: dict, **more: Any) -> dict:
    """The points center ± u ± v, with its front towards u x v."""
    return {"kind": "rectangle", "center": center, "u": u, "v": v, "material": material} | more


def floor(material: dict, size: float = 10.0, height: float = 0.0, **more: Any) -> dict:
    """A square that faces up (+z)."""
    return rectangle((0, 0, height), (size, 0, 0), (0, size, 0), material, **more)


def ceiling(material: dict, size: float = 10.0, height: float = 0.0, **more: Any) -> dict:
    """A square that faces down (-z)."""
    return rectangle((0, 0, height), (size, 0, 0), (0, -size, 0), material, **more)


def sphere(center: Vector, radius: float, material: dict, **more: Any) -> dict:
    """A sphere; with `inward`, its front is its inside."""
    return {"kind": "sphere", "center": center, "radius": radius, "material": material} | more


def box(center: Vector, half: Vector, material: dict, **more: Any) -> dict:
    return {"kind": "box", "center": center, "half": half, "material": material} | more


def point(position: Vector, intensity: float, **more: Any) -> dict:
    return {"kind": "point", "position": position, "intensity": intensity} | more


def medium(absorption: float, scattering: float, phase: str = "isotropic", **more: Any) -> dict:
    """Coefficients per metre; `phase` is isotropic, rayleigh, or hg with `g`."""
    return {"absorption": absorption, "scattering": scattering, "phase": phase} | more


def bins(count: int, start: float, width: float, **more: Any) -> dict:
    """Bin k holds the light of optical path lengths from start + k width on."""
    return {"quantity": "bins", "count": count, "start": start, "width": width} | more
