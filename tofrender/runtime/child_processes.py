"""Start Python processes that do not import from the working folder, and run code in them.

Python puts the working folder first on the path of `python -c` and `python -m`, and also of helper
processes such as the tracker of `multiprocessing`. A file `selectors.py` in a downloaded folder
would then run instead of the standard library's module. The variable `PYTHONSAFEPATH` (Python 3.11)
prevents this in a process and in all its children.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

SAFE_PATH = "PYTHONSAFEPATH"


def safe_environment(**more: str) -> dict[str, str]:
    """Return the environment of a new Python process, with more variables.

    Example:
        >>> safe_environment(LANG="C")["PYTHONSAFEPATH"], safe_environment(LANG="C")["LANG"]
        ('1', 'C')
    """
    return os.environ | {SAFE_PATH: "1"} | more


@contextmanager
def safe_children() -> Iterator[None]:
    """Set the variable for processes that other packages start inside the block."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(SAFE_PATH, None)
        else:
            os.environ[SAFE_PATH] = before


CODE_TIMEOUT_S = 120
"""Time after which code that runs in a process of its own is given up [s]."""


@dataclass(frozen=True)
class Outcome:
    """Result of code that ran in a separate process."""

    answer: dict  # The JSON object that the code has printed
    problem: str = ""  # In one line, what went wrong; empty if nothing did
    stderr: str = ""


def run_code(code: str) -> Outcome:
    """Run Python code that prints a JSON object in a separate process."""
    command = [sys.executable, "-P", "-c", code]  # Without the working folder's modules
    try:
        result = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=CODE_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Outcome({}, f"not finished after {CODE_TIMEOUT_S} seconds")
    except OSError as error:
        return Outcome({}, str(error))

    last = last_line(result.stderr)
    if result.returncode < 0:
        ended_by = f"ended by {signal.Signals(-result.returncode).name}"
        return Outcome({}, f"{ended_by} ({last})" if last else ended_by, result.stderr)
    if result.returncode > 0:
        return Outcome({}, last or f"exit status {result.returncode}", result.stderr)
    try:
        answer = json.loads(last_line(result.stdout))
    except ValueError:
        return Outcome({}, last or "ended without a result", result.stderr)
    return Outcome(answer, stderr=result.stderr)


def last_line(text: str) -> str:
    """Return the last line of an output, in which Python names the exception."""
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else ""
