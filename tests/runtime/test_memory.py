"""Memory limits: their arithmetic, and that the recommended sizes fit."""

import ctypes
import re
import sys

import drjit as dr
import mitsuba as mi
import psutil
import pytest
from helpers.limits import lower
from helpers.processes import python, says
from helpers.support import film, refused

import tofrender
from tofrender.runtime import memory

GIB = 1 << 30
OURS = "tofrender_transient_hdr_film"
NO_CUDA = {"CUDA_VISIBLE_DEVICES": "-1"}


@pytest.fixture
def machine(monkeypatch):
    """Set the amount of free memory."""

    def has(free: int) -> None:
        lower(monkeypatch, available_memory=free)

    return has


@pytest.mark.parametrize("channels", [1, 3])
def test_size_is_what_a_film_allocates(channels):
    """RGB is padded to four floats."""
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
    refused("film of", memory.require_film, *shape, kind=MemoryError)


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
        refused("film of", memory.require_film, *more, channels, kind=MemoryError)


@pytest.mark.parametrize(
    ("free", "shape", "message"),
    [
        (memory.RESERVE - 1, (16, 16, 300, 3), r"must be at most 0\.0 GiB"),
        # With all memory of the world, a 32-bit index still tells only so many bins apart
        (1 << 60, (1 << 16, 1 << 16, 2, 1), "film of"),
        (1 << 60, (1 << 16, 1 << 16, 1 << 20, 3), "film of"),
    ],
)
def test_what_does_not_fit_at_all(machine, free, shape, message):
    machine(free)
    refused(message, memory.require_film, *shape, kind=MemoryError)


def test_available_is_what_the_system_says():
    available = memory.available()
    assert isinstance(available, int)
    assert 0 < available <= psutil.virtual_memory().total


V2 = ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file")
V1 = (
    "sys/fs/cgroup/memory",
    *("memory.limit_in_bytes", "memory.usage_in_bytes", "inactive_file 1\ntotal_inactive_file"),
)
OLD = "7:cpu,cpuacct:/cpu\n4:memory:/all/job\n0::/"


@pytest.mark.parametrize(
    ("membership", "files", "groups", "free"),
    [  # Each group has a limit, of which it uses a part, of which it caches some [GiB]
        ("0::/", V2, {"": (2, 1, 0)}, 1),  # The limit of the root alone, as within a container
        # The process's own group, below a group without limit
        ("0::/user.slice/job", V2, {"user.slice": ("max", 5, 0), "user.slice/job": (3, 2, 0)}, 1),
        # One above has less left, not counting what it only caches
        ("0::/all/job", V2, {"all": (4, 3, 1), "all/job": (4, 1, 0)}, 2),
        # The first version, whose root holds the number of no limit
        (OLD, V1, {"": (1 << 33, 7, 0), "all/job": (3, 2, 1)}, 2),
        ("0::/a", V2, {"a": (1, 2, 0)}, 0),  # More is used than the limit allows, lowered since
        ("", V2, {}, 8),
    ],
)
def test_control_groups_limit(monkeypatch, tmp_path, membership, files, groups, free):
    folder, limit, used, cached = files
    written = {"proc/self/cgroup": membership + "\n" * bool(membership)}
    for group, (most, taken, dropped) in groups.items():
        written[f"{folder}/{group}/{limit}"] = most if most == "max" else most * GIB
        written[f"{folder}/{group}/{used}"] = taken * GIB
        written[f"{folder}/{group}/memory.stat"] = f"inactive_anon 7\n{cached} {dropped * GIB}\n"
    for name, value in written.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(str(value))
    monkeypatch.setattr(memory, "ROOT", tmp_path)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: type("V", (), {"available": 8 * GIB}))
    assert memory.free_on_host() == free * GIB


class Driver:
    """A CUDA driver that works only within a context. The call named `failing` fails."""

    def __init__(self, failing: str) -> None:
        self.failing, self.current, self.held = failing, 0, 0

    def cuDevicePrimaryCtxRetain(self, context, device):
        self.held += self.failing != "retain"
        return self.failing == "retain"

    def cuDevicePrimaryCtxRelease_v2(self, device):
        self.held -= 1

    def cuCtxPushCurrent_v2(self, context):
        self.current += 1

    def cuCtxPopCurrent_v2(self, context):
        self.current -= 1

    def cuMemGetInfo_v2(self, free, total):
        free._obj.value = 5 * GIB
        return 0 if self.current and self.failing != "info" else 201  # Invalid context


@pytest.mark.parametrize(
    ("failing", "free"), [("", 5 * GIB), ("retain", memory.UNLIMITED), ("info", memory.UNLIMITED)]
)
def test_a_gpu_is_asked_in_its_context(monkeypatch, failing, free):
    driver = Driver(failing)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: driver)
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    assert memory.available() == free
    assert (driver.current, driver.held) == (0, 0)


@pytest.fixture
def gpu_machine(monkeypatch):
    """Return a function that sets the free memory of a GPU and of the host [films of 1 GiB]."""
    monkeypatch.setattr(memory, "_has_own_memory", lambda: True)

    def has(on_device: float, on_host: float) -> None:
        device_bytes = memory.RESERVE + int(on_device * GIB)
        host_bytes = memory.RESERVE + int(on_host * GIB)
        lower(monkeypatch, available_memory=device_bytes, free_memory=host_bytes)

    return has


