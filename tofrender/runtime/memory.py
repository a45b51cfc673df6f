"""Memory that films need and that is free. Films that do not fit are refused before work starts."""

import ctypes
import math
from pathlib import Path, PurePosixPath

from . import gpu

# Memory of a render in addition to its film [bytes]: Mitsuba, kernels, rays
RESERVE = 300 << 20

# Size that represents a missing limit [bytes]
UNLIMITED = 1 << 62

# Entries of the largest array that Dr.Jit supports
MAX_FLOATS = (1 << 32) - 1

ROOT = Path("/")

# Control groups by controller: their folder, and the names of limit, usage, and droppable cache
CGROUPS = {
    "": ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    "memory": (
        "sys/fs/cgroup/memory",
        "memory.limit_in_bytes",
        "memory.usage_in_bytes",
        "total_inactive_file",
    ),
}


def stride(channels: int) -> int:
    """Return the number of floats per bin. RGB is padded to four floats, which form one packet."""
    return 4 if channels == 3 else channels


def film_bytes(height: int, width: int, temporal_bins: int, channels: int) -> int:
    """Return the size of a film's bins [bytes]."""
    return height * width * temporal_bins * stride(channels) * 4


def available() -> int:
    """Return the memory that this process may still allocate on the active device [bytes]."""
    return _cuda_free() if _has_own_memory() else free_on_host()


def _has_own_memory() -> bool:
    """Return whether the active device has separate memory. Metal shares the host's memory."""
    import mitsuba as mi

    return gpu.backend_of(mi.variant()) == gpu.CUDA


def free_on_host() -> int:
    """Return the host memory that this process may still allocate [bytes], within all limits."""
    import psutil

    return max(0, min(psutil.virtual_memory().available, *_free_in_cgroups(), address_space()[1]))


def address_space() -> tuple[int, int]:
    """Return the limit of `ulimit -v` on this process, and the free bytes below it."""
    try:
        import resource
    except ImportError:
        # Windows does not have this limit
        return UNLIMITED, UNLIMITED
    import psutil

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return UNLIMITED, UNLIMITED
    return limit, limit - psutil.Process().memory_info().vms


def require_free(what: str, size: int) -> None:
    """Raise a MemoryError if `what` needs more than the free host memory [bytes]."""
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
    """Raise a MemoryError that names smaller sizes if a film does not fit into memory.

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

    # Find sizes that would fit
    bins = int(part * temporal_bins)
    side = math.sqrt(part)
    pixels = f"{int(width * side)} x {int(height * side)} pixels"
    smaller = [f"{bins} bins"] * (bins > 0) + [pixels] * (int(min(width, height) * side) > 0)
    raise MemoryError(
        f"film of {width} x {height} pixels x {temporal_bins} bins: takes "
        f"{needed / 2**30:.1f} GiB{where}, must be at most {part * needed / 2**30:.1f} GiB"
        + (f"; {' or '.join(smaller)} would fit" if smaller else "")
    )


def require_array(what: str, count: int, copies: float, *, host_copies: float = 0.0) -> None:
    """Raise a MemoryError if an array of `count` floats does not fit into memory `copies` times.

    On a GPU, `copies` are in its memory, and `host_copies` are in host memory.
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
    """Return the fraction of a film that fits `copies` times, if Dr.Jit frees unused memory."""
    part = _part_in_free_memory(size, copies)
    if part < 1:
        import drjit as dr

        dr.flush_malloc_cache()
        part = _part_in_free_memory(size, copies)
    return part


def _part_in_free_memory(size: int, copies: float) -> float:
    """Return the fraction of a film that fits `copies` times into memory that is free now."""
    # Free memory, and the size of Dr.Jit's arrays
    part = min(max(0, available() - RESERVE) / (copies * size), MAX_FLOATS * 4 / size)

    # Address space. Dr.Jit reserves the next power of two of bytes
    left = (address_space()[1] - RESERVE) // math.ceil(copies)
    return min(part, 2 ** (left.bit_length() - 1) / size) if left > 0 else 0.0


def _cuda_free() -> int:
    """Return the free memory of Dr.Jit's CUDA device, which is the first device [bytes]."""
    free = ctypes.c_size_t()
    total = ctypes.c_size_t()
    context = ctypes.c_void_p()
    driver = gpu.cuda_driver()
    if driver is None:
        return UNLIMITED

    # Activate the context. Dr.Jit activates it only during its own calls
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
    """Return the free bytes below each memory limit on this process and its parent groups."""
    free = []
    # Find the control groups of this process
    for line in _lines(ROOT / "proc/self/cgroup"):
        _, controllers, path = line.split(":", 2)
        for top, limit, used, cache in (CGROUPS[c] for c in controllers.split(",") if c in CGROUPS):
            own = PurePosixPath(path.lstrip("/"))
            for group in (ROOT / top / part for part in (own, *own.parents)):
                numbers = dict(line.split() for line in _lines(group / "memory.stat"))
                # Read the limit. A missing group and "max" are no limits
                try:
                    most, usage = (int(_lines(group / name)[0]) for name in (limit, used))
                except (IndexError, ValueError):
                    continue
                free.append(most - usage + int(numbers.get(cache, 0)))
    return free


def _lines(path: Path) -> list[str]:
    """Return the lines of a file, or [] if it cannot be read."""
    try:
        return path.read_text().splitlines()
    except OSError:
        return []
