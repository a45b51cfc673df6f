"""The Dataset that `render` returns: labels, checks, and conversion for files.

The variables are `transient (y, x, opl, channel)` and `steady (y, x, channel)`, float32. The
coordinates are pixels, bin centers as `opl` [m] and `time` [ns], and channel names. Attributes are
text, ints and floats. In polarized variants, an axis `stokes` with the components S0 to S3 precedes
the channels.
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
from ..signals.polarization import STOKES
from .cubes import Cube
from .labels import labeled
from .lazy_dask import defer_dask

if TYPE_CHECKING:
    import mitsuba as mi
    import xarray as xr

    from ..films.transient import TransientHDRFilm

# Quantities of a transient: energy of each bin, or density at the center of each bin
QUANTITIES = ("radiance per bin", "radiance per meter")

# Fraction of the energy outside the window above which users are warned
LOST_ENERGY = 0.01

# Variables with their dimensions
DIMS = {"transient": ("y", "x", "opl", "channel"), "steady": ("y", "x", "channel")}

# Optional standard errors with their dimensions
ERRORS = {f"{name}_error": dims for name, dims in DIMS.items()}

# Variables that `denoise` needs, with their dimensions
HALVES = {
    "raw": DIMS["transient"],
    "half_difference": DIMS["transient"],
    "direct": DIMS["transient"],
    "features": ("y", "x", "feature"),
}


def coordinates(film: TransientHDRFilm) -> dict[str, np.ndarray]:
    """Return pixels, bin centers [m], Stokes components and channels of a film's crop window."""
    opl = film.start_opl + (np.arange(film.shape[2]) + 0.5) * film.bin_width_opl
    polarized = {"stokes": np.array(STOKES)} if film_stokes(film) > 1 else {}
    return polarized | pixels_and_channels(film, film.base_channels_count()) | {"opl": opl}


def pixels_and_channels(film: mi.Film, channels: int) -> dict[str, np.ndarray]:
    """Return rows and columns of a film's crop window, and the names of `channels` channels."""
    (x, y), (width, height) = (map(int, each) for each in (film.crop_offset(), film.crop_size()))
    names = np.array(["L"] if channels == 1 else ["R", "G", "B"])
    return {"y": np.arange(y, y + height), "x": np.arange(x, x + width), "channel": names}


def channel_coordinates(film: TransientHDRFilm) -> dict[str, np.ndarray]:
    """Return `coordinates` with Stokes components as channels, see `in_channels`."""
    found = coordinates(film)
    names = [f"{s}.{c}" for s in found.pop("stokes", ()) for c in found["channel"]]
    return found | ({"channel": np.array(names)} if names else {})


def transient_dataset(
    arrays: Mapping[str, np.ndarray], film: TransientHDRFilm, attrs: dict[str, str | int | float]
) -> xr.Dataset:
    """Make the Dataset of a rendered film.

    Args:
        arrays: Arrays with the Stokes components among the channels, by the name of the variable.
        film: Film that defines the coordinates.
        attrs: Attributes that describe the render.
    """
    import xarray as xr

    defer_dask()
    size = {"film_width": int(film.size().x), "film_height": int(film.size().y)}
    count = film_stokes(film)
    variables = {}
    for name, array in arrays.items():
        dims = (DIMS | ERRORS | HALVES)[name]

        # Separate the Stokes components from the channels
        if count > 1:
            dims = (*dims[:-1], "stokes", dims[-1])
            array = array.reshape(*array.shape[:-1], count, -1)
        variables[name] = dims, array
    return labeled(xr.Dataset(variables, coords=coordinates(film), attrs=attrs | size))


def film_stokes(film: TransientHDRFilm) -> int:
    """Return the number of a film's Stokes components, 1 without polarization."""
    return film.shape[3] // film.base_channels_count()


