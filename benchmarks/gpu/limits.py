"""Memory: films that do not fit are refused, and scenes that were dropped are freed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import mitsuba as mi
import numpy as np
import psutil

import tofrender
from tofrender.runtime import gpu, memory

from .part import Part

FILMS = {"40 GB": (1024, 1024, 2384), "12 GB": (1024, 1024, 715)}
"""Width, height and bins. The larger film exceeds the largest array of Dr.Jit, too."""

HOST_LIMIT_GPU = 16 << 30
HOST_LIMIT_CPU = 10 << 30
"""Host memory that films may take [bytes]: the smaller film fits once into the first limit, but a
GPU needs it twice. The limits are simulated, because CUDA does not start under `ulimit -v`."""

MOST_MIB = 512  # Largest growth of memory during a refusal [MiB]
MEASUREMENTS = 25  # Number of measurements of memory, with equally many scenes in between
MOST_KIB_PER_SCENE = 100.0  # Less than the size of a scene, which would leak
LEAST_SCENES = 100  # With fewer scenes, caches of the process grow as much


def film(part: Part) -> None:
    """Render films that do not fit into host memory, which must be refused before work starts."""
    has_own_memory = gpu.backend_of(mi.variant()) == gpu.CUDA
    limit = HOST_LIMIT_GPU if has_own_memory else HOST_LIMIT_CPU
    for name in part.each(list(FILMS)):
        width, height, bins = FILMS[name]
        described = tofrender.cornell_box(width=width, height=height, temporal_bins=bins)
        before = psutil.Process().memory_info().rss
        start = time.perf_counter()
        message = ""
        with _host_limit(limit):
            try:
                tofrender.render(described, spp=1, progress=False)
            except MemoryError as error:
                message = str(error)
        grown_mib = (psutil.Process().memory_info().rss - before) / 2**20
        part.results[name] = {
            "message": message,
            "seconds": time.perf_counter() - start,
            "grown_mib": grown_mib,
            "simulated_host_limit_gib": limit / 2**30,
        }
        part.require(bool(message), f"film of {name}: was not refused")
        if has_own_memory and name == "12 GB":
            part.require("of host memory" in message, f"film of {name}: refused by: {message}")
        part.require(grown_mib < MOST_MIB, f"film of {name}: the refusal took {grown_mib:.0f} MiB")


def scenes(part: Part) -> None:
    """Load and render many different scenes, and measure how memory grows from scene to scene."""
    count = part.sizes.loaded_scenes
    block = max(1, count // MEASUREMENTS)
    loaded: list[int] = []
    used_mib: dict[str, list[float]] = {"host": []}
    if gpu.backend_of(mi.variant()) == gpu.CUDA:
        used_mib["device"] = []

    # Load and render scenes, and measure memory after each block
    for first in part.each(range(0, count, block)):
        for number in range(first, min(count, first + block)):
            tofrender.render(_scene(number), spp=4, progress=False)
        loaded.append(min(count, first + block))
        used_mib["host"].append(psutil.Process().memory_info().rss / 2**20)
        if "device" in used_mib:
            used_mib["device"].append(-memory.available() / 2**20)
    part.results |= {"scenes": loaded, "used_mib": used_mib}
    if not loaded or loaded[-1] < LEAST_SCENES:
        part.skipped.append(f"growth of memory: fewer than {LEAST_SCENES} scenes")
        return

    # Fit a line. The first scenes fill caches
    later = len(loaded) // 5
    for name, values in used_mib.items():
        slope_mib, _ = np.polyfit(loaded[later:], values[later:], 1)
        slope_kib = float(slope_mib * 1024)
        part.results[f"{name}_kib_per_scene"] = slope_kib
        problem = f"{name} memory grows by {slope_kib:.0f} KiB per scene"
        part.require(slope_kib < MOST_KIB_PER_SCENE, problem)


def _scene(number: int) -> dict:
    """Describe a Cornell box. The lamp has another place in each scene."""
    described = tofrender.cornell_box(width=8, height=6, temporal_bins=30)
    lamp = described["light"]
    shift = mi.ScalarTransform4f().translate([1e-4 * number, 0, 0])
    described["light"] = lamp | {"to_world": shift @ lamp["to_world"]}
    return described


@contextmanager
def _host_limit(limit: int) -> Iterator[None]:
    """Let the host have at most a number of free bytes."""
    measured = memory.free_on_host
    memory.free_on_host = lambda: min(limit, measured())
    try:
        yield
    finally:
        memory.free_on_host = measured
