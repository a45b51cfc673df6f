"""Feedback pages for students, in Markdown and HTML, with points, reasons, pictures and hints."""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ...runtime.atomic import replacing
from .. import pages
from ..judge.expect import HINT
from ..material import points_text
from ..rubric import Problem, name_of
from .classes import Class
from .results import split
from .roster import NOTHING, Standing, folder_name

NAME = "feedback"


def write(class_: Class, folder: Path) -> None:
    """Write `FOLDER/MEMBER/feedback.md` and `.html`, with pictures, for each member of a class."""
    owners: dict[str, str] = {}
    for member in class_.members:
        # Choose a folder name that differs from others also without upper and lower case
        name = folder_name(member.id)
        while owners.setdefault(name.lower(), member.id) != member.id:
            name += "_"

        # Write the pictures and the page
        with replacing(folder / name, folder=True) as inside:
            tests = class_.tests(member)
            for name in {p for test in tests.values() for p in test["extra_data"]["pictures"]}:
                picture = class_.pictures(member) / name
                if picture.is_file():
                    shutil.copyfile(picture, inside / name)
            pages.write(inside, NAME, page(class_.standing(member), tests, inside))


def page(standing: Standing, tests: Mapping[str, Mapping[str, Any]], folder: Path) -> str:
    """Return the page of a student as Markdown.

    Args:
        standing: Points of the student.
        tests: Entries of `results.json`, by the tests' ids.
        folder: Folder of the pictures.
    """
    rubric = standing.rubric
    marks = standing.marks

    # Title and total
    total = f"**{points_text(standing.total)} of {points_text(standing.most)} points**"
    if not standing.graded:
        total = "**Not graded yet**"
    parts = [f"# {pages.plain(rubric.title)}: {pages.plain(standing.member.name)}", total]

    # Late penalty, note of the teacher, remarks of the grader
    if standing.graded and standing.lost:
        days = points_text(marks.late_days)
        free = points_text(rubric.late.free_days)
        text = f"The submission was {days} {'day' if days == '1' else 'days'} late"
        text += f" ({free} without a penalty)" if rubric.late.free_days else ""
        parts.append(f"{text}: {points_text(standing.lost)} points are deducted.")
    if marks.note:
        parts.append(f"> {pages.plain(marks.note)}")
    if standing.content is None:
        parts.append(f"{NOTHING[:1].upper()}{NOTHING[1:]}.")
    elif standing.content["output"]:
        parts.append(pages.verbatim(standing.content["output"]))

    # Table of points
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
        for each in rubric.by_hand
        if each.id in marks.points
    ]
    if standing.graded:
        parts.append(pages.table(["problem", "points", "of"], lines))

    # Details of each problem
    for problem in rubric.problems:
        parts += _problem(problem, standing, tests, folder)
    return "\n\n".join(parts) + "\n"


def _problem(
    problem: Problem, standing: Standing, tests: Mapping[str, Mapping[str, Any]], folder: Path
) -> Iterator[str]:
    """Yield the parts of a problem's section: passed tests, and reasons of failed tests.

    Without failed tests, there is no section.
    """
    judged = [(test, tests[test.id]) for test in problem.tests if test.id in tests]
    failed = [(test, result) for test, result in judged if result["status"] != "passed"]
    if not failed:
        return

    # Heading and passed tests
    points = f"{points_text(standing.points(problem))} of {points_text(problem.points)}"
    yield f"## {pages.plain(problem.title)}: {points}"
    passed = [f"`{name_of(test.id)}`" for test, result in judged if result["status"] == "passed"]
    if passed:
        yield f"Passed: {', '.join(passed)}."

    # A missing file fails all tests for the same reason
    if problem.file and all(f"{problem.file} is missing" in each["output"] for _, each in failed):
        names = ", ".join(f"`{name_of(test.id)}`" for test, _ in failed)
        yield f"`{problem.file}` is missing, therefore these tests fail: {names}."
        return

    # Failed tests; equal reasons are shown once
    shown = ""
    for test, result in failed:
        name = name_of(test.id)
        yield f"### `{name}`: {points_text(result['score'])} of {points_text(test.points)}"
        if test.visibility == "hidden":
            yield "The reason is not shown for this test."
            continue
        reason, hints = split(result["output"], HINT)
        if reason == shown:
            yield "The reason is the same as above."
            continue
        shown = reason
        yield pages.verbatim(reason)
        yield from (f"**Hint:** {pages.plain(hint)}" for hint in hints)
        for picture in result["extra_data"]["pictures"]:
            if (folder / picture).is_file():
                yield f"![Expected and actual values of {name}]({picture})"
