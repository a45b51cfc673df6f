"""How much memory a film takes and how much there is: refuse before work starts."""

from __future__ import annotations

import math
from pathlib import Path

RESERVE = 300 << 20
"""What a render takes besides its film [bytes]: Mitsuba, kernels, rays."""


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


def require_film(
    height: int, width: int, temporal_bins: int, channels: int, copies: float = 1.0
) -> None:
    """Refuse a film that does not fit.

    Args:
        height: Rows of pixels.
        width: Columns of pixels.
        temporal_bins: Bins of a pixel.
        channels: Channels of a bin.
        copies: How often the film's size is needed at the peak.

    Raises:
        MemoryError: One line with the film's size and what would fit.
    """
    size = film_bytes(height, width, temporal_bins, channels)
    free = available() - RESERVE
    cells = height * width * temporal_bins
    if copies * size <= free and cells < 1 << 32:
        return
    bins = max(0, min(int(temporal_bins * free / (copies * size)), (1 << 32) // (height * width)))
    side = math.sqrt(max(0.0, min(free / (copies * size), (1 << 32) / cells)))
    raise MemoryError(
        f"film of {width} x {height} pixels x {temporal_bins} bins: takes "
        f"{copies * size / 2**30:.1f} GiB, must be at most {max(free, 0) / 2**30:.1f} GiB; "
        f"{bins} bins would fit, or {int(width * side)} x {int(height * side)} pixels"
    )


def _cuda_free() -> int:
    """Free memory of the CUDA device [bytes], from the driver."""
    import ctypes

    free, total = ctypes.c_size_t(), ctypes.c_size_t()
    try:
        driver = ctypes.CDLL("nvcuda.dll" if __import__("os").name == "nt" else "libcuda.so.1")
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
