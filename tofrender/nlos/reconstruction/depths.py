"""Maximum projection and depth map of a volume, and the error of the depth."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ...labels import VOLUME, by_pixel, even_axis, read
from ...runtime import checks


def check_volume(volume: Any) -> np.ndarray:
    """Return the finite intensities (z, y, x) of a result of `reconstruct`."""
    return _intensity(volume).values


def _intensity(volume: Any) -> xr.DataArray:
    """Read the intensities (z, y, x), which must be finite and in even steps of z."""
    intensity = read(volume, VOLUME, "volume")["intensity"]
    checks.finite("volume: intensity", checks.real_array("volume: intensity", intensity.values))
    even_axis(intensity.to_dataset(), "z", "volume", width=1.0)
    return intensity


def max_projection(volume: Annotated[xr.Dataset, VOLUME]) -> xr.DataArray:
    """Largest intensity along z, (y, x).

    Raises:
        ValueError: Not a result of `reconstruct`.
    """
    return _intensity(volume).max("z")


def depth_map(volume: Annotated[xr.Dataset, VOLUME], threshold: float = 0.2) -> xr.DataArray:
    """Depth of the brightest voxel behind each (y, x).

    Args:
        volume: A result of `reconstruct`.
        threshold: Pixels whose maximum along z is less than this fraction of the volume's maximum
            have no depth; in [0, 1].

    Returns:
        (y, x) float64 [m]: z of the maximum, refined by the parabola through the voxels before and
        after it; NaN where there is nothing.

    Raises:
        ValueError: Not a result of `reconstruct`, uneven steps of z, or a threshold out of range.
    """
    intensity = _intensity(volume)
    values = intensity.values
    threshold = checks.number("threshold", threshold, low=0, high=1)
    z = intensity["z"].values
    peak = values.argmax(axis=0)
    inner = np.clip(peak, 1, max(len(z) - 2, 1))
    depth = z[peak]
    if len(z) > 2:
        before, at, after = (
            np.take_along_axis(values, (inner + step)[None], axis=0)[0].astype(np.float64)
            for step in (-1, 0, 1)
        )
        bend = before - 2 * at + after
        refined = (inner == peak) & (bend < 0)
        shift = np.divide(before - after, 2 * bend, out=np.zeros(bend.shape), where=refined)
        depth = depth + shift * (z[1] - z[0])
    brightest = values.max(axis=0)
    found = (brightest > 0) & (brightest >= threshold * values.max())
    depth = np.where(found, depth, np.nan)
    coords = {axis: intensity[axis] for axis in ("y", "x")}
    return xr.DataArray(depth, coords, ("y", "x"), "depth", {"units": "m", "long_name": "depth"})


@dataclass(frozen=True)
class DepthError:
    """Differences between a depth map and the true one, over pixels where both have a depth."""

    median: float  # of the absolute difference [m]
    mean: float  # of the absolute difference [m]
    rms: float  # root of the mean squared difference [m]
    bias: float  # median of found less true depth [m]
    pixels: int  # number of pixels where both have a depth
    found: float  # fraction of the true pixels that have a depth
    extra: float  # fraction of the pixels with a depth where in truth there is nothing


def depth_error(
    volume: Annotated[xr.Dataset, VOLUME], truth: Any, threshold: float = 0.2
) -> DepthError:
    """Compare the depth map of a volume with the true one.

    Args:
        volume: A result of `reconstruct`.
        truth: Distance of the nearest hidden surface from the wall [m] at the volume's (y, x), NaN
            where there is none. The labels of a DataArray must be those of the volume.
        threshold: As in `depth_map`.

    Returns:
        The differences; NaN if no pixel has both.

    Raises:
        ValueError: A truth of another shape or without any depth.

    Example:
        >>> import xarray as xr
        >>> values = np.zeros((3, 2, 2), np.float32)
        >>> values[1] = 1
        >>> coords = {"z": [0.9, 1.0, 1.1], "y": [0, 1], "x": [0, 1]}
        >>> volume = xr.Dataset({"intensity": (("z", "y", "x"), values)}, coords)
        >>> round(depth_error(volume, np.full((2, 2), 1.02)).median, 3)
        0.02
    """
    depth = depth_map(volume, threshold).values
    true = checks.real_array("truth", by_pixel(truth, volume, "truth"), np.float64)
    valid = true.shape == depth.shape
    checks.shape("truth", true, valid, f"{depth.shape}, as the volume has")
    there, seen = np.isfinite(true), np.isfinite(depth)
    if not there.any():
        raise ValueError("truth: must have a depth in one pixel or more")
    compared = there & seen
    off = (depth - true)[compared] if compared.any() else np.array([np.nan])
    return DepthError(
        median=float(np.median(abs(off))),
        mean=float(abs(off).mean()),
        rms=float(np.sqrt(np.square(off).mean())),
        bias=float(np.median(off)),
        pixels=int(compared.sum()),
        found=float(compared.sum() / there.sum()),
        extra=float((seen & ~there).sum() / max(seen.sum(), 1)),
    )
