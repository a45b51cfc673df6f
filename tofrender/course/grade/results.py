"""Results of grading: points and reasons for each test, as Gradescope's JSON."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...runtime.atomic import replacing
from ..judge.expect import PICTURE
from ..rubric import MAX_SEED, GradedTest, Problem, Rubric, name_of
from .formats import FORMATS

KEPT_TEXT = 6000  # characters of a test's text


@dataclass
class Grade:
    """Result of one test of a submission."""

    passed: bool = False  # in all its cases, which gives all its points
    reason: str = "not judged"  # why not, as a student reads it
    seconds: float = 0.0
    fraction: float = 0.0  # fraction of the points that a failed test gives
    pictures: tuple[str, ...] = ()  # file names of pictures of expected and actual values


@dataclass
class Results:
    """Results of a submission; not graded at first."""

    rubric: Rubric
    grades: dict[str, Grade] = field(default_factory=dict)  # by test id
    remarks: list[str] = field(default_factory=list)  # about the submission as a whole
    seconds: float = 0.0  # duration of grading [s]
    fingerprint: str = ""  # hash of the tests and the rubric
    complete: bool = False  # whether grading has ended
    seed: int = 0  # of the staff's tests
    missing_protections: list[str] = field(default_factory=list)  # of the sandbox
    format: str = "gradescope"  # of the file, of `formats.FORMATS`

    def grade(self, test: GradedTest) -> Grade:
        """Grade of a test."""
        return self.grades.get(test.id, Grade())

    def points(self, test: GradedTest) -> float:
        """Points of a test: all, none, or the fraction that it awards."""
        grade = self.grade(test)
        return test.points if grade.passed else round(test.points * grade.fraction, 2)

    def problem_points(self, problem: Problem) -> float:
        """Points of all tests of a problem."""
        return math.fsum(map(self.points, problem.tests))

    @property
    def score(self) -> float:
        """All points, bonus too."""
        return math.fsum(map(self.problem_points, self.rubric.problems))

    def summary(self) -> str:
        """Problems that lost points, with the reason of the first test that did."""
        reasons = list(self.remarks)
        for problem in self.rubric.problems if self.complete else ():
            lost = [test for test in problem.tests if not self.grade(test).passed]
            if lost and not problem.bonus:
                text = " ".join(printable(self.grade(lost[0]).reason, 300).split())
                reasons.append(f"{problem.id}: {text}")
        return "; ".join(dict.fromkeys(reasons))

    def gradescope(self) -> dict[str, Any]:
        """Content of `results.json`; before grading has ended it is without points and tests."""
        problems = self.rubric.problems if self.complete else ()
        tests = [self._entry(problem, test) for problem in problems for test in problem.tests]
        points = {"score": self.score} if self.complete else {}
        return points | {
            "execution_time": round(self.seconds, 2),
            "output": "\n".join(self.remarks),
            "visibility": "visible",
            "stdout_visibility": "hidden",
            "tests": tests,
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
            "name": f"{problem.id}: {name_of(test.id)}",
            "score": self.points(test),
            "max_score": 0.0 if problem.bonus else test.points,  # so that all are the rubric's
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
        """Write the results file, whole or not at all."""
        text = FORMATS[self.format](self.gradescope())
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Content of a results file and its extra data; empty if it is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return content, dict(content["extra_data"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}, {}


def seed_of_before(folder: Path) -> int:
    """Seed with which some of a class were graded, so that all of it gets the same; or 0."""
    seeds = (_read(path)[1].get("seed") for path in sorted(folder.glob("*.json")))
    return next((seed for seed in seeds if isinstance(seed, int) and 0 < seed <= MAX_SEED), 0)


def finished(path: Path, rubric: Rubric, fingerprint: str) -> dict[str, Any] | None:
    """Content of a results file, if that grading had ended and was of the same tests."""
    content, extra = _read(path)
    same = (extra.get("assignment"), extra.get("fingerprint")) == (rubric.id, fingerprint)
    return content if extra.get("complete") and same else None


def grades_of(
    problem: Problem, lines: Sequence[Mapping[str, Any]], reason: str
) -> dict[str, Grade]:
    """Grades of a problem's tests by id, from the lines of the judge's report, in their order.

    If the judge was ended early, for a `reason`, cases of the last test may be missing.
    """
    grades = {}
    for test in problem.tests:
        cases = [line for line in lines if line["id"] == test.id]
        failed = [line for line in cases if line["outcome"] != "passed"]
        seconds = math.fsum(line["seconds"] for line in cases)
        cut = bool(reason) and bool(lines) and lines[-1]["id"] == test.id
        if failed:
            text, names = split("\n\n".join(map(_case, failed[:3])), PICTURE)
            pictures = tuple(f"{problem.marker}-{Path(name).name}" for name in names)
            fraction = 0.0 if cut else min(float(line["share"]) for line in cases)
            grades[test.id] = Grade(False, text, seconds, fraction, pictures)
        elif cases and not cut:
            grades[test.id] = Grade(True, "", seconds)
        else:
            grades[test.id] = Grade(False, reason or "not judged: the test did not run", seconds)
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


def split(text: str, start: str) -> tuple[str, list[str]]:
    """Text without the lines that start so, and the different rests of these."""
    lines = text.split("\n")
    found = dict.fromkeys(line[len(start) :] for line in lines if line.startswith(start))
    return "\n".join(line for line in lines if not line.startswith(start)), list(found)


def _case(line: Mapping[str, Any]) -> str:
    text = line["text"] or line["outcome"]
    return f"case {line['case']}: {text}" if line["case"] else text
