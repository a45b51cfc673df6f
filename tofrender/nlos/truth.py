"""Ground-truth depth of a hidden scene."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import xarray as xr

from ..labels import VOLUME, Kind, read
from ..paths.surfaces import is_on
from ..runtime.backend import tracing_lock
from ..scenes.loading import load_scene
from .device.relay_wall import DEFAULT_ID, find_shapes

# Largest number of surfaces that a ray passes before it reaches a hidden surface
LAYERS = 256

_POINTS = Kind(
    "a capture", variables=dict.fromkeys(("sensor_grid", "sensor_normals"), ("y", "x", "xyz"))
)
_VOXELS = replace(VOLUME, variables=VOLUME.optional, optional=VOLUME.variables)


@tracing_lock()
def hidden_depth(
    scene: mi.Scene | Mapping[str, Any] | str | os.PathLike[str],
    where: Annotated[xr.Dataset, VOLUME],
    *,
    hidden_shapes: Any = None,
) -> xr.DataArray:
    """Trace the distance from the relay wall to the nearest hidden surface.

    Rays start at the wall, along its normal, one for each (y, x) of a reconstruction or each pixel
    of a capture. They pass through all surfaces that are not hidden shapes.

    Args:
        scene: As for `capture`.
        where: A result of `reconstruct` or `capture`.
        hidden_shapes: The hidden shapes: a shape, its id, or a list of shapes or ids. By default,
            the shapes with ids that start with "hidden". Without such shapes, all shapes except
            sensors, lights, and shapes with ids that start with "relay_wall" or "occluder".

    Returns:
        Depth (y, x) [m], float64. NaN if the ray hits no hidden shape.

    Raises:
        ValueError: `where` is not a reconstruction or a capture, or a shape is missing.

    Example:
        >>> from tofrender import capture
        >>> depth = hidden_depth("nlos_plane", capture("nlos_plane", grid=(2, 2), spp=1))
        >>> depth.values.round(6).tolist()
        [[1.0, 1.0], [1.0, 1.0]]
    """
    # Find the rays and the hidden shapes
    where = read(where, (_VOXELS, _POINTS), "where")
    points, normals = _rays(where)
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, optimize=False)
    hidden = _hidden(scene, hidden_shapes)

    # Trace the rays until they hit a hidden shape
    origin = mi.Point3f(points.reshape(-1, 3).T.copy())
    d = mi.Point3f(normals.reshape(-1, 3).T.copy())
    depth = np.full(points.shape[:2], np.nan).ravel()
    ray = mi.Ray3f(origin, mi.Vector3f(d))
    active: Any = mi.Bool(True)
    for _ in range(LAYERS):
        si = scene.ray_intersect(ray, active)
        found = is_on(si, hidden) & active
        r = np.array(dr.dot(si.p - origin, d), dtype=np.float64)
        depth = np.where(np.array(found), r, depth)
        active = active & si.is_valid() & ~found
        if not dr.any(active):
            break
        ray = si.spawn_ray(ray.d)

    # Return a labeled array
    coords = {axis: where[axis] for axis in ("y", "x")}
    depth = depth.reshape(points.shape[:2])
    return xr.DataArray(depth, coords, ("y", "x"), "depth", {"units": "m", "long_name": "depth"})


def _rays(where: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the start points on the wall and the normals there, both (rows, columns, 3)."""
    # Pixels of a capture
    if "sensor_grid" in where:
        points = where["sensor_grid"].values
        normals = where["sensor_normals"].values
        return points.astype(float), normals.astype(float)

    # Voxel columns of a reconstruction
    x, y = np.meshgrid(where["x"].values, where["y"].values)
    along_x, along_y, along_z = where["frame_axes"].values.astype(np.float64)
    points = where["frame_origin"].values + x[..., None] * along_x + y[..., None] * along_y
    return points, np.broadcast_to(along_z, points.shape)


def _hidden(scene: mi.Scene, given: Any) -> list[mi.Shape]:
    """Return the hidden shapes, as `hidden_depth` documents."""
    if given is not None:
        return find_shapes(scene, given, "hidden_shapes")
    shapes = scene.shapes()
    others = [s for s in shapes if not s.id().startswith((DEFAULT_ID, "occluder"))]
    others = [s for s in others if not (s.is_sensor() or s.is_emitter())]
    known = [s for s in shapes if s.id().startswith("hidden")] or others
    if not known:
        raise ValueError("scene: hidden shapes are missing. Name one or more by hidden_shapes")
    return known
