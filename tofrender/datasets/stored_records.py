"""Data sets on disk: Zarr 3 groups that grow by records, see `GroupStore`.

Each record is one file in each array. At the end, the small arrays are written from the receipts,
which describe how the records were made.
"""

import json
from collections.abc import Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from ..rendering.films_on_disk import require_zarr
from ..rendering.group_store import BLOCK_BYTES, GroupStore, put_labels
from .layout import KINDS, Array, ArrayKind, DatasetPlan
from .record import RecordReceipt
from .varied import Varied

TIME_AXES = ("opl", "capture_opl", "sensor_bin")
"""Axes that are cut into blocks, so that single time bins can be read."""


class StoredRecords(GroupStore[int, RecordReceipt]):
    """Unfinished data set on disk. `StoredRecords.begin` creates or continues it."""

    group_name = "set.zarr"
    what = "data set"
    receipt_class = RecordReceipt

    @classmethod
    def begin(cls, folder: Path, recipe: Mapping[str, Any], plan: DatasetPlan) -> "StoredRecords":
        """Continue with an unfinished data set, or begin one."""
        return cls.continued(folder, recipe, partial(_create_arrays, plan=plan))

    @cached_property
    def records(self) -> list[int]:
        """Numbers of the records."""
        return self.recipe["only"]

    @cached_property
    def _positions(self) -> dict[int, int]:
        """Position of each record in the arrays."""
        return {record: position for position, record in enumerate(self.records)}

    def _open_arrays(self) -> dict[str, Any]:
        """Return the arrays that have a file for each record, by name."""
        with require_zarr().config.set({"array.write_empty_chunks": True}):
            return dict(self.group.arrays())

    def name_of(self, part: int) -> str:
        """Return the name of a record."""
        return f"record {part}"

    def _indices(self, part: int) -> int:
        """Return the position of a record."""
        return self._positions[part]

    def _file_names(self, part: int) -> list[str]:
        """Return the names of the files of a record."""
        position = str(self._positions[part])
        return [
            "/".join([name, "c", position, *["0"] * (array.ndim - 1)])
            for name, array in self.arrays.items()
        ]

    def finish(
        self,
        plan: DatasetPlan,
        receipts: Mapping[int, RecordReceipt],
        attrs: Mapping[str, Any],
        target: Path,
    ) -> None:
        """Write the small arrays and the attributes, and move the set to `target`."""
        group = self.group
        layout = plan.layout
        ordered = [receipts[record] for record in self.records]

        # Write the coordinates
        put_labels(group, "record", np.array(self.records), ["record"])
        for axis, values in layout.axes.items():
            put_labels(group, axis, values, [axis])
            if axis in TIME_AXES:
                group[axis].attrs.update({"units": "m", "long_name": "optical path length"})
            elif axis == "frequency":
                group[axis].attrs.update({"units": "Hz"})

        # Write the drawn values
        for name, each in plan.config.varied.items():
            values, axes = column(each, [receipt.drawn[name] for receipt in ordered])
            put_labels(group, name, values, axes)
            if "xyz" in axes and "xyz" not in group:
                put_labels(group, "xyz", np.array(["x", "y", "z"]), ["xyz"])

        # Write how the records were made
        for name in ("attempt", "render_seed", "energy_outside_window"):
            if all(name in receipt.about for receipt in ordered):
                values = [receipt.about[name] for receipt in ordered]
                put_labels(group, name, np.array(values), ["record"])
        texts = [json.dumps(r.about | {"warnings": r.warnings}) for r in ordered]
        put_labels(group, "made_with", np.array(texts), ["record"])

        # Write the attributes, and move the finished data set
        group.attrs.update(dict(attrs))
        self.move_to(target, [array.name for array in layout.arrays])


def column(varied: Varied, values: list[Any]) -> tuple[np.ndarray, list[str]]:
    """Return the array of a quantity over all records, and the names of its axes.

    Numbers stay numbers, and other values become text. Lists of names become text that is
    separated by blanks.
    """
    # Text, or True and False
    length = varied.distribution.length
    if length is None:
        if all(isinstance(value, bool) for value in values):
            return np.array(values), ["record"]
        return np.array([_as_text(value) for value in values], dtype=str), ["record"]

    # Numbers, or lists of numbers
    axis = "xyz" if varied.is_vector else f"{varied.name}_index"
    return np.array(values, dtype=np.float64), ["record", *([axis] if length else [])]


def _as_text(value: Any) -> str:
    """Convert a drawn value to text."""
    if isinstance(value, str):
        return value
    names = isinstance(value, list) and all(isinstance(each, str) for each in value)
    return " ".join(value) if names else json.dumps(value)


def _create_arrays(group: Any, *, plan: DatasetPlan) -> None:
    """Create the arrays of an empty data set."""
    for array in plan.layout.arrays:
        _create_array(group, array, len(plan.records))


def _create_array(group: Any, array: Array, count: int) -> None:
    """Create an array with one file per record.

    Files consist of blocks of time bins, which can be read separately.
    """
    from zarr.codecs import Crc32cCodec

    # Cut the time axis into blocks. A file is a shard of all blocks
    shape = (1, *array.shape)
    chunks = list(shape)
    shards = None
    for position, axis in enumerate(array.axes, 1):
        if axis in TIME_AXES:
            bins = shape[position]
            fits = max(1, BLOCK_BYTES * bins // array.bytes)
            chunks[position] = min(bins, fits)
            shards = list(shape)
            shards[position] = -(-bins // chunks[position]) * chunks[position]

    # Create the array with its labels
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
    labels = KINDS.get(array.name, ArrayKind(()))._asdict()
    made.attrs.update({name: labels[name] for name in ("units", "long_name") if labels[name]})