def in_channels(dataset: Any, halves: bool = False) -> Any:
    """Convert a Dataset to the layout of film files: Stokes components become channels "S0.R" etc.

    Objects without an axis `stokes` keep their axes.

    Args:
        dataset: The Dataset.
        halves: Whether to keep the variables that `denoise` needs (`HALVES`).
    """
    if not halves and "half_difference" in getattr(dataset, "data_vars", ()):
        dataset = dataset.drop_vars(list(HALVES), errors="ignore")
    if "stokes" not in getattr(dataset, "dims", ()):
        return dataset

    # Join the last two axes of each variable
    names = [f"{s}.{c}" for s in dataset["stokes"].values for c in dataset["channel"].values]
    variables = {}
    for name, variable in dataset.data_vars.items():
        if "stokes" not in variable.dims:
            variables[name] = variable
            continue
        data = variable.data.reshape(*variable.shape[:-2], len(names))
        variables[name] = (*variable.dims[:-2], "channel"), data, variable.attrs

    # Replace the coordinates of the two axes
    coords = {
        name: each for name, each in dataset.coords.items() if name not in ("stokes", "channel")
    }
    flat = type(dataset)(variables, coords | {"channel": names}, dataset.attrs)
    flat["channel"].attrs.update(dataset["channel"].attrs)
    return flat


def for_file(dataset: Any, halves: bool = False) -> xr.Dataset:
    """Convert a result of `render`, or a part of it, to the layout and the labels of files.

    The attribute `energy_outside_window` is updated for the part.

    Args:
        dataset: The Dataset.
        halves: Whether to keep the variables that `denoise` needs (`HALVES`).

    Raises:
        ValueError: The Dataset is not a result of `render`, or its bins or pixels have gaps.
    """
    dataset = read(dataset, FILM, "dataset")
    require_whole_stokes(dataset, "dataset")

    # A sum over channels with keepdims=True has an axis without a coordinate
    if "channel" not in dataset.coords:
        dataset = dataset.assign_coords(channel=["L"])

    # Update the energy outside the window
    outside = energy_outside_window(dataset, "dataset")
    if outside is not None:
        dataset = dataset.assign_attrs(energy_outside_window=outside)
    dataset = in_channels(dataset, halves)
    require_storable(dataset)
    return dataset


def in_components(dataset: xr.Dataset) -> xr.Dataset:
    """Reverse `in_channels`. A Dataset with other channel names is returned unchanged."""
    # Do the channels contain Stokes components?
    names = [str(name) for name in dataset["channel"].values]
    colors = [name.partition(".")[2] for name in names[: len(names) // 4]]
    if names != [f"{s}.{c}" for s in STOKES for c in colors] or not colors:
        return dataset

    # Divide the last axis of each variable
    variables = {}
    for name, variable in dataset.data_vars.items():
        if "channel" not in variable.dims:
            variables[name] = variable
            continue
        data = variable.data.reshape(*variable.shape[:-1], 4, len(colors))
        variables[name] = (*variable.dims[:-1], "stokes", "channel"), data, variable.attrs

    # Add the coordinates of the two axes
    coords = {name: each for name, each in dataset.coords.items() if name != "channel"}
    channel = ("channel", colors, dataset["channel"].attrs)
    coords = {"stokes": list(STOKES)} | coords | {"channel": channel}
    return labeled(type(dataset)(variables, coords, dataset.attrs))


def of_intensity(values: np.ndarray) -> np.ndarray:
    """Return the channels of the intensity: all, or the channels of S0 in polarized variants."""
    count = values.shape[-1]
    return values[..., : count // 4] if count in (4, 12) else values


def components_of(dataset: xr.Dataset) -> list[xr.Dataset]:
    """Return a list of a Dataset's Stokes components, or of the Dataset without polarization."""
    if "stokes" not in getattr(dataset, "dims", ()):
        return [dataset]
    return [dataset.sel(stokes=each, drop=True) for each in dataset["stokes"].values]


def require_storable(dataset: xr.Dataset) -> None:
    """Raise a ValueError if files do not support a film that `read` accepts.

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
    """Raise a ValueError if an attribute is neither text nor a number."""
    for name, value in plain_attributes(dataset).items():
        if not isinstance(value, str | int | float):
            raise ValueError(f"attribute {name} = {value!r}: must be text, an int or a float")


def require_finite(dataset: xr.Dataset) -> None:
    """Raise a ValueError if a render or a capture contains NaN or infinite light."""
    for name in DIMS | ERRORS | HALVES:
        if name in dataset:
            Cube(dataset[name]).require_finite(name)


def plain_attributes(labeled: xr.Dataset | xr.Variable) -> dict[str, Any]:
    """Return the attributes of a Dataset or a variable; NumPy scalars become Python numbers."""
    return {
        str(name): value.item() if isinstance(value, np.generic) else value
        for name, value in labeled.attrs.items()
    }
