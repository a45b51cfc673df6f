"""True depth of a hidden scene."""

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

LAYERS = 256  # most surfaces that a ray passes on its way to a hidden one

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
    """Trace the distance of the nearest hidden surface from the relay wall.

    Rays leave the wall along its normal, one for each (y, x) of a reconstruction or each pixel of a
    capture, and pass through everything that is not hidden.

    Args:
        scene: As for `capture`.
        where: A result of `reconstruct` or `capture`.
        hidden_shapes: The hidden shapes: a shape, its id, or a list of either. By default the
            shapes whose ids start with "hidden"; if there are none, all but those whose ids start
            with "relay_wall" or "occluder" and those with a sensor or a light.

    Returns:
        (y, x) float64 [m], NaN where there is nothing.

    Raises:
        ValueError: No reconstruction or capture, or there is no such shape; one line.

    Example:
        >>> from tofrender import capture
        >>> depth = hidden_depth("nlos_plane", capture("nlos_plane", grid=(2, 2), spp=1))
        >>> depth.values.round(6).tolist()
        [[1.0, 1.0], [1.0, 1.0]]
    """
    where = read(where, (_VOXELS, _POINTS), "where")
    points, normals = _rays(where)
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, optimize=False)
    hidden = _hidden(scene, hidden_shapes)
    origin, d = (mi.Point3f(v.reshape(-1, 3).T.copy()) for v in (points, normals))
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
    coords = {axis: where[axis] for axis in ("y", "x")}
    depth = depth.reshape(points.shape[:2])
    return xr.DataArray(depth, coords, ("y", "x"), "depth", {"units": "m", "long_name": "depth"})


def _rays(where: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return points of the wall and its normals there, both (rows, columns, 3)."""
    if "sensor_grid" in where:
        points, normals = where["sensor_grid"].values, where["sensor_normals"].values
        return points.astype(float), normals.astype(float)
    x, y = np.meshgrid(where["x"].values, where["y"].values)
    along_x, along_y, along_z = where["frame_axes"].values.astype(np.float64)
    points = where["frame_origin"].values + x[..., None] * along_x + y[..., None] * along_y
    return points, np.broadcast_to(along_z, points.shape)


def _hidden(scene: mi.Scene, given: Any) -> list[mi.Shape]:
    if given is not None:
        return find_shapes(scene, given, "hidden_shapes")
    shapes = scene.shapes()
    others = [s for s in shapes if not s.id().startswith((DEFAULT_ID, "occluder"))]
    others = [s for s in others if not (s.is_sensor() or s.is_emitter())]
    known = [s for s in shapes if s.id().startswith("hidden")] or others
    if not known:
        raise ValueError("scene: has no hidden shapes; hidden_shapes must name one or more")
    return known
