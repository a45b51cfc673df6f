"""What `rubric.toml` says about an assignment; the only place where points are."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

FILE_NAME = "rubric.toml"
MAX_SEED = MAX_TERM = (1 << 31) - 1
FORBIDDEN = ("warps", "integrators", "light sampling")
"""What a handout may not allow; `judge.forbidden` says what each is."""
VISIBILITIES = ("visible", "after_due_date", "after_published", "hidden")


@dataclass(frozen=True)
class GradedTest:
    """A test that gives points.

    Attributes:
        id: File and function as pytest names them, "test_pulse.py::test_area"; a parametrised
            function is one test, which passes with all its cases.
        points: What it gives; a test that gives a share says so when it runs.
        visibility: When students see its result, one of Gradescope's words.
    """

    id: str
    points: float
    visibility: str = "visible"


@dataclass(frozen=True)
class Problem:
    """A task of an assignment.

    Attributes:
        id: "a2.gaussian_pulse".
        title: What the handout calls it.
        tests: The tests that judge it.
        file: The file that a student writes; "" if the deliverables are judged.
        names: What this file has to define.
        reference: The module of the package in which these names are right.
        withholds: Modules and packages that students do not get, because they solve this problem.
        needs: Problems whose code this one uses.
        forbids: What it may not use, of `FORBIDDEN`; besides the assignment's.
        tests_of: A problem whose right and wrong solutions this one's file has to tell apart: the
            task is to write a test.
        timeout_s: Longest time that one answer of a submission may take [s].
        takes_s: Time that the tests take with right code on two cores [s].
        bonus: Whether the points come on top of the assignment's maximum.
        other_points: What tests give that students do not have; in their rubric only.
    """

    id: str
    title: str
    tests: tuple[GradedTest, ...]
    file: str = ""
    names: tuple[str, ...] = ()
    reference: str = "tofrender"
    withholds: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    forbids: tuple[str, ...] = ()
    tests_of: str = ""
    timeout_s: float = 60.0
    takes_s: float = 10.0
    bonus: bool = False
    other_points: float = 0.0

    @property
    def marker(self) -> str:
        """The pytest marker of its tests: "a2_gaussian_pulse"."""
        return self.id.replace(".", "_")

    @property
    def points(self) -> float:
        """What all its tests give."""
        return sum(test.points for test in self.tests) + self.other_points


@dataclass(frozen=True)
class ByHand:
    """What a person gives points for.

    Attributes:
        id: "a2.exercises"; the column of the sheet that they are written in.
        title: What the handout calls it.
        points: The most that it gives.
    """

    id: str
    title: str
    points: float


@dataclass(frozen=True)
class Late:
    """What handing in late costs.

    Attributes:
        free_days: Days that cost nothing.
        lost_per_day: Share of the points that each further day costs, from 0 to 1.
    """

    free_days: float = 0.0
    lost_per_day: float = 0.0

    def lost(self, days: float) -> float:
        """Share of the points that is lost.

        Example:
            >>> Late(free_days=2, lost_per_day=0.1).lost(5)
            0.3
        """
        return min(1.0, round(self.lost_per_day * max(0.0, days - self.free_days), 10))


@dataclass(frozen=True)
class Rubric:
    """An assignment: its problems in the order of the handout.

    Attributes:
        id: "a2".
        title: "Time of flight".
        problems: All of them.
        comparisons: Statistical comparisons that the chance of a false alarm is split over.
        also_withhold: Modules and packages that students do not get and that solve no one problem.
        keeps: Modules that students do get, though their package is withheld.
        submit: Patterns of the files that are handed in.
        forbids: What no problem may use, of `FORBIDDEN`.
        seed: Seed of the staff's tests; with 0, each grading draws one. Students do not get it.
        term: Chooses the numbers that the public tests ask for; `tofrender new-term` draws one.
        by_hand: What people grade.
        late: What handing in late costs.
    """

    id: str
    title: str
    problems: tuple[Problem, ...]
    comparisons: int = 100
    also_withhold: tuple[str, ...] = ()
    keeps: tuple[str, ...] = ()
    submit: tuple[str, ...] = ("*.py",)
    forbids: tuple[str, ...] = ()
    seed: int = 0
    term: int = 0
    by_hand: tuple[ByHand, ...] = ()
    late: Late = Late()

    @property
    def points(self) -> float:
        """The maximum, without bonus and what people grade."""
        return sum(problem.points for problem in self.problems if not problem.bonus)

    @cached_property
    def home_of(self) -> dict[str, Problem]:
        """The problem in which a name has to be written."""
        return {name: problem for problem in self.problems for name in problem.names}

    @cached_property
    def problem_of(self) -> dict[str, Problem]:
        """The problem that a test judges, by the test's id."""
        return {test.id: problem for problem in self.problems for test in problem.tests}

    @cached_property
    def withheld(self) -> dict[str, str | None]:
        """Modules and packages that students do not get, with the problem that each solves."""
        modules: dict[str, str | None] = dict.fromkeys(self.also_withhold)
        return modules | {m: problem.id for problem in self.problems for m in problem.withholds}


