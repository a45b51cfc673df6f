"""Create the meshes of the built-in scenes as Mitsuba objects."""

from functools import cache
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..runtime.interface import make_mesh
from .parts import Dict

FILE = Path(__file__).with_suffix(".npz")
"""File with the arrays of the bust and the bunny, written by `scenes/make_meshes.py`."""

PARTS = ("vertices", "faces", "normals")  # Names of the arrays of a mesh in this file

STROKE = 0.103  # Width of the strokes of the letter Z [m]

# The two halves of Mitsuba's `rectangle`, which covers [-1, 1] x [-1, 1] and faces +z
HALVES = {
    "lower": np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]),
    "upper": np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
}


@cache
def stored(name: str) -> tuple[np.ndarray, ...]:
    """Read the arrays of a stored mesh; later calls return the same arrays.

    Args:
        name: "bust" or "bunny".

    Returns:
        Vertices [m], faces (vertex indices, counter-clockwise seen from outside) and unit normals
        of the vertices, each of shape (n, 3).
    """
    with np.load(FILE) as arrays:
        return tuple(arrays[f"{name}_{part}"] for part in PARTS)


def bust_mesh(**parts: Dict) -> Any:
    """Return the bust as an `mi.Mesh`; parts, e.g. a `bsdf`, are dicts for `mi.load_dict`."""
    return mesh_with("bust", *stored("bust"), **parts)


def bunny_mesh(to_world: Any | None = None, **parts: Dict) -> Any:
    """Return the rabbit as an `mi.Mesh`, with parts as in `bust_mesh`.

    Args:
        to_world: A transform that only rotates and translates, or None.
        **parts: Parts of the mesh.
    """
    vertices, faces, normals = stored("bunny")
    turned = normals if to_world is None else normals @ np.array(to_world.matrix)[:3, :3].T
    return mesh_with("bunny", transformed(vertices, to_world), faces, turned, **parts)


def letter_z() -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of a flat letter Z at z = 0.

    The letter is 0.8 m wide and high, and its strokes are `STROKE` wide. Its front faces -z. It
    appears as a Z to a viewer who looks along -z, from the back of the letter.

    Returns:
        Vertices [m] of shape (12, 3), and vertex indices of the triangles of shape (6, 3).
    """
    half = 0.4  # Half the width of the letter [m]
    inner = half - STROKE

    # Find the horizontal width w of the diagonal: w = STROKE sqrt(1 + (run / rise)^2)
    rise = 2 * inner
    w = STROKE
    for _ in range(30):
        w = STROKE * float(np.hypot(1, (2 * half - w) / rise))

    # Corners of the upper, the diagonal and the lower stroke; two triangles for each
    strokes = [
        [(-half, inner), (half, inner), (half, half), (-half, half)],
        [(-half, -inner), (w - half, -inner), (half, inner), (half - w, inner)],
        [(-half, -half), (half, -half), (half, -inner), (-half, -inner)],
    ]
    vertices = np.array([(x, y, 0.0) for stroke in strokes for x, y in stroke])
    faces = [(k + a, k + b, k + c) for k in (0, 4, 8) for a, b, c in ((0, 2, 1), (0, 3, 2))]
    return vertices, np.array(faces)


def letter_z_mesh(to_world: Any | None = None, **parts: Dict) -> Any:
    """Return the letter Z as an `mi.Mesh`, with parts as in `bust_mesh`."""
    vertices, faces = letter_z()
    return mesh_with("letter_z", transformed(vertices, to_world), faces, None, **parts)


def half_rectangle(half: str, to_world: Any | None = None, **parts: Dict) -> Any:
    """Return the "lower" or "upper" triangle of a `rectangle`, with parts as in `bust_mesh`."""
    corners = transformed(HALVES[half], to_world)
    return mesh_with(f"{half}_triangle", corners, np.array([[0, 1, 2]]), None, **parts)


def transformed(points: np.ndarray, to_world: Any | None) -> np.ndarray:
    """Return points (n, 3) after a transform, or the same points if the transform is None."""
    if to_world is None:
        return points
    matrix = np.array(to_world.matrix)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def mesh_with(
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray | None = None,
    **parts: Dict,
) -> Any:
    """Return an `mi.Mesh` with arrays as in `stored` and parts as in `bust_mesh`."""
    properties = mi.Properties()
    for part, description in parts.items():
        properties[part] = mi.load_dict(description)
    return make_mesh(name, vertices, faces, normals, properties)
