"""Overview of a class, in Markdown and HTML: failing tests, likely mistakes, item discrimination.

A failure **looks like** a wrong solution of `mutants.toml` if it fails the same tests of its
problem, or most of them with that mutant's words. An item **separates** if those who pass it have
more points elsewhere.
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
"""Words of a failure without an answer, which looks like no mistake."""
LIKE = 0.5  # fraction of the tests of both that two alike sets of failures have in common
SHOWN = 12  # names of members in a line


@dataclass(frozen=True)
class Result:
    """Test results of a member's submission."""

    member: str  # name
    scores: Mapping[str, float]  # points of each test, by its id
    failures: Mapping[str, str]  # texts of failed tests, by their ids


def write(class_: Class, folder: Path) -> None:
    """Write `overview.md` and `overview.html` into a folder, which exists."""
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
    """Overview as Markdown, from the points of all members and the tests of all submissions."""
    rubric = assignment.rubric
    totals = np.array([each.total for each in standings] or [0.0])
    most = max((each.most for each in standings), default=rubric.points)
    parts = [
        f"# {pages.plain(rubric.title)}: the class",
        f"{len(results)} of {len(standings)} handed in. Points, of {points_text(most)}: "
        f"mean {totals.mean():.1f}, median {np.median(totals):.1f}, "
        f"from {totals.min():.1f} to {totals.max():.1f}.",
        "## Problems",
        _problems(rubric, standings),
        "## Tests",
        "How many failed, and how well the test separates: r is the correlation of its points with "
        "those of all other tests. Above 0.3 is good; below 0, look at the test and at the text.",
        _tests(rubric, results),
        "## What failures look like",
        *_mistakes(assignment, results),
    ]
    return "\n\n".join(parts) + "\n"


def _problems(rubric: Rubric, standings: Sequence[Standing]) -> str:
    lines = []
    for problem in rubric.problems:
        got = np.array([each.points(problem) for each in standings] or [0.0])
        mean = 100 * got.mean() / problem.points if problem.points else 100.0
        most = points_text(problem.points) + " bonus" * problem.bonus
        counts = [str((got >= problem.points).sum()), str((got == 0).sum())]
        lines.append([pages.plain(problem.title), most, f"{mean:.0f} %", *counts])
    return pages.table(["problem", "points", "mean", "all points", "none"], lines)


def _tests(rubric: Rubric, results: Sequence[Result]) -> str:
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
    """Item-rest correlation (Pearson's r) of each item of scores (members, items).

    NaN where all members have equal points.

    Example:
        >>> separation(np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0], [0, 0, 1.0]])).round(2)
        array([ 0.58,  0.58, -0.58])
    """
    found = np.full(scores.shape[1], np.nan)
    for item in range(scores.shape[1]):
        one, rest = scores[:, item], scores.sum(axis=1) - scores[:, item]
        if len(one) > 1 and np.ptp(one) > 0 and np.ptp(rest) > 0:
            found[item] = np.corrcoef(one, rest)[0, 1]
    return found


def _mistakes(assignment: Assignment, results: Sequence[Result]) -> list[str]:
    """Tables of the mutants that failures of each problem look like."""
    known = mutants.read(assignment) if (assignment.folder / "mutants.toml").is_file() else []
    parts = []
    for problem in assignment.rubric.problems:
        seen: dict[str, list[str]] = defaultdict(list)
        unknown: dict[tuple[str, ...], list[str]] = defaultdict(list)
        for result in results:
            if failures := failures_of(result, problem):
                likeliest = likeliest_mutant(failures, problem, known)
                if likeliest is None:
                    unknown[tuple(sorted(failures))].append(result.member)
                else:
                    seen[likeliest.id].append(result.member)
        lines = [
            [f"`{mutant.id}`", pages.plain(mutant.why), _names(seen[mutant.id])]
            for mutant in sorted(known, key=lambda m: -len(seen.get(m.id, ())))
            if mutant.id in seen
        ]
        lines += [
            ["no mutant", "fails " + ", ".join(f"`{name_of(n)}`" for n in names), _names(members)]
            for names, members in sorted(unknown.items(), key=lambda item: -len(item[1]))
        ]
        if lines:
            parts.append(f"### {pages.plain(problem.title)}")
            parts.append(pages.table(["looks like", "what is wrong", "whose"], lines))
    parts.append(
        "What looks like no mutant may be a new mistake: write it into `mutants.toml`."
        if parts
        else "Nobody made a mistake that the tests find."
    )
    return parts


def failures_of(result: Result, problem: Problem) -> dict[str, str]:
    """Texts of a problem's failed tests that had an answer."""
    texts = {t.id: result.failures[t.id] for t in problem.tests if t.id in result.failures}
    return {n: text for n, text in texts.items() if not any(no in text for no in NO_ANSWER)}


def likeliest_mutant(
    failures: Mapping[str, str], problem: Problem, known: Iterable[Mutant]
) -> Mutant | None:
    """Mutant of a problem whose failures are most like these, by test id; None if none is."""
    own = {test.id for test in problem.tests}
    text = "\n".join(failures.values())
    best, most = None, 0.0
    for mutant in known:
        fails = own & set(mutant.fails)
        if mutant.problem != problem.id or not fails:
            continue
        common = len(fails & failures.keys()) / len(fails | failures.keys())
        says = mutant.says in text
        if common >= (LIKE if says else 1.0) and common + says > most:
            best, most = mutant, common + says
    return best


def _names(members: Sequence[str]) -> str:
    shown = ", ".join(pages.plain(name) for name in members[:SHOWN])
    return f"{len(members)}: {shown}" + ", ..." * (len(members) > SHOWN)
