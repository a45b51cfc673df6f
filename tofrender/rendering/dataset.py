"""The Dataset that `render` returns: how it is labelled, and how others read it.

`transient (y, x, opl, channel)` and `steady (y, x, channel)`, float32; coordinates are pixels, bin
centres as `opl` [m] and `time` [ns], and channel names; attributes are text, ints and floats. In
polarised variants, an axis `stokes` with the components S0 to S3 stands before the channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..labels import FILM, energy_outside_window, read, require_whole_stokes
from ..runtime import checks
from ..signals.polarisation import STOKES
from .cubes import Cube
from .labels import TIME, check_time, labelled
from .lazy_dask import defer_dask

if TYPE_CHECKING:
    import mitsuba as mi
    import xarray as xr

    from ..films.transient import TransientHDRFilm

QUANTITIES = ("radiance per bin", "radiance per metre")
"""Quantities of a transient: energy of each bin, or density at its centre."""

LOST_ENERGY = 0.01  # Energy outside the window, as a fraction, above which users are warned

DIMS = {"transient": ("y", "x", "opl", "channel"), "steady": ("y", "x", "channel")}

ERRORS = {f"{name}_error": dims for name, dims in DIMS.items()}
"""Standard errors, where a render has them."""

HALVES = {
    "raw": DIMS["transient"],
    "half_difference": DIMS["transient"],
    "direct": DIMS["transient"],
    "features": ("y", "x", "feature"),
}
"""Variables that `denoise` needs, with their dimensions."""


def coordinates(film: TransientHDRFilm) -> dict[str, np.ndarray]:
    """Pixels, bin centres [m], Stokes components and channels of a film's crop window."""
    opl = film.start_opl + (np.arange(film.shape[2]) + 0.5) * film.bin_width_opl
    polarised = {"stokes": np.array(STOKES)} if film_stokes(film) > 1 else {}
    return polarised | pixels_and_channels(film, film.base_channels_count()) | {"opl": opl}


def pixels_and_channels(film: mi.Film, channels: int) -> dict[str, np.ndarray]:
    """Rows and columns of a film's crop window, and the names of its channels."""
    (x, y), (width, height) = (map(int, each) for each in (film.crop_offset(), film.crop_size()))
    names = np.array(["L"] if channels == 1 else ["R", "G", "B"])
    return {"y": np.arange(y, y + height), "x": np.arange(x, x + width), "channel": names}


def channel_coordinates(film: TransientHDRFilm) -> dict[str, np.ndarray]:
    """`coordinates`, with Stokes components among the channels, as in `in_channels`."""
    found = coordinates(film)
    names = [f"{s}.{c}" for s in found.pop("stokes", ()) for c in found["channel"]]
    return found | ({"channel": np.array(names)} if names else {})


def transient_dataset(
    arrays: Mapping[str, np.ndarray], film: TransientHDRFilm, attrs: dict[str, str | int | float]
) -> xr.Dataset:
    """Make the Dataset of what a film has collected, with attributes that say how it was made."""
    import xarray as xr

    defer_dask()
    size = {"film_width": int(film.size().x), "film_height": int(film.size().y)}
    count = film_stokes(film)
    variables = {}
    for name, array in arrays.items():
        dims = (DIMS | ERRORS | HALVES)[name]
        if count > 1:
            dims = (*dims[:-1], "stokes", dims[-1])
            array = array.reshape(*array.shape[:-1], count, -1)
        variables[name] = dims, array
    return labelled(xr.Dataset(variables, coords=coordinates(film), attrs=attrs | size))


def film_stokes(film: TransientHDRFilm) -> int:
    """Stokes components that a film has, 1 if it does not tell them apart."""
    return film.shape[3] // film.base_channels_count()


def in_channels(dataset: Any, halves: bool = False) -> Any:
    """A Dataset as files have it: Stokes components are channels, "S0.R", "S0.G" and so on.

    `HALVES` are dropped, unless `halves`. Anything else without an axis `stokes` stays as it is.
    """
    if not halves and "half_difference" in getattr(dataset, "data_vars", ()):
        dataset = dataset.drop_vars(list(HALVES), errors="ignore")
    if "stokes" not in getattr(dataset, "dims", ()):
        return dataset
    names = [f"{s}.{c}" for s in dataset["stokes"].values for c in dataset["channel"].values]
    variables = {}
    for name, variable in dataset.data_vars.items():
        if "stokes" not in variable.dims:
            variables[name] = variable
            continue
        data = variable.data.reshape(*variable.shape[:-2], len(names))
        variables[name] = (*variable.dims[:-2], "channel"), data, variable.attrs
    coords = {
        name: each for name, each in dataset.coords.items() if name not in ("stokes", "channel")
    }
    flat = type(dataset)(variables, coords | {"channel": names}, dataset.attrs)
    flat["channel"].attrs.update(dataset["channel"].attrs)
    return flat


def for_file(dataset: Any, halves: bool = False) -> xr.Dataset:
    """A Dataset of `render`, or a part of one, in the order and with the labels that files have.

    The energy outside of the window is that of the part. `halves` is that of `in_channels`.

    Raises:
        ValueError: Another Dataset, or one whose bins or pixels xarray has coarsened.
    """
    dataset = read(dataset, FILM, "dataset")
    require_whole_stokes(dataset, "dataset")
    if "channel" not in dataset.coords:  # A single one, of a sum that has kept its axis
        dataset = dataset.assign_coords(channel=["L"])
    outside = energy_outside_window(dataset, "dataset")
    if outside is not None:
        dataset = dataset.assign_attrs(energy_outside_window=outside)
    dataset = in_channels(dataset, halves)
    check_dataset(dataset)
    return dataset


