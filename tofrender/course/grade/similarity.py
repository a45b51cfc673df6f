"""Programs of a class in the folders that JPlag compares: https://github.com/jplag/JPlag.

JPlag compares the structure of programs, so that other names, comments and orders hide nothing,
and ignores files that everybody was given.
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

SUBMISSIONS, BASE, RESULT = "submissions", "base", "result"


def write(
    assignment: Assignment, submissions: Sequence[Path], out: Path
) -> tuple[list[str], list[str]]:
    """Write `OUT/submissions/NAME/*.py` and the stubs in `OUT/base/`.

    Returns the names of those that are there, and why others are not, a line each.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise FileExistsError(f"--out = {out}: exists; must be a new folder, or an empty one")
    patterns = [p for p in assignment.rubric.submit if p.endswith(".py")] or ["*.py"]
    given = set(assignment.provided_files)
    written, reasons = [], []
    with replacing(out, folder=True) as folder:
        for file in sorted(assignment.starter.glob("*.py")):
            copy_file(file, folder / BASE / file.name)
        for number, submission in enumerate(submissions):
            name = folder_name(unpacking.stem_of(submission))
            name = name if name not in written else f"{name}_{number}"
            target = folder / SUBMISSIONS / name
            try:
                names = assignment.rubric.files
                files = set(unpacking.extract(submission, patterns, target, names))
                for file in files & given:
                    (target / file).unlink()
                if not files - given:
                    raise unpacking.BadSubmission("has no programs")
                written.append(name)
            except unpacking.BadSubmission as error:
                reasons.append(f"{submission.name!a}: {error}")
                shutil.rmtree(target, ignore_errors=True)
    return written, reasons


def command(out: Path) -> str:
    """Command that compares the folders of `write`."""
    base, result, root = (shlex.quote(str(out / name)) for name in (BASE, RESULT, SUBMISSIONS))
    return f"java -jar jplag.jar -l python3 -bc {base} -r {result} {root}"
