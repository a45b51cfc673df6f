"""What a step of a render costs, as its kernels tell: figures that no busy machine changes."""

from __future__ import annotations

import gc
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi

import tofrender

LARGE = 300  # Operations of a kernel that traces paths; those that only move numbers have few
TOLERANCE = 0.02  # Deviation of operations from which on measured times are those of other code


def operations(scene: mi.Scene) -> list[int]:
    """Return the operations of each large kernel in a render of one step."""
    gc.collect()  # Virtual calls have the parts of all living scenes
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        tofrender.render(scene, spp=1, progress=False)
        history = dr.kernel_history([dr.KernelType.JIT])
    counts = [int(each["operation_count"]) for each in history]
    return [count for count in counts if count > LARGE]


def stale(measured: Mapping[str, list[int]], now: Mapping[str, list[int]]) -> list[str]:
    """Return a line for each scene whose kernels are others than when they were measured."""
    return [
        f"{name}: {now[name]} operations now, {measured.get(name)} when measured"
        for name in now
        if len(now[name]) != len(measured.get(name, ()))
        or any(abs(a - b) > TOLERANCE * b for a, b in zip(now[name], measured[name], strict=True))
    ]
