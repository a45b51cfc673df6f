"""Whether Mitsuba can trace rays on a GPU of this machine, and the remedy if it cannot.

CUDA alone is not enough. Mitsuba traces rays with OptiX, which is another library of the NVIDIA
driver. Dr.Jit loads OptiX with the first scene, and many machines have CUDA without OptiX: WSL 2,
containers without the capability `graphics`, and hosts without the package `libnvidia-gl`. On a
Mac, Metal can fail in the same way. A test process therefore traces one ray to a cube. The result
is stored, so that later starts do not repeat the test.
"""

import ctypes
import json
import os
import platform
import re
import shutil
import sys
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path

from . import llvm
from .atomic import replacing
from .child_processes import run_code

CUDA = "cuda"
METAL = "metal"
BACKENDS = (CUDA, METAL)
"""Names of the backends that render on a GPU, in the order of preference."""

VARIABLE = "DRJIT_LIBOPTIX_PATH"
OPTIX = "libnvoptix.so.1"

SETUP_PAGE = "https://mitsuba.readthedocs.io/en/stable/src/optix_setup.html"

MOST_STORED = 100  # Results in the file, which many machines may share

DRIVER_FILE = Path("/proc/driver/nvidia/version")

# Trace one ray from z = 3 to a cube. The top of the cube is at z = 1.
_TRACE_A_RAY = """
import json, mitsuba as mi
mi.set_variant({variant!r})
scene = mi.load_dict({{"type": "scene", "shape": {{"type": "cube"}}}})
distance = scene.ray_intersect(mi.Ray3f([0.1, 0.2, 3], [0, 0, -1])).t[0]
assert abs(distance - 2) < 1e-3, f"a ray of length 2 has length {{distance}}"
print(json.dumps({{}}))
"""


@dataclass(frozen=True)
class State:
    """Result of the test of one GPU backend."""

    works: bool
    reason: str = ""  # Why the backend cannot trace a ray
    remedy: str = ""  # Command or change that helps


def backend_of(variant: str | None) -> str | None:
    """Return the GPU backend of a variant; None for variants that use the CPU.

    Example:
        >>> backend_of("metal_ad_mono"), backend_of("llvm_ad_rgb")
        ('metal', None)
    """
    name = (variant or "").partition("_")[0]
    return name if name in BACKENDS else None


def is_gpu(variant: str | None) -> bool:
    """Return whether a variant renders on a GPU."""
    return backend_of(variant) is not None


def state(backend: str, anew: bool = False) -> State:
    """Test whether a GPU backend that Dr.Jit has started can trace a ray.

    Args:
        backend: "cuda" or "metal".
        anew: Whether to ignore the stored result.

    Returns:
        The result. It is stored for this machine, its driver, and the versions of Mitsuba and
        Dr.Jit. A lack of free GPU memory is not stored, because it goes away.
    """
    if backend == CUDA:
        missing = _missing_optix()
        if missing is not None:
            return missing

    # Use the stored result
    key = _key(backend)
    if not anew:
        known = _stored().get(key)
        if known is not None:
            return known

    # Trace a ray in another process
    result = run_code(_TRACE_A_RAY.format(variant=f"{backend}_ad_rgb"))
    found = diagnosis(backend, result.problem, result.stderr) if result.problem else State(True)

    # Store the result. Other processes may have stored theirs in the meantime
    stored = _stored()
    stored.pop(key, None)
    if found.reason != NO_MEMORY:
        stored[key] = found
    _store(stored)
    return found


def diagnosis(backend: str, problem: str, output: str) -> State:
    """Return the state for a test process that failed.

    Args:
        backend: "cuda" or "metal".
        problem: How the test process ended, in one line.
        output: Text that the test process wrote to stderr.
    """
    if backend == METAL:
        return State(False, f"Metal cannot trace a ray ({problem})", f"update macOS, {TEST_AGAIN}")
    if _HELD_BY_THIS_PROCESS in output:
        return State(True)
    for pattern, reason, remedy in _CAUSES:
        if re.search(pattern, output):
            return State(False, reason, remedy)
    reason = f"OptiX cannot trace a ray ({problem})"
    return State(False, reason, f"update the NVIDIA driver, or see {SETUP_PAGE}, {TEST_AGAIN}")


TEST_AGAIN = "then run `tofrender doctor`, which repeats the test"
"""What to do after the remedy of an unknown cause, because its result is stored."""

NO_MEMORY = "the GPU has no free memory"

_HELD_BY_THIS_PROCESS = "CUDA_ERROR_DEVICE_UNAVAILABLE"
"""Error of a GPU that only one process may use, as many clusters set it up.

This process has started CUDA before, so the test process gets no access. That OptiX can be loaded
is then enough.
"""

