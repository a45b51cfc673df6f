"""Checked access to the fields of captures in HDF5, in the layout of y-tal."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..runtime import checks

_GRID_AXES = {1: "N_3", 2: "X_Y_3"}


def code(fields: dict[str, Any], name: str, known: dict[int, str]) -> str:
    """Look up a field that must be a known code."""
    found = number(fields, name)
    if found not in known:
        allowed = ", ".join(f"{key} ({axes})" for key, axes in known.items())
        raise ValueError(f"{name} = {found:g}: must be one of {allowed}")
    return known[int(found)]


def _field(fields: dict[str, Any], name: str) -> Any:
    if fields.get(name) is None:
        problem = "lacks" if name not in fields else "has nothing in"
        raise ValueError(f"{problem} the field {name}; must have it, as y-tal does")
    return fields[name]


def array(fields: dict[str, Any], name: str) -> np.ndarray:
    """Return a field that must hold real numbers, as float32."""
    return checks.real_array(name, _field(fields, name), np.float32)


def number(fields: dict[str, Any], name: str) -> float:
    """Return a field that must be one number."""
    value = np.asarray(_field(fields, name))
    if value.size != 1 or value.dtype.kind not in "fiub":
        raise ValueError(f"{name} with shape {value.shape}: must be one number")
    return float(value.reshape(-1)[0])


def truth(fields: dict[str, Any], name: str) -> bool:
    """Return a field that must be 0 or 1, as a bool."""
    value = number(fields, name)
    if value not in (0, 1):
        raise ValueError(f"{name} = {value:g}: must be 0 or 1")
    return value == 1


def origin(fields: dict[str, Any], name: str) -> np.ndarray | None:
    """Return a field that must be a point (3,) [m], None if it is missing."""
    if fields.get(name) is None:
        return None
    values = array(fields, name)
    if values.size != 3:
        raise ValueError(f"{name} with shape {values.shape}: must be (3,)")
    return values.reshape(3)


def grid(fields: dict[str, Any], device: str) -> tuple[np.ndarray, np.ndarray]:
    """Return points and normals, (rows, columns, 3), of the sensor or the laser."""
    axes = code(fields, f"{device}_grid_format", _GRID_AXES)
    name = f"{device}_grid_normals"
    points = array(fields, f"{device}_grid_xyz")
    normals = array(fields, name) if fields.get(name) is not None else _default_normals(points)
    for what, values in ((f"{device}_grid_xyz", points), (name, normals)):
        if values.ndim != len(axes.split("_")) or values.shape[-1] != 3:
            raise ValueError(f"{what} with shape {values.shape}: must be {axes}")
        if not np.isfinite(values).all():
            raise ValueError(f"{what}: must hold finite numbers only")
    if axes == "N_3":
        points, normals = points[:, None], normals[:, None]
    return points.swapaxes(0, 1), normals.swapaxes(0, 1)


def _default_normals(points: np.ndarray) -> np.ndarray:
    depth = points[..., 2]
    if np.ptp(depth) > 1e-4:
        raise ValueError("has no normals, and points at several z; must have both or one z")
    return np.broadcast_to(np.array([0, 0, 1], np.float32), points.shape)
