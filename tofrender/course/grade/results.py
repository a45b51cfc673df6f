"""Results of grading: points and reasons for each test, in Gradescope's format."""

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

KEPT_TEXT = 6000  # longest reason of a failed test; longer texts are shortened [characters]


@dataclass
class Grade:
    """Result of one test of a submission."""

    passed: bool = False  # whether all cases passed; then the test gives all its points
    reason: str = "not judged"  # why the test did not pass, for the student
    seconds: float = 0.0  # time of all cases [s]
    fraction: float = 0.0  # fraction of the points that a failed test gives
    pictures: tuple[str, ...] = ()  # file names of pictures of expected and actual values


@dataclass
class Results:
    """Results of a submission. Without grades, no test has been judged."""

    rubric: Rubric
    grades: dict[str, Grade] = field(default_factory=dict)  # by the tests' ids
    remarks: list[str] = field(default_factory=list)  # remarks on the whole submission
    seconds: float = 0.0  # duration of grading [s]
    fingerprint: str = ""  # hash of the tests and the rubric
    complete: bool = False  # whether grading has ended
    seed: int = 0  # seed of the staff's tests
    # actions of a submission that the sandbox could not prevent
    missing_protections: list[str] = field(default_factory=list)
    format: str = "gradescope"  # format of the results file, a key of `formats.FORMATS`

    def grade(self, test: GradedTest) -> Grade:
        """Return the grade of a test."""
        return self.grades.get(test.id, Grade())

    def points(self, test: GradedTest) -> float:
        """Return the points of a test: all points, or a fraction if the test failed."""
        grade = self.grade(test)
        return test.points if grade.passed else round(test.points * grade.fraction, 2)

    def problem_points(self, problem: Problem) -> float:
        """Return the points of all tests of a problem."""
        return math.fsum(map(self.points, problem.tests))

    @property
    def score(self) -> float:
        """Points of all problems, including bonus problems."""
        return math.fsum(map(self.problem_points, self.rubric.problems))

    def summary(self) -> str:
        """Return the remarks, and for each problem the reason of its first failed test.

        Bonus problems are left out.
        """
        reasons = list(self.remarks)
        for problem in self.rubric.problems if self.complete else ():
            lost = [test for test in problem.tests if not self.grade(test).passed]
            if lost and not problem.bonus:
                text = " ".join(printable(self.grade(lost[0]).reason, 300).split())
                reasons.append(f"{problem.id}: {text}")
        return "; ".join(dict.fromkeys(reasons))

    def gradescope(self) -> dict[str, Any]:
        """Return the content of Gradescope's `results.json`.

        Points and tests are missing until grading has ended.
        """
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
        """Return the entry of a test in `results.json`."""
        grade = self.grade(test)
        return {
            "name": f"{problem.id}: {name_of(test.id)}",
            "score": self.points(test),
            "max_score": 0.0 if problem.bonus else test.points,  # The sum is the rubric's maximum
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
        """Write the results file. If this fails, no partial file is left."""
        text = FORMATS[self.format](self.gradescope())
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a results file's content and extra data, both empty if it cannot be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return content, dict(content["extra_data"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}, {}


def seed_of_before(folder: Path) -> int:
    """Return the seed in earlier results of a class, 0 without earlier results.

    All submissions of a class are graded with the same seed.

    Args:
        folder: Folder of the results files.
    """
    seeds = (_read(path)[1].get("seed") for path in sorted(folder.glob("*.json")))
    return next((seed for seed in seeds if isinstance(seed, int) and 0 < seed <= MAX_SEED), 0)


def finished(path: Path, rubric: Rubric, fingerprint: str) -> dict[str, Any] | None:
    """Return the content of a results file, if it is complete and the tests have not changed."""
    content, extra = _read(path)
    same = (extra.get("assignment"), extra.get("fingerprint")) == (rubric.id, fingerprint)
    return content if extra.get("complete") and same else None


def grades_of(
    problem: Problem, lines: Sequence[Mapping[str, Any]], reason: str
) -> dict[str, Grade]:
    """Return the grades of a problem's tests, by the tests' ids.

    Args:
        problem: The problem.
        lines: Lines of the judge's report, in their order, one for each case of a test.
        reason: Why the judge was ended early, "" if it was not. If the judge was ended early,
            cases of the last test may be missing, so this test gives no points.
    """
    grades = {}
    for test in problem.tests:
        # Collect the cases
        cases = [line for line in lines if line["id"] == test.id]
        failed = [line for line in cases if line["outcome"] != "passed"]
        seconds = math.fsum(line["seconds"] for line in cases)
        cut = bool(reason) and bool(lines) and lines[-1]["id"] == test.id

        # Grade the test
        if failed:
            text, names = split("\n\n".join(map(_case, failed[:3])), PICTURE)
            pictures = tuple(f"{problem.marker}-{Path(name).name}" for name in names)
            fraction = 0.0 if cut else min(float(line["share"]) for line in cases)
            grades[test.id] = Grade(
                passed=False, reason=text, seconds=seconds, fraction=fraction, pictures=pictures
            )
        elif cases and not cut:
            grades[test.id] = Grade(passed=True, reason="", seconds=seconds)
        else:
            text = reason or "not judged: the test did not run"
            grades[test.id] = Grade(passed=False, reason=text, seconds=seconds)
    return grades


def printable(text: str, length: int) -> str:
    r"""Remove control characters from a text, and its middle part if it is too long.

    Args:
        text: The text.
        length: Length above which the middle part is removed [characters].

    Example:
        >>> printable("a\x1b[31m\x00b", 100), printable("abcdefgh", 4)
        ('a[31mb', 'ab [...] gh')
    """
    text = "".join(c for c in text if c in "\n\t" or c.isprintable())
    half = length // 2
    return text if len(text) <= length else f"{text[:half]} [...] {text[-half:]}"


def split(text: str, start: str) -> tuple[str, list[str]]:
    """Remove the lines that start with `start` from a text.

    Returns:
        The remaining text, and the ends of the removed lines without duplicates.
    """
    lines = text.split("\n")
    found = dict.fromkeys(line[len(start) :] for line in lines if line.startswith(start))
    return "\n".join(line for line in lines if not line.startswith(start)), list(found)


def _case(line: Mapping[str, Any]) -> str:
    """Return the text of a failed case, with the name of the case."""
    text = line["text"] or line["outcome"]
    return f"case {line['case']}: {text}" if line["case"] else text
