"""How much memory a film takes and how much there is: refuse before work starts."""

from __future__ import annotations

import math
from pathlib import Path

import drjit as dr

RESERVE = 300 << 20
"""What a render takes besides its film [bytes]: Mitsuba, kernels, rays."""

MAX_FLOATS = (1 << 32) - 1
"""Entries of the largest array that Dr.Jit can make."""


def stride(channels: int) -> int:
    """Floats that a bin occupies: RGB is padded to four, which can be added as one packet."""
    return 4 if channels == 3 else channels


def film_bytes(height: int, width: int, temporal_bins: int, channels: int) -> int:
    """Size of a film's bins [bytes]."""
    return height * width * temporal_bins * stride(channels) * 4


def available() -> int:
    """Memory that this process may still take on the active device [bytes]."""
    import mitsuba as mi

    if (mi.variant() or "").startswith("cuda"):
        return _cuda_free()
    import psutil

    free = psutil.virtual_memory().available
    limit, used, cache = _cgroup("memory.max"), _cgroup("memory.current"), _cgroup_cache()
    return free if limit is None or used is None else min(free, limit - used + cache)


def require_film(
    height: int, width: int, temporal_bins: int, channels: int, copies: float = 1.0
) -> None:
    """Refuse a film that does not fit.

    Args:
        height: Rows of pixels.
        width: Columns of pixels.
        temporal_bins: Bins of a pixel.
        channels: Channels of a bin.
        copies: How often its size is needed at the peak.

    Raises:
        MemoryError: One line with the film's size and what would fit.
    """
    size = film_bytes(height, width, temporal_bins, channels)
    part = _part_that_fits(size, copies)
    if part < 1:
        dr.flush_malloc_cache()
        part = _part_that_fits(size, copies)
    if part >= 1:
        return
    bins, side = int(part * temporal_bins), math.sqrt(part)
    pixels = f"{int(width * side)} x {int(height * side)} pixels"
    smaller = [f"{bins} bins"] * (bins > 0) + [pixels] * (int(min(width, height) * side) > 0)
    raise MemoryError(
        f"film of {width} x {height} pixels x {temporal_bins} bins: takes "
        f"{copies * size / 2**30:.1f} GiB, must be at most {part * copies * size / 2**30:.1f} GiB"
        + (f"; {' or '.join(smaller)} would fit" if smaller else "")
    )


def _part_that_fits(size: int, copies: float) -> float:
    """How much of a film of `size` bytes there is room for; 1 or more if all of it."""
    return min(max(0, available() - RESERVE) / (copies * size), MAX_FLOATS * 4 / size)


def _cuda_free() -> int:
    """Free memory of the CUDA device [bytes], from the driver."""
    import ctypes
    import os

    free, total = ctypes.c_size_t(), ctypes.c_size_t()
    try:
        driver = ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
        status = driver.cuMemGetInfo_v2(ctypes.byref(free), ctypes.byref(total))
    except OSError:
        status = -1
    return free.value if status == 0 else 1 << 62


def _cgroup(name: str) -> int | None:
    """A number of this process's control group, None if it has none."""
    try:
        return int((Path("/sys/fs/cgroup") / name).read_text())
    except (OSError, ValueError):
        return None


def _cgroup_cache() -> int:
    """Part of the control group's memory that is file cache, free to be taken [bytes]."""
    try:
        lines = Path("/sys/fs/cgroup/memory.stat").read_text().splitlines()
        return int(dict(line.split() for line in lines)["inactive_file"])
    except (OSError, ValueError, KeyError):
        return 0
