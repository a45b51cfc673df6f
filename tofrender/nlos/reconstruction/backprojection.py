"""Backprojection: each voxel sums the light of all paths that may have passed through it.

    I(v) = 1/N sum over pairs (l, s) of w(v) H(l, s, |v - l| + |v - s|)

over all N pairs of a laser spot l and a point s of the sensor. In a confocal capture l = s, and
paths of equal length form spheres instead of ellipsoids. H is interpolated linearly between bin
centers.
A. Velten et al., Recovering three-dimensional shape around a corner using ultrafast time-of-flight
imaging, Nature Communications 3 (2012).
"""

import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...rendering.workers import check_client, distribute
from ...runtime.backend import activate
from ...runtime.progress import ProgressBar
from ...runtime.variants import require_vectorized
from .volume import VolumeGrid
from .wall_capture import Measured

if TYPE_CHECKING:
    from distributed import Client

WEIGHTINGS = ("uniform", "r2")
"""w = 1, or w = |v - l| |v - s|, which partly compensates the decrease with distance."""

# Number of ranges of voxels for each worker
RANGES = 4

_PAIRS_A_STEP = 1 << 28
"""Pairs of voxel and wall point in one kernel launch, which takes a fraction of a second."""


def backproject(
    measured: Measured,
    grid: VolumeGrid,
    weighting: str = "uniform",
    progress: bool = True,
    client: "Client | None" = None,
) -> np.ndarray:
    """Compute intensities (z, y, x) by backprojection.

    Each voxel is a lane of Dr.Jit, and a loop runs over the points of the sensor. Therefore memory
    contains the capture and the volume, but not their product. A capture on disk is read by rows.

    Args:
        measured: The capture.
        grid: The voxels.
        weighting: One of WEIGHTINGS.
        progress: Whether to show a progress bar.
        client: Client of workers that divide the voxels, None for this process.
    """
    require_vectorized()
    lasers, rows, columns, bins = measured.shape
    # Check the number of bins
    blocks = measured.blocks()
    most = max(measured.sensors[block].size // 3 for block in blocks)
    if most * (bins + 2) > np.iinfo(np.uint32).max:
        raise ValueError(f"capture of {most} x {bins} bins: must have less than 2^32 bins")
    voxels = math.prod(grid.shape)

    # Sum the light in this process, or in workers
    if client is None:
        steps = lasers * len(blocks) * math.ceil(voxels / _voxels_a_step(measured))
        with ProgressBar("backprojection", steps, unit="step", enabled=progress) as bar:
            result = _sum_light(measured, grid, weighting, (0, voxels), bar.update)
    else:
        result = np.zeros(voxels, np.float32)
        count = min(RANGES * check_client(client), voxels)
        ranges = list(itertools.pairwise(voxels * k // count for k in range(count + 1)))
        everywhere: Any = client.scatter(measured, broadcast=True)
        work = partial(_in_worker, mi.variant() or "", everywhere, grid, weighting)
        with ProgressBar("backprojection", count, unit="piece", enabled=progress) as bar:
            for (first, last), found in distribute(client, work, ranges):
                result[first:last] = found
                bar.update()
    return (result / (lasers * rows * columns)).reshape(grid.shape)


def _voxels_a_step(measured: Measured) -> int:
    """Return the number of voxels in one kernel launch."""
    _, rows, columns, _ = measured.shape
    return max(1, _PAIRS_A_STEP // (rows * columns))


def _sum_light(
    measured: Measured,
    grid: VolumeGrid,
    weighting: str,
    voxels: tuple[int, int],
    update: Callable[[], None],
) -> np.ndarray:
    """Sum the light through a range of voxels."""
    first, last = voxels
    # Loop over blocks of pixels, and over ranges of voxels for each kernel launch
    step = _voxels_a_step(measured)
    result = np.zeros(last - first, np.float32)
    for index, block in itertools.product(range(measured.shape[0]), measured.blocks()):
        wall = _Wall(measured, index, block, weighting)
        for start in range(first, last, step):
            count = min(step, last - start)
            here = slice(start - first, start - first + count)
            result[here] += wall.light_through(grid, start, count)
            update()
    return result


def _in_worker(
    variant: str, measured: Measured, grid: VolumeGrid, weighting: str, voxels: tuple[int, int]
) -> np.ndarray:
    """Sum the light through a range of voxels in a worker of a variant."""
    activate(variant)
    return _sum_light(measured, grid, weighting, voxels, lambda: None)


class _Wall:
    """A block of sensor points with their bins, and one laser spot, as arrays for kernels.

    Args:
        measured: The capture.
        index: Index of the laser spot. It is not used if the capture is confocal.
        block: Block of pixels.
        weighting: One of WEIGHTINGS.
    """

    def __init__(self, measured: Measured, index: int, block: tuple[slice, ...], weighting: str):
        # Light with one dark bin before and after
        points = measured.sensors[block].reshape(-1, 3)
        light = measured.light(index, block).reshape(len(points), -1)
        self.count, bins = light.shape
        self.bins = mi.Float32(bins)
        self.row = mi.UInt32(bins + 2)
        padded = np.pad(light, ((0, 0), (1, 1)))
        self.light = mi.Float32(padded.reshape(-1))

        # Points, and their position in bins from the center of the first bin:
        # (path - start) / width - 1/2
        offset = (measured.legs[index][block].reshape(-1) - measured.start) / measured.width - 0.5
        columns = [*points.T, offset]
        self.points = [mi.Float32(np.ascontiguousarray(c, dtype=np.float32)) for c in columns]
        self.per_width = mi.Float32(1 / measured.width)
        self.confocal = measured.mode == "confocal"
        self.weighted = weighting == "r2"
        lasers = [] if self.confocal else measured.lasers[index]
        self.laser = [dr.opaque(mi.Float32, float(coordinate)) for coordinate in lasers]

        # Opaque scalars allow one kernel for all captures
        dr.make_opaque(self.bins, self.row, self.per_width)

    def light_through(self, grid: VolumeGrid, first: int, count: int) -> np.ndarray:
        """Sum the light of all points for `count` voxels from index `first`, x fastest."""
        voxel = _centers(grid, first, count)
        to_laser = 0 if self.confocal else _distance(voxel, self.laser)

        def add(index: Any, total: Any) -> Any:
            # Find the bin of the path through this point
            x, y, z, offset = (dr.gather(mi.Float32, array, index) for array in self.points)
            to_sensor = _distance(voxel, (x, y, z))
            path = 2 * to_sensor if self.confocal else to_laser + to_sensor
            at = dr.fma(path, self.per_width, offset)
            within = (at > -1) & (at < self.bins)

            # Interpolate between bin centers
            below = dr.floor(at)
            cell = dr.fma(index, self.row, mi.UInt32(mi.Int32(below) + 1))
            early = dr.gather(mi.Float32, self.light, cell, within)
            late = dr.gather(mi.Float32, self.light, cell + 1, within)
            found = dr.fma(at - below, late - early, early)

            # Apply the weighting
            if self.weighted:
                found *= dr.square(to_sensor) if self.confocal else to_laser * to_sensor
            return index + 1, total + found

        # Loop over the points
        points = mi.UInt32(self.count)
        dr.make_opaque(points)
        _, total = dr.while_loop(
            (mi.UInt32(0), dr.zeros(mi.Float32, count)),
            lambda index, total: index < points,
            add,
            labels=("index", "total"),
        )
        return total.numpy()


def _centers(grid: VolumeGrid, first: int, count: int) -> list[Any]:
    """Return the centers (x, y, z) of `count` voxels from index `first`, x fastest [m]."""
    index = dr.arange(mi.UInt32, count) + dr.opaque(mi.UInt32, first)
    _, ny, nx = grid.shape
    line = index // nx
    lines = [mi.Float32(grid.centers(axis).astype(np.float32)) for axis in "xyz"]
    steps = (index - line * nx, line % ny, line // ny)
    voxels = [dr.gather(mi.Float32, each, n) for each, n in zip(lines, steps, strict=True)]
    dr.eval(voxels)
    return voxels


def _distance(a: Any, b: Any) -> Any:
    """Return the distance of two points (x, y, z)."""
    x, y, z = (p - q for p, q in zip(a, b, strict=True))
    return dr.sqrt(dr.fma(x, x, dr.fma(y, y, z * z)))


def sharpen(values: np.ndarray, grid: VolumeGrid) -> np.ndarray:
    """Return the negative Laplacian of intensities (z, y, x) [m^-2], or 0 if it is negative.

    Backprojection blurs a surface over all voxels at its distance. The second derivative finds the
    maximum of their sum. All axes with more than one voxel contribute, so that the result does not
    depend on the orientation of surfaces.
    """
    result = np.zeros_like(values)
    for index, axis in enumerate("zyx"):
        if values.shape[index] > 1:
            # Second differences with repeated values at both ends
            along = np.moveaxis(values, index, 0)
            padded = np.concatenate([along[:1], along, along[-1:]])
            second = padded[:-2] + padded[2:] - 2 * along
            result -= np.moveaxis(second, 0, index) / np.float32(grid.step(axis) ** 2)
    return np.maximum(result, 0)
