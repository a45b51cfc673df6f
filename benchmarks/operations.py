"""Operations in the kernels of a render. These counts do not depend on the load of the machine."""

from __future__ import annotations

import gc
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi

import tofrender

LARGE = 300  # Smallest number of operations of a kernel that traces paths
TOLERANCE = 0.02  # Relative change of operations above which measured times are stale


def operations(scene: mi.Scene) -> list[int]:
    """Return the operations of each large kernel in a render of one step."""
    gc.collect()  # Kernels contain the plugins of all scenes in memory
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        tofrender.render(scene, spp=1, progress=False)
        history = dr.kernel_history([dr.KernelType.JIT])
    counts = [int(each["operation_count"]) for each in history]
    return [count for count in counts if count > LARGE]


def stale(measured: Mapping[str, list[int]], now: Mapping[str, list[int]]) -> list[str]:
    """Return a line for each scene with kernels that have changed since the measurement."""
    return [
        f"{name}: {now[name]} operations now, {measured.get(name)} when measured"
        for name in now
        if len(now[name]) != len(measured.get(name, ()))
        or any(abs(a - b) > TOLERANCE * b for a, b in zip(now[name], measured[name], strict=True))
    ]