ONE_GIB = (512, 256, 512, 3)
"""Shape of a film of 1 GiB."""


@pytest.mark.parametrize(
    ("on_device", "on_host", "message"),
    [
        (2, 3, None),
        (1.9, 100, r"takes 2\.0 GiB of GPU memory, must be at most 1\.9 GiB; 486 bins"),
        (100, 2.5, r"takes 3\.0 GiB of host memory, must be at most 2\.5 GiB; 426 bins"),
        (100, 0, r"takes 3\.0 GiB of host memory, must be at most 0\.0 GiB$"),
    ],
)
def test_a_gpu_needs_both_memories(gpu_machine, on_device, on_host, message):
    gpu_machine(on_device, on_host)
    copies = {"copies": 9, "device_copies": 2, "host_copies": 3}
    if message is None:
        memory.require_film(*ONE_GIB, **copies)
    else:
        refused(message, memory.require_film, *ONE_GIB, **copies, kind=MemoryError)


def test_an_array_on_a_gpu_needs_both_memories(gpu_machine):
    gpu_machine(3, 0.5)
    quarter = GIB // 4
    memory.require_array("phasors", quarter, 3)
    message = "phasors: takes 1.0 GiB of host memory, must be at most 0.5 GiB"
    refused(message, memory.require_array, "phasors", quarter, 3, host_copies=1, kind=MemoryError)


@pytest.mark.parametrize(
    ("variant", "own"), [("cuda_ad_mono", True), ("metal_ad_rgb", False), ("llvm_ad_rgb", False)]
)
def test_metal_shares_the_memory_of_the_host(monkeypatch, variant, own):
    monkeypatch.setattr(mi, "variant", lambda: variant)
    assert memory._has_own_memory() is own


@pytest.mark.parametrize(
    ("settings", "films"),
    [
        ({}, 2),  # Dr.Jit's copy, and one to write to
        ({"integrator": "transient_bdpt"}, 3),  # A film for splats comes on top
        ({"errors": True, "spp": 32}, 3.5),  # Two packed films on top
    ],
)
def test_a_render_on_a_gpu_needs_host_memory_for_its_result(gpu_machine, settings, films):
    """A film fits on the GPU, but its result is slightly too large for the host."""
    scene = tofrender.load_scene("cornell_box", width=64, height=48, temporal_bins=100)
    film_gib = memory.film_bytes(48, 64, 100, 3) / GIB
    options = {"spp": 1, "progress": False} | settings
    gpu_machine(100, 0.99 * films * film_gib)
    message = r"film of 64 x 48 pixels x 100 bins: .* of host memory"
    refused(message, tofrender.render, scene, **options, kind=MemoryError)


needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="ulimit -v counts on Linux")


@needs_linux
def test_dr_jit_maps_powers_of_two(machine, monkeypatch):
    machine(64 * GIB)
    monkeypatch.setattr(memory, "address_space", lambda: (8 * GIB, memory.RESERVE + GIB))
    memory.require_film(512, 512, 256, 3)  # exactly 1 GiB
    shape = (512, 512, 257, 3)
    refused(r"at most 1\.0 GiB; 256 bins", memory.require_film, *shape, kind=MemoryError)
    shape = (512, 512, 256, 3)
    refused(r"at most 1\.0 GiB", memory.require_film, *shape, copies=2, kind=MemoryError)


UNDER_A_LIMIT = """
import resource, sys, psutil, mitsuba as mi, tofrender
used = psutil.Process().memory_info().vms
resource.setrlimit(resource.RLIMIT_AS, (used + (1000 << 20), -1))
for bins in (900, 400):  # 900 and 400 MiB, for which 1024 and 512 are mapped
    scene = tofrender.load_scene("cornell_box", width=256, height=256, temporal_bins=bins)
    try:
        print(tofrender.render(scene, spp=1, progress=False).sizes["opl"])
    except MemoryError as error:
        print(error)
"""


@needs_linux
def test_a_limit_on_address_space_refuses_a_film_and_leaves_the_process_alive():
    refused, rendered = says(UNDER_A_LIMIT, **NO_CUDA)
    assert refused.startswith("film of 256 x 256 pixels x 900 bins: takes 0.9 GiB, must be at most")
    assert rendered == "400"


@needs_linux
@pytest.mark.parametrize("kib", [100_000, 420_000])
def test_too_little_address_space_to_start_is_one_line(kib):
    limited = f"ulimit -v {kib}; exec {sys.executable} -c 'import tofrender'"
    result = python(f"import os; os.execvp('sh', ['sh', '-c', {limited!r}])", **NO_CUDA)
    assert result.returncode == 1
    last = result.stderr.splitlines()[-1]
    error = "tofrender.runtime.variants.BackendError"
    assert last.startswith(f"{error}: ulimit -v = {kib}: must be at")


def test_a_film_refuses_before_it_allocates(machine, monkeypatch):
    made = mi.load_dict(film(640, 480, bins=3000, type=OURS))
    machine(GIB)
    monkeypatch.setattr(dr, "zeros", lambda *_: pytest.fail("bins were allocated"))
    refused(r"640 x 480 pixels x 3000 bins: takes 13\.7 GiB", made.prepare, [], kind=MemoryError)
