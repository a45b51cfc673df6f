"""What is looked at: something that was saved, or a render that refines while one looks."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...io import save_npz
from ...rendering.renderer import render
from ...runtime import backend

if TYPE_CHECKING:
    import xarray as xr

FIRST_SPP = 1
STEP_S = 4.0
"""Time between two pictures of a render [s], once it is under way."""


class Saved:
    """What a command has written.

    A large cube stays on disk where its format allows that; only what is shown is read.

    Args:
        path: File or folder.
        load: Reads it.
    """

    is_live = False

    def __init__(self, path: Path, load: Callable[[Path], xr.Dataset]) -> None:
        self.path, self._load = path, load
        self.name = path.name or str(path.resolve())
        self.data: xr.Dataset | None = None
        self.error: BaseException | None = None
        self.version = 0
        self._seen: float | None = None
        self.look()

    def begin(self) -> None:
        """It was read when it was opened."""

    def look(self) -> None:
        """Read it again if it has changed."""
        try:
            seen = self.path.stat().st_mtime
        except OSError as error:
            seen = -1.0
            if self._seen != seen:
                self.data, self.error = None, error
        if seen == self._seen:
            return
        self._seen = seen
        self.version += 1
        if seen < 0:
            return
        try:
            self.data, self.error = self._load(self.path), None
        except (ValueError, OSError, MemoryError) as error:
            self.data, self.error = None, error

    def close(self) -> None:
        """Nothing goes on."""


class Live:
    """A render that goes on in a thread of its own, to ever more samples.

    Args:
        name: What it is called.
        words: Arguments of `render`; `spp` is where it ends.
    """

    is_live = True

    def __init__(self, name: str, words: Mapping[str, Any]) -> None:
        import mitsuba as mi

        self.name = name
        self.data: xr.Dataset | None = None
        self.error: BaseException | None = None
        self.version = 0
        self.most = int(words["spp"])
        self._words = dict(words)
        self._stop = threading.Event()
        self._variant = mi.variant()
        self._thread = threading.Thread()

    def begin(self) -> None:
        """Start, unless it has been started before."""
        if self._thread.ident is None:
            self.go_on()

    @property
    def done(self) -> int:
        """Samples per pixel so far."""
        return 0 if self.data is None else int(self.data.attrs["spp"])

    @property
    def is_running(self) -> bool:
        """Whether more samples are on their way."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Take no more samples after those under way."""
        self._stop.set()

    def go_on(self) -> None:
        """Take more samples after a stop."""
        if not self.is_running and self.done < self.most:
            self._stop.clear()
            self._thread = threading.Thread(target=self._run, name="render", daemon=True)
            self._thread.start()

    def look(self) -> None:
        """Nothing is read."""

    def save(self, path: Path, overwrite: bool = False) -> Path:
        """Write what is there so far as an npz file.

        Raises:
            ValueError: There is nothing yet.
            FileExistsError: The file exists.
        """
        if self.data is None:
            raise ValueError("path: there is nothing to save yet")
        return Path(save_npz(self.data, path, overwrite=overwrite))

    def close(self) -> None:
        """Stop, and wait for the samples under way."""
        self.stop()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        """Render in steps, each of which goes on from the one before."""
        import time
        import warnings

        try:
            backend.activate(self._variant)
            while self.done < self.most and not self._stop.is_set():
                spp = min(self._next(), self.most)
                begin = time.monotonic()
                before = self.done
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)
                    words = self._words | {"spp": spp, "resume": self.data, "progress": False}
                    self.data = render(**words)
                self._rate = (spp - before) / max(time.monotonic() - begin, 1e-3)
                self.version += 1
        except Exception as error:
            self.error = error
            self.version += 1

    _rate = 0.0

    def _next(self) -> int:
        """Samples at the next picture: twice as many, unless that takes long."""
        if not self.done:
            return FIRST_SPP
        return self.done + max(1, min(self.done, math.floor(self._rate * STEP_S)))
