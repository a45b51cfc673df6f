"""Camera unwarping of a finished render: from camera time to the scene's own time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..rendering.cubes import Cube
from ..rendering.dataset import DIMS, check_dataset, time_axis
from ..rendering.labels import TIME, labelled
from ..runtime import checks, memory
from ..runtime.progress import with_status

if TYPE_CHECKING:
    import xarray as xr


@with_status("Unwarping")
def unwarp_camera(dataset: xr.Dataset, distance_m: Any) -> xr.Dataset:
    """Leave the way from the camera to the first surface out of every pixel's times.

    A camera sees a distant surface later than a near one, so in its video a wavefront that sweeps
    the scene looks bent and late. Here each pixel's time axis moves back by its own distance, and
    the video shows every surface when light reaches it. A shift by part of a bin divides each
    bin's light linearly between two bins, so that the sum over bins stays what it was.

    A render with `camera_unwarp=True` subtracts each path's own first segment, which is exact also
    where several surfaces share a pixel; this function needs no new render.

    Args:
        dataset: The result of `render`, in camera time.
        distance_m: (height, width), distance [m] from the camera's position to what each pixel
            sees (not the depth along the axis), at least 0. NaN or infinity where it sees no
            surface; such a pixel is dark, or, if light arrived there, unknown (NaN).

    Returns:
        A Dataset of the same pixels and bin width. Its window is as long as all light needs:
        bins at either end in which no pixel has light are left out. The attribute `camera_unwarp`
        is 1; `fingerprint` is gone, since a render cannot be resumed from this.

    Raises:
        ValueError: A Dataset that is unwarped already or not one of `render`, another shape, or a
            negative distance.
        MemoryError: The result does not fit into memory.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> unwarped = unwarp_camera(dataset, np.full((16, 16), 3.0))
        >>> float(unwarped.opl[0]) < float(dataset.opl[0])
        True
    """
    check_dataset(dataset)
    if dataset.attrs.get("camera_unwarp"):
        raise ValueError("dataset with camera_unwarp = 1: must be in camera time")
    cube = Cube(dataset["transient"])
    distances = _distances(distance_m, cube.shape[:2])
    start, width = time_axis(dataset)
    seen = np.isfinite(distances)
    shift = np.where(seen, distances, 0) / width
    # Rounding must not spill light of a shift by whole bins into the next one.
    shift = np.where(abs(shift - np.rint(shift)) < 1e-6, np.rint(shift), shift)
    whole = np.floor(shift).astype(np.int64)
    part = (shift - whole).astype(np.float32)
    lit = _Lit(cube)
    first, stop = lit.occupied(seen, whole, part > 0)
    unwarped = _moved(cube, whole, part, np.arange(first, stop))
    unwarped[lit.unfinished] = np.nan
    unwarped[~seen] = np.where(lit.any[~seen][:, None, None], np.nan, 0)

    opl = start + (np.arange(first, stop) + 0.5) * width
    attrs = {name: value for name, value in dataset.attrs.items() if name != "fingerprint"}
    attrs |= {"start_opl": start + first * width, "camera_unwarp": 1}
    name = {"units": "m", "long_name": "optical path length without the camera's segment"}
    cube = (DIMS["transient"], unwarped, dataset["transient"].attrs)
    result = dataset.drop_vars(["transient", "opl", TIME], errors="ignore").assign(transient=cube)
    result = result.assign_coords(opl=("opl", opl, name))
    result.attrs = attrs
    return labelled(result[["transient", "steady"]])


def _moved(cube: Cube, whole: np.ndarray, part: np.ndarray, bins: np.ndarray) -> np.ndarray:
    """Move each pixel back by `whole + part` bins; `bins` are those wanted, as numbers before."""
    height, width, count, channels = cube.shape
    memory.require_free("dataset", 4 * height * width * len(bins) * channels)
    moved = np.empty((height, width, len(bins), channels), np.float32)
    for place, values in cube.rows():
        for row, new, steps, late in zip(
            values, moved[place], whole[place], part[place], strict=True
        ):
            padded = np.pad(row, ((0, 0), (1, 1), (0, 0)))
            source = (bins + steps[:, None])[..., None]
            here, after = (
                np.take_along_axis(padded, np.clip(source + one, -1, count) + 1, axis=1)
                for one in (0, 1)
            )
            share = late[:, None, None]
            with np.errstate(invalid="ignore"):
                new[:] = (1 - share) * here + share * after
    return moved


class _Lit:
    """Where a film has light, (height, width).

    Attributes:
        first: First bin with light, the count of bins where there is none.
        stop: The bin after the last one with light.
        any: Whether there is light, or what is unknown.
        unfinished: Whether values are NaN.
    """

    def __init__(self, cube: Cube) -> None:
        size = cube.shape[:2]
        self.count = cube.shape[2]
        self.first, self.stop = np.full(size, self.count), np.zeros(size, np.int64)
        self.any, self.unfinished = np.zeros(size, bool), np.zeros(size, bool)
        for (rows, columns, bins, _), values in cube.pieces():
            here = rows, columns
            light, unknown = values != 0, np.isnan(values)
            self.any[here] |= light.any(axis=(2, 3))
            self.unfinished[here] |= unknown.any(axis=(2, 3))
            lit = (light & ~unknown).any(axis=3)
            used, last = lit.any(axis=2), bins.stop - lit[..., ::-1].argmax(axis=2)
            begin = np.where(used, bins.start + lit.argmax(axis=2), self.count)
            self.first[here] = np.minimum(self.first[here], begin)
            self.stop[here] = np.maximum(self.stop[here], np.where(used, last, 0))

    def occupied(self, seen: np.ndarray, whole: np.ndarray, parted: np.ndarray) -> tuple[int, int]:
        """First bin, and the one after the last, that get light from any pixel that is seen."""
        used = (self.stop > 0) & seen
        if not used.any():
            return 0, self.count
        first = (self.first - whole - parted)[used].min()
        stop = (self.stop - whole)[used].max()
        if stop - first > checks.MAX_BINS:
            raise ValueError(
                f"distance_m spreads the light over {stop - first} bins: must be at most "
                f"{checks.MAX_BINS}"
            )
        return int(first), int(stop)


def _distances(distance_m: Any, shape: tuple[int, ...]) -> np.ndarray:
    distances = checks.real_array("distance_m", distance_m)
    if distances.shape != shape:
        raise ValueError(
            f"distance_m with shape {distances.shape}: must be {shape}, one number a pixel"
        )
    distances = distances.astype(np.float64)
    wrong = distances[(distances < 0) | (np.isfinite(distances) & (distances > checks.MAX_OPL))]
    if wrong.size:
        raise ValueError(f"distance_m holds {wrong[0]:g}: must be from 0 to 1e12 metres, or NaN")
    return distances
