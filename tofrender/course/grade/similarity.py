"""Prepare the programs of a class for JPlag, which finds copies: https://github.com/jplag/JPlag.

JPlag compares the structure of programs. It finds copies with changed names, comments and order,
and ignores the code of files that all students got.
"""

import shlex
import shutil
from collections.abc import Sequence
from pathlib import Path

from ...runtime.atomic import replacing
from ..assignments import Assignment
from ..material import copy_file
from . import unpacking
from .roster import folder_name

# Folders
SUBMISSIONS = "submissions"
BASE = "base"
RESULT = "result"


def write(
    assignment: Assignment, submissions: Sequence[Path], out: Path
) -> tuple[list[str], list[str]]:
    """Write the programs to `OUT/submissions/NAME/*.py`, and the stubs to `OUT/base/`.

    Args:
        assignment: The assignment.
        submissions: Paths of the submissions.
        out: New or empty folder.

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

        # Submissions, without files that all students got
        for number, submission in enumerate(submissions):
            name = folder_name(unpacking.stem_of(submission))
            name = name if name not in written else f"{name}_{number}"
            target = folder / SUBMISSIONS / name
            try:
                names = assignment.rubric.files
                files = set(unpacking.extract(submission, patterns, target, names))
                for file in files & provided:
                    (target / file).unlink()
                if not files - provided:
                    raise unpacking.BadSubmission("contains no programs")
                written.append(name)
            except unpacking.BadSubmission as error:
                reasons.append(f"{submission.name!a}: {error}")
                shutil.rmtree(target, ignore_errors=True)
    return written, reasons


def command(out: Path) -> str:
    """Return the command that compares the programs that `write` wrote."""
    base, result, root = (shlex.quote(str(out / name)) for name in (BASE, RESULT, SUBMISSIONS))
    return f"java -jar jplag.jar -l python3 -bc {base} -r {result} {root}"
