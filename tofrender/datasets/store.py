"""Data sets on disk: a Zarr 3 group that grows by records, each written once and checked.

Each record is a file in each array. While the set is incomplete, receipts beside it say which
records are there, with the CRC-32 of their files and all that made them; at the end the small
arrays are written from these, and the set moves out of the folder that holds both.
"""

import json
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..rendering.films_on_disk import require_whole, require_zarr
from ..rendering.store import BLOCK_BYTES, checksum, put_in_place, put_labels
from ..runtime import atomic
from .layout import KINDS, Array, Kind, Plan
from .record import Receipt
from .varied import Varied

GROUP, RECEIPTS, PLAN = "set.zarr", "receipts", "plan.json"
TIME_AXES = ("opl", "capture_opl", "sensor_bin")


class Store:
    """A data set on disk that is being made, with its receipts; `Store.begin` begins one."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.group_path = folder, folder / GROUP
        self.records: list[int] = self.planned(folder)["only"]
        self._indices = {record: index for index, record in enumerate(self.records)}
        zarr = require_zarr()
        self._group = zarr.open_group(self.group_path, mode="r+", zarr_format=3)
        with zarr.config.set({"array.write_empty_chunks": True}):  # A file for each record
            self._arrays = dict(self._group.arrays())

    @classmethod
    def begin(cls, folder: Path, recipe: Mapping[str, Any], plan: Plan) -> "Store":
        """Go on with a data set, or begin one."""
        recipe = json.loads(json.dumps(recipe))
        found = cls.planned(folder)
        if found:
            _require_same(folder, found, recipe)
            require_whole(folder / GROUP, listed=False)
            for left in folder.rglob("*.partial"):  # Of zarr, when it was killed
                atomic.remove(left)
        else:
            _create(folder, plan)
            with atomic.replacing(folder / RECEIPTS / PLAN) as file:
                file.write_text(json.dumps(recipe))
        return cls(folder)

    @staticmethod
    def planned(folder: Path) -> dict[str, Any]:
        """Recipe of a data set that was begun; empty if there is none."""
        if not (folder / GROUP / "zarr.json").exists():  # It has just moved to its place
            return {}
        try:
            return dict(json.loads((folder / RECEIPTS / PLAN).read_text()))
        except (OSError, ValueError, TypeError):
            return {}

    def put(self, record: int, arrays: Mapping[str, np.ndarray], receipt: Receipt) -> Receipt:
        """Write a record; what was written before stays where the disk is full."""
        index, files = self._indices[record], {}
        try:
            for name, array in arrays.items():
                self._arrays[name][index] = array
                file = "/".join([name, "c", str(index), *["0"] * array.ndim])
                atomic.sync(self.group_path / file)
                files[file] = checksum(self.group_path / file)
        except OSError as error:
            if error.errno not in atomic.DISK_FULL:
                raise
            size = sum(array.nbytes for array in arrays.values())
            raise atomic.disk_full(self.folder, size) from None
        receipt = replace(receipt, files=files)
        with atomic.replacing(self._receipt(record)) as file:
            file.write_text(json.dumps(asdict(receipt)))
        return receipt

    def receipt(self, record: int) -> Receipt | None:
        """The receipt of a record that is on disk; a damaged one is warned of and left out."""
        path = self._receipt(record)
        if not path.exists():
            return None
        with suppress(OSError, ValueError, TypeError, AttributeError):
            receipt = self.last_receipt(record)
            files = receipt.files
            if files and all(checksum(self.group_path / name) == files[name] for name in files):
                return receipt
        warnings.warn(
            f"record {record} of {self.folder}: is damaged, making it again", stacklevel=2
        )
        return None

    def last_receipt(self, record: int) -> Receipt:
        """The receipt of a record that is on disk, its files unread."""
        return Receipt(**json.loads(self._receipt(record).read_text()))

    def _receipt(self, record: int) -> Path:
        return self.folder / RECEIPTS / f"record {record}.json"

    def finish(
        self, plan: Plan, receipts: Mapping[int, Receipt], attrs: Mapping[str, Any], target: Path
    ) -> None:
        """Write the small arrays and the attributes, and move the set to `target`."""
        group, layout = self._group, plan.layout
        ordered = [receipts[record] for record in self.records]
        put_labels(group, "record", np.array(self.records), ["record"])
        for axis, values in layout.axes.items():
            put_labels(group, axis, values, [axis])
            if axis in TIME_AXES:
                group[axis].attrs.update({"units": "m", "long_name": "optical path length"})
            elif axis == "frequency":
                group[axis].attrs.update({"units": "Hz"})
        for name, each in plan.config.varied.items():
            values, axes = column(each, [receipt.drawn[name] for receipt in ordered])
            put_labels(group, name, values, axes)
            if "xyz" in axes and "xyz" not in group:
                put_labels(group, "xyz", np.array(["x", "y", "z"]), ["xyz"])
        for name in ("attempt", "render_seed", "energy_outside_window"):
            if all(name in receipt.about for receipt in ordered):
                values = [receipt.about[name] for receipt in ordered]
                put_labels(group, name, np.array(values), ["record"])
        texts = [json.dumps(r.about | {"warnings": r.warnings}) for r in ordered]
        put_labels(group, "made_with", np.array(texts), ["record"])
        group.attrs.update(dict(attrs))
        put_in_place(self.group_path, target, [array.name for array in layout.arrays])
        atomic.remove(self.folder)


def column(varied: Varied, values: list[Any]) -> tuple[np.ndarray, list[str]]:
    """Values of a quantity in all records, and its axes: numbers, else text.

    Lists of names become text with blanks between.
    """
    length = varied.distribution.length
    if length is None:
        if all(isinstance(value, bool) for value in values):
            return np.array(values), ["record"]
        return np.array([_as_text(value) for value in values], dtype=str), ["record"]
    axis = "xyz" if varied.is_vector else f"{varied.name}_index"
    return np.array(values, dtype=np.float64), ["record", *([axis] if length else [])]


def _as_text(value: Any) -> str:
    if isinstance(value, str):
        return value
    names = isinstance(value, list) and all(isinstance(each, str) for each in value)
    return " ".join(value) if names else json.dumps(value)


def _require_same(folder: Path, found: Mapping[str, Any], plan: Mapping[str, Any]) -> None:
    """Refuse to go on with another data set."""
    old, new = _flat(found), _flat(plan)
    for key in {**new, **old}:
        if old.get(key) != new.get(key):
            now = f"{key} = {_short(new[key])}" if key in new else f"without {key}"
            before = f"with {key} = {_short(old[key])}" if key in old else f"without {key}"
            raise ValueError(
                f"{now}: the unfinished data set was begun {before}; must be the same, "
                f"or {folder} be removed"
            )


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _flat(tree: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Values by their dotted keys."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        name = key if where in ("", "config") else f"{where}.{key}"
        found |= _flat(value, name) if isinstance(value, Mapping) and value else {name: value}
    return found


def _create(folder: Path, plan: Plan) -> None:
    """Make an empty data set."""
    atomic.remove(folder)
    zarr = require_zarr()
    group = zarr.open_group(folder / GROUP, mode="w", zarr_format=3)
    for array in plan.layout.arrays:
        _create_array(group, array, len(plan.records))
    (folder / RECEIPTS).mkdir()


def _create_array(group: Any, array: Array, count: int) -> None:
    """An array whose records are a file each, of blocks of time bins that can be read alone."""
    from zarr.codecs import Crc32cCodec

    shape = (1, *array.shape)
    chunks, shards = list(shape), None
    for position, axis in enumerate(array.axes, 1):
        if axis in TIME_AXES:
            bins = shape[position]
            fits = max(1, BLOCK_BYTES * bins // array.bytes)
            chunks[position] = min(bins, fits)
            shards = list(shape)
            shards[position] = -(-bins // chunks[position]) * chunks[position]
    made = group.create_array(
        array.name,
        shape=(count, *array.shape),
        dtype=array.dtype,
        chunks=tuple(chunks),
        shards=None if shards is None else tuple(shards),
        compressors=[Crc32cCodec()],
        fill_value=False if array.dtype == "bool" else float("nan"),
        dimension_names=("record", *array.axes),
    )
    labels = KINDS.get(array.name, Kind(()))._asdict()
    made.attrs.update({name: labels[name] for name in ("units", "long_name") if labels[name]})
