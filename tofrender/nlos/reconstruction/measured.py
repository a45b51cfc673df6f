"""What the methods work on: light by wall points, in the frame of the wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...rendering.cubes import Cube
from ...rendering.dataset import time_axis
from ..captures import first_and_last_legs

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class WallFrame:
    """Axes of the wall: x along growing columns, y along growing rows, z into the hidden scene.

    The axes are orthonormal. They may be left-handed, as they say where columns and rows run.

    Attributes:
        origin: Mean of the grid's corner points, world space [m], (3,).
        axes: Unit vectors of x, y and z in world space, one a row, (3, 3).
    """

    origin: np.ndarray
    axes: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, normals: np.ndarray) -> WallFrame:
        """The frame of a grid of points and normals, both (rows, columns, 3)."""
        origin = points[[0, 0, -1, -1], [0, -1, 0, -1]].mean(axis=0)
        z = normals.mean(axis=(0, 1))
        if not np.linalg.norm(z) > 0.1:
            raise ValueError("capture: sensor_normals: must point to one side of the wall")
        z = z / np.linalg.norm(z)
        columns = (points[:, -1] - points[:, 0]).mean(axis=0)
        rows = (points[-1] - points[0]).mean(axis=0)
        x = _across(columns, z)
        if x is None:  # one column
            across = _across(rows, z)
            x = _any_across(z) if across is None else np.cross(across, z)
        y = np.cross(z, x)
        return cls(origin, np.stack([x, -y if y @ rows < 0 else y, z]))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points of world space (..., 3) in the wall's frame [m]."""
        return (points - self.origin) @ self.axes.T


def _across(vector: np.ndarray, normal: np.ndarray) -> np.ndarray | None:
    """The unit vector along what of `vector` is normal to `normal`; None if that is nothing."""
    flat = vector - (vector @ normal) * normal
    length = np.linalg.norm(flat)
    return flat / length if length > 1e-6 else None


def _any_across(normal: np.ndarray) -> np.ndarray:
    axis = np.zeros(3)
    axis[np.argmin(abs(normal))] = 1
    flat = axis - (axis @ normal) * normal
    return flat / np.linalg.norm(flat)


@dataclass(frozen=True)
class Lattice:
    """Points of a wall that lie in one plane, evenly: column i, row j at (x0 + i dx, y0 + j dy)."""

    x0: float
    dx: float
    y0: float
    dy: float


@dataclass(frozen=True)
class Measured:
    """A capture in the frame of its wall.

    Attributes:
        mode: "single", "confocal" or "exhaustive".
        cube: What the sensor saw, (rows, columns, bins, channels), exhaustive (laser rows, laser
            columns, rows, columns, bins, channels).
        start: Where the first bin starts [m].
        width: Width of a bin [m].
        legs: What path lengths count outside the hidden scene [m], (lasers, rows, columns).
        sensors: Points that are looked at [m], (rows, columns, 3).
        lasers: Points that are lit [m], (lasers, 3); of a confocal capture as `sensors`.
        frame: The wall's frame.
        lattice: Where the sensor's points lie evenly in a plane, else None.
    """

    mode: str
    cube: Cube
    start: float
    width: float
    legs: np.ndarray
    sensors: np.ndarray
    lasers: np.ndarray
    frame: WallFrame
    lattice: Lattice | None

    @classmethod
    def of(cls, capture: xr.Dataset) -> Measured:
        """Take a checked capture."""
        mode = str(capture.attrs["mode"])
        points, normals, lit = (
            capture[name].values.astype(np.float64)
            for name in ("sensor_grid", "sensor_normals", "laser_grid")
        )
        frame = WallFrame.of(points, normals)
        sensors, lasers = frame(points), frame(lit)
        rows, columns = points.shape[:2]
        start, width = time_axis(capture)
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
        )

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Lasers (one unless exhaustive), rows, columns and bins."""
        *lasers, rows, columns, bins, _ = self.cube.shape
        return math.prod(lasers), rows, columns, bins

    def blocks(self) -> list[tuple[slice, ...]]:
        """Where the blocks of pixels are that `light` can read by themselves; one in memory."""
        return [()] if self.cube.in_memory else self._lit_by(0).row_blocks()

    def light(self, laser: int, place: tuple[slice, ...] = ()) -> np.ndarray:
        """Luminance per bin, (rows, columns, bins) float32, of some pixels or all.

        Raises:
            MemoryError: It does not fit; one line.
        """
        seen = self._lit_by(laser).view(place)
        return seen.luminance("capture").astype(np.float32, copy=False)

    def _lit_by(self, laser: int) -> Cube:
        """What the sensor saw of a laser, (rows, columns, bins, channels)."""
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
    """The lattice that points (rows, columns, 3) in the wall's frame lie on, None if on none."""
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
