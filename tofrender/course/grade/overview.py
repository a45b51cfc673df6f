"""Overview of a class, in Markdown and HTML: failing tests, possible mistakes, item discrimination.

Submissions are grouped by the tests of a problem that they fail. Each group lists all mutants of
`mutants.toml` that fail the same tests, because these tests cannot distinguish the mutants. Mutants
that fail similar tests follow. A test **separates** students if those who pass the test have more
points in other tests.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import mutants, pages
from ..assignments import Assignment
from ..material import points_text
from ..mutants import Mutant
from ..rubric import Problem, Rubric, name_of
from .classes import Class
from .roster import Standing

NAME = "overview"
NO_ANSWER = ("not written yet", "is missing", "not judged")
"""Texts of failures without an answer, which do not identify a mistake."""
LIKE = 0.5  # smallest overlap of failed tests (intersection over union) of a similar mutant
SHOWN = 12  # largest number of names in a cell


@dataclass(frozen=True)
class Result:
    """Results of the tests of a member's submission."""

    member: str  # name of the member
    scores: Mapping[str, float]  # points of each test, by its id
    failures: Mapping[str, str]  # texts of failed tests, by their ids


def write(class_: Class, folder: Path) -> None:
    """Write `overview.md` and `overview.html` into an existing folder."""
    results = []
    for member in class_.members:
        if tests := class_.tests(member):
            scores = {name: float(test["score"]) for name, test in tests.items()}
            failed = {n: test["output"] for n, test in tests.items() if test["status"] != "passed"}
            results.append(Result(member.name, scores, failed))
    standings = [class_.standing(member) for member in class_.members]
    standings = [standing for standing in standings if standing.graded]
    pages.write(folder, NAME, page(class_.grader.assignment, standings, results))


def page(assignment: Assignment, standings: Sequence[Standing], results: Sequence[Result]) -> str:
    """Return the overview as Markdown.

    Args:
        assignment: The assignment.
        standings: Points of all graded members.
        results: Tests of all submissions.
    """
    rubric = assignment.rubric
    totals = np.array([each.total for each in standings] or [0.0])
    most = max((each.most for each in standings), default=rubric.points)
    parts = [
        f"# {pages.plain(rubric.title)}: the class",
        f"{len(results)} of {len(standings)} students handed in a submission. "
        f"Points, of {points_text(most)}: mean {totals.mean():.1f}, "
        f"median {np.median(totals):.1f}, from {totals.min():.1f} to {totals.max():.1f}.",
        "## Problems",
        _problems(rubric, standings),
        "## Tests",
        "Number of failures, and how well a test separates: r is the correlation between the "
        "points of the test and the points of all other tests. A value above 0.3 is good. If r is "
        "below 0, check the test and the handout.",
        _tests(rubric, results),
        "## Which mistakes fail the same tests",
        *_mistakes(assignment, results),
    ]
    return "\n\n".join(parts) + "\n"


def _problems(rubric: Rubric, standings: Sequence[Standing]) -> str:
    """Return the table of problems: mean points, and how many students have all or none."""
    lines = []
    for problem in rubric.problems:
        got = np.array([each.points(problem) for each in standings] or [0.0])
        mean = 100 * got.mean() / problem.points if problem.points else 100.0
        most = points_text(problem.points) + " bonus" * problem.bonus
        counts = [str((got >= problem.points).sum()), str((got == 0).sum())]
        lines.append([pages.plain(problem.title), most, f"{mean:.0f} %", *counts])
    return pages.table(["problem", "points", "mean", "all points", "none"], lines)


def _tests(rubric: Rubric, results: Sequence[Result]) -> str:
    """Return the table of tests: number of failures and discrimination."""
    ids = list(rubric.problem_by_test)
    scores = np.array([[result.scores.get(name, 0.0) for name in ids] for result in results])
    separates = separation(scores.reshape(len(results), len(ids)))
    lines = []
    for name, r in zip(ids, separates, strict=True):
        failed = sum(name in result.failures for result in results)
        percent = f" ({100 * failed / len(results):.0f} %)" if results else ""
        text = "" if np.isnan(r) else f"{r:+.2f}" + " **!**" * bool(r < 0)
        problem = rubric.problem_by_test[name]
        lines.append([problem.id, f"`{name_of(name)}`", f"{failed}{percent}", text])
    return pages.table(["problem", "test", "failed", "r"], lines)


