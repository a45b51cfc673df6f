"""Run an assignment's tests in a separate pytest process, and read its report."""

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

from ...runtime.backend import NO_VARIANT
from ...runtime.child_processes import safe_environment
from ..assignments import PACKAGE
from ..rubric import Rubric

MAX_REPORT = 64 << 20  # part of a report that is read [bytes]
# Exit statuses of pytest
OK = 0
SOME_FAILED = 1
NONE_COLLECTED = 5
PYTEST_OPTIONS = ("-q", "-p", "no:cacheprovider", "-p", "tofrender.course.judge.plugin")
"""Options of pytest: load the judge's plugin, and do not write a cache."""
REPORTED = {"id", "case", "outcome", "text", "share", "seconds"}  # required keys of a report's line


@dataclass(frozen=True)
class TestOutcome:
    """Outcome of a test, over all its cases and seeds."""

    outcome: str  # "passed", "failed", or "skipped" if all cases were skipped
    texts: tuple[str, ...] = ()  # texts of the failed cases
    fraction: float = 0.0  # fraction of the test's points; the worst case counts
    seconds: float = 0.0  # time of all cases [s]
    cases: int = 1
    seeded: bool = False  # whether the test draws random numbers
    uses: frozenset[str] = frozenset()  # names of the submission that the test used


def run(
    folder: Path,
    *,
    tests: Iterable[str] | None = None,
    submission: Path | None = None,
    edition: Path | None = None,
    seeds: int = 1,
    pytest_options: Sequence[str] = (),
) -> dict[str, TestOutcome]:
    """Run tests of an assignment.

    Args:
        folder: Folder of the assignment, or of a student.
        tests: Ids of the tests; by default all tests.
        submission: Folder that is judged. By default, the setting `submission` in `pytest.ini`
            decides; without this setting, the package itself is judged.
        edition: Folder with the package that the submission imports; by default this package.
        seeds: Number of seeds; random tests are repeated with each seed.
        pytest_options: Further options of pytest. They may exclude all tests.

    Returns:
        Outcomes by the ids of the tests.

    Raises:
        RuntimeError: pytest could not run the tests.
    """
    with tempfile.TemporaryDirectory() as scratch:
        report = Path(scratch) / "report.jsonl"
        options = [f"--report={report}", f"--seeds={seeds}", *pytest_options]
        options += [] if submission is None else [f"--submission={submission.resolve()}"]
        options += [] if tests is None else [f"tests/{test}" for test in tests]
        result = pytest(folder, options, edition)
        lines = read_report(report)

    # Failed tests are a result. Failures without a report mean that pytest could not start
    status = result.returncode
    all_passed = status == OK
    some_failed = status == SOME_FAILED and lines
    none_chosen = status == NONE_COLLECTED and pytest_options
    if not (all_passed or some_failed or none_chosen):
        raise RuntimeError(f"pytest failed in {folder.name}: {last_lines(result)}")
    return outcomes_of(lines)


def read_report(path: Path) -> list[dict[str, Any]]:
    """Read the complete lines of a judge's report, one for each case of a test.

    The result is empty if the file does not exist.
    """
    if not path.is_file():
        return []
    with path.open("rb") as file:
        content = file.read(MAX_REPORT)
    lines = []
    for text in content.decode("utf-8", errors="replace").splitlines():
        with suppress(ValueError):  # The last line is incomplete if the judge was ended
            lines.append(json.loads(text))
    return [line for line in lines if isinstance(line, dict) and line.keys() >= REPORTED]


def outcomes_of(lines: Iterable[dict[str, Any]]) -> dict[str, TestOutcome]:
    """Combine the cases of each test to its outcome. A test fails if one of its cases fails."""
    cases: dict[str, list[dict]] = {}
    for line in lines:
        cases.setdefault(line["id"], []).append(line)
    return {name: _outcome_of(lines) for name, lines in cases.items()}


def _outcome_of(cases: list[dict]) -> TestOutcome:
    """Combine the cases of one test."""
    outcomes = [case["outcome"] for case in cases]
    outcome = next((o for o in ("failed", "passed") if o in outcomes), "skipped")
    return TestOutcome(
        outcome=outcome,
        texts=tuple(case["text"] for case in cases if case["outcome"] == "failed"),
        fraction=min(case["share"] for case in cases),
        seconds=sum(case["seconds"] for case in cases),
        cases=len(cases),
        seeded=any(case["seeded"] for case in cases),
        uses=frozenset(name for case in cases for name in case["uses"]),
    )


def points_of(rubric: Rubric, outcomes: dict[str, TestOutcome]) -> dict[str, float]:
    """Return the points of each problem, by its id.

    A test that passed gives all its points, a failed test the fraction in its outcome.
    """
    none = TestOutcome("skipped")
    return {
        problem.id: math.fsum(t.points * outcomes.get(t.id, none).fraction for t in problem.tests)
        for problem in rubric.problems
    }


def pytest(
    folder: Path, options: Sequence[str], package: Path | None = None
) -> subprocess.CompletedProcess:
    """Run pytest in an assignment's folder, without leaving files there.

    Args:
        folder: Folder of the assignment.
        options: Options of pytest.
        package: Folder of the package `tofrender` that the tests import; by default this package.
    """
    if find_spec("pytest") is None:
        raise ModuleNotFoundError("pytest is missing", name="pytest")

    # Put the package first; an empty entry of PYTHONPATH would be the working folder
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    path = [str((package or PACKAGE.parent).resolve()), *filter(None, inherited)]
    environment = safe_environment(
        PYTHONPATH=os.pathsep.join(path),
        PYTHONDONTWRITEBYTECODE="1",
        PYTEST_ADDOPTS="",
        PYTEST_DISABLE_PLUGIN_AUTOLOAD="1",
        **{NO_VARIANT: "1"},  # Submissions render in processes of their own
    )
    command = [sys.executable, "-P", "-m", "pytest", *PYTEST_OPTIONS, *options]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def last_lines(result: subprocess.CompletedProcess, count: int = 3) -> str:
    """Return the last lines of a process's output as one line; without output, its exit status."""
    lines = [line for line in (result.stdout + result.stderr).splitlines() if line.strip()]
    return " | ".join(lines[-count:]) or f"exit status {result.returncode}"
