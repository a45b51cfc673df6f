"""Data sets on disk: a Zarr 3 group that grows by records, each written once and checked.

Each record is a file in each array. While the set is incomplete, receipts beside it say which
records are there, with the CRC-32 of their files and all that made them; at the end the small
arrays are written from these, and the set moves out of the folder that holds both.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..rendering.films_on_disk import require_zarr
from ..rendering.store import BLOCK_BYTES, checksum, put_in_place, put_labels
from ..runtime import atomic
from .layout import MEANS, UNITS, Array, Layout
from .record import Made
from .varied import Varied

GROUP, RECEIPTS, PLAN = "set.zarr", "receipts", "plan.json"
TIME_AXES = ("opl", "capture_opl")


@dataclass
class Receipt:
    """What is known of a record on disk.

    Attributes:
        files: CRC-32 of each file, by its name.
        drawn, about, warnings, seconds: As in `Made`.
    """

    files: dict[str, int]
    drawn: dict[str, Any]
    about: dict[str, Any]
    warnings: list[str]
    seconds: float


class Store:
    """A data set on disk that is being made, begun by `Store.begin`.

    Args:
        folder: Where it is, with its receipts.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.group_path = folder, folder / GROUP
        self.records: list[int] = self.planned(folder)["only"]
        self._places = {record: index for index, record in enumerate(self.records)}
        zarr = require_zarr()
        self._group = zarr.open_group(self.group_path, mode="r+", zarr_format=3)
        with zarr.config.set({"array.write_empty_chunks": True}):  # A file for each record
            self._arrays = dict(self._group.arrays())

    @classmethod
    def begin(
        cls, folder: Path, plan: Mapping[str, Any], records: list[int], layout: Layout
    ) -> Store:
        """Go on with a data set, or begin one.

        Args:
            folder: Where it is, made if it is not there.
            plan: All that it depends on, as JSON can hold it.
            records: Numbers of its records.
            layout: Its arrays.

        Raises:
            ValueError: The folder is of another data set; one line that names the key that differs.
            ImportError: The package zarr is missing; one line.
        """
        plan = json.loads(json.dumps({**plan, "only": records}))
        found = cls.planned(folder)
        if found:
            _require_same(folder, found, plan)
            for left in folder.rglob("*.partial"):  # Of zarr, when it was killed
                atomic.remove(left)
        else:
            _create(folder, layout, len(records))
            with atomic.replacing(folder / RECEIPTS / PLAN) as file:
                file.write_text(json.dumps(plan))
        return cls(folder)

    @staticmethod
    def planned(folder: Path) -> dict[str, Any]:
        """What a data set that was begun is of; nothing if there is none."""
        if not (folder / GROUP / "zarr.json").exists():  # It has just moved to its place
            return {}
        try:
            return dict(json.loads((folder / RECEIPTS / PLAN).read_text()))
        except (OSError, ValueError, TypeError):
            return {}

    # ------------------------------------------------------------------------------ records

    def put(self, record: int, made: Made) -> Receipt:
        """Write a record.

        Raises:
            OSError: There is no room; one line. What was written before stays.
        """
        index, files = self._places[record], {}
        try:
            for name, array in made.arrays.items():
                self._arrays[name][index] = array
                file = "/".join([name, "c", str(index), *["0"] * array.ndim])
                atomic.sync(self.group_path / file)
                files[file] = checksum(self.group_path / file)
        except OSError as error:
            if error.errno not in atomic.DISK_FULL:
                raise
            size = sum(array.nbytes for array in made.arrays.values())
            raise atomic.disk_full(self.folder, size) from None
        receipt = Receipt(files, made.drawn, made.about, made.warnings, made.seconds)
        with atomic.replacing(self._receipt(record)) as file:
            file.write_text(json.dumps(asdict(receipt)))
        return receipt

    def receipt(self, record: int) -> Receipt | None:
        """The receipt of a record that is there and undamaged.

        Warns:
            UserWarning: It is damaged.
        """
        path = self._receipt(record)
        if not path.exists():
            return None
        try:
            receipt = self.last_receipt(record)
            whole = bool(receipt.files) and all(
                checksum(self.group_path / name) == crc for name, crc in receipt.files.items()
            )
        except (OSError, ValueError, TypeError, AttributeError):
            whole, receipt = False, None
        if not whole:
            warnings.warn(
                f"record {record} of {self.folder}: is damaged, making it again", stacklevel=2
            )
            return None
        return receipt

    def last_receipt(self, record: int) -> Receipt:
        """The receipt of a record that is there, its files unread."""
        return Receipt(**json.loads(self._receipt(record).read_text()))

    def _receipt(self, record: int) -> Path:
        return self.folder / RECEIPTS / f"record {record}.json"

    # ------------------------------------------------------------------------------ the end

    def finish(
        self,
        receipts: Mapping[int, Receipt],
        varied: Mapping[str, Varied],
        layout: Layout,
        attrs: Mapping[str, Any],
        target: Path,
    ) -> None:
        """Write what is small, and move the set to its place."""
        group = self._group
        its = [receipts[record] for record in self.records]
        put_labels(group, "record", np.array(self.records), ["record"])
        for axis, values in layout.axes.items():
            put_labels(group, axis, values, [axis])
            if axis in TIME_AXES:
                group[axis].attrs.update({"units": "m", "long_name": "optical path length"})
            elif axis == "frequency":
                group[axis].attrs.update({"units": "Hz"})
        for name, each in varied.items():
            values, axes = column(each, [receipt.drawn[name] for receipt in its])
            put_labels(group, name, values, axes)
            if "xyz" in axes and "xyz" not in group:
                put_labels(group, "xyz", np.array(["x", "y", "z"]), ["xyz"])
        told = {"attempt": [receipt.about["attempt"] for receipt in its]}
        told["render_seed"] = [receipt.about["render_seed"] for receipt in its]
        if all("energy_outside_window" in receipt.about for receipt in its):
            told["energy_outside_window"] = [r.about["energy_outside_window"] for r in its]
        for name, values in told.items():
            put_labels(group, name, np.array(values), ["record"])
        texts = [json.dumps(r.about | {"warnings": r.warnings}) for r in its]
        put_labels(group, "made_with", np.array(texts), ["record"])
        group.attrs.update(dict(attrs))
        put_in_place(self.group_path, target, [array.name for array in layout.arrays])
        atomic.remove(self.folder)


