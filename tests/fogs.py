"""Media for tests: even ones, and grids of the same density."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np


def fog(
    sigma_t: float = 1.0, albedo: Any = 1.0, g: float = 0.0, kind: str = "even", **more: Any
) -> dict:
    """A medium of one density, or a grid of it: "grid", or "dense corner" with null collisions."""
    phase = {"type": "hg", "g": g} if g else {"type": "isotropic"}
    more = {"albedo": albedo, "phase": phase} | more
    if kind == "even":
        return {"type": "homogeneous", "sigma_t": sigma_t, **more}
    density = np.ones((8, 8, 8, 1), np.float32)
    if kind == "dense corner":  # Far from all light; the majorant is 2.5 times what is needed
        density[0, 0, 0] = 2.5
    grid = volume(density, (-40, -40, -40), 80)
    return {"type": "heterogeneous", "sigma_t": grid, "scale": sigma_t, **more}


def volume(density: np.ndarray, corner: Any, size: Any) -> dict:
    """A grid of values, from a corner on."""
    place = mi.ScalarTransform4f().translate(list(corner)).scale(size)
    return {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(density.astype(np.float32)),
        "to_world": place,
        "filter_type": "nearest",
    }


def cloud(size: float, sigma_t: float = 4.0, **more: Any) -> dict:
    """Random densities in a cube around the origin, up to `sigma_t`."""
    density = np.random.default_rng(7).random((6, 6, 6, 1)) ** 2
    grid = volume(density, (-size,) * 3, 2 * size)
    return {"type": "heterogeneous", "sigma_t": grid, "scale": sigma_t, "albedo": 0.9} | more


def filled(shape: dict, medium: dict, **more: Any) -> dict:
    """A shape that is nothing but the boundary of a medium."""
    return shape | {"bsdf": {"type": "null"}, "interior": medium} | more


def cube(scale: Any, position: Any = (0, 0, 0), **more: Any) -> dict:
    place = mi.ScalarTransform4f().translate(list(position)).scale(scale)
    return {"type": "cube", "to_world": place, **more}


def sphere(radius: float, position: Any = (0, 0, 0), **more: Any) -> dict:
    return {"type": "sphere", "radius": radius, "center": list(position), **more}
