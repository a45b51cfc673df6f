"""Volumes of voxels in front of the wall, and the Dataset of their intensities."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ...rendering.labels import labeled
from ...runtime import checks
from .wall_capture import Measured, WallFrame

MAX_VOXELS = 1 << 30


@dataclass(frozen=True)
class VolumeGrid:
    """A box of voxels in the wall's frame: x along columns, y along rows, z away from the wall.

    Each axis is (low edge [m], high edge [m], number of voxels).

    Raises:
        ValueError: An axis is not such a triple, or it is behind the wall.

    Example:
        >>> VolumeGrid((-1, 1, 4), (-1, 1, 4), (0.5, 1.5, 10)).centers("x").tolist()
        [-0.75, -0.25, 0.25, 0.75]
    """

    x: tuple[float, float, int]
    y: tuple[float, float, int]
    z: tuple[float, float, int]

    def __post_init__(self):
        for name in "xyz":
            object.__setattr__(self, name, _axis(name, getattr(self, name)))
        checks.require("volume: z", self.z, self.z[0] >= 0, "before the wall, z >= 0")
        if math.prod(self.shape) > MAX_VOXELS:
            raise ValueError(f"volume of {self.shape} voxels: must be at most {MAX_VOXELS}")

    @classmethod
    def of(cls, value: Any) -> "VolumeGrid":
        """Convert three axes (low, high, count). A grid is returned unchanged."""
        if isinstance(value, cls):
            return value
        allowed = "a VolumeGrid or (low, high, count) for x, y, z"
        return cls(*checks.items("volume", value, 3, allowed))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return the numbers of voxels along (z, y, x)."""
        return self.z[2], self.y[2], self.x[2]

    def step(self, axis: str) -> float:
        """Return the size of a voxel along an axis [m]."""
        low, high, count = getattr(self, axis)
        return (high - low) / count

    def centers(self, axis: str) -> np.ndarray:
        """Return the centers of the voxels along an axis [m]."""
        low, _, count = getattr(self, axis)
        return low + (np.arange(count) + 0.5) * self.step(axis)


def _axis(name: str, value: Any) -> tuple[float, float, int]:
    """Check an axis (low, high, count)."""
    *edges, count = checks.items(f"volume: {name}", value, 3, "(low, high, count)")
    low, high = (checks.meters(f"volume: {name}", edge) for edge in edges)
    count = checks.integer(f"volume: count of {name}", count, 1, checks.MAX_SIZE)
    checks.require(f"volume: {name}", value, low < high, "(low, high, count) with low < high")
    return low, high, count


def default_volume(measured: Measured) -> VolumeGrid:
    """Return the volume from which light of the window can arrive.

    Voxels are opposite to the points of the wall's grid, one for each point. Along z, they reach
    from the smallest depth of the window's shortest path to half the longest path. Their depth is
    half a bin or half the grid's spacing, whichever is larger.
    """
    # Largest depth
    shortest, longest = measured.path_range()
    z_high = longest / 2

    # Smallest depth, for the farthest points of laser and sensor
    farthest = 0.0
    if measured.mode != "confocal":
        points = measured.sensors.reshape(-1, 3)
        farthest = max(np.linalg.norm(points - spot, axis=1).max() for spot in measured.lasers)
    z_low = math.sqrt(max(0.0, max(0.0, shortest) ** 2 - farthest**2)) / 2

    # Number of voxels
    step = max(measured.width / 2, measured.spacing / 2)
    count = max(1, min(round((z_high - z_low) / step), checks.MAX_SIZE))
    return VolumeGrid(*_lateral(measured), z=(z_low, z_high, count))


def native_volume(measured: Measured) -> VolumeGrid:
    """Return voxels opposite to the points of a lattice; along z, one voxel for each bin."""
    shortest, _ = measured.path_range()
    bins = measured.shape[-1]
    low = max(0.0, shortest / 2)
    return VolumeGrid(*_lateral(measured), z=(low, low + bins * measured.width / 2, bins))


def _lateral(measured: Measured) -> list[tuple[float, float, int]]:
    """Return the axes x and y with one voxel for each point of the wall."""
    points = measured.sensors
    axes = []
    for coordinate, count in ((0, points.shape[1]), (1, points.shape[0])):
        values = points[..., coordinate]
        low = float(values.min())
        high = float(values.max())
        margin = (high - low) / (2 * (count - 1)) if count > 1 else measured.spacing / 2 or 0.5
        axes.append((low - margin, high + margin, count))
    return axes


def resample(values: np.ndarray, given: VolumeGrid, wanted: VolumeGrid) -> np.ndarray:
    """Resample values (z, y, x) to another grid of voxels; values outside the old grid are 0.

    Each axis is interpolated linearly between centers. A voxel that is larger than the old voxels
    gets the average of the old voxels that it covers.
    """
    if given == wanted:
        return values
    for index, axis in enumerate("zyx"):
        weights = _weights(given, wanted, axis)
        values = np.moveaxis(np.tensordot(weights, values, axes=(1, index)), 0, index)
    return np.ascontiguousarray(values, dtype=np.float32)


def _weights(given: VolumeGrid, wanted: VolumeGrid, axis: str) -> np.ndarray:
    """Return the weights (wanted voxels, given voxels) of `resample` along one axis."""
    old = given.step(axis)
    new = wanted.step(axis)
    distance = wanted.centers(axis)[:, None] - given.centers(axis)

    # Smaller voxels: interpolate linearly. The sum of weights is below 1 in the outer half of the
    # outermost voxels
    if new <= old * (1 + 1e-9):
        weights = np.maximum(0, 1 - abs(distance) / old)
        low, high, _ = getattr(given, axis)
        inside = (wanted.centers(axis) > low) & (wanted.centers(axis) < high)
        total = weights.sum(axis=1)
        factor = np.divide(inside, total, out=np.zeros(len(total)), where=total > 0)
        return (weights * factor[:, None]).astype(np.float32)

    # Larger voxels: average
    overlap = np.minimum(distance + new / 2, old / 2) - np.maximum(distance - new / 2, -old / 2)
    return (np.maximum(overlap, 0) / new).astype(np.float32)


def volume_dataset(
    values: np.ndarray, grid: VolumeGrid, frame: WallFrame, attrs: dict[str, str | int | float]
) -> xr.Dataset:
    """Create the Dataset of intensities (z, y, x)."""
    names = {"z": "distance from the wall", "y": "along the wall's rows", "x": "along its columns"}
    dataset = xr.Dataset(
        {
            "intensity": (("z", "y", "x"), values.astype(np.float32, copy=False)),
            "frame_origin": (("xyz",), frame.origin),
            "frame_axes": (("axis", "xyz"), frame.axes),
        },
        coords={axis: grid.centers(axis) for axis in names}
        | {"xyz": ["x", "y", "z"], "axis": ["x", "y", "z"]},
        attrs=attrs,
    )
    for axis, name in names.items():
        dataset[axis].attrs.update(units="m", long_name=name)
    return labeled(dataset)
