"""`tofrender doctor`: check whether rendering works on this machine, and name what helps.

A wrong LLVM aborts the process that loads it. Therefore Mitsuba and Dr.Jit run in subprocesses, and
their failures become lines of the report.
"""

import os
import platform
import re
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING

from . import backend, gpu, llvm, memory
from .child_processes import last_line, run_code

if TYPE_CHECKING:
    from rich.console import Console

# With less memory [bytes], only the smallest pictures can be rendered
LEAST_MEMORY = 2**30
_PIP = f"{sys.executable} -m pip install"

# Ask Dr.Jit for its backends and threads

_ASK_DRJIT = """
import json, drjit as dr, mitsuba as mi
cuda = "cuda_ad_rgb" in mi.variants() and dr.has_backend(dr.JitBackend.CUDA)
metal = "metal_ad_rgb" in mi.variants() and dr.has_backend(dr.JitBackend.Metal)
print(json.dumps({"cuda": cuda, "metal": metal, "threads": dr.thread_count()}))
"""

# Render a small picture, and measure the speed. The first render compiles the kernel
_TEST_RENDER = """
import json, math, time
import tofrender
import drjit as dr, mitsuba as mi
scene = mi.cornell_box()
scene["sensor"]["film"] |= {"width": 64, "height": 64}
scene = mi.load_dict(scene)
mean = dr.mean(mi.render(scene, spp=64), axis=None).array[0]  # compiles the kernel, too
assert math.isfinite(mean) and mean > 0, f"the picture's mean is {mean}"
start, passes = time.perf_counter(), 0
while time.perf_counter() - start < 0.7:
    passes += 1
    dr.eval(mi.render(scene, spp=64, seed=passes))
    dr.sync_thread()
rate = passes * 64**3 / (time.perf_counter() - start)
print(json.dumps({"variant": mi.variant(), "rate": rate}))
"""


@dataclass(frozen=True)
class Check:
    """One line of the report."""

    # Name of the checked part, and whether it works
    name: str
    ok: bool

    # What was found
    detail: str

    # Command or change that helps
    remedy: str = ""

    # Whether rendering requires this part
    required: bool = True


def diagnose() -> list[Check]:
    """Check everything that rendering depends on. This takes a few seconds and never raises."""
    answer = run_code(_ASK_DRJIT).answer
    device = _check_metal(answer) if sys.platform == "darwin" else _check_cuda(answer)
    renders_on_gpu = device.ok and any(answer.get(name) for name in gpu.BACKENDS)
    used = f", Dr.Jit uses {answer['threads']}" if answer.get("threads") else ""
    return [
        Check("Python", True, f"{platform.python_version()} at {sys.executable}"),
        _package("Mitsuba", "mitsuba", "tofrender"),
        _package("Dr.Jit", "drjit", "mitsuba"),
        _check_llvm(required=not renders_on_gpu),
        device,
        Check("Threads", True, f"{backend.cores()} for this process{used}"),
        _check_memory(),
        _check_ffmpeg(),
        _check_render(),
    ]


