"""Surfaces and lights of small scenes, and where they are."""

from typing import Any

import mitsuba as mi
import numpy as np


def gray(value: float) -> dict:
    """The same in red, green and blue. (A flat spectrum of an emitter would look pink.)"""
    return {"type": "rgb", "value": [value] * 3}


def diffuse(albedo: float) -> dict:
    return {"type": "diffuse", "reflectance": gray(albedo)}


def plane(to_world=None, size: float = 10.0, **more: Any) -> dict:
    """A large square in z = 0 that faces +z, then moved by `to_world`."""
    to_world = mi.ScalarTransform4f() if to_world is None else to_world
    return {"type": "rectangle", "to_world": to_world @ mi.ScalarTransform4f().scale(size), **more}


def translate(x: float, y: float, z: float):
    return mi.ScalarTransform4f().translate([x, y, z])


def rotate(axis, angle: float):
    return mi.ScalarTransform4f().rotate(list(axis), angle)


def point_light(position, intensity: float) -> dict:
    return {"type": "point", "position": list(position), "intensity": gray(intensity)}


def area_light(radiance: float) -> dict:
    return {"type": "area", "radiance": gray(radiance)}


def unit(vector) -> np.ndarray:
    vector = np.asarray(vector, dtype=np.float64)
    return vector / np.linalg.norm(vector)
