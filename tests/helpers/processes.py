"""Python code in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def python(code: str, **environment: str) -> subprocess.CompletedProcess:
    """Run a script to its end; its working directory is the project's root."""
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def says(code: str, **environment: str) -> list[str]:
    """What a script prints, one entry a line; it must succeed."""
    result = python(code, **environment)
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()
