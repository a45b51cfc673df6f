"""Vertices of meshes and world transforms, by the interfaces of Mitsuba 3.9 and 3.10.

Mitsuba 3.9 keeps vertices in flat arrays `vertex_positions` and `vertex_normals`; 3.10 in tensors
(n, 3) `positions` and `normals`. There the pose of a sensor or emitter may be animated, and is then
that at time 0, and nested in `to_world`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

POSITIONS = ("vertex_positions", "positions")
NORMALS = ("vertex_normals", "normals")
POSE = "to_world"


def name_of(params: Mapping[str, Any], names: tuple[str, ...], prefix: str = "") -> str | None:
    """The parameter that has one of several names, None if there is none."""
    return next((f"{prefix}{name}" for name in names if f"{prefix}{name}" in params), None)


def pose_name(params: Mapping[str, Any], prefix: str = "") -> str | None:
    """The parameter that holds a pose, None if there is none."""
    key = f"{prefix}{POSE}"
    nested = (name for name in params.keys() if name.startswith(f"{key}."))  # noqa: SIM118
    return key if key in params else next(nested, None)


def rows(params: Mapping[str, Any], names: tuple[str, ...]) -> np.ndarray:
    """Positions [m] or normals of a mesh, float64 (n, 3); empty if there are none."""
    name = name_of(params, names)
    return np.array([] if name is None else params[name], dtype=np.float64).reshape(-1, 3)


def set_rows(params: Any, names: tuple[str, ...], values: np.ndarray) -> None:
    """Replace positions or normals of a mesh by others, (n, 3)."""
    name = name_of(params, names)
    params[name] = like(params[name], mi.Float(np.float32(values).ravel()))


def vectors(value: Any, kind: Any) -> Any:
    """Positions or normals as Dr.Jit vectors, with their derivatives."""
    return dr.unravel(kind, value.array if dr.is_tensor_v(value) else value)


def like(value: Any, flat: Any) -> Any:
    """A flat array of vectors in the form of a parameter: flat, or a tensor (n, 3)."""
    return type(value)(flat, shape=(dr.width(flat) // 3, 3)) if dr.is_tensor_v(value) else flat


def make_mesh(
    name: str,
    points: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray | None = None,
    properties: mi.Properties | None = None,
) -> Any:
    """A mesh of vertices, (n, 3), and indices of corners, (faces, 3)."""
    untyped: Any = mi.Mesh
    tensor: Any = mi.TensorXf
    indices: Any = mi.TensorXu
    more: dict[str, Any] = {} if properties is None else {"props": properties}
    smooth = {} if normals is None else {"normals": tensor(np.float32(normals))}
    try:
        mesh = untyped(name, len(points), len(faces), **more, has_vertex_normals=bool(smooth))
    except TypeError:  # Since 3.10
        tensors = {"positions": tensor(np.float32(points)), **smooth}
        return untyped(name, faces=indices(np.uint32(faces)), **tensors, **more)
    params = mi.traverse(mesh)
    params["faces"] = np.uint32(faces).ravel()
    for names, values in ((POSITIONS, points), (NORMALS, normals)):
        if values is not None:
            set_rows(params, names, values)
    params.update()
    return mesh


def readable(params: mi.SceneParameters) -> mi.SceneParameters:
    """Remove parameters without a value, which Mitsuba cannot read; returns the same object.

    The BSDF `hair` of Mitsuba 3.9 lists the kind of absorption that it does not use.
    """
    properties: Any = params.properties
    missing = [name for name, (value, *_) in properties.items() if value is None]
    if missing:
        params.keep([name for name in properties if name not in missing])
    return params


def world_transform(part: Any) -> Any:
    """Pose of a sensor or an emitter, at time 0 if it is animated."""
    found = part.world_transform()
    return found.eval(0.0) if hasattr(found, "eval") else found


def pose(part: Any) -> np.ndarray:
    """Matrix of a pose, see `world_transform`, float64 (4, 4)."""
    return np.array(world_transform(part).matrix, dtype=np.float64).reshape(4, 4)
