"""A sitting rabbit: smoothly blended ellipsoids as one closed mesh.

Each part is an ellipsoid with an approximate signed distance d. Their smooth union is the surface

    -K log(sum of exp(-d / K)) = 0.

The mesh is a surface net on a regular grid (S. Gibson, "Constrained Elastic Surface Nets", MICCAI
1998). Every cell that the surface passes through gets a vertex, at the mean of the points where the
cell's edges cross the surface. Every grid edge that crosses the surface gets a quad, formed by the
vertices of the four cells around the edge. Then the vertices are smoothed and projected onto the
surface. The gradient of the distance gives the normals.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Center x, y, z [m]; half-axes x, y, z [m]; lean about z and spread about x [degrees]. A part with
# z other than 0 is mirrored to -z.
PARTS = np.array(
    [
        (-0.08, 0.24, 0.000, 0.26, 0.20, 0.165, 12, 0),  # body
        (-0.17, 0.17, 0.100, 0.16, 0.15, 0.085, 20, 0),  # haunches
        (0.10, 0.27, 0.000, 0.13, 0.19, 0.125, -14, 0),  # chest
        (0.20, 0.48, 0.000, 0.13, 0.12, 0.108, -12, 0),  # head
        (0.29, 0.45, 0.000, 0.075, 0.063, 0.068, -15, 0),  # snout
        (0.25, 0.43, 0.050, 0.055, 0.050, 0.045, 0, 0),  # cheeks
        (0.12, 0.70, 0.075, 0.055, 0.170, 0.032, 16, 10),  # ears
        (-0.36, 0.20, 0.000, 0.075, 0.075, 0.075, 0, 0),  # tail
        (0.15, 0.10, 0.075, 0.055, 0.120, 0.050, 6, 0),  # forelegs
        (0.18, 0.035, 0.075, 0.085, 0.036, 0.048, 0, 0),  # forefeet
        (-0.13, 0.040, 0.125, 0.135, 0.042, 0.058, 0, 0),  # hind feet
    ]
)

K = 0.018
"""Width of the blend between parts [m]."""

CELL = 0.0135
"""Width of a grid cell [m]."""


@cache
def bunny() -> tuple[Array, NDArray[np.int64], Array]:
    """Return the rabbit as a closed triangle mesh that sits on y = 0 and looks along +x.

    Returns:
        Three read-only arrays, the same in each call.

        vertices: Positions [m], shape (v, 3).
        faces: Vertex indices of the triangles, counter-clockwise from outside, shape (f, 3).
        normals: Unit normals of the smooth surface at the vertices, outwards, shape (v, 3).
    """
    # Evaluate the distance on a grid, and extract the surface
    low = np.array([-0.48, -0.04, -0.24])
    high = np.array([0.42, 0.92, 0.24])
    axes = [np.arange(a, b, CELL) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    vertices, quads = _surface_net(_distance(grid), low)

    # Smooth the mesh and project it onto the surface
    for _ in range(4):
        vertices = _onto_surface(_smoothed(vertices, quads))
    normals = _gradient(vertices)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)

    # Cut quads into triangles, and set the mesh on y = 0
    faces = _triangles(vertices, quads)
    vertices = vertices - [0, vertices[:, 1].min(), 0]
    for array in (vertices, faces, normals):
        array.flags.writeable = False
    return vertices, faces, normals


def _smoothed(vertices: Array, quads: NDArray[np.int64]) -> Array:
    """Move each vertex to the mean of its neighbors, which avoids thin triangles."""
    total = np.zeros_like(vertices)
    count = np.zeros(len(vertices))
    for k in range(4):
        for neighbor in (quads[:, k - 1], quads[:, k - 3]):
            np.add.at(total, quads[:, k], vertices[neighbor])
            np.add.at(count, quads[:, k], 1)
    return total / count[:, None]


def _onto_surface(vertices: Array) -> Array:
    """Move vertices to the surface by one Newton step along the gradient of the distance."""
    gradient = _gradient(vertices)
    step = _distance(vertices) / (gradient**2).sum(axis=-1)
    return vertices - step[:, None] * gradient


def _distance(points: Array) -> Array:
    """Return the approximate signed distance of points (..., 3) to the surface [m]."""
    total = np.zeros(points.shape[:-1])
    for *center, a, b, c, lean, spread in PARTS:
        axes = _axes(lean, spread)
        for side in (1, -1) if center[2] else (1,):
            p = (points - center) if side > 0 else (points * [1, 1, -1] - center)
            p = p @ axes / (a, b, c)  # In the frame of the ellipsoid, where it is a unit sphere
            length = np.linalg.norm(p, axis=-1)
            slope = np.linalg.norm(p / (a, b, c), axis=-1)
            d = length * (length - 1) / np.maximum(slope, 1e-9)
            total += np.exp(-np.maximum(d, -0.5) / K)
    return -K * np.log(np.maximum(total, 1e-300))


def _axes(lean: float, spread: float) -> Array:
    """Return the axes of a part as columns, after a rotation about x by `spread`, z by `lean`."""
    (s, c), (t, u) = ((np.sin(a), np.cos(a)) for a in np.deg2rad([lean, spread]))
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, u, -t], [0, t, u]])
    return about_z @ about_x


def _gradient(points: Array, step: float = 1e-5) -> Array:
    """Return the gradient of the distance at points (n, 3), by central differences."""
    return np.stack(
        [(_distance(points + e) - _distance(points - e)) / (2 * step) for e in step * np.eye(3)],
        axis=-1,
    )


def _surface_net(values: Array, low: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the surface net of the zero level of a grid.

    Args:
        values: Signed distances at the grid points.
        low: Position of the first grid point [m].

    Returns:
        Vertices (v, 3) [m], and quads (q, 4) of vertex indices, counter-clockwise from outside.
    """
    cells = tuple(n - 1 for n in values.shape)
    inside = values < 0
    count = np.zeros(cells)
    total = np.zeros((*cells, 3))
    quads = []
    index = np.arange(np.prod(cells)).reshape(cells)
    for axis in range(3):
        # Find edges along this axis that cross the surface, and the points where they cross it
        first, second = (np.take(values, range(k, k + cells[axis]), axis) for k in (0, 1))
        crossed = (first < 0) != (second < 0)
        along = np.where(crossed, first / np.where(crossed, first - second, 1.0), 0.0)
        point = np.indices(first.shape).transpose(1, 2, 3, 0).astype(float)
        point[..., axis] += along

        # Add each point to the four cells that share the edge
        u = (axis + 1) % 3
        v = (axis + 2) % 3
        around = ((0, 0), (1, 0), (1, 1), (0, 1))
        for i, j in around:
            window = [slice(None)] * 3
            window[u] = slice(i, i + cells[u])
            window[v] = slice(j, j + cells[v])
            count += crossed[tuple(window)]
            total += (crossed[..., None] * point)[(*window, slice(None))]

        # Make a quad of the four cells around each crossed edge inside the grid
        where = np.argwhere(crossed)
        where = where[
            (where[:, u] > 0)
            & (where[:, v] > 0)
            & (where[:, u] < cells[u])
            & (where[:, v] < cells[v])
        ]
        ring = np.stack([where] * 4, axis=1)
        ring[..., u] -= [1, 0, 0, 1]
        ring[..., v] -= [1, 1, 0, 0]
        quad = index[tuple(np.moveaxis(ring, -1, 0))]

        # Reverse the order of corners if the surface faces against the axis
        outwards = inside[tuple(where.T)]
        quads.append(np.where(outwards[:, None], quad, quad[:, ::-1]))

    # Number the cells that the surface passes through
    used = count.ravel() > 0
    renumber = np.cumsum(used) - 1
    vertices = low + CELL * total.reshape(-1, 3)[used] / count.ravel()[used][:, None]
    return vertices, renumber[np.concatenate(quads)]


def _triangles(vertices: Array, quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut each quad into two triangles along its shorter diagonal."""
    a, b, c, d = quads.T
    shorter = np.linalg.norm(vertices[a] - vertices[c], axis=1) <= np.linalg.norm(
        vertices[b] - vertices[d], axis=1
    )
    one = np.where(shorter, [a, b, c], [a, b, d]).T
    two = np.where(shorter, [a, c, d], [b, c, d]).T
    return np.concatenate([one, two])
