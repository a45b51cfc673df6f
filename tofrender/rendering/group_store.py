"""Zarr groups that grow part by part; each part is written once and checked.

While a group is incomplete, receipts next to it state which parts are finished, with the CRC-32C of
their files. The recipe next to the receipts states what the group is made of. At the end the
metadata are consolidated, all files are listed, and the group moves out of the folder that contains
group and receipts.
"""

from __future__ import annotations

import json
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from ..runtime import atomic
from .films_on_disk import checksum, list_files, require_whole, require_zarr

# Folder of the receipts
RECEIPTS = "receipts"

# File of the recipe
RECIPE = "plan.json"

# Largest size of a block, which is read and checked as a whole [bytes]
BLOCK_BYTES = 4 << 20


@dataclass(kw_only=True)
class PartReceipt:
    """Receipt of a part on disk."""

    # CRC-32C of each file, by its name
    files: dict[str, int] = field(default_factory=dict)


Part = TypeVar("Part")
Receipt = TypeVar("Receipt", bound=PartReceipt)


class GroupStore(ABC, Generic[Part, Receipt]):
    """A group that is being made, with the receipts of its finished parts.

    Args:
        folder: Folder of the group and its receipts.
    """

    # Name of the group in the folder
    group_name: ClassVar[str]

    # Noun for the group, for messages
    what: ClassVar[str]

    # Class of the receipts
    receipt_class: ClassVar[type[PartReceipt]]

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.group_path = folder / self.group_name
        self.recipe = self.planned(folder)
        self.group = require_zarr().open_group(self.group_path, mode="r+", zarr_format=3)
        self.arrays = self._open_arrays()

    @classmethod
    def continued(
        cls, folder: Path, recipe: Mapping[str, object], create: Callable[[Any], None]
    ) -> Self:
        """Continue with an unfinished group, or make an empty one.

        A receipt is a file that marks a part as finished and contains the part's checksums.

        Args:
            folder: Folder of the group and its receipts.
            recipe: Values that determine the group. An unfinished group must have the same recipe.
            create: Function that creates the arrays of an empty group.
        """
        # Convert the recipe to JSON's types, for the comparison with a saved recipe
        recipe = json.loads(json.dumps(dict(recipe)))
        found = cls.planned(folder)
        if found:
            _require_same(cls.what, folder, found, recipe)
            require_whole(folder / cls.group_name, listed=False)

            # Remove what Zarr was writing when its process was killed
            for left in folder.rglob("*.partial"):
                atomic.remove(left)
            return cls(folder)

        # Create an empty group. The recipe is written last: without it, the next call starts again
        atomic.remove(folder)
        group = require_zarr().open_group(folder / cls.group_name, mode="w", zarr_format=3)
        create(group)
        (folder / RECEIPTS).mkdir()
        with atomic.replacing(folder / RECEIPTS / RECIPE) as file:
            file.write_text(json.dumps(recipe))
        return cls(folder)

    @classmethod
    def planned(cls, folder: Path) -> dict[str, Any]:
        """Return the recipe of an unfinished group, or an empty dict if the group is missing."""
        # The process may have been killed after the group moved to its place
        if not (folder / cls.group_name / "zarr.json").exists():
            return {}
        try:
            return dict(json.loads((folder / RECEIPTS / RECIPE).read_text()))
        except (OSError, ValueError, TypeError):
            return {}

    @abstractmethod
    def _open_arrays(self) -> dict[str, Any]:
        """Return the arrays that contain parts, by name."""

    @abstractmethod
    def name_of(self, part: Part) -> str:
        """Return the name of a part, for its receipt and for messages, e.g. "tile 0 8"."""

    @abstractmethod
    def _indices(self, part: Part) -> Any:
        """Return the index of a part in each array."""

    @abstractmethod
    def _file_names(self, part: Part) -> list[str]:
        """Return the names of all files that may contain a part."""

    def _files(self, part: Part) -> list[str]:
        """Return the names of the files that contain a part; files of zeros may be missing."""
        return [name for name in self._file_names(part) if (self.group_path / name).exists()]

    def write_part(self, part: Part, arrays: Mapping[str, np.ndarray], receipt: Receipt) -> Receipt:
        """Write the arrays of a part, and its receipt.

        Returns:
            The receipt with the checksums of the files.

        Raises:
            OSError: The disk is full. Parts that are finished remain.
        """
        # Zarr would read damaged files before it writes
        for name in self._files(part):
            (self.group_path / name).unlink()

        # Write the arrays
        indices = self._indices(part)
        try:
            for name, array in arrays.items():
                self.arrays[name][indices] = array
        except OSError as error:
            if error.errno not in atomic.DISK_FULL:
                raise
            size = sum(array.nbytes for array in arrays.values())
            raise atomic.disk_full(self.folder, size) from None

        # Write the receipt
        files = {}
        for name in self._files(part):
            atomic.sync(self.group_path / name)
            files[name] = checksum(self.group_path / name)
        receipt = replace(receipt, files=files)
        with atomic.replacing(self.receipt_path(part)) as file:
            file.write_text(json.dumps(asdict(receipt)))
        return receipt

    def receipt(self, part: Part) -> Receipt | None:
        """Return the receipt of a finished part; warn of a damaged part, and return None."""
        if not self.receipt_path(part).exists():
            return None

        # Do the files have the checksums of the receipt?
        with suppress(OSError, ValueError, TypeError, AttributeError):
            receipt = self.unchecked_receipt(part)
            found = {name: checksum(self.group_path / name) for name in self._files(part)}
            if found == receipt.files:
                return receipt
        warnings.warn(
            f"{self.name_of(part)} of {self.folder}: is damaged, making it again", stacklevel=2
        )
        return None

    def unchecked_receipt(self, part: Part) -> Receipt:
        """Return the receipt of a finished part without reading the files of the part."""
        found: Any = self.receipt_class(**json.loads(self.receipt_path(part).read_text()))
        return found

    def receipt_path(self, part: Part) -> Path:
        """Return the path of a part's receipt."""
        return self.folder / RECEIPTS / f"{self.name_of(part)}.json"

    def move_to(self, target: Path, checked: Iterable[str]) -> None:
        """Move the finished group to its place, and remove the receipts.

        Args:
            target: Path of the group.
            checked: Names of the arrays that have checksums in their blocks, see `list_files`.
        """
        # Complete the group
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            require_zarr().consolidate_metadata(self.group_path)
        list_files(self.group_path, checked)

        # Write all data to the disk before the group moves
        atomic.sync(self.group_path)
        os.rename(self.group_path, target)
        atomic.sync(target.parent, deep=False)
        atomic.remove(self.folder)


