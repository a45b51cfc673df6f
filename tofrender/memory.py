"""How much memory a film takes and how much there is: refuse before work starts."""

from __future__ import annotations

import math
from pathlib import Path

RESERVE = 300 << 20
"""What a render takes besides its film [bytes]: Mitsuba, kernels, rays."""

MAX_CELLS = 1 << 32
"""Bins of all pixels together that a 32-bit index can tell apart."""


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
    limit, used = (_cgroup(name) for name in ("memory.max", "memory.current"))
    return min(free, limit - used) if limit is not None and used is not None else free


def require_film(height: int, width: int, temporal_bins: int, channels: int) -> None:
    """Refuse a film that does not fit.

    Args:
        height: Rows of pixels.
        width: Columns of pixels.
        temporal_bins: Bins of a pixel.
        channels: Channels of a bin.

    Raises:
        MemoryError: One line with the film's size and what would fit.
    """
    size = film_bytes(height, width, temporal_bins, channels)
    free = max(0, available() - RESERVE)
    cells = height * width * temporal_bins
    part = min(free / size, MAX_CELLS / cells)  # Of the film, that fits
    if part >= 1:
        return
    side = math.sqrt(part)
    raise MemoryError(
        f"film of {width} x {height} pixels x {temporal_bins} bins: takes {size / 2**30:.1f} GiB, "
        f"must be at most {min(free, part * size) / 2**30:.1f} GiB; {int(part * temporal_bins)} "
        f"bins would fit, or {int(width * side)} x {int(height * side)} pixels"
    )


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
