"""The Dataset that `render` returns: how it is labelled, and how others read it.

`transient (y, x, opl, channel)` and `steady (y, x, channel)`, float32; coordinates are pixels, bin
centres as `opl` [m] and `time` [ns], and channel names; attributes are text, ints and floats. In
polarised variants, an axis `stokes` with the components S0 to S3 stands before the channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..labels import (
    FILM,
    energy_outside_window,
    read,
    require_axes_only,
    require_consecutive,
    require_whole_stokes,
)
from ..signals.polarisation import STOKES
from .cubes import Cube
from .labels import labelled
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
    require_storable(dataset)
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


def require_storable(dataset: xr.Dataset) -> None:
    """Refuse a film that `read` accepts, but that files do not support.

    Files contain float32 values of a rectangle of pixels, standard errors of both variables, and
    attributes that are text or numbers.
    """
    names = set(dataset.data_vars)
    if names not in (set(DIMS), {*DIMS, *ERRORS}, {*DIMS, *HALVES}):
        raise ValueError(
            f"dataset: a file with the variables {', '.join(sorted(map(str, names)))} is not "
            "supported. Save transient and steady, with the errors of both or with all variables "
            "of denoise"
        )
    for name, variable in dataset.data_vars.items():
        if variable.dtype != np.float32:
            raise ValueError(
                f"dataset: the variable {name} has the type {variable.dtype}; in files it must be "
                "float32. Convert the Dataset: astype('float32')"
            )
    require_consecutive(dataset, "dataset")
    require_axes_only(dataset, "dataset")
    require_plain_attributes(dataset)


def require_plain_attributes(dataset: xr.Dataset) -> None:
    """Refuse attributes that are neither text nor numbers, as files do not support others."""
    for name, value in plain_attributes(dataset).items():
        if not isinstance(value, str | int | float):
            raise ValueError(f"attribute {name} = {value!r}: must be text, an int or a float")


def require_finite(dataset: xr.Dataset) -> None:
    """Refuse a Dataset, of a render or a capture, with light that is NaN or infinite."""
    for name in DIMS | ERRORS | HALVES:
        if name in dataset:
            Cube(dataset[name]).require_finite(name)


def plain_attributes(labelled: xr.Dataset | xr.Variable) -> dict[str, Any]:
    """Attributes of a Dataset or one of its variables by name, NumPy's scalars as Python's."""
    return {
        str(name): value.item() if isinstance(value, np.generic) else value
        for name, value in labelled.attrs.items()
    }
