"""Rubrics: the content of `rubric.toml`, the only file that states points."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path

from . import toml

FILE_NAME = "rubric.toml"
SECONDS_PER_DAY = 86_400
NOT_JUDGED = ("by_hand", "late")  # tables that do not change the results of tests
STAFF_TEST = "*_staff.py"
MAX_SEED = (1 << 31) - 1
FORBIDDEN = ("warps", "integrators", "sampling")
"""Features that an assignment can forbid, see `judge.forbidden`."""
VISIBILITIES = ("visible", "after_due_date", "after_published", "hidden")


@dataclass(frozen=True)
class GradedTest:
    """A test that gives points. A parametrized function is one test with several cases."""

    id: str  # file and function in pytest's notation: "test_pulse.py::test_area"
    points: float
    visibility: str = "visible"  # when students see the result; Gradescope's values

    @property
    def is_staff(self) -> bool:
        """Whether the test is in a file that students do not get."""
        return fnmatch(self.id.partition("::")[0], STAFF_TEST)


@dataclass(frozen=True)
class Problem:
    """A task of an assignment."""

    id: str  # "a2.gaussian_pulse"
    title: str
    tests: tuple[GradedTest, ...]
    file: str = ""  # file that a student writes; "" if the notebook's results are judged
    names: tuple[str, ...] = ()  # names that this file has to define
    reference: str = "tofrender"  # module of the package that defines these names correctly
    # modules and packages that students do not get, because they solve this problem
    withholds: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()  # ids of the problems that this problem's code imports
    forbids: tuple[str, ...] = ()  # words of `FORBIDDEN`, in addition to the assignment's
    # id of another problem, if the task is to write a test that recognizes its wrong solutions
    tests_of: str = ""
    timeout_s: float = 60.0  # longest time of one answer [s]
    takes_s: float = 10.0  # time of the tests with a correct solution, on two cores [s]
    bonus: bool = False  # whether the points are added to the assignment's maximum
    other_points: float = 0.0  # points of the staff's tests, in released rubrics only

    @property
    def marker(self) -> str:
        """Marker of the tests in pytest: "a2_gaussian_pulse"."""
        return self.id.replace(".", "_")

    @property
    def points(self) -> float:
        """Maximum points of the problem."""
        return sum(test.points for test in self.tests) + self.other_points


@dataclass(frozen=True)
class ByHand:
    """A part of an assignment that is graded by hand."""

    id: str  # "a2.exercises"; also the name of a column in the sheet of marks
    title: str
    points: float  # maximum points


@dataclass(frozen=True)
class Late:
    """Penalty for a late submission."""

    free_days: float = 0.0  # days without a penalty
    lost_per_day: float = 0.0  # fraction of the points that each further day costs, from 0 to 1
    deadline: str = ""  # time with its offset, such as "2027-01-31 23:59 +01:00"; "" if unknown

    def lost(self, days: float) -> float:
        """Return the fraction of the points that is lost after `days` late days.

        Example:
            >>> Late(free_days=2, lost_per_day=0.1).lost(5)
            0.3
        """
        return min(1.0, round(self.lost_per_day * max(0.0, days - self.free_days), 10))

    def days(self, handed_in: str) -> int:
        """Return the number of late days of a time stamp; a day that has begun counts.

        Args:
            handed_in: Time with its offset, as in the export of a learning management system.

        Raises:
            ValueError: The text is not such a time, or the rubric has no deadline.

        Example:
            >>> late = Late(deadline="2027-01-31 23:59 +01:00")
            >>> late.days("2027-02-01T01:00:00+01:00"), late.days("2027-01-31 22:58:00 +0000")
            (1, 0)
        """
        if not self.deadline:
            raise ValueError("rubric.toml has no deadline in its table [late]")
        seconds = (time_of(handed_in) - time_of(self.deadline)).total_seconds()
        return max(0, math.ceil(seconds / SECONDS_PER_DAY))


@dataclass(frozen=True)
class Rubric:
    """Problems, points and rules of an assignment, in the order of the handout."""

    id: str  # "a2"
    title: str  # "Time of flight"
    problems: tuple[Problem, ...]
    comparisons: int = 100  # number of statistical comparisons that share the false-alarm rate
    # modules that students do not get, although no single problem asks for them
    also_withhold: tuple[str, ...] = ()
    keeps: tuple[str, ...] = ()  # modules that students get, although their package is withheld
    submit: tuple[str, ...] = ("*.py",)  # patterns of the files that are handed in
    forbids: tuple[str, ...] = ()  # words of `FORBIDDEN` that apply to all problems
    term: int = 0  # chooses the numbers of the public tests, see `tofrender new-term`
    by_hand: tuple[ByHand, ...] = ()
    late: Late = Late()

    @property
    def points(self) -> float:
        """Maximum points, without bonus problems and parts that are graded by hand."""
        return sum(problem.points for problem in self.problems if not problem.bonus)

    @property
    def files(self) -> list[str]:
        """Names of the files that the problems ask for, without duplicates."""
        return list(dict.fromkeys(each.file for each in self.problems if each.file))

    @cached_property
    def problem_by_name(self) -> dict[str, Problem]:
        """Problem that asks for a name, by this name."""
        return {name: problem for problem in self.problems for name in problem.names}

    @cached_property
    def problem_by_test(self) -> dict[str, Problem]:
        """Return the problem of each test, by the test's id."""
        return {test.id: problem for problem in self.problems for test in problem.tests}

    @property
    def public_tests(self) -> list[str]:
        """Ids of the public tests."""
        return [t.id for p in self.problems for t in p.tests if t.visibility == "visible"]

    def needed(self, problem: str) -> set[str]:
        """Return the ids of a problem and of all problems that it needs, also indirectly."""
        needs = {each.id: each.needs for each in self.problems}
        found = {problem}
        while new := {need for name in found for need in needs[name]} - found:
            found |= new
        return found

    @cached_property
    def withheld(self) -> dict[str, str | None]:
        """Withheld modules and packages, with the id of the problem that each solves, or None."""
        modules: dict[str, str | None] = dict.fromkeys(self.also_withhold)
        return modules | {m: problem.id for problem in self.problems for m in problem.withholds}