_CAUSES = (
    (
        "driver of your graphics card buggy",
        "Dr.Jit refuses NVIDIA drivers from 565 to 569, because they compile kernels wrongly",
        "install NVIDIA driver 570 or newer",
    ),
    (
        "graphics driver is too old|driver R535 is required",
        "the NVIDIA driver is too old for OptiX",
        "install NVIDIA driver 535 or newer",
    ),
    (
        "out of memory|OUT_OF_MEMORY|Out of memory",
        NO_MEMORY,
        "end other programs on the GPU, or choose another GPU with CUDA_VISIBLE_DEVICES",
    ),
)
"""Pattern in the output of Dr.Jit, the reason that it means, and the remedy."""


def cuda_driver() -> ctypes.CDLL | None:
    """Load the library of the CUDA driver; None if it is missing."""
    try:
        return ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return None


def driver_present() -> bool:
    """Return whether this machine has an NVIDIA driver, usable or not."""
    return DRIVER_FILE.exists() or shutil.which("nvidia-smi") is not None


def driver_version() -> str:
    """Return the version of the NVIDIA driver, such as "580.95", or its CUDA version.

    Returns an empty string if neither is known.
    """
    try:
        found = re.search(r"\s(\d+\.\d[\d.]*)\s", DRIVER_FILE.read_text())
    except OSError:
        found = None
    if found:
        return found[1]
    driver = cuda_driver()
    number = ctypes.c_int()
    if driver is None or driver.cuDriverGetVersion(ctypes.byref(number)):
        return ""
    return f"CUDA {number.value // 1000}.{number.value % 1000 // 10}"


def devices() -> list[str]:
    """List the CUDA devices of this process, as names for `CUDA_VISIBLE_DEVICES`."""
    driver = cuda_driver()
    count = ctypes.c_int()
    if driver is None or driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)):
        return []
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is None:
        return [str(number) for number in range(count.value)]
    # The driver ignores the names behind the first unknown one
    return [name.strip() for name in visible.split(",")][: count.value]


def _missing_optix() -> State | None:
    """Return the state of a machine without a working OptiX library, or None if it works."""
    if os.name == "nt":  # Dr.Jit searches the folders of the driver, too
        return None
    named = os.environ.get(VARIABLE)
    try:
        ctypes.CDLL(named or OPTIX)
    except OSError:
        if named:
            reason = f"{VARIABLE} = '{named}': OptiX cannot be loaded from there"
            return State(False, reason, f"unset {VARIABLE}, or name the file {OPTIX}")
        return State(False, f"CUDA works, but OptiX ({OPTIX}) is missing", _optix_remedy())
    return None


def _optix_remedy(root: Path = Path("/")) -> str:
    """Return the command or change that adds the OptiX library to this kind of machine."""
    if "microsoft" in platform.uname().release.lower():
        return f"WSL 2 does not bring OptiX; copy it there as {SETUP_PAGE} describes"
    in_container = (root / ".dockerenv").exists() or (root / "run/.containerenv").exists()
    if in_container or "NVIDIA_DRIVER_CAPABILITIES" in os.environ:
        return (
            "start the container with NVIDIA_DRIVER_CAPABILITIES=all, because OptiX needs the "
            "capability `graphics`"
        )
    system = llvm.System()
    sudo = "" if system.euid == 0 else "sudo "
    major = driver_version().partition(".")[0]
    if "ubuntu" in system.distributions and major.isdigit():
        return f"{sudo}apt-get install -y libnvidia-gl-{major}"
    if "debian" in system.distributions:
        return f"{sudo}apt-get install -y libnvoptix1"
    return f"install the part of the NVIDIA driver that contains {OPTIX}"


def _key(backend: str) -> str:
    """Return a text that differs whenever the result of the GPU test may differ."""
    parts = [backend, platform.node(), _version("mitsuba"), _version("drjit"), sys.executable]
    if backend == CUDA:
        parts.append(driver_version())
        for name in (VARIABLE, "DRJIT_LIBCUDA_PATH", "CUDA_VISIBLE_DEVICES", "LD_LIBRARY_PATH"):
            parts.append(f"{name}={os.environ.get(name, '')}")
    else:
        parts.append(platform.mac_ver()[0])
    return " ".join(parts)


def _version(package: str) -> str:
    """Return the version of an installed package, or "" for a build that was not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def _file() -> Path:
    """Return the file that stores the results of GPU tests, in Dr.Jit's folder of kernels."""
    folder = os.environ.get("DRJIT_CACHE_DIR")
    return (Path(folder) if folder else Path.home() / ".drjit") / "tofrender_gpu.json"


def _stored() -> dict[str, State]:
    """Return the stored results by key, or an empty dict if the file is missing or damaged."""
    try:
        held = json.loads(_file().read_text(encoding="utf-8"))
        return {key: State(**each) for key, each in held.items()}
    except (OSError, RuntimeError, ValueError, TypeError, AttributeError):
        return {}


def _store(results: dict[str, State]) -> None:
    """Store the newest results; if the folder is read-only, the next start tests again."""
    newest = list(results.items())[-MOST_STORED:]
    text = json.dumps({key: asdict(each) for key, each in newest})
    try:
        path = _file()
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except (OSError, RuntimeError):
        return
