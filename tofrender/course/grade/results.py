"""What grading finds out: points and reasons for each test, as Gradescope's JSON and as CSV."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...runtime.atomic import replacing
from ..judge.expect import PICTURE
from ..rubric import MAX_SEED, GradedTest, Problem, Rubric

KEPT_TEXT = 6000
"""Characters of a test's text that are kept."""


@dataclass
class Grade:
    """What one test of a submission gave.

    Attributes:
        passed: Whether all its cases passed, which gives all its points.
        reason: Why not, as a student reads it.
        seconds: How long it took [s].
        share: Share of the points that it gives all the same.
        pictures: Names of pictures of what was expected and what came.
    """

    passed: bool = False
    reason: str = "not judged"
    seconds: float = 0.0
    share: float = 0.0
    pictures: tuple[str, ...] = ()


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
        seed: Seed of the staff's tests.
        missing_protections: What the grading machine could not keep the submission from.
    """

    rubric: Rubric
    grades: dict[str, Grade] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    seconds: float = 0.0
    fingerprint: str = ""
    complete: bool = False
    seed: int = 0
    missing_protections: list[str] = field(default_factory=list)

    def grade(self, test: GradedTest) -> Grade:
        """The grade of a test."""
        return self.grades.get(test.id, Grade())

    def points(self, test: GradedTest) -> float:
        """What a test gives: all its points, none, or the share that it awards."""
        grade = self.grade(test)
        return test.points if grade.passed else round(test.points * grade.share, 2)

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
                "seed": self.seed,
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
            "extra_data": {
                "test": test.id,
                "execution_time": round(grade.seconds, 2),
                "pictures": list(grade.pictures),
            },
        }

    def write(self, path: Path) -> None:
        """Write `results.json`, whole or not at all."""
        text = json.dumps(self.gradescope(), indent=1, allow_nan=False)
        with replacing(path) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")


def seed_of(path: Path) -> int:
    """The seed of the staff's tests in what `Results.write` has written; 0 if there is none."""
    try:
        seed = json.loads(path.read_text(encoding="utf-8"))["extra_data"]["seed"]
    except (OSError, ValueError, KeyError, TypeError):
        return 0
    return seed if isinstance(seed, int) and 0 <= seed <= MAX_SEED else 0


def finished(path: Path, rubric: Rubric, fingerprint: str) -> dict[str, Any] | None:
    """What `Results.write` has written, if that grading had ended and was of the same tests."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        extra = content["extra_data"]
        same = (extra["assignment"], extra["fingerprint"]) == (rubric.id, fingerprint)
        return content if extra["complete"] and same else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


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
            text, names = _without_pictures(text)
            pictures = tuple(f"{problem.marker}-{name}" for name in names)
            share = 0.0 if cut else min(float(line["share"]) for line in cases)
            grades[test.id] = Grade(False, text, seconds, share, pictures)
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


def _without_pictures(text: str) -> tuple[str, tuple[str, ...]]:
    """A test's text without the places of its pictures, and the names of these."""
    lines = text.split("\n")
    found = tuple(Path(line[len(PICTURE) :]).name for line in lines if line.startswith(PICTURE))
    return "\n".join(line for line in lines if not line.startswith(PICTURE)), found


def _case(line: Mapping[str, Any]) -> str:
    text = line["text"] or ("skipped" if line["outcome"] == "skipped" else "failed")
    return f"case {line['case']}: {text}" if line["case"] else text


def _first_lines(text: str) -> str:
    return " ".join(printable(text, 300).split())
