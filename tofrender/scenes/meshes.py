"""Meshes of the built-in scenes as Mitsuba's objects."""

from functools import cache
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..runtime.interface import make_mesh
from .parts import Dict

FILE = Path(__file__).with_suffix(".npz")
"""Arrays of the bust and the bunny, computed by `scenes/make_meshes.py`."""

PARTS = ("vertices", "faces", "normals")

STROKE = 0.103  # Width of the strokes of the letter Z [m]

# The two halves of Mitsuba's `rectangle`, which spans [-1, 1] x [-1, 1] and faces +z.
HALVES = {
    "lower": np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]),
    "upper": np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]),
}


@cache
def stored(name: str) -> tuple[np.ndarray, ...]:
    """Vertices [m], faces (indices of corners, counter-clockwise from outside) and unit normals.

    `name` is "bust" or "bunny"; each array has the shape (n, 3), and is the same every time.
    """
    with np.load(FILE) as arrays:
        return tuple(arrays[f"{name}_{part}"] for part in PARTS)


def bust_mesh(**parts: Dict) -> Any:
    """The bust as an `mi.Mesh`; parts, e.g. a `bsdf`, are dicts for `mi.load_dict`."""
    return mesh_with("bust", *stored("bust"), **parts)


def bunny_mesh(to_world: Any | None = None, **parts: Dict) -> Any:
    """The rabbit as an `mi.Mesh` with parts as in `bust_mesh`, after a rotation and a shift."""
    vertices, faces, normals = stored("bunny")
    turned = normals if to_world is None else normals @ np.array(to_world.matrix)[:3, :3].T
    return mesh_with("bunny", transformed(vertices, to_world), faces, turned, **parts)


def letter_z() -> tuple[np.ndarray, np.ndarray]:
    """The letter Z, flat at z = 0, 0.8 m wide and high, its strokes `STROKE` wide.

    It faces -z, and reads as a Z for who looks along -z, at its back.

    Returns:
        Vertices [m], shape (12, 3), and indices of each triangle's corners, shape (6, 3).
    """
    half, inner = 0.4, 0.4 - STROKE
    # The diagonal's horizontal width w makes it STROKE wide: w = STROKE sqrt(1 + (run / rise)^2)
    rise, w = 2 * inner, STROKE
    for _ in range(30):
        w = STROKE * float(np.hypot(1, (2 * half - w) / rise))
    strokes = [
        [(-half, inner), (half, inner), (half, half), (-half, half)],
        [(-half, -inner), (w - half, -inner), (half, inner), (half - w, inner)],
        [(-half, -half), (half, -half), (half, -inner), (-half, -inner)],
    ]
    vertices = np.array([(x, y, 0.0) for stroke in strokes for x, y in stroke])
    faces = [(k + a, k + b, k + c) for k in (0, 4, 8) for a, b, c in ((0, 2, 1), (0, 3, 2))]
    return vertices, np.array(faces)


def letter_z_mesh(to_world: Any | None = None, **parts: Dict) -> Any:
    """The letter Z as an `mi.Mesh` with parts as in `bust_mesh`."""
    vertices, faces = letter_z()
    return mesh_with("letter_z", transformed(vertices, to_world), faces, None, **parts)


def half_rectangle(half: str, to_world: Any | None = None, **parts: Dict) -> Any:
    """The "lower" or "upper" one of the two triangles of a `rectangle`; parts as in `bust_mesh`."""
    corners = transformed(HALVES[half], to_world)
    return mesh_with(f"{half}_triangle", corners, np.array([[0, 1, 2]]), None, **parts)


def transformed(points: np.ndarray, to_world: Any | None) -> np.ndarray:
    """Points (n, 3) after a transform, if there is one."""
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
    """Return an `mi.Mesh` with parts, e.g. a `bsdf`, which are dicts for `mi.load_dict`."""
    properties = mi.Properties()
    for part, description in parts.items():
        properties[part] = mi.load_dict(description)
    return make_mesh(name, vertices, faces, normals, properties)
