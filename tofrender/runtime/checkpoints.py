"""What long work has done so far, in a file that outlives the process."""

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
from .atomic import check_writable, remove_leftovers, replacing
from .progress import EVERY_S

COST = 0.02
"""Part of the time that saving may take."""

_ABOUT = "tofrender"


@dataclass
class Kept:
    """Work that was stopped.

    Attributes:
        done: Units that were done: samples per pixel, laser points.
        of: Units that were to be done.
        seconds: Time that they took [s].
        arrays: What they came to.
    """

    done: int
    of: int
    seconds: float
    arrays: dict[str, np.ndarray]


class Checkpoint:
    """A file that long work keeps up to date, to go on from after it was stopped or killed.

    The same call with the same file goes on where the file ends. The file is whole and on the disk
    whenever it is there: a new one takes its place in one move. It is not removed when the work is
    done, since that is lost while it is in memory only: `remove` it when results are written.

    Args:
        path: A file name that ends in .npz.
        seconds: Least time between two savings [s], above 0. Where saving takes more than 2 % of
            that, more time goes by.
        tell: Is called with a line that says what is gone on with.
        again: How to go on, for the message of work that was stopped.
        resume: Whether to go on from a file that is there; else it is replaced by the first saving.

    Raises:
        ValueError: An argument is wrong; one line.
        PermissionError: The place is not writable.

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
        self.path: Path = checks.path("checkpoint", path)
        if self.path.suffix != ".npz":
            raise ValueError(f"checkpoint = {path}: must be a file name that ends in .npz")
        if self.path.is_dir():
            raise ValueError(f"checkpoint = {path}: is a folder; must be the name of a file")
        self.seconds = checks.number("seconds", seconds, unit="seconds", positive=True)
        self.tell = checks.function("tell", tell)
        again = checks.instance("again", again, str, "text")
        self.again = again or f"the same call goes on with {path}"
        self.resume = checks.boolean("resume", resume)
        check_writable(path)
        self._recipe: dict[str, Any] = {}
        self._began = self._saved = time.monotonic()
        self._cost = self._before = 0.0
        self._told = False

    @classmethod
    def of(cls, given: Checkpoint | str | os.PathLike | None) -> Checkpoint | None:
        """What a function takes as a checkpoint: the name of a file will do."""
        return given if given is None or isinstance(given, Checkpoint) else cls(given)

    def begin(self, recipe: Mapping[str, Any], of: int, unit: str, before: int = 0) -> Kept | None:
        """Say what the work is, and find what was done of it.

        Args:
            recipe: All that results depend on, as JSON can hold it.
            of: How many units are to be done.
            unit: What these are called.
            before: How many were done before all of these.

        Returns:
            What was done, None if nothing was.

        Raises:
            ValueError: The file is of other work, or more was done than is wanted; one line.

        Warns:
            UserWarning: The file is damaged, and the work starts anew.
        """
        self._recipe = json.loads(json.dumps(recipe))
        self._began = self._saved = time.monotonic()
        self._before = 0.0
        if not self.resume or not self.path.exists():
            return None
        try:
            about, kept = self._load()
        except Exception:  # Whatever a reader makes of bytes that nobody wrote
            warnings.warn(f"{self.path}: is damaged, starting anew", stacklevel=5)
            return None
        for name in about["recipe"] | self._recipe:
            its, value = about["recipe"].get(name), self._recipe.get(name)
            if its != value:
                raise ValueError(
                    f"checkpoint = {self.path}: was made with {name} = {its!r}; must be {value!r}, "
                    "or the file removed"
                )
        if kept.done > of:
            raise ValueError(
                f"checkpoint = {self.path}: has {kept.done} {unit}, must have at most {of}"
            )
        self._before = kept.seconds
        self.tell(f"resuming from {before + kept.done} of {before + of} {unit}")
        return kept

    def recipe(self) -> dict[str, Any]:
        """What the file says that its work is, nothing if it does not."""
        try:
            _require_stored(self.path)
            with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as archive:
                return dict(json.loads(str(archive[_ABOUT]))["recipe"])
        except Exception:  # As in `begin`, which tells
            return {}

    @property
    def due(self) -> bool:
        """Whether it is time to save."""
        return time.monotonic() - self._saved >= max(self.seconds, self._cost / COST)

    def save(self, done: int, of: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Put what was done into the file.

        Warns:
            UserWarning: There is no room. What was saved before stays, and the work goes on.
        """
        start = time.monotonic()
        seconds = self._before + start - self._began
        told = {"recipe": self._recipe, "done": done, "of": of, "seconds": seconds}
        about = json.dumps(told | {"arrays": _kinds(arrays)})
        size = sum(array.nbytes for array in arrays.values())
        try:
            with replacing(self.path, needed_bytes=size) as temporary, open(temporary, "wb") as out:
                all_of_it: dict[str, Any] = {_ABOUT: np.array(about), **arrays}
                np.savez(out, **all_of_it)
            self._told = False
        except OSError as error:
            if not self._told:  # Once until there is room again
                warnings.warn(f"no checkpoint was saved: {error}", stacklevel=4)
            self._told = True
        self._saved = time.monotonic()
        self._cost = self._saved - start

    def remove(self) -> None:
        """Take the file away, and what killed runs left of it: the work is kept elsewhere."""
        self.path.unlink(missing_ok=True)
        remove_leftovers(self.path)

    def _load(self) -> tuple[dict[str, Any], Kept]:
        """What the file says, if all checksums are right."""
        _require_stored(self.path)
        with ZipFile(self.path) as archive:
            if archive.testzip():  # NumPy may read less than there is, which tests nothing
                raise BadZipFile
        with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            about = json.loads(str(archive[_ABOUT]))
            arrays = {name: archive[name] for name in archive.files if name != _ABOUT}
        named = about["arrays"]  # Of an earlier version: a list of names
        if named != (list(arrays) if isinstance(named, list) else _kinds(arrays)):
            raise KeyError
        done, of = (checks.integer(name, about[name], 0, 1 << 62) for name in ("done", "of"))
        if not isinstance(about["recipe"], dict):
            raise TypeError
        seconds = checks.number("seconds", about["seconds"], unit="seconds")
        return about, Kept(done, of, seconds, arrays)


def _require_stored(path: Path) -> None:
    """Refuse a file that says that it holds more bytes than it has, as compressed ones do."""
    with ZipFile(path) as archive:
        if sum(info.file_size for info in archive.infolist()) > path.stat().st_size:
            raise BadZipFile


def _kinds(arrays: Mapping[str, np.ndarray]) -> dict[str, list[Any]]:
    """Types and shapes of arrays by name, as JSON can hold them."""
    return {name: [array.dtype.str, *array.shape] for name, array in arrays.items()}


class Within:
    """A checkpoint of work of many parts, as one of them uses it.

    Args:
        checkpoint: That of all.
        before: Units of the parts before.
        of: Units of all.
        more: What the parts before came to.
    """

    def __init__(
        self, checkpoint: Checkpoint, before: int, of: int, more: Mapping[str, np.ndarray]
    ) -> None:
        self.checkpoint, self.before, self.of, self.more = checkpoint, before, of, more

    @property
    def due(self) -> bool:
        """Whether it is time to save."""
        return self.checkpoint.due

    def save(self, done: int, of: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Put what was done into the file of all."""
        self.checkpoint.save(self.before + done, self.of, {**arrays, **self.more})
