"""Light by wall points, in the frame of the wall, as the reconstruction methods use it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from ...labels import bins_of
from ...rendering.cubes import Cube
from ..captures import COUNTS, first_and_last_legs
from .background import Background, find_background


@dataclass(frozen=True)
class WallFrame:
    """Orthonormal frame of the wall: x along columns, y along rows, z into the hidden scene.

    Left-handed where columns and rows run so. `origin` is the mean of the grid's corner points in
    world space [m], (3,); `axes` has x, y and z as rows, (3, 3).
    """

    origin: np.ndarray
    axes: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, normals: np.ndarray) -> WallFrame:
        """Fit the frame of a grid of points and normals, both (rows, columns, 3)."""
        origin = points[[0, 0, -1, -1], [0, -1, 0, -1]].mean(axis=0)
        z = normals.mean(axis=(0, 1))
        if not np.linalg.norm(z) > 0.1:
            raise ValueError("capture: sensor_normals: must point to one side of the wall")
        z = z / np.linalg.norm(z)
        columns = (points[:, -1] - points[:, 0]).mean(axis=0)
        rows = (points[-1] - points[0]).mean(axis=0)
        x = _project(columns, z)
        if x is None:  # one column
            along = _project(rows, z)
            x = _project(np.eye(3)[abs(z).argmin()], z) if along is None else np.cross(along, z)
        y = np.cross(z, x)
        return cls(origin, np.stack([x, -y if y @ rows < 0 else y, z]))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Transform points of world space (..., 3) to the wall's frame [m]."""
        return (points - self.origin) @ self.axes.T


def _project(vector: np.ndarray, normal: np.ndarray) -> Any:
    """Unit vector of the projection of `vector` on the plane of a normal; None if that is 0."""
    flat = vector - (vector @ normal) * normal
    length = np.linalg.norm(flat)
    return flat / length if length > 1e-6 else None


@dataclass(frozen=True)
class Lattice:
    """Even points in the plane of a wall: column i, row j at (x0 + i dx, y0 + j dy)."""

    x0: float
    dx: float
    y0: float
    dy: float


@dataclass(frozen=True)
class Measured:
    """A capture in the frame of its wall, with lengths in metres."""

    mode: str
    cube: Cube  # light (rows, columns, bins, channels), exhaustive with two laser axes before
    start: float  # of the first bin
    width: float  # of a bin
    legs: np.ndarray  # first and last legs that path lengths count, (lasers, rows, columns)
    sensors: np.ndarray  # points that the sensor looks at, (rows, columns, 3)
    lasers: np.ndarray  # laser spots (lasers, 3); of a confocal capture as `sensors`
    frame: WallFrame
    lattice: Lattice | None  # None if the sensor's points are not even
    counts: bool = False  # whether light is photon counts
    background: Background | None = None  # subtracted by `light`

    @classmethod
    def of(cls, capture: xr.Dataset) -> Measured:
        """Transform a checked capture."""
        mode = str(capture.attrs["capture_mode"])
        points, normals, spots = (
            capture[name].values.astype(np.float64)
            for name in ("sensor_grid", "sensor_normals", "laser_grid")
        )
        frame = WallFrame.of(points, normals)
        sensors, lasers = frame(points), frame(spots)
        rows, columns = points.shape[:2]
        width = bins_of(capture, "capture").bin_width_opl
        start = float(capture["opl"].values[0] - width / 2)
        return cls(
            mode,
            Cube(capture["transient"]),
            start,
            width,
            first_and_last_legs(capture).reshape(-1, rows, columns),
            sensors,
            sensors if mode == "confocal" else lasers.reshape(-1, 3),
            frame,
            _lattice(sensors),
            capture.attrs.get("quantity") == COUNTS,
        )

    def without_background(self) -> Measured:
        """Subtract dark counts and omit bins without light of the hidden scene, of counts only."""
        if not self.counts:
            return self
        lasers, rows, columns, bins = self.shape
        total = np.zeros(bins)
        for laser in range(lasers):
            for block in self.blocks():
                total += self.light(laser, block).sum(axis=(0, 1), dtype=np.float64)
        zero = int(np.floor(-self.start / self.width + 1e-6))
        return replace(self, background=find_background(total, lasers * rows * columns, zero))

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Lasers (one unless exhaustive), rows, columns and bins."""
        *lasers, rows, columns, bins, _ = self.cube.shape
        return math.prod(lasers), rows, columns, bins

    def blocks(self) -> list[tuple[slice, ...]]:
        """Blocks of pixels that `light` can read by themselves; one if all are in memory."""
        return [()] if self.cube.in_memory else self._of_laser(0).row_blocks()

    def light(self, laser: int, block: tuple[slice, ...] = ()) -> np.ndarray:
        """Luminance per bin of a block, (rows, columns, bins) float32; MemoryError if too large."""
        seen = self._of_laser(laser).view(block)
        light = seen.luminance("capture").astype(np.float32, copy=False)
        known = self.background
        return light if known is None else (light - np.float32(known.dark)) * known.kept

    def _of_laser(self, laser: int) -> Cube:
        """Light of one laser spot, (rows, columns, bins, channels)."""
        return self.cube.view(np.unravel_index(laser, self.cube.shape[:-4]))

    @property
    def spacing(self) -> float:
        """Typical distance between neighbouring points of the sensor's grid [m]; 0 of one point."""
        steps = [np.linalg.norm(np.diff(self.sensors, axis=a), axis=-1).ravel() for a in (0, 1)]
        joined = np.concatenate(steps)
        return float(np.median(joined)) if joined.size else 0.0

    def path_range(self) -> tuple[float, float]:
        """Shortest and longest path from wall to wall that the bins can hold [m]."""
        stop = self.start + self.shape[-1] * self.width
        return self.start - float(self.legs.max()), stop - float(self.legs.min())


def _lattice(points: np.ndarray) -> Lattice | None:
    """Fit a lattice to points (rows, columns, 3) in the wall's frame, None if they are off it."""
    rows, columns = points.shape[:2]
    if rows < 2 or columns < 2:
        return None
    dx = (points[:, -1, 0] - points[:, 0, 0]).mean() / (columns - 1)
    dy = (points[-1, :, 1] - points[0, :, 1]).mean() / (rows - 1)
    x0, y0 = points[0, 0, :2]
    even = np.zeros(points.shape)
    even[..., 0] = x0 + dx * np.arange(columns)
    even[..., 1] = (y0 + dy * np.arange(rows))[:, None]
    if not (min(dx, dy) > 0 and np.allclose(points, even, rtol=0, atol=0.01 * min(dx, dy))):
        return None
    return Lattice(float(x0), float(dx), float(y0), float(dy))
