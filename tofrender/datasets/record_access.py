"""Open data sets without reading their arrays, and read the render or the capture of a record."""

import json
import os
import warnings
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import CAPTURES, RECORDS, TRANSIENT, Kind, bins_of, read, with_energy
from ..nlos import make_capture
from ..nlos.captures import ON_WALL, dimensions
from ..rendering.dataset import LOST_ENERGY
from ..rendering.films_on_disk import naming_files, require_whole, require_zarr
from ..rendering.labels import labeled, labels_of
from ..runtime import checks
from .layout import RADIANCE

KIND = "tofrender data set"
BINS = "temporal_bins"
"""Attribute of a loaded data set: number of time bins of its renders."""


def load_dataset(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open a data set of `make_dataset`, without reading its arrays.

    See also `make_dataset`.

    Args:
        path: Folder of the data set.

    Returns:
        A Dataset with dask arrays, which are read from disk when they are used. The attribute
        `parameters` lists the varied quantities, and each quantity is a variable. The variable
        `made_with` describes as JSON how each record was made. Functions that accept time-resolved
        light accept one record, `dataset.isel(record=0)`. `render_of` returns a record with all
        attributes of its render.

    Raises:
        FileNotFoundError: `path` does not exist.
        ValueError: The folder is not a data set of this package, or files are missing, truncated
            or damaged.
        ImportError: The packages zarr and dask are missing.
    """
    # Is the folder a complete data set?
    folder = checks.path("path", path)
    if not folder.exists():
        raise FileNotFoundError(f"path = {path}: does not exist; must be a data set on disk")
    require_zarr()
    wrong = f"path = {path}: must be a finished data set that `make_dataset` wrote"
    if not (folder / "zarr.json").is_file():
        raise ValueError(wrong)
    require_whole(folder)

    # Open the arrays
    try:
        dataset = xr.open_zarr(folder, chunks={}, consolidated=True, zarr_format=3)
        dataset = naming_files(dataset, folder, "data set")
    except (OSError, RuntimeError, ValueError, KeyError, TypeError):
        raise ValueError(wrong) from None
    if dataset.attrs.get("kind") != KIND:
        raise ValueError(wrong)

    # Convert coordinates of text, and add attributes of time-resolved light
    texts = {n: list(map(str, c.values)) for n, c in dataset.coords.items() if c.dtype.kind in "OT"}
    dataset = dataset.assign_coords(texts)
    if "transient" in dataset:
        light = {"quantity": "radiance per bin", "units": RADIANCE}
        dataset = dataset.assign_attrs(light | {BINS: dataset.sizes["opl"]})

    # Add labels. The units of draws are unknown here
    dataset = labeled(dataset)
    for name, variable in dataset.variables.items():
        default = {"long_name": str(name).replace("_", " ")}
        for key, text in (default | labels_of(str(name).removeprefix("capture_"), {})).items():
            variable.attrs.setdefault(key, text)
    dataset.encoding["source"] = str(folder)
    return dataset


def capture_of(dataset: Annotated[xr.Dataset, CAPTURES], record: int) -> xr.Dataset:
    """Return the capture of a record, for `reconstruct`.

    Args:
        dataset: Data set from `load_dataset`, or a part of the data set. Parts of the window and of
            the wall are supported.
        record: Number of the record, a value of the coordinate `record`.

    Raises:
        ValueError: The data set lacks captures, or `record` is not one of its records.
    """
    # Find the record and the axes of its capture
    one, about = _record(dataset, record)
    if "capture" not in dataset:
        raise ValueError("dataset: has no captures; must be made with outputs.capture")
    stated = about["capture"]
    axes = dimensions(stated["capture_mode"])
    if stated["capture_mode"] == "confocal":  # The laser follows the sensor
        del axes["laser_grid"], axes["laser_normals"]

    # Rename the variables to the names in a capture, without the prefix
    names = {f"capture_{name}": name for name in (*axes, ON_WALL)} | {"capture": "transient"}
    names |= {"wall_y": "y", "wall_x": "x", "capture_opl": "opl"}
    capture = one[[name for name in names if name in one.data_vars]].drop_vars(
        "time", errors="ignore"
    )
    known = {own: name for own, name in names.items() if own in {*capture.variables, *capture.dims}}
    capture = capture.rename(known).assign_attrs(stated)

    # Read the arrays by their labels
    kind = Kind(CAPTURES.name, axes, optional={ON_WALL: ("y", "x")}, bins="opl")
    found = read(capture, kind, "dataset")
    bins = bins_of(found, "dataset")
    arrays: dict[str, Any] = {str(n): each.values for n, each in found.data_vars.items()}

    # The mask is omitted if all points are on the wall
    on_wall = arrays.pop(ON_WALL, np.ones(1, bool))
    return make_capture(
        **arrays,
        mode=stated["capture_mode"],
        start_opl=bins.start_opl,
        bin_width_opl=bins.bin_width_opl,
        counts_first_and_last_legs=bool(stated["counts_first_and_last_legs"]),
        on_wall=None if on_wall.all() else on_wall,
        attrs={"scene": str(about["scene"]), "spp": stated["spp"], "seed": about["render_seed"]},
    )


def render_of(dataset: Annotated[xr.Dataset, RECORDS], record: int) -> xr.Dataset:
    """Return the render of a record, as `render` returns it.

    Args:
        dataset: Data set from `load_dataset`.
        record: Number of the record, a value of the coordinate `record`.

    Returns:
        A Dataset with `transient (y, x, opl, channel)` and `steady (y, x, channel)` [W m^-2 sr^-1],
        and the attributes of the render. Without steady pictures in the data set, `steady` is
        the sum of the bins, without the light outside the window.

    Raises:
        ValueError: `dataset` lacks transients, or `record` is not one of its records.

    Warns:
        UserWarning: `steady` is the sum of the bins, and over 1 % of the light is outside them.

    Example:
        >>> import tempfile, tofrender
        >>> given = {"records": 2, "scene": "cornell_box", "outputs": {"transient": True}}
        >>> given["render"] = {"width": 8, "height": 6, "spp": 4}
        >>> given["render"] |= {"temporal_bins": 60, "window": (3, 15)}
        >>> out = tempfile.mkdtemp() + "/boxes.zarr"
        >>> made = tofrender.make_dataset(given, out, tell=str)
        >>> I, Q, *_ = tofrender.transient_to_phasor(render_of(made, 1), 20e6)
        >>> I.shape
        (6, 8, 3)
    """
    # Read the record by its labels
    one, about = _record(dataset, record)
    if "transient" not in dataset:
        raise ValueError("dataset has no transients; make it with outputs.transient = true")
    names = [name for name in ("transient", "steady") if name in one]
    film = read(
        one[names].drop_attrs(deep=False).assign_attrs(about["render"]), TRANSIENT, "dataset"
    )
    transient = film["transient"]

    # Sum the bins if the steady picture is missing
    if "steady" in film:
        steady = film["steady"]
    else:
        bins = dataset.attrs.get(BINS, transient.sizes["opl"])
        if transient.sizes["opl"] != bins:
            raise ValueError(
                f"dataset: has {transient.sizes['opl']} of {bins} bins, and no steady pictures. "
                "Select bins after render_of"
            )
        steady = transient.sum("opl", dtype=np.float64).astype(np.float32)
        outside = film.attrs["energy_outside_window"]
        if outside > LOST_ENERGY:
            warnings.warn(
                f"steady is the sum of the bins, and {outside:.1%} of the energy is outside them; "
                "outputs.steady = true keeps the picture of all time",
                stacklevel=2,
            )

    # Use arrays without attributes, so that `labeled` adds the labels of a render
    pictures = {"transient": transient, "steady": steady}
    arrays = {each: (values.dims, values.values) for each, values in pictures.items()}
    axes = {axis: film[axis].values for axis in transient.dims}
    found = labeled(xr.Dataset(arrays, axes, film.attrs))
    return with_energy(found, "dataset") if "steady" in film else found


def _record(dataset: Any, record: int) -> tuple[xr.Dataset, dict[str, Any]]:
    """Return the part of a data set that is one record, and how the record was made."""
    checks.instance("dataset", dataset, xr.Dataset, "what load_dataset returns")
    for name in ("record", "made_with"):
        if name not in dataset.variables:
            raise ValueError(
                f"dataset: {name} is missing. Pass what load_dataset returns; select records "
                "without drop"
            )
    numbers = np.atleast_1d(dataset["record"].values)
    if np.ndim(record) or np.count_nonzero(numbers == record) != 1:
        raise ValueError(f"record = {record!r}: must be one of the coordinate record")
    one = dataset.sel(record=record) if "record" in dataset.dims else dataset
    if one["made_with"].ndim:
        raise ValueError(
            f"dataset: made_with has the additional axis {one['made_with'].dims[0]}. Choose along "
            "the axis"
        )
    return one, json.loads(str(one["made_with"].values))