def separation(scores: np.ndarray) -> np.ndarray:
    """Return the item-rest correlation of each test.

    This is Pearson's r between the points of the test and the sum of all other tests.

    Args:
        scores: Points of shape (members, tests).

    Returns:
        Array of shape (tests,). A value is NaN if all members have equal points.

    Example:
        >>> separation(np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0], [0, 0, 1.0]])).round(2)
        array([ 0.58,  0.58, -0.58])
    """
    found = np.full(scores.shape[1], np.nan)
    for item in range(scores.shape[1]):
        points = scores[:, item]
        other_points = scores.sum(axis=1) - points
        if len(points) > 1 and np.ptp(points) > 0 and np.ptp(other_points) > 0:
            found[item] = np.corrcoef(points, other_points)[0, 1]
    return found


def _mistakes(assignment: Assignment, results: Sequence[Result]) -> list[str]:
    """Return a table for each problem with the mutants that fail the same tests."""
    known = mutants.read(assignment) if (assignment.folder / "mutants.toml").is_file() else []
    parts = []
    for problem in assignment.rubric.problems:
        # Group the members by the tests that fail
        groups: dict[tuple[str, ...], list[Result]] = defaultdict(list)
        for result in results:
            if failures := failures_of(result, problem):
                groups[tuple(sorted(failures))].append(result)

        # Frequent groups come first
        lines = []
        for names, members in sorted(groups.items(), key=lambda item: -len(item[1])):
            texts = {name: "\n".join(result.failures[name] for result in members) for name in names}
            found = candidates(texts, problem, known)
            in_problem = {test.id for test in problem.tests}
            mistakes = [
                "(similar tests) " * (in_problem.intersection(mutant.fails) != set(names))
                + f"`{mutant.id}`: {pages.plain(mutant.why)}"
                for mutant in found
            ]
            lines.append(
                [
                    ", ".join(f"`{name_of(name)}`" for name in names),
                    " · ".join(mistakes) or "no mutant",
                    separating(found, assignment.rubric),
                    _names([result.member for result in members]),
                ]
            )
        if lines:
            parts.append(f"### {pages.plain(problem.title)}")
            head = ["fails", "fails the same tests as", "what separates these", "students"]
            parts.append(pages.table(head, lines))
    parts.append(
        "Several mistakes can fail the same tests, so read the submission before you name a "
        "mistake. A group without a mutant may show a new mistake. Add it to `mutants.toml`."
        if parts
        else "The tests found no mistakes."
    )
    return parts


def failures_of(result: Result, problem: Problem) -> dict[str, str]:
    """Return the texts of a problem's failed tests, by id, except failures without an answer."""
    texts = {t.id: result.failures[t.id] for t in problem.tests if t.id in result.failures}
    return {n: text for n, text in texts.items() if not any(no in text for no in NO_ANSWER)}


def candidates(
    failures: Mapping[str, str], problem: Problem, known: Iterable[Mutant]
) -> list[Mutant]:
    """Find the mutants that fail the same tests of a problem, or nearly the same tests.

    Args:
        failures: Texts of the failed tests, by id.
        problem: Problem of the tests.
        known: Mutants of the assignment.

    Returns:
        All mutants with the same failed tests, then those that share half of the tests or more.
        Among equals, a mutant whose text occurs in the failures comes first.
    """
    tests = {test.id for test in problem.tests}
    text = "\n".join(failures.values())
    overlaps = {}
    for mutant in known:
        fails = tests & set(mutant.fails)
        if mutant.problem == problem.id and fails:
            overlap = len(fails & failures.keys()) / len(fails | failures.keys())
            if overlap >= LIKE:
                overlaps[mutant] = overlap
    return sorted(overlaps, key=lambda m: (-overlaps[m], m.says not in text))


def separating(found: Sequence[Mutant], rubric: Rubric) -> str:
    """Describe the tests that only some of several mutants fail.

    Args:
        found: The mutants.
        rubric: Rubric of the assignment. Tests of all problems count.
    """
    if len(found) < 2:
        return ""
    parts = []
    for test in rubric.problem_by_test:
        fails = [f"`{mutant.id}`" for mutant in found if test in mutant.fails]
        if 0 < len(fails) < len(found):
            parts.append(f"only {', '.join(fails)} fails `{name_of(test)}`")
    return "; ".join(parts) or "no test; the texts of the failures may"


def _names(members: Sequence[str]) -> str:
    """Return the number of members, and the first names."""
    shown = ", ".join(pages.plain(name) for name in members[:SHOWN])
    return f"{len(members)}: {shown}" + ", ..." * (len(members) > SHOWN)
