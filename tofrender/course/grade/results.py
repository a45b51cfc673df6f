"""What grading finds out: points and reasons for each test, as Gradescope's JSON and as CSV."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...runtime.atomic import replacing
from ..material import points_text
from ..rubric import GradedTest, Problem, Rubric

KEPT_TEXT = 6000
"""Characters of a test's text that are kept."""


@dataclass
class Grade:
    """What one test of a submission gave.

    Attributes:
        passed: Whether all its cases passed, which gives all its points.
        reason: Why not, as a student reads it.
        seconds: How long it took [s].
    """

    passed: bool = False
    reason: str = "not judged"
    seconds: float = 0.0


@dataclass
class Results:
    """What a submission gets; nothing at first.

    Attributes:
        rubric: The assignment's problems and points.
        grades: By test id; a test without one gives nothing.
        remarks: What concerns the submission as a whole.
        seconds: How long grading took [s].
        fingerprint: Stands for the tests and the rubric that were used.
        complete: Whether grading has ended.
        missing_protections: What the grading machine could not keep the submission from.
    """

    rubric: Rubric
    grades: dict[str, Grade] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    seconds: float = 0.0
    fingerprint: str = ""
    complete: bool = False
    missing_protections: list[str] = field(default_factory=list)

    def grade(self, test: GradedTest) -> Grade:
        """The grade of a test."""
        return self.grades.get(test.id, Grade())

    def points(self, test: GradedTest) -> float:
        """What a test gives: all its points or none."""
        return test.points if self.grade(test).passed else 0.0

    def problem_points(self, problem: Problem) -> float:
        """What all tests of a problem give."""
        return math.fsum(map(self.points, problem.tests))

    @property
    def score(self) -> float:
        """All points, bonus too."""
        return math.fsum(map(self.problem_points, self.rubric.problems))

    def summary(self) -> str:
        """The problems that lost points, with the reason of the first test that did."""
        reasons = list(self.remarks)
        for problem in self.rubric.problems:
            lost = [test for test in problem.tests if not self.grade(test).passed]
            if lost and not problem.bonus:
                reasons.append(f"{problem.id}: {_first_lines(self.grade(lost[0]).reason)}")
        return "; ".join(dict.fromkeys(reasons))

    def gradescope(self) -> dict[str, Any]:
        """The content of `results.json`.

        A bonus test has no maximum of its own there, so that the maximum stays the rubric's.
        """
        problems = self.rubric.problems
        return {
            "score": self.score,
            "execution_time": round(self.seconds, 2),
            "output": "\n".join(self.remarks),
            "visibility": "visible",
            "stdout_visibility": "hidden",
            "tests": [
                self._entry(problem, test)
                for problem in self.rubric.problems
                for test in problem.tests
            ],
            "extra_data": {
                "assignment": self.rubric.id,
                "max_score": self.rubric.points,
                "problems": {p.id: self.problem_points(p) for p in problems},
                "summary": self.summary(),
                "fingerprint": self.fingerprint,
                "complete": self.complete,
                "missing_protections": self.missing_protections,
            },
        }

    def _entry(self, problem: Problem, test: GradedTest) -> dict[str, Any]:
        grade = self.grade(test)
        return {
            "name": f"{problem.id}: {test.id.partition('::')[2] or test.id}",
            "score": self.points(test),
            "max_score": 0.0 if problem.bonus else test.points,
            "status": "passed" if grade.passed else "failed",
            "output": "" if grade.passed else printable(grade.reason, KEPT_TEXT),
            "visibility": test.visibility,
            "tags": [problem.id] + ["bonus"] * problem.bonus,
            "extra_data": {"test": test.id, "execution_time": round(grade.seconds, 2)},
        }

    def write(self, path: Path) -> None:
        """Write `results.json`, whole or not at all."""
        text = json.dumps(self.gradescope(), indent=1, allow_nan=False)
        with replacing(path) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")


def finished(path: Path, rubric: Rubric, fingerprint: str) -> dict[str, Any] | None:
    """What `Results.write` has written, if that grading had ended and was of the same tests."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        extra = content["extra_data"]
        same = (extra["assignment"], extra["fingerprint"]) == (rubric.id, fingerprint)
        return content if extra["complete"] and same else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_csv(path: Path, rubric: Rubric, rows: Mapping[str, Mapping[str, Any]]) -> None:
    """Write a class: a line for each submission, with the total, each problem and the reasons.

    Args:
        path: File to write.
        rubric: The assignment's problems.
        rows: What is in each submission's `results.json`, by the submission's name.
    """
    problems = [problem.id for problem in rubric.problems]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["submission", "total", *problems, "reason"])
        for name, content in rows.items():
            extra = content["extra_data"]
            points = [points_text(extra["problems"][problem]) for problem in problems]
            reason = _cell(extra["summary"])
            writer.writerow([_cell(name), points_text(content["score"]), *points, reason])


def grades_of(
    problem: Problem, lines: Sequence[Mapping[str, Any]], ended: bool, reason: str
) -> dict[str, Grade]:
    """The grades of a problem's tests, from the judge's report.

    Args:
        problem: The problem that was judged.
        lines: The judge's report, a line for each case of a test, in the order of their end.
        ended: Whether the judge came to its end. If not, cases of the last test may be missing.
        reason: Why it did not, and so why a test has no line.

    Returns:
        A `Grade` for each test of the problem, by its id. Passed are tests all of whose cases
        were judged and passed.
    """
    grades = {}
    for test in problem.tests:
        cases = [line for line in lines if line["id"] == test.id]
        failed = [line for line in cases if line["outcome"] != "passed"]
        seconds = math.fsum(line["seconds"] for line in cases)
        cut = not ended and bool(lines) and lines[-1]["id"] == test.id
        if failed:
            text = "\n\n".join(_case(line) for line in failed[:3])
            grades[test.id] = Grade(False, text, seconds)
        elif not cases or cut:
            why = reason or "not judged: the test did not run"
            grades[test.id] = Grade(False, why, seconds)
        else:
            grades[test.id] = Grade(True, "", seconds)
    return grades


def printable(text: str, length: int) -> str:
    r"""Text without control characters, its middle left out if it is too long.

    Example:
        >>> printable("a\x1b[31m\x00b", 100), printable("abcdefgh", 4)
        ('a[31mb', 'ab [...] gh')
    """
    text = "".join(c for c in text if c in "\n\t" or c.isprintable())
    half = length // 2
    return text if len(text) <= length else f"{text[:half]} [...] {text[-half:]}"


def _case(line: Mapping[str, Any]) -> str:
    text = line["text"] or ("skipped" if line["outcome"] == "skipped" else "failed")
    return f"case {line['case']}: {text}" if line["case"] else text


def _first_lines(text: str) -> str:
    return " ".join(printable(text, 300).split())


def _cell(text: str) -> str:
    """Text that no spreadsheet takes for a formula."""
    text = " ".join(printable(text, 2000).split())
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") else text
