"""The process that grades one of a class: `python -m tofrender.course.grade.one < WISHES`.

What a submission starts ends with it, and nothing that it does to it harms another.
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path
from typing import Any

from ..assignments import Assignment
from ..judge import sandbox
from .grading import Grader, Taken


def main(wishes: dict[str, Any]) -> None:
    """Grade what was taken; the arguments of `Grader` and `Grader.grade` as JSON has them."""
    grader = Grader(
        Assignment(Path(wishes["assignment"])),
        Path(wishes["scratch"]),
        wishes["time_limit_s"],
        wishes["memory_gib"],
        wishes["seed"],
    )
    hidden = [Path(path) for path in wishes["hidden"]]
    out, pictures = Path(wishes["out"]), Path(wishes["pictures"])
    taken = Taken(Path(wishes["taken"]), wishes["refused"])
    grader.grade(taken, out, hidden, pictures)


if __name__ == "__main__":
    if sys.platform.startswith("linux"):
        sandbox.prctl(sandbox.SET_PDEATHSIG, signal.SIGTERM)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: ends what runs
    try:
        main(json.loads(sys.stdin.read()))
    except KeyboardInterrupt:
        sys.exit(130)
