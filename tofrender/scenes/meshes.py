"""Meshes of the built-in scenes, as Mitsuba's objects and as the PLY files that XML scenes read.

`write("scenes/meshes")` writes the files anew.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from .bust import bust
from .parts import Dict

# The two halves of Mitsuba's `rectangle`, which spans [-1, 1] x [-1, 1] and faces +z.
HALVES = {
    "lower": np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]),
    "upper": np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
}


def bust_mesh(**parts: Dict) -> Any:
    """The bust as an `mi.Mesh`.

    Args:
        **parts: What belongs to the shape, e.g. `bsdf`, each a dict for `mi.load_dict`.
    """
    return _mesh("bust", *bust(), **parts)


def half_rectangle(half: str, to_world: Any | None = None, **parts: Dict) -> Any:
    """One of the two triangles that make up a `rectangle`.

    Args:
        half: "lower" or "upper".
        to_world: The rectangle's transform.
        **parts: As for `bust_mesh`.
    """
    corners = HALVES[half]
    if to_world is not None:
        matrix = np.array(to_world.matrix)
        corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
    return _mesh(f"{half}_triangle", corners, np.array([[0, 1, 2]]), None, **parts)


def _mesh(
    name: str, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None, **parts: Dict
) -> Any:
    properties = mi.Properties()
    for part, description in parts.items():
        properties[part] = mi.load_dict(description)
    smooth = normals is not None
    mesh = mi.Mesh(name, len(vertices), len(faces), properties, has_vertex_normals=smooth)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    if normals is not None:
        parameters["vertex_normals"] = normals.astype(np.float32).ravel()
    parameters.update()
    return mesh


def write(folder: str | Path) -> None:
    """Write bust.ply, lower_triangle.ply and upper_triangle.ply into `folder`.

    Raises:
        NotADirectoryError: There is no such folder.
    """
    if not Path(folder).is_dir():
        raise NotADirectoryError(f"folder = {str(folder)!r}: must be a folder that exists")
    meshes = {"bust": bust_mesh()}
    meshes |= {f"{half}_triangle": half_rectangle(half) for half in HALVES}
    for name, mesh in meshes.items():
        mesh.write_ply(str(Path(folder) / f"{name}.ply"))