def read(path: str | Path) -> Rubric:
    """Read a rubric.

    Args:
        path: `rubric.toml`, or the folder that it is in.

    Raises:
        FileNotFoundError: There is none.
        ValueError: It does not hold together; one line that names the file and the entry.
    """
    path = Path(path)
    path = path / FILE_NAME if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; an assignment's folder has a {FILE_NAME}")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not TOML: {error}") from None
    problems = []
    for entry in content.get("problem", []):
        where = f"{path}: problem {entry.get('id', len(problems) + 1)!r}"
        tests = tuple(_make(GradedTest, test, where) for test in entry.get("tests", []))
        problems.append(_make(Problem, entry | {"tests": tests}, where))
    by_hand = [_make(ByHand, each, f"{path}: [[by_hand]]") for each in content.get("by_hand", [])]
    head = content.get("assignment", {}) | {"problems": tuple(problems), "by_hand": tuple(by_hand)}
    head["late"] = _make(Late, content.get("late", {}), f"{path}: [late]")
    rubric = _make(Rubric, head, f"{path}: [assignment]")
    _check(rubric, path)
    return rubric


def _make(kind: type, entry: dict[str, Any], where: str) -> Any:
    """An instance of a dataclass from a table of the file, whose lists become tuples."""
    known = kind.__dataclass_fields__
    for key in entry:
        if key not in known:
            raise ValueError(f"{where}: {key!r} is unknown; must be one of {', '.join(known)}")
    entry = {key: tuple(v) if isinstance(v, list) else v for key, v in entry.items()}
    try:
        return kind(**entry)
    except TypeError as error:
        raise ValueError(f"{where}: {str(error).split('__init__() ')[-1]}") from None


def _check(rubric: Rubric, path: Path) -> None:
    """Refuse what does not hold together."""
    ids = [problem.id for problem in rubric.problems]
    ids += [each.id for each in rubric.by_hand]
    tests = [test.id for problem in rubric.problems for test in problem.tests]
    for kind, names in (("problem", ids), ("test", tests)):
        double = sorted({name for name in names if names.count(name) > 1})
        if double:
            raise ValueError(f"{path}: {kind} {double[0]!r} is there more than once")
    if not rubric.problems:
        raise ValueError(f"{path}: has no [[problem]]")
    for name, value in (("term", rubric.term), ("seed", rubric.seed)):
        if not isinstance(value, int) or not 0 <= value <= MAX_TERM:
            raise ValueError(f"{path}: {name} = {value}: must be an integer from 0 to {MAX_TERM}")
    if not 0 <= rubric.late.free_days < math.inf:
        days = rubric.late.free_days
        raise ValueError(f"{path}: [late]: free_days = {days}: must be a number from 0")
    if not 0 <= rubric.late.lost_per_day <= 1:
        share = rubric.late.lost_per_day
        raise ValueError(f"{path}: [late]: lost_per_day = {share}: must be a number from 0 to 1")
    for each in rubric.by_hand:
        if not each.id.startswith(f"{rubric.id}.") or not 0 <= each.points < math.inf:
            raise ValueError(
                f"{path}: [[by_hand]] {each.id!r}: must start with {rubric.id!r} and a dot, and "
                "give 0 points or more"
            )
    for problem in rubric.problems:
        where = f"{path}: problem {problem.id!r}"
        if not problem.id.startswith(f"{rubric.id}."):
            raise ValueError(f"{where}: must start with {rubric.id!r} and a dot")
        if not problem.tests and not problem.other_points:
            raise ValueError(f"{where}: has no tests")
        for word in {*rubric.forbids, *problem.forbids} - set(FORBIDDEN):
            raise ValueError(f"{where}: forbids {word!r}: must be one of {', '.join(FORBIDDEN)}")
        if problem.timeout_s <= 0:
            raise ValueError(f"{where}: timeout_s = {problem.timeout_s}: must be above 0")
        for need in problem.needs:
            if need not in ids:
                raise ValueError(f"{where}: needs {need!r}, which is no problem of this file")
        if problem.tests_of and (problem.tests_of not in ids or len(problem.names) != 1):
            raise ValueError(
                f"{where}: tests_of = {problem.tests_of!r}: must be a problem of this file, and "
                "names one function that tests it"
            )
        for test in problem.tests:
            if test.points < 0 or test.visibility not in VISIBILITIES:
                raise ValueError(
                    f"{where}: test {test.id!r}: points must be 0 or more, visibility one of "
                    f"{', '.join(VISIBILITIES)}"
                )