def column(varied: Varied, values: list[Any]) -> tuple[np.ndarray, list[str]]:
    """What was drawn of a quantity in all records, and its axes: numbers, else text.

    Lists of names become text with blanks between.
    """
    length = varied.distribution.length()
    if length is None:
        if all(isinstance(value, bool) for value in values):
            return np.array(values), ["record"]
        texts = [v if isinstance(v, str) else _as_text(v) for v in values]
        return np.array(texts, dtype=str), ["record"]
    axis = "xyz" if varied.is_place else f"{varied.name}_index"
    return np.array(values, dtype=np.float64), ["record", *([axis] if length else [])]


def _as_text(value: Any) -> str:
    names = isinstance(value, list) and all(isinstance(each, str) for each in value)
    return " ".join(value) if names else json.dumps(value)


def _require_same(folder: Path, found: Mapping[str, Any], plan: Mapping[str, Any]) -> None:
    """Refuse to go on with another data set."""
    old, new = _flat(found), _flat(plan)
    for key in {**new, **old}:
        if old.get(key) != new.get(key):
            was, is_now = (
                f"{key} = {_short(each[key])}" if key in each else f"without {key}"
                for each in (old, new)
            )
            raise ValueError(
                f"{is_now}: the unfinished data set was begun {_with(was)}; must be the same, "
                f"or {folder} be removed"
            )


def _with(what: str) -> str:
    return what if what.startswith("without") else f"with {what}"


def _short(value: Any) -> str:
    said = json.dumps(value)
    return said if len(said) <= 60 else f"{said[:57]}..."


def _flat(tree: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Values by their dotted keys."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        name = key if where in ("", "config") else f"{where}.{key}"
        found |= _flat(value, name) if isinstance(value, Mapping) and value else {name: value}
    return found


def _create(folder: Path, layout: Layout, count: int) -> None:
    """Make an empty data set."""
    atomic.remove(folder)
    zarr = require_zarr()
    group = zarr.open_group(folder / GROUP, mode="w", zarr_format=3)
    for array in layout.arrays:
        _create_array(group, array, count)
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
    told = {"units": UNITS.get(array.name), "long_name": MEANS.get(array.name)}
    made.attrs.update({name: text for name, text in told.items() if text})
