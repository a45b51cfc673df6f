"""Maximum projection and depth map of a volume, and the error of the depth."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ...labels import VOLUME, by_pixel, even_axis, read
from ...runtime import checks


def check_volume(volume: Any) -> np.ndarray:
    """Return the intensities (z, y, x) of a result of `reconstruct`, which must be finite."""
    return _intensity(volume).values


def _intensity(volume: Any) -> xr.DataArray:
    """Return the intensities (z, y, x), which must be finite, with even steps of z."""
    intensity = read(volume, VOLUME, "volume")["intensity"]
    checks.finite("volume: intensity", checks.real_array("volume: intensity", intensity.values))
    even_axis(intensity.to_dataset(), "z", "volume", width=1.0)
    return intensity


def max_projection(volume: Annotated[xr.Dataset, VOLUME]) -> xr.DataArray:
    """Return the largest intensity along z, (y, x).

    Raises:
        ValueError: The argument is not a result of `reconstruct`.
    """
    return _intensity(volume).max("z")


def depth_map(volume: Annotated[xr.Dataset, VOLUME], threshold: float = 0.2) -> xr.DataArray:
    """Return the depth of the brightest voxel at each (y, x).

    Args:
        volume: A result of `reconstruct`.
        threshold: Fraction of the volume's maximum, in [0, 1]. Pixels with a smaller maximum along
            z are dark.

    Returns:
        Depth (y, x) [m], float64: z of the maximum, refined by the parabola through the maximum and
        the voxels before and after it. NaN for dark pixels.

    Raises:
        ValueError: The volume is not a result of `reconstruct`, its steps of z are uneven, or the
            threshold is out of range.
    """
    intensity = _intensity(volume)
    values = intensity.values
    threshold = checks.number("threshold", threshold, low=0, high=1)
    z = intensity["z"].values

    # Find the brightest voxel
    peak = values.argmax(axis=0)
    inner = np.clip(peak, 1, max(len(z) - 2, 1))
    depth = z[peak]

    # Refine by a parabola, if the voxel has two neighbors
    if len(z) > 2:
        before, at, after = (
            np.take_along_axis(values, (inner + step)[None], axis=0)[0].astype(np.float64)
            for step in (-1, 0, 1)
        )
        bend = before - 2 * at + after
        refined = (inner == peak) & (bend < 0)
        shift = np.divide(before - after, 2 * bend, out=np.zeros(bend.shape), where=refined)
        depth = depth + shift * (z[1] - z[0])

    # Remove dark pixels
    brightest = values.max(axis=0)
    found = (brightest > 0) & (brightest >= threshold * values.max())
    depth = np.where(found, depth, np.nan)
    coords = {axis: intensity[axis] for axis in ("y", "x")}
    return xr.DataArray(depth, coords, ("y", "x"), "depth", {"units": "m", "long_name": "depth"})


@dataclass(frozen=True)
class DepthError:
    """Differences between a depth map and the true depth, over pixels that have both depths."""

    # Median, mean, and root mean square of the absolute difference [m]
    median: float
    mean: float
    rms: float

    # Median of the found depth minus the true depth [m]
    bias: float

    # Number of pixels that have both depths
    pixels: int

    # Fraction of the pixels with a true depth in which a depth was found
    found: float

    # Fraction of the pixels with a found depth in which the true depth is NaN
    extra: float


def depth_error(
    volume: Annotated[xr.Dataset, VOLUME], truth: Any, threshold: float = 0.2
) -> DepthError:
    """Compare the depth map of a volume with the true depth.

    Args:
        volume: A result of `reconstruct`.
        truth: Distance from the wall to the nearest hidden surface [m] at the volume's (y, x), NaN
            without a surface. The labels of a DataArray must equal the labels of the volume.
        threshold: As in `depth_map`.

    Returns:
        The differences. They are NaN if no pixel has both depths.

    Raises:
        ValueError: `truth` has another shape or contains only NaN.

    Example:
        >>> import xarray as xr
        >>> values = np.zeros((3, 2, 2), np.float32)
        >>> values[1] = 1
        >>> coords = {"z": [0.9, 1.0, 1.1], "y": [0, 1], "x": [0, 1]}
        >>> volume = xr.Dataset({"intensity": (("z", "y", "x"), values)}, coords)
        >>> round(depth_error(volume, np.full((2, 2), 1.02)).median, 3)
        0.02
    """
    # Read both depths
    depth = depth_map(volume, threshold).values
    true = checks.real_array("truth", by_pixel(truth, volume, "truth"), np.float64)
    valid = true.shape == depth.shape
    checks.shape("truth", true, valid, f"{depth.shape}, as the volume has")
    there = np.isfinite(true)
    seen = np.isfinite(depth)
    if not there.any():
        raise ValueError("truth: all pixels are NaN. Pass a depth in at least one pixel")

    # Compare pixels that have both depths
    compared = there & seen
    difference = (depth - true)[compared] if compared.any() else np.array([np.nan])
    return DepthError(
        median=float(np.median(abs(difference))),
        mean=float(abs(difference).mean()),
        rms=float(np.sqrt(np.square(difference).mean())),
        bias=float(np.median(difference)),
        pixels=int(compared.sum()),
        found=float(compared.sum() / there.sum()),
        extra=float((seen & ~there).sum() / max(seen.sum(), 1)),
    )
