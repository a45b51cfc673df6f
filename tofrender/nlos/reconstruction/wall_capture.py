"""Captures in the frame of the wall, as the reconstruction methods use them."""

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

    The frame is left-handed if the grid of columns and rows is left-handed.
    """

    # Mean of the grid's corner points in world space [m], (3,)
    origin: np.ndarray

    # Unit vectors x, y and z in world space, as rows, (3, 3)

    axes: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, normals: np.ndarray) -> WallFrame:
        """Fit the frame of a grid of points and normals, both (rows, columns, 3)."""
        # z is the mean normal
        origin = points[[0, 0, -1, -1], [0, -1, 0, -1]].mean(axis=0)
        z = normals.mean(axis=(0, 1))
        if not np.linalg.norm(z) > 0.1:
            raise ValueError("capture: sensor_normals: must point to one side of the wall")
        z = z / np.linalg.norm(z)

        # x follows the columns
        columns = (points[:, -1] - points[:, 0]).mean(axis=0)
        rows = (points[-1] - points[0]).mean(axis=0)
        x = _project(columns, z)
        if x is None:
            # With a single column, x is perpendicular to the rows
            along = _project(rows, z)
            x = _project(np.eye(3)[abs(z).argmin()], z) if along is None else np.cross(along, z)
        # y follows the rows
        y = np.cross(z, x)
        return cls(origin, np.stack([x, -y if y @ rows < 0 else y, z]))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Transform points (..., 3) from world space to the wall's frame [m]."""
        return (points - self.origin) @ self.axes.T


def _project(vector: np.ndarray, normal: np.ndarray) -> Any:
    """Project a vector on the plane of a normal, and return its unit vector, or None if it is 0."""
    flat = vector - (vector @ normal) * normal
    length = np.linalg.norm(flat)
    return flat / length if length > 1e-6 else None


@dataclass(frozen=True)
class Lattice:
    """Even points in the plane of a wall: column i, row j is at (x0 + i dx, y0 + j dy)."""

    # Coordinate of the first column, and distance of columns [m]
    x0: float
    dx: float

    # Coordinate of the first row, and distance of rows [m]
    y0: float
    dy: float


@dataclass(frozen=True)
class Measured:
    """A capture in the frame of its wall, with lengths in meters."""

    # "single", "confocal" or "exhaustive"
    mode: str

    # Light (rows, columns, bins, channels). An exhaustive capture has two laser axes before
    cube: Cube

    # Path length where the first bin starts, and width of a bin [m]
    start: float
    width: float

    # First and last legs that path lengths count [m], (lasers, rows, columns)
    legs: np.ndarray

    # Points at which the sensor looks [m], (rows, columns, 3)
    sensors: np.ndarray

    # Laser spots [m], (lasers, 3). In a confocal capture, they equal `sensors`
    lasers: np.ndarray

    # Frame of the wall in world space
    frame: WallFrame

    # Lattice of the sensor's points, None if they are not even
    lattice: Lattice | None

    # Whether light is photon counts
    counts: bool = False

    # Background that `light` subtracts, None without a background
    background: Background | None = None

    @classmethod
    def of(cls, capture: xr.Dataset) -> Measured:
        """Convert a checked capture."""
        mode = str(capture.attrs["capture_mode"])
        points, normals, spots = (
            capture[name].values.astype(np.float64)
            for name in ("sensor_grid", "sensor_normals", "laser_grid")
        )
        frame = WallFrame.of(points, normals)
        sensors = frame(points)
        lasers = frame(spots)
        rows, columns = points.shape[:2]
        width = bins_of(capture, "capture").bin_width_opl
        start = float(capture["opl"].values[0] - width / 2)
        return cls(
            mode=mode,
            cube=Cube(capture["transient"]),
            start=start,
            width=width,
            legs=first_and_last_legs(capture).reshape(-1, rows, columns),
            sensors=sensors,
            lasers=sensors if mode == "confocal" else lasers.reshape(-1, 3),
            frame=frame,
            lattice=_lattice(sensors),
            counts=capture.attrs.get("quantity") == COUNTS,
        )

    def without_background(self) -> Measured:
        """Return photon counts with their background; other light is returned unchanged.

        `light` of the result subtracts dark counts, and is 0 in bins without light of the hidden
        scene.
        """
        if not self.counts:
            return self

        # Sum the histograms of all pixels
        lasers, rows, columns, bins = self.shape
        total = np.zeros(bins)
        for laser in range(lasers):
            for block in self.blocks():
                total += self.light(laser, block).sum(axis=(0, 1), dtype=np.float64)
        zero = int(np.floor(-self.start / self.width + 1e-6))
        return replace(self, background=find_background(total, lasers * rows * columns, zero))

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Return the numbers of lasers, rows, columns and bins; one laser unless exhaustive."""
        *lasers, rows, columns, bins, _ = self.cube.shape
        return math.prod(lasers), rows, columns, bins

    def blocks(self) -> list[tuple[slice, ...]]:
        """Return blocks of pixels that `light` can read separately, one if all are in memory."""
        return [()] if self.cube.in_memory else self._of_laser(0).row_blocks()

    def light(self, laser: int, block: tuple[slice, ...] = ()) -> np.ndarray:
        """Return the luminance per bin of a block, (rows, columns, bins) float32.

        Args:
            laser: Index of the laser spot.
            block: One of `blocks`, by default all pixels.

        Raises:
            MemoryError: The block does not fit into memory.
        """
        seen = self._of_laser(laser).view(block)
        light = seen.luminance("capture").astype(np.float32, copy=False)
        known = self.background
        return light if known is None else (light - np.float32(known.dark)) * known.kept

    def _of_laser(self, laser: int) -> Cube:
        """Return the light of one laser spot, (rows, columns, bins, channels)."""
        return self.cube.view(np.unravel_index(laser, self.cube.shape[:-4]))

    @property
    def spacing(self) -> float:
        """Return the median distance of neighboring points of the sensor [m], 0 for one point."""
        steps = [np.linalg.norm(np.diff(self.sensors, axis=a), axis=-1).ravel() for a in (0, 1)]
        joined = np.concatenate(steps)
        return float(np.median(joined)) if joined.size else 0.0

    def path_range(self) -> tuple[float, float]:
        """Return the shortest and longest path from wall to wall that the bins can contain [m]."""
        stop = self.start + self.shape[-1] * self.width
        return self.start - float(self.legs.max()), stop - float(self.legs.min())


def _lattice(points: np.ndarray) -> Lattice | None:
    """Fit a lattice to points (rows, columns, 3) in the wall's frame, None if they are uneven."""
    rows, columns = points.shape[:2]
    if rows < 2 or columns < 2:
        return None

    # Find origin and steps from opposite edges
    dx = (points[:, -1, 0] - points[:, 0, 0]).mean() / (columns - 1)
    dy = (points[-1, :, 1] - points[0, :, 1]).mean() / (rows - 1)
    x0, y0 = points[0, 0, :2]

    # Compare all points with the lattice
    even = np.zeros(points.shape)
    even[..., 0] = x0 + dx * np.arange(columns)
    even[..., 1] = (y0 + dy * np.arange(rows))[:, None]
    if not (min(dx, dy) > 0 and np.allclose(points, even, rtol=0, atol=0.01 * min(dx, dy))):
        return None
    return Lattice(float(x0), float(dx), float(y0), float(dy))