def in_components(dataset: xr.Dataset) -> xr.Dataset:
    """The reverse of `in_channels`, for channels that have such names."""
    names = [str(name) for name in dataset["channel"].values]
    colours = [name.partition(".")[2] for name in names[: len(names) // 4]]
    if names != [f"{s}.{c}" for s in STOKES for c in colours] or not colours:
        return dataset
    variables = {}
    for name, variable in dataset.data_vars.items():
        if "channel" not in variable.dims:
            variables[name] = variable
            continue
        data = variable.data.reshape(*variable.shape[:-1], 4, len(colours))
        variables[name] = (*variable.dims[:-1], "stokes", "channel"), data, variable.attrs
    coords = {name: each for name, each in dataset.coords.items() if name != "channel"}
    channel = ("channel", colours, dataset["channel"].attrs)
    coords = {"stokes": list(STOKES)} | coords | {"channel": channel}
    return labelled(type(dataset)(variables, coords, dataset.attrs))


def of_intensity(values: np.ndarray) -> np.ndarray:
    """Channels of a film that are no less than 0: all, or those of S0 in polarised variants."""
    count = values.shape[-1]
    return values[..., : count // 4] if count in (4, 12) else values


def components_of(dataset: xr.Dataset) -> list[xr.Dataset]:
    """A polarised Dataset's Stokes components, else the only one."""
    if "stokes" not in getattr(dataset, "dims", ()):
        return [dataset]
    return [dataset.sel(stokes=each, drop=True) for each in dataset["stokes"].values]


def check_dataset(dataset: object) -> None:
    """Refuse anything but a Dataset like the ones that `render` returns, or a part of one."""
    import xarray as xr

    if not isinstance(dataset, xr.Dataset):
        raise ValueError(f"dataset = {type(dataset).__name__}: must be an xarray.Dataset")
    if "stokes" in dataset.dims:
        raise ValueError(
            "dataset: has an axis stokes; must be one component, like "
            "dataset.sel(stokes='S0', drop=True)"
        )
    require_one_render("dataset", dataset)
    found = {str(name): variable.dims for name, variable in dataset.data_vars.items()}
    known = found in (DIMS, DIMS | ERRORS, DIMS | HALVES)
    if not known or any(v.dtype != np.float32 for v in dataset.data_vars.values()):
        raise ValueError(
            f"dataset with {found}: must hold the float32 variables {DIMS}, their errors or no "
            "other, or those of a denoised render"
        )
    along_axes = {name for name, each in dataset.coords.items() if each.dims}
    if along_axes - {TIME} != set(DIMS["transient"]) or not all(dataset.sizes.values()):
        raise ValueError(
            f"dataset with {dict(dataset.sizes)}: must have coordinates on all axes, and no "
            "other but time"
        )
    first_pixel(dataset)
    check_attributes("dataset", dataset)


def require_one_render(what: str, dataset: xr.Dataset) -> None:
    """Refuse several renders in one Dataset: frames of an animation, records of a data set."""
    if "transient" not in dataset:
        return
    for axis in dataset["transient"].dims:
        if axis == "record":
            raise ValueError(
                f"{what}: has the axis 'record' of a data set. Pass the render of one record, like "
                "datasets.render_of(dataset, 0)"
            )
        if axis not in (*DIMS["transient"], "stokes"):
            raise ValueError(
                f"{what}: has the axis {str(axis)!r}. Pass one entry of it, like "
                f"dataset.isel({axis}=0)"
            )


def check_attributes(what: str, dataset: xr.Dataset) -> None:
    """Refuse attributes that contradict the time axis, or are no text or numbers."""
    start, width = time_axis(dataset)
    stated = [dataset.attrs.get(name) for name in ("start_opl", "bin_width_opl")]
    if not np.allclose(np.array(stated, dtype=float), (start, width), rtol=1e-6, atol=1e-3 * width):
        raise ValueError(
            f"{what}: attributes start_opl, bin_width_opl = {stated}; must be [{start:g}, "
            f"{width:g}], as the coordinate opl has it"
        )
    for name, value in plain_attributes(dataset).items():
        if not isinstance(value, str | int | float):
            raise ValueError(f"attribute {name} = {value!r}: must be text, an int or a float")


def require_finite(dataset: xr.Dataset) -> None:
    """Refuse a Dataset, of a render or a capture, with light that is NaN or infinite."""
    for name in DIMS | ERRORS | HALVES:
        if name in dataset:
            Cube(dataset[name]).require_finite(name)


def first_pixel(dataset: xr.Dataset) -> tuple[int, int]:
    """Column and row of the first pixel."""
    for axis in ("y", "x"):
        values = dataset[axis].values
        if values.dtype.kind not in "iu" or (np.diff(values) != 1).any():
            raise ValueError(f"coordinate {axis}: must be consecutive pixel indices")
    return int(dataset["x"].values[0]), int(dataset["y"].values[0])


def time_axis(dataset: xr.Dataset) -> tuple[float, float]:
    """Start of the first bin and width of the bins [m], from the coordinate `opl`."""
    check_time(dataset)
    width = checks.metres("bin_width_opl", dataset.attrs.get("bin_width_opl"), positive=True)
    centres = np.asarray(dataset["opl"].values, dtype=np.float64)
    if not np.allclose(np.diff(centres), width, rtol=1e-3, atol=0):
        raise ValueError(f"coordinate opl: must be the centres of consecutive bins of {width:g} m")
    return float(centres[0] - width / 2), width


def plain_attributes(labelled: xr.Dataset | xr.Variable) -> dict[str, Any]:
    """Attributes of a Dataset or one of its variables by name, NumPy's scalars as Python's."""
    return {
        str(name): value.item() if isinstance(value, np.generic) else value
        for name, value in labelled.attrs.items()
    }
