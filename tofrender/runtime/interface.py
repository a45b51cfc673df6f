"""Vertices of meshes and poses, with the interfaces of Mitsuba 3.9 and 3.10.

Mitsuba 3.9 stores vertices in the flat arrays `vertex_positions` and `vertex_normals`. Mitsuba 3.10
stores them in the tensors `positions` and `normals` with shape (n, 3). In 3.10, the pose of a
sensor or an emitter may also be animated. Its parameters are then nested in `to_world`, and this
module uses the pose at time 0.
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
    """Return the name in `names` that exists in the parameters; None if all are missing."""
    return next((f"{prefix}{name}" for name in names if f"{prefix}{name}" in params), None)


def pose_name(params: Mapping[str, Any], prefix: str = "") -> str | None:
    """Return the name of the parameter with the pose; None if it is missing."""
    key = f"{prefix}{POSE}"
    nested = (name for name in params.keys() if name.startswith(f"{key}."))  # noqa: SIM118
    return key if key in params else next(nested, None)


def rows(params: Mapping[str, Any], names: tuple[str, ...]) -> np.ndarray:
    """Return positions [m] or normals of a mesh, float64 (n, 3); n is 0 if they are missing."""
    name = name_of(params, names)
    return np.array([] if name is None else params[name], dtype=np.float64).reshape(-1, 3)


def set_rows(params: Any, names: tuple[str, ...], values: np.ndarray) -> None:
    """Replace positions or normals of a mesh by `values` with shape (n, 3)."""
    name = name_of(params, names)
    params[name] = like(params[name], mi.Float(np.float32(values).ravel()))


def vectors(value: Any, kind: Any) -> Any:
    """Return positions or normals as Dr.Jit vectors of type `kind`, with derivatives."""
    return dr.unravel(kind, value.array if dr.is_tensor_v(value) else value)


def like(value: Any, flat: Any) -> Any:
    """Return a flat array in the form of the parameter `value`: flat, or a tensor (n, 3)."""
    return type(value)(flat, shape=(dr.width(flat) // 3, 3)) if dr.is_tensor_v(value) else flat


def make_mesh(
    name: str,
    points: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray | None = None,
    properties: mi.Properties | None = None,
) -> Any:
    """Make a mesh.

    Args:
        name: Name of the mesh.
        points: Vertices (n, 3) [m].
        faces: Indices of the vertices of each triangle (faces, 3).
        normals: Normals of the vertices (n, 3); None for a faceted mesh.
        properties: Properties with the BSDF and the emitter of the mesh.
    """
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
    """Remove parameters without a value, and return the same object.

    Mitsuba cannot read such parameters. The BSDF `hair` of Mitsuba 3.9 lists the parameters of
    absorption that it does not use.
    """
    properties: Any = params.properties
    missing = [name for name, (value, *_) in properties.items() if value is None]
    if missing:
        params.keep([name for name in properties if name not in missing])
    return params


def world_transform(part: Any) -> Any:
    """Return the pose of a sensor or an emitter; at time 0 if it is animated."""
    found = part.world_transform()
    return found.eval(0.0) if hasattr(found, "eval") else found


def pose(part: Any) -> np.ndarray:
    """Return the matrix of the pose of a sensor or an emitter, float64 (4, 4)."""
    return np.array(world_transform(part).matrix, dtype=np.float64).reshape(4, 4)
