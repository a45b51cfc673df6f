"""Camera unwarping of a finished render: from camera time to scene time."""

from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import FILM, bins_of, by_pixel, read, with_energy
from ..rendering.cubes import Cube
from ..rendering.labels import labeled
from ..runtime import checks, memory
from ..runtime.progress import status


@status("Unwarping")
def unwarp_camera(dataset: Annotated[xr.Dataset, FILM], distance_m: Any) -> xr.Dataset:
    """Subtract the camera segment from the path lengths of every pixel.

    A camera sees a distant surface later than a near surface. This function moves the time axis of
    each pixel back by the pixel's distance, so that a video shows every surface when light reaches
    it. A shift by part of a bin divides each bin's light linearly between two bins, which keeps the
    sum over bins. A render with `camera_unwarp=True` subtracts the first segment of each path
    instead. That is exact, also if several surfaces share a pixel. See also `true_depth`.

    Args:
        dataset: The result of `render`, in camera time.
        distance_m: (height, width), distance [m] from the camera's position to the surface in each
            pixel (not the depth along the axis), at least 0. A pixel without a surface has the
            distance NaN or infinity. It becomes dark, or unknown (NaN) if it contains light. The
            labels of a DataArray must be the labels of the Dataset. An array has the order of the
            Dataset's rows and columns.

    Returns:
        A Dataset of the same pixels and bin width. Its window spans the bins in which any pixel
        has light. The attribute `camera_unwarp` is 1. The attribute `fingerprint` is removed, since
        a render cannot be resumed from the result. Standard errors are omitted, since the errors of
        neighboring bins are not independent. Variables for `denoise` are omitted, too.

    Raises:
        ValueError: A Dataset that is unwarped already or not one of `render`, another shape, or a
            negative distance.
        MemoryError: The result does not fit into memory.

    Example:
        >>> from tofrender import cornell_box, render
        >>> dataset = render(cornell_box(width=16, height=16), spp=16, window="auto")
        >>> unwarped = unwarp_camera(dataset, np.full((16, 16), 3.0))
        >>> float(unwarped.opl[0]) < float(dataset.opl[0])
        True
    """
    # Check the arguments
    distance_m = by_pixel(distance_m, dataset, "distance_m")
    dataset = with_energy(read(dataset, FILM, "dataset"), "dataset")
    if dataset.attrs.get("camera_unwarp"):
        raise ValueError(
            "dataset: its path lengths lack the camera's segment already (camera_unwarp = 1). Pass "
            "a film in camera time"
        )
    film = dataset[["transient", "steady"]]
    light = film["transient"]
    cube = Cube(light.data.reshape(*light.shape[:3], -1))  # Stokes components are channels
    distances = checked_distances(distance_m, cube.shape[:2])

    # Split the shift of each pixel into whole bins and a part of a bin
    width = bins_of(film, "dataset").bin_width_opl
    start = float(film["opl"].values[0] - width / 2)
    seen = np.isfinite(distances)
    shift = np.where(seen, distances, 0) / width
    # Rounding must not move light of a shift by whole bins to the next bin
    shift = np.where(abs(shift - np.rint(shift)) < 1e-6, np.rint(shift), shift)
    whole = np.floor(shift).astype(np.int64)
    part = (shift - whole).astype(np.float32)

    # Shift the light, in the window that contains it
    first, stop, lit, unfinished = _window(cube, seen, whole, part > 0)
    unwarped = _shifted(cube, whole, part, np.arange(first, stop))
    unwarped[unfinished] = np.nan
    unwarped[~seen] = np.where(lit[~seen][:, None, None], np.nan, 0)

    # Label the result
    opl = start + (np.arange(first, stop) + 0.5) * width
    attrs = {name: value for name, value in film.attrs.items() if name != "fingerprint"}
    attrs |= {"start_opl": start + first * width, "camera_unwarp": 1}
    name = {"units": "m", "long_name": "optical path length without the camera's segment"}
    shape = (*light.shape[:2], stop - first, *light.shape[3:])
    moved = (light.dims, unwarped.reshape(shape), light.attrs)
    result = film.drop_dims("opl").assign(transient=moved, steady=film["steady"])
    result = result.assign_coords(opl=("opl", opl, name))[["transient", "steady"]]
    result.attrs = attrs
    return labeled(result)


def _shifted(cube: Cube, whole: np.ndarray, part: np.ndarray, bins: np.ndarray) -> np.ndarray:
    """Return the bins of each pixel after a shift back by `whole + part` bins."""
    height, width, count, channels = cube.shape
    memory.require_free("dataset", 4 * height * width * len(bins) * channels)
    shifted = np.empty((height, width, len(bins), channels), np.float32)
    for rows, values in cube.rows():
        pixel_rows = zip(values, shifted[rows], whole[rows], part[rows], strict=True)
        for row, out, steps, fraction in pixel_rows:
            padded = np.pad(row, ((0, 0), (1, 1), (0, 0)))
            source = (bins + steps[:, None])[..., None]
            here, after = (
                np.take_along_axis(padded, np.clip(source + one, -1, count) + 1, axis=1)
                for one in (0, 1)
            )
            weight = fraction[:, None, None]
            with np.errstate(invalid="ignore"):
                out[:] = (1 - weight) * here + weight * after
    return shifted


def _window(
    cube: Cube, seen: np.ndarray, whole: np.ndarray, has_part: np.ndarray
) -> tuple[int, int, np.ndarray, np.ndarray]:
    """Return the bins with light of seen pixels after the shift, and masks of pixels.

    Returns:
        (first, stop, lit, unfinished): the first bin and the end of the range of bins, the pixels
        with light or NaN, and the pixels with NaN.
    """
    # Find the first and the last bin of each pixel with light
    size = cube.shape[:2]
    count = cube.shape[2]
    begin = np.zeros(size, np.int64)
    end = np.zeros(size, np.int64)
    lit = np.zeros(size, bool)
    unfinished = np.zeros(size, bool)
    for rows, values in cube.rows():
        light = values != 0
        unknown = np.isnan(values)
        lit[rows] = light.any(axis=(2, 3))
        unfinished[rows] = unknown.any(axis=(2, 3))
        light = (light & ~unknown).any(axis=3)
        begin[rows] = light.argmax(axis=2)
        end[rows] = np.where(light.any(axis=2), count - light[..., ::-1].argmax(axis=2), 0)

    # Shift them, and join the ranges of all pixels
    used = (end > 0) & seen
    if not used.any():
        return 0, count, lit, unfinished
    first = (begin - whole - has_part)[used].min()
    stop = (end - whole)[used].max()
    if stop - first > checks.MAX_BINS:
        problem = f"spreads the light over {stop - first} bins"
        raise ValueError(f"distance_m {problem}: must be at most {checks.MAX_BINS}")
    return int(first), int(stop), lit, unfinished


def checked_distances(distance_m: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return distances [m] in a shape of pixels. NaN or infinity means a pixel without surface."""
    distances = checks.real_array("distance_m", distance_m, np.float64)
    valid = distances.shape == shape
    checks.shape("distance_m", distances, valid, f"{shape}, one number a pixel")
    wrong = distances[(distances < 0) | (np.isfinite(distances) & (distances > checks.MAX_OPL))]
    if wrong.size:
        raise ValueError(f"distance_m contains {wrong[0]:g}: must be from 0 to 1e12 meters, or NaN")
    return distances
