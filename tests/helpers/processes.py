"""Python code in a process of its own."""

import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]

GUARD_S = 600.0
"""Where a limit must be given: only what hangs takes so long, on the slowest machine too [s]."""


def python(code: str, **environment: str) -> subprocess.CompletedProcess:
    """Run a script to its end; its working directory is the project's root."""
    options: dict = {"env": os.environ | environment, "cwd": ROOT}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, **options)


def says(code: str, **environment: str) -> list[str]:
    """What a script prints, one entry a line; it must succeed."""
    result = python(code, **environment)
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


def wait_for(what) -> None:
    """Until this is true, or the test's time limit ends it."""
    while not what():
        time.sleep(0.02)