def put_labels(group: Any, name: str, values: np.ndarray, axes: list[str]) -> None:
    """Write a small array of numbers or text; an array with this name is replaced."""
    text = values.dtype.kind == "U"
    array = group.create_array(
        name,
        shape=values.shape,
        dtype=str if text else values.dtype,
        dimension_names=axes,
        overwrite=True,
    )
    array[:] = values.astype(object) if text else values


def _require_same(
    what: str, folder: Path, found: Mapping[str, Any], recipe: Mapping[str, Any]
) -> None:
    """Raise a ValueError that names the first difference between two recipes.

    Args:
        what: Noun for the group, for messages.
        folder: Folder of the unfinished group.
        found: Recipe of the unfinished group.
        recipe: Recipe of the new call.
    """
    old = _flat(found)
    new = _flat(recipe)
    for key in {**new, **old}:
        if old.get(key) != new.get(key):
            now = f"{key} = {_short(new[key])}" if key in new else f"without {key}"
            before = f"with {key} = {_short(old[key])}" if key in old else f"without {key}"
            raise ValueError(
                f"{now}: the unfinished {what} was begun {before}; must be the same, "
                f"or {folder} be removed"
            )


def _short(value: Any) -> str:
    """Return a value as text of at most 60 characters."""
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _flat(tree: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Return the values of nested mappings by their dotted keys."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        name = key if where in ("", "config") else f"{where}.{key}"
        found |= _flat(value, name) if isinstance(value, Mapping) and value else {name: value}
    return found
