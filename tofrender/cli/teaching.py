"""The commands `tofrender gradescope`, `similarity` and `new-term`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .course import Name
from .grade import MAX_SEED, SEED
from .options import integer, real, say


def gradescope(
    assignment: Name,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="Zip to write: autograder.zip.")
    ],
    time_limit: Annotated[float, real(30, "Seconds for one submission.")] = 540,
    memory: Annotated[float, real(1, "GiB of memory for one submission.")] = 4,
    seed: Annotated[int | None, integer(1, MAX_SEED, SEED)] = None,
) -> None:
    """Make an autograder for Gradescope: setup.sh, run_autograder, and all that they need.

    Upload it as it is. Choose the largest container, and there a limit above --time-limit.
    """
    if out.is_dir():
        raise ValueError(f"--out = {out}: is a folder; must be a file")
    if out.suffix.lower() != ".zip":
        raise ValueError(f"--out = {out}: must end in .zip")
    from ..course.assignments import find
    from ..course.grade import gradescope

    found = find(assignment)
    limits = {"time_limit_s": time_limit, "memory_gib": memory}
    names = gradescope.write(found, out, **limits, seed=seed or 0)
    size = out.stat().st_size / 2**20
    say(f"{out}: {len(names)} files, {size:.1f} MiB; {found.rubric.points:g} points")


def similarity(
    assignment: Name,
    everyone: Annotated[
        Path, typer.Option("--all", metavar="DIR", help="Folder of a class's submissions.")
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="A new folder, for JPlag.")
    ],
) -> None:
    """Put a class's programs where JPlag compares them, and say how to run it.

    Stubs go apart, so that what everybody was given counts for nobody.
    """
    if not everyone.is_dir():
        raise ValueError(f"--all = {everyone}: is no folder; must be one of submissions")
    from ..course.assignments import find
    from ..course.grade import classes, similarity

    found = find(assignment)
    there, reasons = similarity.write(found, classes.submissions_in(everyone, out), out)
    for reason in reasons:
        say(f"warning: {reason}", err=True)
    say(f"{out}: {len(there)} submissions", "Next, with JPlag 5 or newer:")
    say(f"  {similarity.command(out)}")


def new_term(
    assignment: Name,
    term: Annotated[
        int | None, integer(0, MAX_SEED, "The term; 0 is that of the first year. Else drawn.")
    ] = None,
) -> None:
    """Let the public tests ask for other numbers, so that last year's answers fit no more.

    It writes one line of the rubric. Commit it after `tofrender verify` has passed.
    """
    from ..course.assignments import find
    from ..course.author import terms

    found = find(assignment)
    before, now = terms.new_term(found, term)
    say(f"{found.rubric.id}: term {before} is term {now} now", "Next:")
    say(f"  tofrender verify {assignment} --seeds 200", f"  tofrender release {assignment} -o dist")
