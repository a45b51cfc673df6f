"""Which machine, devices and versions are checked."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version

import drjit as dr
import mitsuba as mi

import tofrender
from tofrender.runtime import gpu

from .part import Part

PACKAGES = ("mitsuba", "drjit", "mitransient", "numpy", "xarray")


def machine(part: Part) -> None:
    """Describe the machine, and the variant that `tofrender` chooses on it."""
    part.results |= {
        "variant": str(mi.variant()),
        "on_gpu": gpu.is_gpu(mi.variant()),
        "cards": cards(),
        "driver": gpu.driver_version(),
        "system": platform.platform(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "threads": dr.thread_count(),
        "versions": {"tofrender": tofrender.__version__} | installed(),
    }
    part.save()


def cards() -> list[str]:
    """Names of the NVIDIA cards of this machine."""
    command = ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return []
    return found.stdout.splitlines() if found.returncode == 0 else []


def processor() -> str:
    """Name of the processor."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:
            for line in info:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def installed() -> dict[str, str | None]:
    """Version of each package; None if it is not installed."""
    versions: dict[str, str | None] = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = None
    return versions
