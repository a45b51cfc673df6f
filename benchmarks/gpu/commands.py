"""Run commands as a user does, and without OptiX."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tofrender.runtime import gpu, llvm

from .part import Part

ROOT = Path(__file__).parents[2]

WITHOUT_OPTIX = {gpu.VARIABLE: "/nowhere"}

ON_THE_CPU = "tofrender: rendering on the CPU: "
"""Start of the line that names the reason if a GPU is present but cannot render."""

LONGEST_S = 240.0  # Time limit of a command [s]


def commands(part: Part) -> None:
    """Run `doctor` and a render, with and without OptiX."""
    on_gpu = gpu.is_gpu(part.variant)
    for name in part.each(["without OptiX", "as it is"]):
        environment = WITHOUT_OPTIX if name == "without OptiX" else {}
        if environment and llvm.choose() is None:
            part.skipped.append(f"{name}: LLVM is missing, so nothing can render")
            continue

        # Run the commands
        checked = _command(part, ["doctor"], environment)
        with tempfile.TemporaryDirectory() as folder:
            options = ["--size", "16x12", "--bins", "30", "--spp", "4", "--out", folder]
            rendered = _command(part, ["render", "cornell_box", *options], environment)
            pictures = len(list(Path(folder).glob("frame_*.exr")))
            videos = len(list(Path(folder).glob("*.mp4")))
        part.results[name] = {"doctor": checked, "render": rendered}

        # Both must succeed. One line names the reason if a GPU cannot be used
        part.require(checked["status"] == 0, f"doctor, {name}: status {checked['status']}")
        part.require(rendered["status"] == 0, f"render, {name}: status {rendered['status']}")
        part.require(pictures == 30, f"render, {name}: {pictures} pictures instead of 30")
        part.require(videos == 1, f"render, {name}: {videos} videos instead of 1")
        reasons = [line for line in rendered["output"] if line.startswith(ON_THE_CPU)]
        expected = 1 if on_gpu and environment else 0
        problem = f"render, {name}: {len(reasons)} lines with a reason instead of {expected}"
        part.require(len(reasons) == expected, problem)


def _command(part: Part, arguments: list[str], environment: dict[str, str]) -> dict[str, Any]:
    """Run `tofrender` with arguments; returns its exit status, its output and its time."""
    start = time.monotonic()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "tofrender", *arguments],
            cwd=ROOT,
            env=os.environ | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=max(1.0, min(LONGEST_S, part.left())),
            check=False,
        )
        status = done.returncode
        output = done.stdout
    except subprocess.TimeoutExpired:
        status = -1
        output = "no time left"
    seconds = time.monotonic() - start
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    return {"status": status, "seconds": seconds, "output": lines}