def report(checks: list[Check], console: "Console | None" = None) -> int:
    """Print the checks and the remedies. Return the exit status, 0 if rendering works.

    A terminal gets a table. Files and pipes get one line for each check, which is never broken.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # Print the checks
    console = console or Console()
    table = Table(show_header=False, box=None, pad_edge=False)
    for check in checks:
        failed = ("FAILED", "red") if check.required else ("missing", "yellow")
        word, style = ("ok", "green") if check.ok else failed
        if console.is_terminal:
            table.add_row(Text(word, style), check.name, Text(check.detail, overflow="fold"))
        else:
            console.out(f"{word:7} {check.name:12} {check.detail}", highlight=False)
    if console.is_terminal:
        console.print(table)

    # Print the remedies
    for check in checks:
        if check.remedy:
            text = Text.assemble("\n", (f"{check.name}: ", "bold"), check.remedy)
            console.print(text, soft_wrap=True)
    console.print(f"\nRendering will {'' if works(checks) else 'not '}work.")
    return 0 if works(checks) else 1


def works(checks: list[Check]) -> bool:
    """Return whether rendering will work."""
    return all(check.ok or not check.required for check in checks)


def main() -> int:
    """Run all checks and print the report. Return the exit status of `tofrender doctor`."""
    from rich.console import Console

    console = Console()
    with console.status("Checking ..."):
        checks = diagnose()
    return report(checks, console)


def _package(name: str, package: str, required_by: str) -> Check:
    """Check that a package is installed in a version that `required_by` accepts.

    Args:
        name: Name in the report.
        package: The package.
        required_by: Package that requires it.
    """
    from packaging.requirements import Requirement

    # Which version is required? A checkout that is not installed has no metadata
    try:
        requirements = map(Requirement, metadata.requires(required_by) or [])
        wanted = next((str(r) for r in requirements if r.name == package), package)
    except metadata.PackageNotFoundError:
        wanted = package

    # Which version is installed?
    remedy = f'{_PIP} "{wanted}"'
    try:
        version = metadata.version(package)
    except metadata.PackageNotFoundError:
        return Check(name, False, "not installed", remedy)
    if not Requirement(wanted).specifier.contains(version, prereleases=True):
        return Check(name, False, f"{version}, but {required_by} needs {wanted}", remedy)
    return Check(name, True, version)


def _check_llvm(required: bool) -> Check:
    """Check that a usable LLVM is installed, and that it can be loaded."""
    # Choose a library, and list the others
    chosen = llvm.choose()
    others = [
        f"{library.path} {library.problem or f'is LLVM {library.major}'}"
        for library in llvm.candidates()
        if chosen is None or library.path != chosen.path
    ]
    also = f"; found too: {', '.join(others)}" if others else ""

    # Report the choice
    if chosen is None:
        found = f"none that is usable{also.replace(' too', '')}"
        return Check("LLVM", False, found, llvm.refusal(), required)
    detail = f"{chosen.major} at {chosen.path}{also}"
    if error := llvm.loading_error(chosen.path):
        return Check("LLVM", False, f"{detail}; {error}", llvm.install_command(), required)
    return Check("LLVM", True, detail)


def _check_cuda(answer: dict) -> Check:
    """Check that CUDA starts and that OptiX traces a ray, given the answer of Dr.Jit."""
    # Why is CUDA missing?
    name = "CUDA, OptiX"
    if not answer.get(gpu.CUDA):
        if not gpu.driver_present():
            return Check(name, True, "no NVIDIA driver; rendering on the CPU")
        if os.environ.get("CUDA_VISIBLE_DEVICES") in ("", "-1"):
            return Check(name, True, "CUDA_VISIBLE_DEVICES hides all GPUs; rendering on the CPU")
        found = "there is a driver that Dr.Jit cannot use; rendering on the CPU"
        remedy = (
            "install NVIDIA driver 535 or newer (see `nvidia-smi`); the GPU must have compute "
            "capability 7.5 or more"
        )
        return Check(name, False, found, remedy, required=False)
    return _check_gpu(name, gpu.CUDA, f"driver {gpu.driver_version() or 'of unknown version'}")


def _check_metal(answer: dict) -> Check:
    """Check that Metal traces a ray, given the answer of Dr.Jit."""
    if not answer.get(gpu.METAL):
        found = "Dr.Jit cannot use Metal here; rendering on the CPU"
        remedy = "update macOS to 15 or newer, if the Mac has an Apple processor"
        return Check("Metal", False, found, remedy, required=False)
    return _check_gpu("Metal", gpu.METAL, f"macOS {platform.mac_ver()[0]}")


def _check_gpu(name: str, backend_name: str, system: str) -> Check:
    """Trace a ray on a GPU, without the stored result of an earlier test."""
    state = gpu.state(backend_name, anew=True)
    if state.works:
        detail = f"traces rays ({system}), and is used unless you name another variant"
        return Check(name, True, detail)
    detail = f"{state.reason} ({system}); rendering on the CPU"
    return Check(name, False, detail, state.remedy, required=False)


def _check_memory() -> Check:
    """Check that enough memory is free."""
    try:
        import psutil
    except ImportError:
        return Check("Memory", False, "cannot be measured without psutil", f"{_PIP} psutil")
    free = memory.free_on_host()
    detail = f"{free / 2**30:.1f} of {psutil.virtual_memory().total / 2**30:.1f} GiB free"
    if free < LEAST_MEMORY:
        remedy = "close other programs, or render with fewer pixels and bins (--size, --bins)"
        return Check("Memory", False, detail, remedy, required=False)
    return Check("Memory", True, detail)


def _check_ffmpeg() -> Check:
    """Check that videos can be encoded."""
    try:
        import imageio_ffmpeg

        path = imageio_ffmpeg.get_ffmpeg_exe()
        version = imageio_ffmpeg.get_ffmpeg_version()
    except (ImportError, RuntimeError, OSError, subprocess.SubprocessError) as error:
        remedy = f"{_PIP} --force-reinstall imageio-ffmpeg"
        if os.environ.get("IMAGEIO_FFMPEG_EXE"):
            remedy = "unset IMAGEIO_FFMPEG_EXE"
        return Check("ffmpeg", False, f"no videos: {last_line(str(error))}", remedy, False)
    return Check("ffmpeg", True, f"{version} at {path}")


def _check_render() -> Check:
    """Render a small picture in a subprocess."""
    outcome = run_code(_TEST_RENDER)
    error = outcome.problem
    if not error:
        rate = outcome.answer["rate"] / 1e6
        variant = outcome.answer["variant"]
        return Check("Test render", True, f"{rate:.2g} million samples/s with {variant}")

    # Choose a remedy. A BackendError names the remedy itself
    if "BackendError: " in error:
        remedy = ""
    elif re.search("cuda|optix|metal", error, re.IGNORECASE):
        remedy = "render on the CPU with --variant llvm_ad_rgb, and update the driver of the GPU"
    elif error.startswith("ended by"):
        remedy = f"try another LLVM: `unset {llvm.VARIABLE}`, or run: {llvm.install_command()}"
    else:
        remedy = f"{_PIP} --force-reinstall mitsuba"
    return Check("Test render", False, re.sub(r"^(\w+\.)+\w+: ", "", error), remedy)
