"""Backprojection: each voxel adds up the light of the paths that could have gone through it.

    I(v) = 1/N sum over pairs (l, s) of w(v) H(l, s, |v - l| + |v - s|)

over all N pairs of a laser spot l and a sensor's point s (in a confocal capture l = s: spheres
instead of ellipsoids). Between bin centres, H is interpolated linearly.
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
from ...runtime.variants import require_vectorised
from .measured import Measured
from .volume import VolumeGrid

if TYPE_CHECKING:
    from distributed import Client

WEIGHTINGS = ("uniform", "r2")
"""w = 1, or |v - l| |v - s|, which compensates a part of the falloff with distance."""

RANGES = 4  # ranges of voxels for each worker

_PAIRS_A_STEP = 1 << 28
"""Pairs of voxel and wall point in one kernel launch: a fraction of a second."""


def backproject(
    measured: Measured,
    grid: VolumeGrid,
    weighting: str = "uniform",
    progress: bool = True,
    client: "Client | None" = None,
) -> np.ndarray:
    """Intensities (z, y, x) by backprojection with one of WEIGHTINGS, by workers if there are some.

    Voxels are Dr.Jit's lanes, and a loop goes over the sensor's points, so memory holds the capture
    (of one on disk, some rows) and the volume, but not their product.
    """
    require_vectorised()
    lasers, rows, columns, bins = measured.shape
    blocks = measured.blocks()
    most = max(measured.sensors[block].size // 3 for block in blocks)
    if most * (bins + 2) > np.iinfo(np.uint32).max:
        raise ValueError(f"capture of {most} x {bins} bins: must have less than 2^32 bins")
    voxels = math.prod(grid.shape)
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
    """Number of voxels in one kernel launch."""
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
    """Sum the light through a range of voxels, in a worker."""
    activate(variant)
    return _sum_light(measured, grid, weighting, voxels, lambda: None)


class _Wall:
    """One laser spot (confocal: none), a block of sensor points, and their bins, for kernels."""

    def __init__(self, measured: Measured, index: int, block: tuple[slice, ...], weighting: str):
        points = measured.sensors[block].reshape(-1, 3)
        light = measured.light(index, block).reshape(len(points), -1)
        self.count, bins = light.shape
        self.bins = mi.Float32(bins)
        self.row = mi.UInt32(bins + 2)
        padded = np.pad(light, ((0, 0), (1, 1)))  # no light before and after
        self.light = mi.Float32(padded.reshape(-1))
        # Position in bins, from the centre of the first: (path - start) / width - 1/2
        offset = (measured.legs[index][block].reshape(-1) - measured.start) / measured.width - 0.5
        columns = [*points.T, offset]
        self.points = [mi.Float32(np.ascontiguousarray(c, dtype=np.float32)) for c in columns]
        self.per_width = mi.Float32(1 / measured.width)
        self.confocal = measured.mode == "confocal"
        self.weighted = weighting == "r2"
        lasers = [] if self.confocal else measured.lasers[index]
        self.laser = [dr.opaque(mi.Float32, float(coordinate)) for coordinate in lasers]
        dr.make_opaque(self.bins, self.row, self.per_width)

    def light_through(self, grid: VolumeGrid, first: int, count: int) -> np.ndarray:
        """Sum over the points, for `count` voxels from `first` on, x fastest."""
        voxel = _centres(grid, first, count)
        to_laser = 0 if self.confocal else _distance(voxel, self.laser)

        def add(index: Any, total: Any) -> Any:
            x, y, z, offset = (dr.gather(mi.Float32, array, index) for array in self.points)
            to_sensor = _distance(voxel, (x, y, z))
            path = 2 * to_sensor if self.confocal else to_laser + to_sensor
            at = dr.fma(path, self.per_width, offset)
            within = (at > -1) & (at < self.bins)
            below = dr.floor(at)
            cell = dr.fma(index, self.row, mi.UInt32(mi.Int32(below) + 1))
            early = dr.gather(mi.Float32, self.light, cell, within)
            late = dr.gather(mi.Float32, self.light, cell + 1, within)
            found = dr.fma(at - below, late - early, early)
            if self.weighted:
                found *= dr.square(to_sensor) if self.confocal else to_laser * to_sensor
            return index + 1, total + found

        points = mi.UInt32(self.count)
        dr.make_opaque(points)
        _, total = dr.while_loop(
            (mi.UInt32(0), dr.zeros(mi.Float32, count)),
            lambda index, total: index < points,
            add,
            labels=("index", "total"),
        )
        return total.numpy()


def _centres(grid: VolumeGrid, first: int, count: int) -> list[Any]:
    """Centres (x, y, z) of `count` voxels from `first` on, x fastest [m]."""
    index = dr.arange(mi.UInt32, count) + dr.opaque(mi.UInt32, first)
    _, ny, nx = grid.shape
    line = index // nx
    lines = [mi.Float32(grid.centres(axis).astype(np.float32)) for axis in "xyz"]
    steps = (index - line * nx, line % ny, line // ny)
    voxels = [dr.gather(mi.Float32, each, n) for each, n in zip(lines, steps, strict=True)]
    dr.eval(voxels)
    return voxels


def _distance(a: Any, b: Any) -> Any:
    x, y, z = (p - q for p, q in zip(a, b, strict=True))
    return dr.sqrt(dr.fma(x, x, dr.fma(y, y, z * z)))


def sharpen(values: np.ndarray, grid: VolumeGrid) -> np.ndarray:
    """Minus the Laplacian of intensities (z, y, x) [m^-2], where it is above 0.

    Backprojection blurs a surface over all voxels at its distance; the second derivative finds
    their sum's maximum. All three axes count, but for one of a single voxel, so that surfaces of
    any orientation stand out alike.
    """
    result = np.zeros_like(values)
    for number, axis in enumerate("zyx"):
        if values.shape[number] > 1:
            along = np.moveaxis(values, number, 0)
            padded = np.concatenate([along[:1], along, along[-1:]])
            second = padded[:-2] + padded[2:] - 2 * along
            result -= np.moveaxis(second, 0, number) / np.float32(grid.step(axis) ** 2)
    return np.maximum(result, 0)
