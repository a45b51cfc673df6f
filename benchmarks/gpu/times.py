"""Time transient renders, relative to Mitsuba's `path`, and split the time by its use."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from tofrender.runtime import gpu

from .. import peers
from ..six_scenes import SCENES, Described
from ..timing import trace
from .part import LIGHT_LENGTH_M, Part

PROGRAMS: dict[str, Callable[[Described], mi.Scene]] = {
    "path": peers.path,
    "one light point": lambda described: peers.ours(described, light_samples=1),
    "ours": peers.ours,
    "mitransient": peers.mitransient,
}

TARGETS = {"one light point": {64: 1.4, 1024: 1.2}, "ours": {64: 2.5, 1024: 2.5}}
"""Time over that of `path` that a GPU should reach, by samples per pixel."""

MOST_OVER_KERNELS = 1.2  # Wall-clock time over kernel time, from the second render on


def times(part: Part) -> None:
    """Time each scene with each program and each number of samples."""
    for name in part.each(list(SCENES)[: part.sizes.timed_scenes]):
        rows: dict[str, Any] = {}
        for program, load in PROGRAMS.items():
            if program == "mitransient" and not peers.has("mitransient"):
                rows[program] = "not installed"
                continue
            rows[program] = _times_of(load(_sized(SCENES[name](), part)), part)
            gc.collect()  # The kernels of the next scene would contain the parts of this one
        for program in rows:
            _compare(rows, program)
        part.results[name] = rows
    if gpu.is_gpu(part.variant) and part.results:
        part.results["targets"] = _targets(part.results, part.sizes.timed_spp)


def split(render: Callable[[], object]) -> dict[str, float]:
    """Measure one render, and what its time is spent on [s].

    Dr.Jit reports the times of its kernels. In the remaining time, Python and C++ code traces
    the render and starts kernels.
    """
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        wall_s = _seconds(render)
        launches = dr.kernel_history()
    compiling_s = 0.0
    running_s = 0.0
    for launch in launches:
        compiling_s += launch.get("codegen_time", 0.0) / 1e3
        compiling_s += launch.get("backend_time", 0.0) / 1e3
        running_s += launch["execution_time"] / 1e3
    return {
        "wall_s": wall_s,
        "tracing_s": wall_s - compiling_s - running_s,
        "compiling_s": compiling_s,
        "running_s": running_s,
        "launches": len(launches),
    }


def _sized(described: Described, part: Part) -> Described:
    """Set the size of a scene's film."""
    width, height, bins = part.sizes.timed_film
    described["sensor"]["film"] |= {
        "width": width,
        "height": height,
        "temporal_bins": bins,
        "bin_width_opl": LIGHT_LENGTH_M / bins,
    }
    return described


def _times_of(scene: mi.Scene, part: Part) -> dict[str, Any]:
    """Measure the first render, the median of some more, and what the last one spends time on."""
    rows: dict[str, Any] = {}
    for spp in part.sizes.timed_spp:
        render = trace(scene, spp)
        first = split(render)
        seconds = [_seconds(render) for _ in range(part.sizes.runs)]
        rows[str(spp)] = {
            "first": first,
            "median_s": float(np.median(seconds)),
            "later": split(render),
        }
    return rows


def _seconds(render: Callable[[], object]) -> float:
    """Wall-clock time of a render [s]."""
    dr.sync_thread()
    start = time.perf_counter()
    render()
    dr.sync_thread()
    return time.perf_counter() - start


def _compare(rows: dict[str, Any], program: str) -> None:
    """Divide the times of a program by the times of `path`."""
    if rows[program] == "not installed":
        return
    for spp, row in rows[program].items():
        row["over_path"] = row["median_s"] / rows["path"][spp]["median_s"]


def _targets(results: dict[str, Any], spps: Sequence[int]) -> list[dict[str, Any]]:
    """Compare the slowest scene with each target for these numbers of samples."""
    found: list[dict[str, Any]] = []
    for program, by_spp in TARGETS.items():
        for spp in spps:
            if spp in by_spp:
                value = max(rows[program][str(spp)]["over_path"] for rows in results.values())
                what = f"{program}, {spp} samples: over path"
                found.append({"what": what, "target": by_spp[spp], "value": value})
    for spp in spps:
        later = [rows["ours"][str(spp)]["later"] for rows in results.values()]
        value = max(row["wall_s"] / row["running_s"] for row in later)
        what = f"ours, {spp} samples, later renders: over kernels"
        found.append({"what": what, "target": MOST_OVER_KERNELS, "value": value})
    for row in found:
        row["met"] = row["value"] <= row["target"]
    return found
