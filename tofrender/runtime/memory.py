"""Memory that films need and that is free: what does not fit is refused before work starts."""

import ctypes
import math
from pathlib import Path, PurePosixPath

from . import gpu

RESERVE = 300 << 20  # Bytes of a render besides its film: Mitsuba, kernels, rays
UNLIMITED = 1 << 62
MAX_FLOATS = (1 << 32) - 1  # Entries of the largest array that Dr.Jit can make

ROOT = Path("/")
CGROUPS = {  # controller: mount, and files there with limit, usage, and cache that can be dropped
    "": ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    "memory": (
        *("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes"),
        "total_inactive_file",
    ),
}


def stride(channels: int) -> int:
    """Floats of a bin: RGB is padded to four, which can be added as one packet."""
    return 4 if channels == 3 else channels


def film_bytes(height: int, width: int, temporal_bins: int, channels: int) -> int:
    """Size of a film's bins [bytes]."""
    return height * width * temporal_bins * stride(channels) * 4


def available() -> int:
    """Memory that this process may still allocate on the active device [bytes]."""
    return _cuda_free() if _has_own_memory() else free_on_host()


def _has_own_memory() -> bool:
    """Whether the active device has memory of its own. Metal shares the memory of the host."""
    import mitsuba as mi

    return gpu.backend_of(mi.variant()) == gpu.CUDA


def free_on_host() -> int:
    """Host memory that this process may still allocate [bytes], with all limits on it."""
    import psutil

    return max(0, min(psutil.virtual_memory().available, *_free_in_cgroups(), address_space()[1]))


def address_space() -> tuple[int, int]:
    """Limit of `ulimit -v` on this process, and free bytes under it."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return UNLIMITED, UNLIMITED
    import psutil

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return UNLIMITED, UNLIMITED
    return limit, limit - psutil.Process().memory_info().vms


def require_free(what: str, size: int) -> None:
    """Raise a MemoryError if `what` takes more than the free host memory [bytes]."""
    free = free_on_host()
    if size > free:
        raise MemoryError(
            f"{what}: takes {size / 2**30:.1f} GiB, must be at most {free / 2**30:.1f} GiB, which "
            "is free"
        )


def require_film(
    height: int,
    width: int,
    temporal_bins: int,
    channels: int,
    copies: float = 1.0,
    *,
    device_copies: float | None = None,
    host_copies: float = 0.0,
) -> None:
    """Raise a MemoryError for a film that does not fit into memory, with what would fit.

    Args:
        height: Number of rows.
        width: Number of columns.
        temporal_bins: Number of bins per pixel.
        channels: Number of channels per bin.
        copies: Number of films that exist at the same time, if the CPU renders.
        device_copies: Number of films in the memory of a GPU, by default `copies`.
        host_copies: Number of films in host memory while or after a GPU renders.
    """
    size = film_bytes(height, width, temporal_bins, channels)
    part, needed, where = _part_that_fits(size, copies, device_copies, host_copies)
    if part >= 1:
        return
    bins, side = int(part * temporal_bins), math.sqrt(part)
    pixels = f"{int(width * side)} x {int(height * side)} pixels"
    smaller = [f"{bins} bins"] * (bins > 0) + [pixels] * (int(min(width, height) * side) > 0)
    raise MemoryError(
        f"film of {width} x {height} pixels x {temporal_bins} bins: takes "
        f"{needed / 2**30:.1f} GiB{where}, must be at most {part * needed / 2**30:.1f} GiB"
        + (f"; {' or '.join(smaller)} would fit" if smaller else "")
    )


def require_array(what: str, count: int, copies: float, *, host_copies: float = 0.0) -> None:
    """Raise a MemoryError if an array of `count` floats does not fit `copies` times.

    On a GPU, `copies` are in its memory, and `host_copies` in that of the host.
    """
    part, needed, where = _part_that_fits(4 * count, copies, copies, host_copies)
    if part < 1:
        raise MemoryError(
            f"{what}: takes {needed / 2**30:.1f} GiB{where}, must be at most "
            f"{part * needed / 2**30:.1f} GiB"
        )


def _part_that_fits(
    size: int, copies: float, device_copies: float | None, host_copies: float
) -> tuple[float, float, str]:
    """Compare what a film of `size` bytes needs with the free memory.

    Returns:
        The fraction of the film that fits (1 or more if all of it does), the needed memory [bytes],
        and which memory is too small, as a part of a message.
    """
    if not _has_own_memory():
        part = _part_after_cleanup(size, copies)
        return part, copies * size, ""

    # Check the memory of the GPU
    on_device = copies if device_copies is None else device_copies
    part = _part_after_cleanup(size, on_device)
    if part < 1 or not host_copies:
        return part, on_device * size, " of GPU memory"

    # Check the memory of the host, which gets the results
    free = max(0, free_on_host() - RESERVE)
    return free / (host_copies * size), host_copies * size, " of host memory"


def _part_after_cleanup(size: int, copies: float) -> float:
    """Fraction of a film that fits `copies` times, also into memory that Dr.Jit can return."""
    part = _part_in_free_memory(size, copies)
    if part < 1:
        import drjit as dr

        dr.flush_malloc_cache()
        part = _part_in_free_memory(size, copies)
    return part


def _part_in_free_memory(size: int, copies: float) -> float:
    """Fraction that fits without the memory that Dr.Jit keeps for later arrays."""
    part = min(max(0, available() - RESERVE) / (copies * size), MAX_FLOATS * 4 / size)
    left = (address_space()[1] - RESERVE) // math.ceil(copies)
    # Dr.Jit maps the next power of two of bytes, and touches what it needs
    return min(part, 2 ** (left.bit_length() - 1) / size) if left > 0 else 0.0


def _cuda_free() -> int:
    """Free memory of the CUDA device that Dr.Jit uses, the first one [bytes], from the driver."""
    free, total, context = ctypes.c_size_t(), ctypes.c_size_t(), ctypes.c_void_p()
    driver = gpu.cuda_driver()
    if driver is None:
        return UNLIMITED
    # Dr.Jit makes its context current only while it works
    if driver.cuDevicePrimaryCtxRetain(ctypes.byref(context), 0):
        return UNLIMITED
    try:
        driver.cuCtxPushCurrent_v2(context)
        failed = driver.cuMemGetInfo_v2(ctypes.byref(free), ctypes.byref(total))
        driver.cuCtxPopCurrent_v2(ctypes.byref(context))
    finally:
        driver.cuDevicePrimaryCtxRelease_v2(0)
    return UNLIMITED if failed else free.value


def _free_in_cgroups() -> list[int]:
    """Free bytes under each memory limit on this process's control group and on its parents."""
    free = []
    for line in _lines(ROOT / "proc/self/cgroup"):
        _, controllers, path = line.split(":", 2)
        for top, limit, used, cache in (CGROUPS[c] for c in controllers.split(",") if c in CGROUPS):
            own = PurePosixPath(path.lstrip("/"))
            for group in (ROOT / top / part for part in (own, *own.parents)):
                numbers = dict(line.split() for line in _lines(group / "memory.stat"))
                try:
                    most, usage = (int(_lines(group / name)[0]) for name in (limit, used))
                except (IndexError, ValueError):  # No such group, or "max": no limit
                    continue
                free.append(most - usage + int(numbers.get(cache, 0)))
    return free


def _lines(path: Path) -> list[str]:
    """Lines of a file, none if it cannot be read."""
    try:
        return path.read_text().splitlines()
    except OSError:
        return []
