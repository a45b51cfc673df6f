"""The commands `tofrender release`, `verify`, `start` and `submit`."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from ..course.assignments import find
from ..course.judge.running import TestOutcome, points_of
from ..course.material import points_text
from ..course.rubric import Rubric
from ..runtime.checks import printable
from .options import argument, integer, named, note, say, switch

MAX_SEEDS = 10_000
CHECKS = "structure, edition, starter, reference, solutions, mutants, or a mutant's id"

Name = Annotated[
    str, argument("ASSIGNMENT", "Name of the assignment, for example a2, or its folder.")
]


def release(
    assignment: Name,
    out: Annotated[Path, named("DIR", "Folder in which the edition is made.", "--out", "-o")],
    pdf: Annotated[
        bool, switch("--pdf", "Print the handout as PDF as well, with Chromium.")
    ] = False,
) -> None:
    """Make the students' edition of an assignment.

    The edition is a new folder in DIR. It contains the handout and the package without the modules
    that students write themselves. The command fails if the edition would contain such a module.

    Examples:
        tofrender release a1 -o dist
        tofrender release a2 -o dist --pdf
    """
    from tofrender.course import edition
    from tofrender.course.author.release import PACKAGE_FOLDER, release as make

    found = find(assignment)
    made = make(found, out, pdf=pdf)
    chosen = edition.chosen(found.rubric)
    kinds = ", ".join([".md", ".html", *([".pdf"] if pdf else [])])
    alone = sorted(edition.withheld(found.rubric).keys() - chosen.keys())
    say(f"{made}: README and exercises ({kinds}), figures and {PACKAGE_FOLDER}/")
    say(f"withheld: {', '.join(sorted(chosen))}")
    if alone:
        say(f"also left out, because they need a withheld module: {', '.join(alone)}")
    say(f'students run: pip install "./{PACKAGE_FOLDER}[course]"')


def verify(
    assignment: Name,
    seeds: Annotated[
        int, integer(1, MAX_SEEDS, "Number of seeds with which correct solutions must pass")
    ] = 1,
    wrong: Annotated[
        int | None,
        integer(
            1, MAX_SEEDS, "Number of wrong solutions to try, evenly spread", show_default="all"
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        named("CHECK", f"Run this check only: {CHECKS}. Repeat the option for more checks."),
    ] = None,
) -> None:
    """Check an assignment before its release.

    Correct solutions must get all points and stubs none. Each wrong solution must fail exactly its
    tests. The students' edition must not contain withheld modules. Rubric, tests and handout must
    agree. If a check fails, the exit status is 1.

    Examples:
        tofrender verify a1
        tofrender verify a2 --only solutions --seeds 20
    """
    from rich.console import Console

    from tofrender.course.author.verify import verify as run_checks

    found = find(assignment)
    chosen = tuple(only or ())
    console = Console()
    passed = True
    with console.status("") as status:
        for check in run_checks(found, seeds=seeds, only=chosen, wrong=wrong, say=status.update):
            mark = "ok    " if check.ok else "FAILED"
            lines = [f"{mark}  {check.name:10} {check.seconds:6.1f} s  {check.detail}"]
            lines += [f"        {reason}" for reason in check.reasons]
            text = printable("\n".join(lines))
            console.print(text, markup=False, highlight=False, soft_wrap=True)
            passed &= check.ok
    if not passed:
        raise typer.Exit(1)


def start(
    assignment: Name, folder: Annotated[Path, argument("FOLDER", "New folder to work in.")]
) -> None:
    """Make a folder to work on an assignment.

    The folder contains stubs, tests, handout and notebook of the assignment.

    Examples:
        tofrender start a1 my_a1
        tofrender start a2 ~/course/a2
    """
    from tofrender.course.notebooks import NOTEBOOK
    from tofrender.course.student.folders import start as make

    found = find(assignment)
    made = make(found, folder)
    first = found.rubric.problems[0]
    reading = f"then read README.md, and open {NOTEBOOK} in an editor or Jupyter"
    commands = {
        f"cd {shlex.quote(str(made))}": reading,
        f"pytest -m {first.marker}": f"tests the first problem ({first.file or first.id})",
        "pytest": "tests all of them",
        f"tofrender submit {found.rubric.id} .": "packs what is handed in",
    }
    say(f"{made}: {found.rubric.title}", "Next:")
    say(*(f"  {command:30} {meaning}" for command, meaning in commands.items()))


def submit(
    assignment: Name,
    folder: Annotated[Path, argument("FOLDER", "Folder that `tofrender start` has made.")],
) -> None:
    """Run the public tests and pack the submission.

    The submission is FOLDER.zip next to FOLDER. It is packed even if tests fail.

    Examples:
        tofrender submit a1 my_a1
        tofrender submit a2 .
    """
    from tofrender.course.student import folders

    found = find(assignment)
    folders.check(found, folder)
    folder = folder.resolve()
    say("Running the public tests ...")
    try:
        _table(found.rubric, folders.run_public_tests(found, folder))
    except RuntimeError as error:
        # Tests that cannot run do not prevent handing in
        note(f"warning: {error}")
    handed = folders.pack(found, folder, folder.with_name(f"{folder.name}.zip"))
    for name in handed.missing:
        note(f"warning: {name} is missing")
    for name in handed.unchanged:
        note(f"warning: {name} was not changed")
    say(f"{handed.archive}: {', '.join(handed.files)}")


def _table(rubric: Rubric, outcomes: dict[str, TestOutcome]) -> None:
    """Print the points of each problem, and the failed tests."""
    reached = points_of(rubric, outcomes)
    width = max(len(problem.title) for problem in rubric.problems)
    total = 0.0
    for problem in rubric.problems:
        tests = [test for test in problem.tests if test.id in outcomes]
        public = sum(test.points for test in tests)
        total += 0 if problem.bonus else public
        line = f"{points_text(reached[problem.id]):>5} of {points_text(public)}"
        line += " bonus" if problem.bonus else ""
        if public < problem.points:
            line += f", {points_text(problem.points - public)} from tests that are not public"
        say(f"  {problem.title:{width}}  {line}")
        failed = [test for test in tests if outcomes[test.id].outcome != "passed"]
        unwritten = [t for t in failed if all("not written yet" in s for s in outcomes[t.id].texts)]
        notes = [f"not written yet: {len(unwritten)} tests"] if unwritten else []
        notes += [f"{t.id.partition('::')[2]}: failed" for t in failed if t not in unwritten]
        say(*(f"  {'':{width}}    {note}" for note in notes))
    line = f"{points_text(sum(reached.values())):>5} of {points_text(total)}"
    say(f"  {'Together':{width}}  {line}")
