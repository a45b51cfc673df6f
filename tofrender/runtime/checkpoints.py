"""Checkpoints: files with the state of long work, which can then be resumed."""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from . import checks
from .atomic import check_file, part_path, remove_leftovers, replacing
from .progress import EVERY_S

COST = 0.02  # largest fraction of the time for saving
_HEADER = "tofrender"
"""Name of the array with the description of the work as JSON."""


@dataclass
class SavedState:
    """State of interrupted work."""

    done: int  # finished units, for example samples per pixel or laser points
    of: int  # all units of the work
    seconds: float  # time for the finished units [s]
    arrays: dict[str, np.ndarray]  # sums over the finished units


class Checkpoint:
    """File with the state of long work. Work that was stopped or killed continues from the file.

    To continue, make the same call with the same file. The file is replaced in one step, so that it
    is always complete. The file stays after the end of the work, because the result may exist in
    memory only. Call `remove` when the result is written.

    Args:
        path: A file name that ends in .npz.
        seconds: Smallest time between two saves [s], above 0. It is extended if saving needs more
            than 2 % of the time.
        tell: Function that is called with a line of text when work is resumed.
        again: How to resume, for the message of work that was stopped.
        resume: Whether to resume from an existing file. Otherwise the first save replaces the file.

    Raises:
        ValueError: An argument is wrong.
        PermissionError: `path` is not writable.

    Example:
        >>> import tempfile, tofrender
        >>> checkpoint = Checkpoint(tempfile.mkdtemp() + "/box.npz", seconds=1e-6)
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=60, bin_width_opl=0.2)
        >>> part = tofrender.render(scene, spp=16, checkpoint=checkpoint)
        >>> whole = tofrender.render(scene, spp=64, checkpoint=checkpoint)
        resuming from 16 of 64 samples per pixel
        >>> checkpoint.remove()
    """

    def __init__(
        self,
        path: str | os.PathLike,
        seconds: float = EVERY_S,
        tell: Callable[[str], None] = print,
        again: str = "",
        resume: bool = True,
    ) -> None:
        self.path: Path = check_file(path, ".npz", overwrite=True, name="checkpoint")
        self.seconds = checks.number("seconds", seconds, unit="seconds", positive=True)
        self.tell = checks.function("tell", tell)
        again = checks.instance("again", again, str, "text")
        self.again = again or f"make the same call again to continue from {path}"
        self.resume = checks.boolean("resume", resume)
        self._recipe: dict[str, Any] = {}
        self._began = self._saved = time.monotonic()
        self._cost = self._before = 0.0
        self._warned = False

    def of_part(self, number: int) -> Checkpoint:
        """Return the checkpoint of part `number`, in a file of its own."""
        path = part_path(self.path, number)
        return Checkpoint(path, self.seconds, self.tell, self.again, self.resume)

    @classmethod
    def of(cls, given: Checkpoint | str | os.PathLike | None) -> Checkpoint | None:
        """Make a checkpoint from a file name; return None and checkpoints unchanged."""
        return given if given is None or isinstance(given, Checkpoint) else cls(given)

    def begin(
        self, recipe: Mapping[str, Any], of: int, unit: str, before: int = 0
    ) -> SavedState | None:
        """Begin work, and return its state from the file.

        If the file is damaged, the work begins anew with a warning.

        Args:
            recipe: Everything that the result depends on, as values of JSON.
            of: Number of units of the work.
            unit: Name of a unit, for messages.
            before: Number of units of earlier work, for messages.

        Returns:
            The state of interrupted work; None without one.

        Raises:
            ValueError: The file belongs to another recipe, or contains more units.
        """
        self._recipe = json.loads(json.dumps(recipe))
        self._began = self._saved = time.monotonic()
        self._before = 0.0
        if not self.resume or not self.path.exists():
            return None
        try:
            header, state = self._load()
        except Exception:
            # A damaged file can make the readers raise many kinds of errors
            warnings.warn(f"{self.path}: is damaged, starting anew", stacklevel=5)
            return None
        for name in header["recipe"] | self._recipe:
            found = header["recipe"].get(name)
            value = self._recipe.get(name)
            if found != value:
                raise ValueError(
                    f"checkpoint = {self.path}: was made with {name} = {found!r} instead of "
                    f"{value!r}. Use the same value, or remove the file"
                )
        if state.done > of:
            raise ValueError(
                f"checkpoint = {self.path}: contains {state.done} {unit}; must be at most {of}"
            )
        self._before = state.seconds
        self.tell(f"resuming from {before + state.done} of {before + of} {unit}")
        return state

    def recipe(self) -> dict[str, Any]:
        """Return the recipe of the work in the file; an empty one if the file cannot be read."""
        try:
            _require_stored(self.path)
            with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as archive:
                return dict(json.loads(str(archive[_HEADER]))["recipe"])
        except Exception:
            return {}  # The method `begin` warns about damaged files

    @property
    def due(self) -> bool:
        """Return whether it is time to save."""
        return time.monotonic() - self._saved >= max(self.seconds, self._cost / COST)

    def save(self, done: int, of: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the state into the file. If the disk is full, warn and keep the earlier file."""
        start = time.monotonic()
        seconds = self._before + start - self._began
        header = {
            "recipe": self._recipe,
            "done": done,
            "of": of,
            "seconds": seconds,
            "arrays": _dtypes_and_shapes(arrays),
        }
        size = sum(array.nbytes for array in arrays.values())
        try:
            with replacing(self.path, needed_bytes=size) as temporary, open(temporary, "wb") as out:
                content: dict[str, Any] = {_HEADER: np.array(json.dumps(header)), **arrays}
                np.savez(out, **content)
            self._warned = False
        except OSError as error:
            if not self._warned:  # Warn once until saving works again
                warnings.warn(f"no checkpoint was saved: {error}", stacklevel=4)
            self._warned = True
        self._saved = time.monotonic()
        self._cost = self._saved - start

    def remove(self) -> None:
        """Remove the file and temporary files of killed runs. Call it when results are written."""
        self.path.unlink(missing_ok=True)
        remove_leftovers(self.path)

    def _load(self) -> tuple[dict[str, Any], SavedState]:
        """Read the header and the state, and compare all checksums."""
        _require_stored(self.path)
        with ZipFile(self.path) as archive:
            if archive.testzip():  # NumPy does not compare the checksum of what it does not read
                raise BadZipFile
        with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            header = json.loads(str(archive[_HEADER]))
            arrays = {name: archive[name] for name in archive.files if name != _HEADER}
        if header["arrays"] != _dtypes_and_shapes(arrays):
            raise KeyError
        done = checks.integer("done", header["done"], 0, 1 << 62)
        of = checks.integer("of", header["of"], 0, 1 << 62)
        if not isinstance(header["recipe"], dict):
            raise TypeError
        seconds = checks.number("seconds", header["seconds"], unit="seconds")
        return header, SavedState(done, of, seconds, arrays)


def _require_stored(path: Path) -> None:
    """Raise a BadZipFile error if an archive is compressed, as it may not fit in memory then."""
    with ZipFile(path) as archive:
        if sum(info.file_size for info in archive.infolist()) > path.stat().st_size:
            raise BadZipFile


def _dtypes_and_shapes(arrays: Mapping[str, np.ndarray]) -> dict[str, list[Any]]:
    return {name: [array.dtype.str, *array.shape] for name, array in arrays.items()}


@dataclass
class SubCheckpoint:
    """Checkpoint of one part of work that has many parts."""

    checkpoint: Checkpoint  # checkpoint of the whole work
    before: int  # units of the earlier parts
    of: int  # units of all parts
    more: Mapping[str, np.ndarray]  # results of the earlier parts

    @property
    def due(self) -> bool:
        """Return whether it is time to save."""
        return self.checkpoint.due

    def save(self, done: int, of: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the state of this part and of the earlier parts into the file."""
        self.checkpoint.save(self.before + done, self.of, {**arrays, **self.more})
