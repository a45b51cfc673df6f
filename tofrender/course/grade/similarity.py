"""Prepare the programs of a class for JPlag, which finds copies: https://github.com/jplag/JPlag.

JPlag compares the structure of programs. It finds copies with changed names, comments and order,
and ignores the code of files that all students got.
"""

import shlex
import shutil
from collections.abc import Sequence
from pathlib import Path

from ...runtime.atomic import replacing
from ..assignments import PACKAGE, Assignment
from ..edition import path_of
from ..material import copy_file
from . import unpacking
from .roster import folder_name

# Folders
SUBMISSIONS = "submissions"
BASE = "base"
RESULT = "result"
STAFF = "staff_solutions"
REFERENCE = "package"
OLD = "old"  # programs that submissions are compared with, but that are not compared themselves


def write(
    assignment: Assignment, submissions: Sequence[Path], out: Path, old: Sequence[Path] = ()
) -> tuple[list[str], list[str]]:
    """Write the programs to `OUT/submissions/NAME/*.py`, and the stubs to `OUT/base/`.

    The folder `OUT/old/` gets what submissions can be copied from: the solutions of the staff, the
    package's modules that solve the problems, and submissions of other terms.

    Args:
        assignment: The assignment.
        submissions: Paths of the submissions.
        out: New or empty folder.
        old: Paths of submissions of other terms.

    Returns:
        Names of the written submissions, and a message for each submission that was left out.

    Raises:
        FileExistsError: The folder is not empty.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise FileExistsError(f"--out = {out}: exists; pass a new folder or an empty folder")
    patterns = [p for p in assignment.rubric.submit if p.endswith(".py")] or ["*.py"]
    provided = set(assignment.provided_files)
    written = []
    reasons = []
    with replacing(out, folder=True) as folder:
        # Stubs
        for file in sorted(assignment.starter.glob("*.py")):
            copy_file(file, folder / BASE / file.name)

        # Solutions of the staff, and the package's modules
        for file in sorted(assignment.solutions.glob("*.py")):
            copy_file(file, folder / OLD / STAFF / file.name)
        for problem in assignment.rubric.problems:
            for module in problem.withholds:
                source = PACKAGE / path_of(module)
                found = sorted(source.rglob("*.py")) if source.is_dir() else [source]
                for file in found:
                    copy_file(file, folder / OLD / REFERENCE / file.relative_to(PACKAGE))

        # Submissions, without files that all students got
        names = assignment.rubric.files
        for part, paths in ((SUBMISSIONS, submissions), (OLD, old)):
            taken = {STAFF, REFERENCE} if part == OLD else set()
            for number, submission in enumerate(paths):
                name = folder_name(unpacking.stem_of(submission))
                name = name if name not in taken else f"{name}_{number}"
                target = folder / part / name
                try:
                    files = set(unpacking.extract(submission, patterns, target, names))
                    for file in files & provided:
                        (target / file).unlink()
                    if not files - provided:
                        raise unpacking.BadSubmission("contains no programs")
                except unpacking.BadSubmission as error:
                    reasons.append(f"{submission.name!a}: {error}")
                    shutil.rmtree(target, ignore_errors=True)
                    continue
                taken.add(name)
                if part == SUBMISSIONS:
                    written.append(name)
    return written, reasons


def command(out: Path) -> str:
    """Return the command that compares the programs that `write` wrote."""
    names = (BASE, RESULT, OLD, SUBMISSIONS)
    base, result, old, root = (shlex.quote(str(out / name)) for name in names)
    return f"java -jar jplag.jar -l python3 -bc {base} -r {result} -old {old} {root}"
