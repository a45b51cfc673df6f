"""A page for each student, in Markdown and HTML: points, reasons, pictures, hints."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ...runtime.atomic import replacing
from .. import pages
from ..judge.expect import HINT
from ..material import points_text
from ..rubric import Problem
from .classes import Class
from .standing import NOTHING, Standing

NAME = "feedback"


def write(class_: Class, folder: Path) -> None:
    """Write `FOLDER/MEMBER/feedback.md` and `.html`, with pictures, for each of a class."""
    taken: dict[str, str] = {}
    for member in class_.members:
        name = member.folder
        while taken.setdefault(name.lower(), member.id) != member.id:
            name += "_"
        with replacing(folder / name, folder=True) as inside:
            tests: list[Mapping[str, Any]] = []
            if member.submission is not None:
                text = class_.results(member).read_text(encoding="utf-8")
                tests = json.loads(text)["tests"]
                drawn = class_.pictures(member)
                for picture in {p for test in tests for p in test["extra_data"]["pictures"]}:
                    if (drawn / picture).is_file():
                        shutil.copyfile(drawn / picture, inside / picture)
            pages.write(inside, NAME, page(class_.standing(member), tests, inside))


def page(standing: Standing, tests: list[Mapping[str, Any]], folder: Path) -> str:
    """A student's page, as Markdown.

    Args:
        standing: What they get.
        tests: What `results.json` says of each test; none if nothing was handed in.
        folder: Holds the pictures that there are.
    """
    rubric, marks = standing.rubric, standing.marks
    by_hand = [each for each in rubric.by_hand if each.id in marks.points]
    most = rubric.points + sum(each.points for each in by_hand)
    total = f"**{points_text(standing.total)} of {points_text(most)} points**"
    parts = [f"# {pages.plain(rubric.title)}: {pages.plain(standing.member.name)}", total]
    if standing.lost:
        days = points_text(marks.late_days)
        parts.append(
            f"It came {days} days late, {points_text(rubric.late.free_days)} of which cost "
            f"nothing: {points_text(standing.lost)} points are taken off."
        )
    if marks.note:
        parts.append(f"> {pages.plain(marks.note)}")
    if standing.content is None:
        parts.append(f"{NOTHING[:1].upper()}{NOTHING[1:]}.")
    elif standing.content["output"]:
        parts.append(pages.verbatim(standing.content["output"]))
    lines = [
        [
            pages.plain(problem.title),
            points_text(standing.points(problem)) + " (by hand)" * (problem.id in marks.points),
            points_text(problem.points) + " bonus" * problem.bonus,
        ]
        for problem in rubric.problems
    ]
    lines += [
        [pages.plain(each.title), points_text(marks.points[each.id]), points_text(each.points)]
        for each in by_hand
    ]
    parts.append(pages.table(["problem", "points", "of"], lines))
    said = {test["extra_data"]["test"]: test for test in tests}
    for problem in rubric.problems:
        parts += _problem(problem, standing, said, folder)
    return "\n\n".join(parts) + "\n"


def _problem(
    problem: Problem, standing: Standing, said: Mapping[str, Mapping[str, Any]], folder: Path
) -> Iterator[str]:
    """What a problem's tests said, the reasons of those that failed."""
    those = [(test, said[test.id]) for test in problem.tests if test.id in said]
    failed = [(test, came) for test, came in those if came["status"] != "passed"]
    if not failed:
        return
    points = f"{points_text(standing.points(problem))} of {points_text(problem.points)}"
    yield f"## {pages.plain(problem.title)}: {points}"
    passed = [name_of(test.id) for test, came in those if came["status"] == "passed"]
    if passed:
        yield "Passed: " + ", ".join(f"`{name}`" for name in passed) + "."
    shown = ""
    for test, came in failed:
        name = name_of(test.id)
        yield f"### `{name}`: {points_text(came['score'])} of {points_text(test.points)}"
        if test.visibility == "hidden":
            yield "What this test asks for is not shown."
            continue
        reason, hints = split(came["output"])
        if reason == shown:
            yield "As above."
            continue
        shown = reason
        yield pages.verbatim(reason)
        yield from (f"**Hint:** {pages.plain(hint)}" for hint in hints)
        for picture in came["extra_data"]["pictures"]:
            if (folder / picture).is_file():
                yield f"![What {name} expected, and what came]({picture})"


def name_of(test: str) -> str:
    """A test's name without its file.

    Example:
        >>> name_of("test_pulse.py::test_area")
        'test_area'
    """
    return test.partition("::")[2] or test


def split(text: str) -> tuple[str, list[str]]:
    """A failure's text without its hints, and these."""
    lines = text.split("\n")
    hints = dict.fromkeys(line[len(HINT) :] for line in lines if line.startswith(HINT))
    return "\n".join(line for line in lines if not line.startswith(HINT)), list(hints)
