"""Backprojection: each voxel adds up the light of the paths that could have gone through it.

    I(v) = 1/N sum over pairs (l, s) of w(v) H(l, s, |v - l| + |v - s|)

over all N pairs of a lit point l and a point s that is looked at (in a confocal capture l = s:
spheres instead of ellipsoids). Between bin centres, H is interpolated linearly.
A. Velten et al., Recovering three-dimensional shape around a corner using ultrafast time-of-flight
imaging, Nature Communications 3 (2012).
"""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...rendering.workers import check_client, shared_out
from ...runtime import checks
from ...runtime.backend import activate, require_vectorised
from ...runtime.progress import progress_bar
from .measured import Measured
from .volume import VolumeGrid

if TYPE_CHECKING:
    from distributed import Client

WEIGHTINGS = ("uniform", "r2")
"""w = 1, or |v - l| |v - s|, which makes up for a part of the falloff with distance."""

PIECES = 4
"""Ranges of voxels for each worker."""

_PAIRS_A_STEP = 1 << 28
"""Pairs of voxel and wall point that one kernel launch goes through: a fraction of a second."""


def backproject(
    measured: Measured,
    grid: VolumeGrid,
    weighting: str = "uniform",
    progress: bool = True,
    client: Client | None = None,
) -> np.ndarray:
    """Intensities (z, y, x) by backprojection with one of WEIGHTINGS, by workers if there are some.

    The voxels are Dr.Jit's lanes, and a loop goes over the points that are looked at, so memory
    holds the capture (of one on disk, some rows), the volume and nothing of the size of their
    product.
    """
    require_vectorised()
    checks.one_of("weighting", weighting, WEIGHTINGS)
    lasers, rows, columns, bins = measured.shape
    points, blocks = rows * columns, measured.blocks()
    most = max(measured.sensors[place].size // 3 for place in blocks)
    if most * (bins + 2) > np.iinfo(np.uint32).max:
        raise ValueError(f"capture of {most} x {bins} bins: must have less than 2^32 bins")
    voxels = math.prod(grid.shape)
    step = max(1, _PAIRS_A_STEP // points)
    slabs = [(first, min(step, voxels - first)) for first in range(0, voxels, step)]
    result = np.zeros(voxels, np.float32)
    if client is not None:
        _by_workers(result, client, measured, grid, weighting, progress)
        return (result / (lasers * points)).reshape(grid.shape)
    total = lasers * len(blocks) * len(slabs)
    with progress_bar("backprojection", total, unit="step", enabled=progress) as bar:
        for index, place in itertools.product(range(lasers), blocks):
            wall = _Wall(measured, index, place, weighting)
            for first, count in slabs:
                result[first : first + count] += wall.light_through(grid, first, count)
                bar.update()
    return (result / (lasers * points)).reshape(grid.shape)


def _by_workers(
    result: np.ndarray,
    client: Client,
    measured: Measured,
    grid: VolumeGrid,
    weighting: str,
    progress: bool,
) -> None:
    """Fill `result`, each worker a few ranges of voxels at a time."""
    count = min(PIECES * check_client(client), result.size)
    edges = [result.size * k // count for k in range(count + 1)]
    ranges = list(itertools.pairwise(edges))
    everywhere: Any = client.scatter(measured, broadcast=True)
    work = partial(_light_in, mi.variant() or "", everywhere, grid, weighting)
    with progress_bar("backprojection", count, unit="piece", enabled=progress) as bar:
        for (first, last), found in shared_out(client, work, ranges):
            result[first:last] = found
            bar.update()


def _light_in(
    variant: str, measured: Measured, grid: VolumeGrid, weighting: str, voxels: tuple[int, int]
) -> np.ndarray:
    """The light through a range of voxels, in a worker."""
    activate(variant)
    first, last = voxels
    result = np.zeros(last - first, np.float32)
    for index, place in itertools.product(range(measured.shape[0]), measured.blocks()):
        wall = _Wall(measured, index, place, weighting)
        result += wall.light_through(grid, first, last - first)
    return result


class _Wall:
    """One lit point (or each point by itself), points that are looked at, and their bins."""

    def __init__(self, measured: Measured, index: int, place: tuple[slice, ...], weighting: str):
        points = measured.sensors[place].reshape(-1, 3)
        light = measured.light(index, place).reshape(len(points), -1)
        self.count, bins = light.shape
        self.bins = mi.Float32(bins)
        self.row = mi.UInt32(bins + 2)
        padded = np.zeros((self.count, bins + 2), np.float32)  # no light before and after
        padded[:, 1:-1] = light
        self.light = mi.Float32(padded.reshape(-1))
        # Position in bins, from the centre of the first: (path - start) / width - 1/2
        offset = (measured.legs[index][place].reshape(-1) - measured.start) / measured.width - 0.5
        columns = [*points.T, offset]
        self.points = [mi.Float32(np.ascontiguousarray(c, dtype=np.float32)) for c in columns]
        self.per_width = mi.Float32(1 / measured.width)
        self.confocal = measured.mode == "confocal"
        self.weighted = weighting == "r2"
        self.laser = None if self.confocal else measured.lasers[index]
        dr.make_opaque(self.bins, self.row, self.per_width)

    def light_through(self, grid: VolumeGrid, first: int, count: int) -> np.ndarray:
        """Sum over the points for `count` voxels from `first` on, x fastest."""
        voxel = _centres(grid, first, count)
        to_laser = 0 if self.laser is None else _distance(voxel, _opaque(self.laser))

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


def _centres(grid: VolumeGrid, first: int, count: int) -> tuple[Any, Any, Any]:
    """Centres of voxels [m]."""
    index = dr.arange(mi.UInt32, count) + dr.opaque(mi.UInt32, first)
    _, ny, nx = grid.shape
    line = index // nx
    steps = (index - line * nx, line % ny, line // ny)
    lows = _opaque([getattr(grid, axis)[0] + grid.step(axis) / 2 for axis in "xyz"])
    sizes = _opaque([grid.step(axis) for axis in "xyz"])
    voxel = tuple(
        dr.fma(mi.Float32(n), size, low) for n, size, low in zip(steps, sizes, lows, strict=True)
    )
    dr.eval(voxel)
    return voxel  # pyright: ignore[reportReturnType]


def _opaque(numbers: Any) -> list[Any]:
    """Numbers that the kernel reads, rather than being compiled for them."""
    return [dr.opaque(mi.Float32, float(number)) for number in numbers]


def _distance(a: Any, b: Any) -> Any:
    x, y, z = (p - q for p, q in zip(a, b, strict=True))
    return dr.sqrt(dr.fma(x, x, dr.fma(y, y, z * z)))


def sharpen(values: np.ndarray, grid: VolumeGrid) -> np.ndarray:
    """Minus the Laplacian of intensities (z, y, x) [m^-2], where it is above 0.

    Backprojection blurs a surface over all that is equally far; the second derivative finds where
    that adds up. All three axes count, so that surfaces of any orientation stand out alike; an
    axis of one voxel does not.
    """
    result = np.zeros_like(values)
    for number, axis in enumerate("zyx"):
        if values.shape[number] > 1:
            along = np.moveaxis(values, number, 0)
            padded = np.concatenate([along[:1], along, along[-1:]])
            second = padded[:-2] + padded[2:] - 2 * along
            result -= np.moveaxis(second, 0, number) / np.float32(grid.step(axis) ** 2)
    return np.maximum(result, 0)
