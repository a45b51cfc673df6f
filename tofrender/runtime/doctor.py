"""`tofrender doctor`: whether rendering works on this machine, and which command helps if not.

A wrong LLVM aborts the process that loads it, so Mitsuba and Dr.Jit run in subprocesses, whose
failures become lines of the report.
"""

import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from . import backend, llvm, memory

if TYPE_CHECKING:
    from rich.console import Console

LEAST_MEMORY = 2**30  # Bytes below which only the smallest pictures can be rendered
_PIP = f"{sys.executable} -m pip install"

_ASK_DRJIT = """
import json, drjit as dr
cuda = dr.has_backend(dr.JitBackend.CUDA)
print(json.dumps({"cuda": cuda, "threads": dr.thread_count()}))
"""

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

    name: str
    ok: bool
    detail: str  # What was found
    remedy: str = ""  # Command or change that helps
    required: bool = True  # Whether rendering fails without it


def diagnose() -> list[Check]:
    """Check everything that rendering depends on; takes a few seconds and never raises."""
    answer, _ = _in_process(_ASK_DRJIT)
    cuda = bool(answer.get("cuda"))
    used = f", Dr.Jit uses {answer['threads']}" if answer.get("threads") else ""
    return [
        Check("Python", True, f"{platform.python_version()} at {sys.executable}"),
        _package("Mitsuba", "mitsuba", "tofrender"),
        _package("Dr.Jit", "drjit", "mitsuba"),
        _check_llvm(required=not cuda),
        _check_cuda(cuda),
        Check("Threads", True, f"{backend.cores()} for this process{used}"),
        _check_memory(),
        _check_ffmpeg(),
        _check_render(),
    ]


def report(checks: list[Check], console: "Console | None" = None) -> int:
    """Print a table of the checks and the remedies; returns the exit status, 0 if all will work."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = console or Console()
    table = Table(show_header=False, box=None, pad_edge=False)
    for check in checks:
        failed = ("FAILED", "red") if check.required else ("missing", "yellow")
        mark = Text(*(("ok", "green") if check.ok else failed))
        table.add_row(mark, check.name, Text(check.detail, overflow="fold"))
    console.print(table)
    for check in checks:
        if check.remedy:
            text = Text.assemble("\n", (f"{check.name}: ", "bold"), check.remedy)
            console.print(text, soft_wrap=True)
    console.print(f"\nRendering will {'' if works(checks) else 'not '}work.")
    return 0 if works(checks) else 1


def works(checks: list[Check]) -> bool:
    """Whether rendering will work."""
    return all(check.ok or not check.required for check in checks)


def main() -> int:
    """Diagnose and report; returns the exit status of `tofrender doctor`."""
    from rich.console import Console

    console = Console()
    with console.status("Checking ..."):
        checks = diagnose()
    return report(checks, console)


def _package(name: str, package: str, required_by: str) -> Check:
    """Check that a package is installed in a version that `required_by` accepts."""
    from packaging.requirements import Requirement

    try:
        requirements = map(Requirement, metadata.requires(required_by) or [])
        wanted = next((str(r) for r in requirements if r.name == package), package)
    except metadata.PackageNotFoundError:  # run from a checkout that was not installed
        wanted = package
    remedy = f'{_PIP} "{wanted}"'
    try:
        version = metadata.version(package)
    except metadata.PackageNotFoundError:
        return Check(name, False, "not installed", remedy)
    if not Requirement(wanted).specifier.contains(version, prereleases=True):
        return Check(name, False, f"{version}, but {required_by} needs {wanted}", remedy)
    return Check(name, True, version)


def _check_llvm(required: bool) -> Check:
    chosen = llvm.choose()
    others = [
        f"{library.path} {library.problem or f'is LLVM {library.major}'}"
        for library in llvm.candidates()
        if chosen is None or library.path != chosen.path
    ]
    also = f"; found too: {', '.join(others)}" if others else ""
    if chosen is None:
        found = f"none that is usable{also.replace(' too', '')}"
        return Check("LLVM", False, found, llvm.refusal(), required)
    detail = f"{chosen.major} at {chosen.path}{also}"
    if error := llvm.loading_error(chosen.path):
        return Check("LLVM", False, f"{detail}; {error}", llvm.install_command(), required)
    return Check("LLVM", True, detail)


def _check_cuda(works: bool) -> Check:
    if works:
        return Check("CUDA", True, "works, and is used unless you name another variant")
    if Path("/proc/driver/nvidia/version").exists() or shutil.which("nvidia-smi"):
        remedy = "update the NVIDIA driver (see `nvidia-smi`), or render with llvm_* variants"
        return Check("CUDA", False, "there is a driver that Dr.Jit cannot use", remedy, False)
    return Check("CUDA", True, "no NVIDIA driver; rendering on the CPU")


def _check_memory() -> Check:
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
    try:
        import imageio_ffmpeg

        path = imageio_ffmpeg.get_ffmpeg_exe()
        version = imageio_ffmpeg.get_ffmpeg_version()
    except (ImportError, RuntimeError, OSError, subprocess.SubprocessError) as error:
        remedy = f"{_PIP} --force-reinstall imageio-ffmpeg"
        if os.environ.get("IMAGEIO_FFMPEG_EXE"):
            remedy = "unset IMAGEIO_FFMPEG_EXE"
        return Check("ffmpeg", False, f"no videos: {_last_line(str(error))}", remedy, False)
    return Check("ffmpeg", True, f"{version} at {path}")


def _check_render() -> Check:
    answer, error = _in_process(_TEST_RENDER)
    if not error:
        rate = answer["rate"] / 1e6
        return Check("Test render", True, f"{rate:.2g} million samples/s with {answer['variant']}")
    if llvm.choose() is None:
        error, remedy = "no usable LLVM", ""  # which stands at LLVM
    elif "BackendError: " in error:
        remedy = ""  # which the error says itself
    elif error.startswith("ended by"):
        remedy = f"try another LLVM: `unset {llvm.VARIABLE}`, or run: {llvm.install_command()}"
    else:
        remedy = f"{_PIP} --force-reinstall mitsuba"
    return Check("Test render", False, re.sub(r"^(\w+\.)+\w+: ", "", error), remedy)


def _in_process(code: str) -> tuple[dict, str]:
    """Run Python code in a subprocess: the JSON object it prints, or what went wrong."""
    command = [sys.executable, "-P", "-c", code]  # Without the working folder's modules
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except subprocess.TimeoutExpired:
        return {}, "not finished after 120 seconds"
    except OSError as error:
        return {}, str(error)
    if result.returncode < 0:
        last = _last_line(result.stderr)
        ended_by = f"ended by {signal.Signals(-result.returncode).name}"
        return {}, f"{ended_by} ({last})" if last else ended_by
    if result.returncode > 0:
        return {}, _last_line(result.stderr) or f"exit status {result.returncode}"
    return json.loads(_last_line(result.stdout)), ""


def _last_line(text: str) -> str:
    """Last line of an output, where Python names the exception."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else ""