def name_of(test: str) -> str:
    """Return the name of a test's function from the test's id."""
    return test.partition("::")[2] or test


def time_of(text: str) -> datetime:
    """Convert a text to a time with its offset from UTC.

    Raises:
        ValueError: The text is not a time in the format of ISO 8601, or lacks the offset.
    """
    try:
        compact = re.sub(r"\s+(?=[+-]\d\d:?\d\d$)", "", text.strip())
        found = datetime.fromisoformat(compact.replace(" UTC", "+00:00"))
    except ValueError:
        found = None
    if found is None or found.tzinfo is None:
        example = "2027-01-31 23:59:00 +01:00"
        raise ValueError(f"{text[:40]!r}: must be a time with its offset, such as {example}")
    return found


def read(path: str | Path) -> Rubric:
    """Read a rubric.

    Args:
        path: Path of `rubric.toml` or of its folder.

    Raises:
        FileNotFoundError: The file is missing.
        ValueError: The file is not TOML, or its content is inconsistent.
    """
    path = Path(path)
    path = path / FILE_NAME if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; an assignment's folder needs {FILE_NAME}")

    # Problems and their tests
    content = toml.read(path)
    problems = []
    for table in content.get("problem", []):
        where = f"{path}: problem {table.get('id', len(problems) + 1)!r}"
        tests = tuple(toml.make(GradedTest, test, where) for test in table.get("tests", []))
        problems.append(toml.make(Problem, table | {"tests": tests}, where))

    # The table [assignment]; parts graded by hand and the late penalty have tables next to it
    head = content.get("assignment", {}) | {
        "problems": tuple(problems),
        "by_hand": tuple(
            toml.make(ByHand, table, f"{path}: [[by_hand]]") for table in content.get("by_hand", [])
        ),
        "late": toml.make(Late, content.get("late", {}), f"{path}: [late]"),
    }
    rubric = toml.make(Rubric, head, f"{path}: [assignment]")
    for fault in _faults(rubric):
        raise ValueError(f"{path}: {fault}")
    return rubric


def _faults(rubric: Rubric) -> Iterator[str]:
    """Yield a message for each inconsistency of a rubric."""
    # Unique ids
    ids = [part.id for part in (*rubric.problems, *rubric.by_hand)]
    tests = [test.id for problem in rubric.problems for test in problem.tests]
    for kind, names in (("problem", ids), ("test", tests)):
        for name in sorted(name for name in names if names.count(name) > 1):
            yield f"{kind} {name!r} is defined more than once"
    if not rubric.problems:
        yield "needs at least one [[problem]]"

    # Term, late penalty and parts graded by hand
    if not isinstance(rubric.term, int) or not 0 <= rubric.term <= MAX_SEED:
        yield f"term = {rubric.term}: must be an integer from 0 to {MAX_SEED}"
    late = rubric.late
    if late.deadline:
        try:
            time_of(late.deadline)
        except ValueError as error:
            yield f"[late]: deadline = {error}"
    if not 0 <= late.free_days < math.inf:
        yield f"[late]: free_days = {late.free_days}: must be a number from 0"
    if not 0 <= late.lost_per_day <= 1:
        yield f"[late]: lost_per_day = {late.lost_per_day}: must be a number from 0 to 1"
    start = f"must start with {rubric.id!r} and a dot"
    for part in rubric.by_hand:
        if not part.id.startswith(f"{rubric.id}.") or not 0 <= part.points < math.inf:
            yield f"[[by_hand]] {part.id!r}: the id {start}; points must be 0 or more"

    # Problems
    for problem in rubric.problems:
        where = f"problem {problem.id!r}"
        if not problem.id.startswith(f"{rubric.id}."):
            yield f"{where}: the id {start}"
        if not problem.tests and not problem.other_points:
            yield f"{where}: needs at least one test"
        for word in {*rubric.forbids, *problem.forbids} - set(FORBIDDEN):
            yield f"{where}: forbids {word!r}: must be one of {', '.join(FORBIDDEN)}"
        if problem.timeout_s <= 0:
            yield f"{where}: timeout_s = {problem.timeout_s}: must be above 0"
        for need in problem.needs:
            if need not in ids:
                yield f"{where}: needs {need!r}, which is not a problem of this file"
        if problem.tests_of and (problem.tests_of not in ids or len(problem.names) != 1):
            text = "must be a problem of this file, and names must contain one function"
            yield f"{where}: tests_of = {problem.tests_of!r}: {text}"

        # Tests of the problem
        for test in problem.tests:
            if test.points < 0 or test.visibility not in VISIBILITIES:
                text = f"points must be 0 or more, visibility one of {', '.join(VISIBILITIES)}"
                yield f"{where}: test {test.id!r}: {text}"
