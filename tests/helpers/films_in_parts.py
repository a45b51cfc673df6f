"""What the tests of tiles, streams, workers and error bars share: small scenes, comparisons."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import tofrender
from helpers.limits import lower
from tofrender.integrators import passes
from tofrender.rendering import work_items

ROOT = Path(__file__).parents[2]
ROUNDING = 1e-5  # What adding in another order may change, relative to the brightest value

OWN = {"render_seconds", "energy_outside_window"}
"""Attributes that differ from render to render, the second one by rounding."""


def box(width: int = 12, height: int = 9, **options: Any) -> dict:
    """A Cornell box that takes milliseconds."""
    small = {"temporal_bins": 40, "bin_width_opl": 0.3, "max_depth": 4}
    return tofrender.cornell_box(width=width, height=height, **small | options)


def crop(x: int, y: int, width: int, height: int) -> dict:
    """Parameters of a film that renders a part only."""
    names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
    return dict(zip(names, (x, y, width, height), strict=True))


def in_tiles(monkeypatch: Any, rows: float, *, columns: int = 12, bins: int = 40) -> None:
    """Let tiles have at most so many rows of a film, by the memory that they may take."""
    size = int(rows * tofrender.runtime.memory.film_bytes(1, columns, bins, 3))
    lower(monkeypatch, tile_bytes=size)


def in_small_steps(patch: Any, pixels: int = 2 * 12) -> None:
    """Let tiles of so many pixels take two samples in each of them in a step."""
    samples = 2 * pixels
    lanes = {"llvm": samples, "cuda": samples}
    lower(patch, step_samples=samples, first_samples=samples, lanes=lanes, private_lanes=1)


def replace_launch(patch: Any, make: Callable[[Callable], Callable]) -> None:
    """Replace the function that launches the kernel of a step: `make` gets it and returns another.

    Its arguments are the sampler of the pixels, the pixels, the number of samples, and a weight.
    """
    patch.setattr(passes, "_step", make(passes._step))


def watch_steps(patch: Any, look: Callable[[int], object]) -> None:
    """Let `look(number)` be called after each step of a render."""
    steps = work_items.steps

    def watched(*arguments: Any, **options: Any) -> Iterator:
        for number, done in enumerate(steps(*arguments, **options)):
            look(number)
            yield done

    patch.setattr(work_items, "steps", watched)


def render(scene: Any, **options: Any):
    return tofrender.render(scene, **{"spp": 8, "progress": False} | options)


def differences(film: Any, whole: Any) -> dict[str, float]:
    """Largest difference of each variable, relative to its brightest value; NaN counts as 1."""
    assert list(film.data_vars)
    assert set(film.data_vars) == set(whole.data_vars)
    found = {}
    for name in whole.data_vars:
        one, other = film[name].values, whole[name].values
        assert one.shape == other.shape
        assert one.dtype == other.dtype
        largest = np.abs(one - other).max() / (np.abs(other).max() or 1.0)
        found[name] = float(largest) if np.isfinite(largest) else 1.0
    return found


def check_same(film: Any, whole: Any, rounding: float = ROUNDING) -> None:
    """Two renders are one: coordinates, values up to rounding, attributes but for their own."""
    assert set(film.coords) == set(whole.coords)
    for name in whole.coords:
        np.testing.assert_array_equal(film[name].values, whole[name].values)
    assert dict(film.sizes) == dict(whole.sizes)
    assert film["transient"].dims == whole["transient"].dims
    assert set(film.attrs) == set(whole.attrs)
    for name in set(whole.attrs) - OWN:
        assert film.attrs[name] == whole.attrs[name], name
    outside = (each.attrs["energy_outside_window"] for each in (film, whole))
    assert abs(next(outside) - next(outside)) < 1e-5
    found = differences(film, whole)
    assert max(found.values()) <= rounding, found


def names(folder: Path) -> set[str]:
    """All that stands in a folder, hidden too."""
    return set(os.listdir(folder))


def script(code: str, *arguments: object, **options: Any) -> subprocess.Popen:
    """A Python process with its own group, that sees the tests' modules."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])
    options |= {"env": os.environ | {"PYTHONPATH": path} | options.get("env", {}), "cwd": ROOT}
    options |= dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(command, text=True, start_new_session=True, **options)


def end(process: subprocess.Popen, number: int = signal.SIGKILL) -> tuple[str, str]:
    """Send a signal to a process, and give what else it has to say."""
    process.send_signal(number)
    return process.communicate()
