"""Read data sets: lazily, and a record's capture as `reconstruct` takes it."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..nlos import make_capture
from ..rendering.films_on_disk import FILES, naming_files, require_whole, require_zarr
from ..rendering.labels import labelled, labels_of
from ..runtime import checks
from .layout import GEOMETRY, ORIGINS

KIND = "tofrender data set"


def load_dataset(path: str | os.PathLike[str]) -> xr.Dataset:
    """Open a data set that `make_dataset` has made, without reading it.

    See also `make_dataset`.

    Args:
        path: The folder.

    Returns:
        A Dataset whose large variables are read from disk when they are used (dask arrays). The
        attribute `parameters` names the varied quantities, each a variable; `made_with` says of
        each record, as JSON, all that made it.

    Raises:
        FileNotFoundError: There is nothing at `path`.
        ValueError: It is no data set of this package, or files of it are missing, cut or damaged;
            one line.
        ImportError: The packages zarr and dask are missing; one line.
    """
    folder = checks.path("path", path)
    if not folder.exists():
        raise FileNotFoundError(f"path = {path}: does not exist; must be a data set on disk")
    require_zarr()
    wrong = f"path = {path}: must be a finished data set that `make_dataset` wrote"
    if not (folder / "zarr.json").is_file():
        raise ValueError(wrong)
    require_whole(folder, listed=(folder / FILES).is_file())
    try:
        dataset = xr.open_zarr(folder, chunks={}, consolidated=True, zarr_format=3)
        dataset = naming_files(dataset, folder, "data set")
    except (OSError, RuntimeError, ValueError, KeyError, TypeError):
        raise ValueError(wrong) from None
    if dataset.attrs.get("kind") != KIND:
        raise ValueError(wrong)
    if not (folder / FILES).is_file():
        _require_records(folder, dataset)
    texts = {n: list(map(str, c.values)) for n, c in dataset.coords.items() if c.dtype.kind in "OT"}
    dataset = labelled(dataset.assign_coords(texts))
    for name, variable in dataset.variables.items():  # Only the config knows units of draws
        default = {"long_name": str(name).replace("_", " ")}
        for key, text in (default | labels_of(str(name).removeprefix("capture_"), {})).items():
            variable.attrs.setdefault(key, text)
    dataset.encoding["source"] = str(folder)
    return dataset


def _require_records(folder: Path, dataset: xr.Dataset) -> None:
    """Refuse a data set of an earlier version, without a list of files, that lacks a record's."""
    for name, variable in dataset.data_vars.items():
        chunks = variable.chunks
        if chunks and chunks[0][0] == 1 and (variable.ndim > 2 or len(chunks[0]) > 1):
            for record in range(variable.shape[0]):
                file = "/".join([str(name), "c", str(record), *["0"] * (variable.ndim - 1)])
                if not (folder / file).is_file():
                    raise ValueError(
                        f"path = {folder}: {file} is missing; must be as it was written, copy the "
                        "data set again"
                    )


def capture_of(dataset: xr.Dataset, record: int) -> xr.Dataset:
    """The capture of a record, which `reconstruct` takes.

    Args:
        dataset: What `load_dataset` returns.
        record: Its number, a value of the coordinate `record`.

    Raises:
        ValueError: The data set has no captures, or no such record; one line.
    """
    checks.instance("dataset", dataset, xr.Dataset, "what load_dataset returns")
    if "capture" not in dataset:
        raise ValueError("dataset: has no captures; must be made with outputs.capture")
    if np.ndim(record) or record not in dataset["record"].values:
        raise ValueError(f"record = {record!r}: must be one of the coordinate record")
    one = dataset.sel(record=record)
    about = json.loads(str(one["made_with"].values))
    capture = about["capture"]
    names = [name for name in (*GEOMETRY, *ORIGINS) if f"capture_{name}" in one]
    geometry: dict[str, Any] = {name: one[f"capture_{name}"].values for name in names}
    on_wall = one["capture_on_wall"].values
    return make_capture(
        one["capture"].values,
        mode=capture["mode"],
        start_opl=capture["start_opl"],
        bin_width_opl=capture["bin_width_opl"],
        counts_first_and_last_legs=bool(capture["counts_first_and_last_legs"]),
        on_wall=None if on_wall.all() else on_wall,
        attrs={"scene": str(about["scene"]), "spp": capture["spp"], "seed": about["render_seed"]},
        **geometry,
    )
