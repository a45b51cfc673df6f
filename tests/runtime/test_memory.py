"""The memory plan: its arithmetic, and that what it offers instead fits."""

from __future__ import annotations

import re

import mitsuba as mi
import psutil
import pytest
from support import film

from tofrender.runtime import memory

GIB = 1 << 30
OURS = "tofrender_transient_hdr_film"


@pytest.fixture
def machine(monkeypatch):
    """Set how much memory there is."""

    def has(free: int) -> None:
        monkeypatch.setattr(memory, "available", lambda: free)

    return has


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ((1, 1, 1, 1), 4),
        ((1, 1, 1, 3), 16),  # RGB is padded to four floats
        ((256, 256, 300, 3), 256 * 256 * 300 * 16),
        ((10, 20, 30, 1), 10 * 20 * 30 * 4),
    ],
)
def test_size_of_a_film(shape, size):
    assert memory.film_bytes(*shape) == size


@pytest.mark.parametrize("channels", [1, 3])
def test_size_is_what_a_film_allocates(channels):
    mi.set_variant({1: "llvm_ad_mono", 3: "llvm_ad_rgb"}[channels])
    made = mi.load_dict(film(5, 4, bins=7, type=OURS))
    made.prepare([])
    assert made.bins.sums.numpy().nbytes == memory.film_bytes(4, 5, 7, channels)


def test_the_boundary_is_exact(machine):
    shape = (100, 200, 300, 3)
    size = memory.film_bytes(*shape)
    machine(memory.RESERVE + size)
    memory.require_film(*shape)
    machine(memory.RESERVE + size - 1)
    with pytest.raises(MemoryError):
        memory.require_film(*shape)


@pytest.mark.parametrize(
    ("free", "shape"),
    [
        (8 * GIB, (1024, 2048, 4096, 3)),
        (1 * GIB, (256, 256, 3000, 3)),
        (64 * GIB, (1 << 14, 1 << 14, 300, 1)),
    ],
)
def test_what_is_offered_fits(machine, free, shape):
    machine(free)
    height, width, bins, channels = shape
    with pytest.raises(MemoryError) as error:
        memory.require_film(*shape)
    text = str(error.value)
    assert "\n" not in text
    size, most = memory.film_bytes(*shape), free - memory.RESERVE
    start = f"film of {width} x {height} pixels x {bins} bins: takes {size / GIB:.1f} GiB, "
    assert text.startswith(start + "must be at most ")
    assert float(re.search(r"at most ([\d.]+) GiB", text)[1]) <= most / GIB + 0.05
    fewer, narrow, low = map(int, re.search(r"; (\d+) bins or (\d+) x (\d+)", text).groups())
    memory.require_film(height, width, fewer, channels)
    memory.require_film(low, narrow, bins, channels)
    for more in ((height, width, fewer + 1), (low + height // 50 + 1, narrow + width // 50, bins)):
        with pytest.raises(MemoryError):
            memory.require_film(*more, channels)


def test_with_less_than_the_reserve_nothing_fits(machine):
    machine(memory.RESERVE - 1)
    with pytest.raises(MemoryError, match=r"must be at most 0\.0 GiB"):
        memory.require_film(16, 16, 300, 3)


def test_indices_are_limited_too(machine):
    """With all memory of the world, a 32-bit index still tells only so many bins apart."""
    machine(1 << 60)
    with pytest.raises(MemoryError):
        memory.require_film(1 << 16, 1 << 16, 2, 1)
    with pytest.raises(MemoryError):
        memory.require_film(1 << 16, 1 << 16, 1 << 20, 3)


def test_available_is_what_the_system_says():
    available = memory.available()
    assert isinstance(available, int)
    assert 0 < available <= psutil.virtual_memory().total


def test_a_control_group_limits(monkeypatch):
    numbers = {"memory.max": 2 * GIB, "memory.current": GIB}
    monkeypatch.setattr(memory, "_cgroup", numbers.get)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: type("V", (), {"available": 8 * GIB}))
    assert memory.available() == GIB
    numbers["memory.max"] = None  # "max": no limit
    assert memory.available() == 8 * GIB


def test_a_film_refuses_before_it_allocates(machine, monkeypatch):
    import drjit as dr

    made = mi.load_dict(film(640, 480, bins=3000, type=OURS))
    machine(GIB)
    monkeypatch.setattr(dr, "zeros", lambda *_: pytest.fail("bins were allocated"))
    with pytest.raises(MemoryError, match=r"640 x 480 pixels x 3000 bins: takes 13\.7 GiB"):
        made.prepare([])
