"""Run an assignment's tests in a pytest of their own, and read its report."""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ...runtime.child_processes import safe_environment
from ..assignments import PACKAGE
from ..rubric import Rubric

MAX_REPORT = 64 << 20  # bytes of a report that are read
OK, SOME_FAILED, NONE_COLLECTED = 0, 1, 5
PYTEST_OPTIONS = ("-q", "-p", "no:cacheprovider", "-p", "tofrender.course.judge.plugin")
"""Options of pytest with which it starts no Mitsuba and leaves no files."""
REPORTED = {"id", "case", "outcome", "text", "share", "seconds"}  # keys of a report's line


@dataclass(frozen=True)
class Outcome:
    """Outcome of a test, over all its cases and seeds."""

    outcome: str  # "passed", "failed", or "skipped" if all cases were
    texts: tuple[str, ...] = ()  # of the cases that failed
    fraction: float = 0.0  # fraction of its points: that of its worst case
    seconds: float = 0.0  # of all cases
    cases: int = 1
    seeded: bool = False  # whether the test draws random numbers
    uses: frozenset[str] = frozenset()  # names of the submission that it has used


def run(
    folder: Path,
    *,
    tests: Iterable[str] | None = None,
    submission: Path | None = None,
    edition: Path | None = None,
    seeds: int = 1,
    more: Sequence[str] = (),
) -> dict[str, Outcome]:
    """Run tests of an assignment's folder; the outcomes by the tests' ids.

    By default the submission is the folder in `pytest.ini`, or the package; it imports the package
    of `edition`. `more` are options of pytest, which may choose no test.
    """
    with tempfile.TemporaryDirectory() as scratch:
        report = Path(scratch) / "report.jsonl"
        options = [f"--report={report}", f"--seeds={seeds}", *more]
        options += [] if submission is None else [f"--submission={submission.resolve()}"]
        options += [] if tests is None else [f"tests/{test}" for test in tests]
        result = pytest(folder, options, edition)
        lines = read_report(report)
    ended = result.returncode in (OK, *([NONE_COLLECTED] if more else []))
    if not ended and not (result.returncode == SOME_FAILED and lines):  # It could not start
        raise RuntimeError(f"pytest failed in {folder.name}: {last_lines(result)}")
    return outcomes_of(lines)


def read_report(path: Path) -> list[dict[str, Any]]:
    """Whole lines of a judge's report, one a case of a test; none if there is no report."""
    if not path.is_file():
        return []
    with path.open("rb") as file:
        content = file.read(MAX_REPORT)
    lines = []
    for text in content.decode("utf-8", errors="replace").splitlines():
        with suppress(ValueError):  # the last one, cut off when the judge was ended
            lines.append(json.loads(text))
    return [line for line in lines if isinstance(line, dict) and line.keys() >= REPORTED]


def outcomes_of(lines: Iterable[dict[str, Any]]) -> dict[str, Outcome]:
    """Outcomes of tests from those of their cases: one that fails fails its test."""
    cases: dict[str, list[dict]] = {}
    for line in lines:
        cases.setdefault(line["id"], []).append(line)
    return {name: _outcome_of(lines) for name, lines in cases.items()}


def _outcome_of(cases: list[dict]) -> Outcome:
    outcomes = [case["outcome"] for case in cases]
    outcome = next((o for o in ("failed", "passed") if o in outcomes), "skipped")
    texts = tuple(case["text"] for case in cases if case["outcome"] == "failed")
    return Outcome(
        outcome,
        texts,
        fraction=min(case["share"] for case in cases),
        seconds=sum(case["seconds"] for case in cases),
        cases=len(cases),
        seeded=any(case["seeded"] for case in cases),
        uses=frozenset(name for case in cases for name in case["uses"]),
    )


def points_of(rubric: Rubric, outcomes: dict[str, Outcome]) -> dict[str, float]:
    """Points of each problem: those of its tests that passed, and fractions of others."""
    none = Outcome("skipped")
    return {
        problem.id: math.fsum(t.points * outcomes.get(t.id, none).fraction for t in problem.tests)
        for problem in rubric.problems
    }


def pytest(
    folder: Path, options: Sequence[str], package: Path | None = None
) -> subprocess.CompletedProcess:
    """Run pytest in an assignment's folder, quietly, and leave nothing there."""
    if find_spec("pytest") is None:
        raise ModuleNotFoundError("pytest is missing", name="pytest")
    # An empty entry would be the working folder
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    path = [str((package or PACKAGE.parent).resolve()), *filter(None, inherited)]
    environment = safe_environment(
        PYTHONPATH=os.pathsep.join(path),
        PYTHONDONTWRITEBYTECODE="1",
        PYTEST_ADDOPTS="",
        PYTEST_DISABLE_PLUGIN_AUTOLOAD="1",
    )
    command = [sys.executable, "-P", "-m", "pytest", *PYTEST_OPTIONS, *options]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def last_lines(result: subprocess.CompletedProcess, count: int = 3) -> str:
    """End of a process's output."""
    lines = [line for line in (result.stdout + result.stderr).splitlines() if line.strip()]
    return " | ".join(lines[-count:]) or f"exit status {result.returncode}"
