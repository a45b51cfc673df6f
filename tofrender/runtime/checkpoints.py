"""Checkpoints: the state of long work in a file, to resume it after it was stopped or killed."""

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

COST = 0.02  # Part of the time that saving may take
_HEADER = "tofrender"  # Name of the array with the description, as JSON


@dataclass
class SavedState:
    """State of interrupted work."""

    done: int  # Units that were done: samples per pixel, laser points
    of: int  # Units that were to be done
    seconds: float  # Time that they took [s]
    arrays: dict[str, np.ndarray]  # Sums so far


class Checkpoint:
    """File from which long work is resumed after it was stopped or killed.

    The same call with the same file resumes where the file ends. The file is replaced in one step,
    so that it is always complete. It outlives the end of the work, whose result may be in memory
    only: `remove` it when results are written.

    Args:
        path: A file name that ends in .npz.
        seconds: Least time between two saves [s], above 0; more if a save takes over 2 % of it.
        tell: Function that is called with a line that says what is resumed.
        again: How to resume, for the message of work that was stopped.
        resume: Whether to resume from an existing file; else the first save replaces it.

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
        self.again = again or f"the same call goes on with {path}"
        self.resume = checks.boolean("resume", resume)
        self._recipe: dict[str, Any] = {}
        self._began = self._saved = time.monotonic()
        self._cost = self._before = 0.0
        self._warned = False

    def of_part(self, number: int) -> Checkpoint:
        """Return the checkpoint of one of several renders, whose file has its number."""
        path = part_path(self.path, number)
        return Checkpoint(path, self.seconds, self.tell, self.again, self.resume)

    @classmethod
    def of(cls, given: Checkpoint | str | os.PathLike | None) -> Checkpoint | None:
        """Make a checkpoint of a file name; None and checkpoints stay as they are."""
        return given if given is None or isinstance(given, Checkpoint) else cls(given)

    def begin(
        self, recipe: Mapping[str, Any], of: int, unit: str, before: int = 0
    ) -> SavedState | None:
        """Start work of `of` units after `before` others, and return its state in the file, if any.

        The recipe has all that results depend on, as JSON can hold it: a file of another recipe, or
        of more units, is a ValueError. With a damaged file the work starts anew, with a warning.
        """
        self._recipe = json.loads(json.dumps(recipe))
        self._began = self._saved = time.monotonic()
        self._before = 0.0
        if not self.resume or not self.path.exists():
            return None
        try:
            header, state = self._load()
        except Exception:  # Whatever a damaged file makes readers raise
            warnings.warn(f"{self.path}: is damaged, starting anew", stacklevel=5)
            return None
        for name in header["recipe"] | self._recipe:
            found, value = header["recipe"].get(name), self._recipe.get(name)
            if found != value:
                raise ValueError(
                    f"checkpoint = {self.path}: was made with {name} = {found!r}; must be "
                    f"{value!r}, or the file removed"
                )
        if state.done > of:
            raise ValueError(
                f"checkpoint = {self.path}: has {state.done} {unit}, must have at most {of}"
            )
        self._before = state.seconds
        self.tell(f"resuming from {before + state.done} of {before + of} {unit}")
        return state

    def recipe(self) -> dict[str, Any]:
        """Recipe of the work in the file; empty if the file cannot be read."""
        try:
            _require_stored(self.path)
            with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as archive:
                return dict(json.loads(str(archive[_HEADER]))["recipe"])
        except Exception:  # As in `begin`, which warns
            return {}

    @property
    def due(self) -> bool:
        """Whether it is time to save."""
        return time.monotonic() - self._saved >= max(self.seconds, self._cost / COST)

    def save(self, done: int, of: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the state into the file; on a full disk warn, and keep the earlier file."""
        start = time.monotonic()
        seconds = self._before + start - self._began
        header = {"recipe": self._recipe, "done": done, "of": of, "seconds": seconds}
        header |= {"arrays": _dtypes_and_shapes(arrays)}
        size = sum(array.nbytes for array in arrays.values())
        try:
            with replacing(self.path, needed_bytes=size) as temporary, open(temporary, "wb") as out:
                content: dict[str, Any] = {_HEADER: np.array(json.dumps(header)), **arrays}
                np.savez(out, **content)
            self._warned = False
        except OSError as error:
            if not self._warned:  # Once until saving works again
                warnings.warn(f"no checkpoint was saved: {error}", stacklevel=4)
            self._warned = True
        self._saved = time.monotonic()
        self._cost = self._saved - start

    def remove(self) -> None:
        """Remove the file and temporary files of killed runs; call it when results are written."""
        self.path.unlink(missing_ok=True)
        remove_leftovers(self.path)

    def _load(self) -> tuple[dict[str, Any], SavedState]:
        """Header and state in the file, if all checksums are right."""
        _require_stored(self.path)
        with ZipFile(self.path) as archive:
            if archive.testzip():  # NumPy may read less than there is, which tests nothing
                raise BadZipFile
        with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            header = json.loads(str(archive[_HEADER]))
            arrays = {name: archive[name] for name in archive.files if name != _HEADER}
        listed = header["arrays"]  # Of an earlier version: a list of names
        if listed != (list(arrays) if isinstance(listed, list) else _dtypes_and_shapes(arrays)):
            raise KeyError
        done, of = (checks.integer(name, header[name], 0, 1 << 62) for name in ("done", "of"))
        if not isinstance(header["recipe"], dict):
            raise TypeError
        seconds = checks.number("seconds", header["seconds"], unit="seconds")
        return header, SavedState(done, of, seconds, arrays)


def _require_stored(path: Path) -> None:
    """Refuse an archive with compressed content, which may unpack to more bytes than fit."""
    with ZipFile(path) as archive:
        if sum(info.file_size for info in archive.infolist()) > path.stat().st_size:
            raise BadZipFile


def _dtypes_and_shapes(arrays: Mapping[str, np.ndarray]) -> dict[str, list[Any]]:
    return {name: [array.dtype.str, *array.shape] for name, array in arrays.items()}


@dataclass
class SubCheckpoint:
    """Checkpoint of work in many parts, as one of them uses it."""

    checkpoint: Checkpoint  # Of all parts
    before: int  # Units of the parts before
    of: int  # Units of all parts
    more: Mapping[str, np.ndarray]  # Results of the parts before

    @property
    def due(self) -> bool:
        """Whether it is time to save."""
        return self.checkpoint.due

    def save(self, done: int, of: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the state of this part and of those before into the file."""
        self.checkpoint.save(self.before + done, self.of, {**arrays, **self.more})
