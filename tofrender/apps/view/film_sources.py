"""Sources of the viewer: a saved Dataset, or a render in progress."""

import math
import threading
import time
import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import mitsuba as mi
import xarray as xr

from ...io import save_npz
from ...rendering.renderer import render
from ...rendering.settings import RenderSettings
from ...runtime import backend
from ...scenes.loading import load_scene
from ..explorer.paths import path_tracer

STEP_S = 4.0  # Time between two updates of a render [s], once it is under way


class SavedDataset:
    """Result of a command, which is read again when its file changes.

    Large cubes can stay on the disk. Errors of the first reading are raised. Later errors are kept
    in `error`.
    """

    def __init__(self, path: Path, load: Callable[[Path], xr.Dataset]) -> None:
        self.path = path
        self._load = load
        self.name = path.name or str(path.resolve())
        self._modified: float | None = path.stat().st_mtime
        self.data: xr.Dataset | None = load(path)
        self.error: BaseException | None = None
        self.version = 1

    def refresh(self) -> None:
        """Read the file again if it has changed."""
        modified = self.path.stat().st_mtime if self.path.exists() else None
        if modified == self._modified:
            return
        self._modified = modified
        self.data = None
        self.error = None
        self.version += 1
        try:
            self.data = self._load(self.path)
        except (ValueError, OSError, MemoryError) as error:
            self.error = error


class LiveRender:
    """Render in a separate thread, with a growing number of samples, up to `spp` of the options."""

    def __init__(self, name: str, options: Mapping[str, Any]) -> None:
        self.name = name
        self.data: xr.Dataset | None = None
        self.error: BaseException | None = None
        self.version = 0
        self.max_spp = int(options["spp"])
        self._options = dict(options)
        self._samples_per_second = 0.0
        self._stop = threading.Event()
        self._no_click = threading.Event()  # Cleared while the paths of a clicked pixel are traced
        self._no_click.set()
        self._variant = mi.variant()
        self._thread = threading.Thread()

    @property
    def spp(self) -> int:
        """Samples per pixel so far."""
        return 0 if self.data is None else int(self.data.attrs["spp"])

    @property
    def is_running(self) -> bool:
        """Whether the render is running."""
        return self._thread.is_alive()

    @property
    def has_started(self) -> bool:
        """Whether the render was ever started."""
        return self._thread.ident is not None

    def start(self) -> None:
        """Start the render, or continue after a stop."""
        if not self.is_running and self.spp < self.max_spp:
            self._stop.clear()
            self._thread = threading.Thread(target=self._run, name="render", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Stop after the current samples."""
        self._stop.set()

    def close(self) -> None:
        """Stop, and wait for the current samples."""
        self.stop()
        if self.has_started:
            self._thread.join()

    def save(self, path: Path, overwrite: bool = False) -> Path:
        """Write the current render as an npz file."""
        if self.data is None:
            raise ValueError("path: the first samples are not finished yet; save the render later")
        return Path(save_npz(self.data, path, overwrite=overwrite))

    @cached_property
    def _trace(self) -> Callable[[Any, Any], dict[str, Any]]:
        settings = RenderSettings(**self._options)
        # Merged shapes would lose their names
        changes: Any = settings.scene_changes | {"optimize": False}
        return path_tracer(load_scene(settings.scene, **changes), self.data, "transient")

    def trace(self, pixel: Any, opl: Any) -> dict[str, Any]:
        """Return paths of a pixel with lengths in a range, as `plain_paths`.

        The render starts no further step until the paths are traced.
        """
        self._no_click.clear()
        try:
            backend.activate(self._variant)
            return self._trace(pixel, opl)
        except (ValueError, OSError, MemoryError) as error:
            return {"pixel": pixel, "opl": opl, "traced": True, "error": str(error)}
        finally:
            self._no_click.set()

    def _run(self) -> None:
        try:
            backend.activate(self._variant)
            while self.spp < self.max_spp and not self._stop.is_set():
                self._no_click.wait()
                spp = min(self._next_spp(), self.max_spp)
                begin = time.monotonic()
                before = self.spp

                # Continue the render with more samples
                step = {"spp": spp, "resume": self.data, "progress": False}
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)
                    self.data = render(**(self._options | step))
                seconds = max(time.monotonic() - begin, 1e-3)
                self._samples_per_second = (spp - before) / seconds
                self.version += 1
        except Exception as error:
            self.error = error
            self.version += 1

    def _next_spp(self) -> int:
        """Return the samples per pixel of the next update, at most twice the current number."""
        if not self.spp:
            return 1
        return self.spp + max(1, min(self.spp, math.floor(self._samples_per_second * STEP_S)))
