"""Meshes in STL files, binary and ASCII, which Mitsuba does not read."""

import os
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..runtime import checks, memory
from ..scenes.meshes import mesh_with
from .files import reading

HEADER = 80  # Bytes of text before the number of triangles
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
BYTES_IN_MEMORY = 400  # Memory for each triangle while vertices are merged
WORDS_OF_TRIANGLE = 21  # facet normal x y z outer loop (vertex x y z) * 3 endloop endfacet


def load_stl(path: str | os.PathLike[str], **parts: Any) -> mi.Mesh:
    """Read a mesh from an STL file.

    Args:
        path: A binary or ASCII STL file.
        **parts: Parts of the mesh by name, as dicts for `mi.load_dict`, for example
            `bsdf={"type": "diffuse"}`.

    Returns:
        The mesh, which can be a part of a scene's dict. Vertices with equal coordinates are merged,
        and the mesh has flat faces. STL files do not state a unit; coordinates are used as meters.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file has another format, is cut short, or has coordinates that are not
            finite.

    Example:
        >>> import tempfile, pathlib
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = pathlib.Path(folder, "a.stl")
        ...     corners = "vertex 0 0 0 vertex 1 0 0 vertex 0 1 0"
        ...     text = f"facet normal 0 0 1 outer loop {corners} endloop endfacet"
        ...     _ = file.write_text(f"solid a {text} endsolid a")
        ...     load_stl(file, bsdf={"type": "diffuse"}).face_count()
        1
    """
    vertices, faces = read_stl(path)
    return mesh_with(Path(path).stem, vertices, faces, **parts)


def read_stl(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    """Read the vertices (n, 3) and the corners of faces (m, 3) of an STL file, see `load_stl`."""
    with reading(path, "a binary or ASCII STL file") as file:
        corners = _corners(file)
        checks.finite("vertices", corners)
        vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        return vertices.astype(np.float64), index.reshape(-1, 3)


def _corners(file: Path) -> np.ndarray:
    """Read the corners of all triangles, float32 (triangles, 3, 3)."""
    size = file.stat().st_size
    memory.require_free("triangles", size // TRIANGLE.itemsize * BYTES_IN_MEMORY)
    content = file.read_bytes()

    # The count of a binary file states its length. Some binary files start with "solid", too
    if size >= HEADER + 4:
        count = int.from_bytes(content[HEADER : HEADER + 4], "little")
        if size == HEADER + 4 + count * TRIANGLE.itemsize:
            checks.require("triangles", count, count > 0, "1 or more")
            return np.frombuffer(content, TRIANGLE, count, HEADER + 4)["corners"]
    if content.lstrip()[:5].lower() != b"solid":
        raise ValueError("is cut short, or is not an STL file; must be complete")
    return _ascii_corners(content.decode("utf-8", "replace"))


def _ascii_corners(text: str) -> np.ndarray:
    """Read the triangles of an ASCII file, with one solid or several."""
    # Find the triangles
    words = text.lower().split()
    starts = [k for k, word in enumerate(words) if word == "facet"]
    checks.require("triangles", len(starts), len(starts) > 0, "1 or more")
    checks.require("last word", words[-1][:20], "endsolid" in words[-3:], "endsolid and a name")

    # Read three corners of each triangle
    corners = np.empty((len(starts), 3, 3), np.float32)
    for number, start in enumerate(starts):
        facet = words[start : start + WORDS_OF_TRIANGLE]
        expected = {1: "normal", 5: "outer", 6: "loop", 7: "vertex", 11: "vertex", 15: "vertex"}
        expected |= {19: "endloop", 20: "endfacet"}
        whole = len(facet) == WORDS_OF_TRIANGLE and all(
            facet[k] == word for k, word in expected.items()
        )
        if not whole:
            raise ValueError(f"triangle {number} must be a facet with a normal and three vertices")
        for corner in range(3):
            first = 8 + 4 * corner
            corners[number, corner] = [float(word) for word in facet[first : first + 3]]
    return corners
