"""A class's programs in the folders that JPlag compares: https://github.com/jplag/JPlag.

JPlag compares the structure of programs, so that other names, comments and orders hide nothing,
and takes off what everybody was given.
"""

from __future__ import annotations

import re
import shlex
import tempfile
from collections.abc import Sequence
from pathlib import Path

from ...runtime.atomic import replacing
from ..assignments import Assignment
from . import unpacking

SUBMISSIONS, BASE, RESULT = "submissions", "base", "result"


def write(
    assignment: Assignment, submissions: Sequence[Path], out: Path
) -> tuple[list[str], list[str]]:
    """Write `OUT/submissions/NAME/*.py` and, in `OUT/base/`, what students start from.

    Args:
        assignment: Says which files are handed in.
        submissions: Folders and zips.
        out: A new folder.

    Returns:
        Names of those that are there, and why others are not, a line each.

    Raises:
        FileExistsError: There is something in `out`.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise FileExistsError(f"--out = {out}: exists; must be a new folder, or an empty one")
    patterns = [pattern for pattern in assignment.rubric.submit if pattern.endswith(".py")]
    patterns = patterns or ["*.py"]
    given = set(assignment.given)
    there, reasons = [], []
    with replacing(out, folder=True) as folder:
        for file in sorted(assignment.starter.glob("*.py")):
            _put(folder / BASE / file.name, file.read_bytes())
        for number, submission in enumerate(submissions):
            name = re.sub(r"[^\w@+-]|^-", "_", submission.stem)[:80]
            name = name if name not in there else f"{name}_{number}"
            with tempfile.TemporaryDirectory() as scratch:
                taken = Path(scratch) / "taken"
                try:
                    names = unpacking.extract(submission, patterns, taken)
                except unpacking.BadSubmission as error:
                    reasons.append(f"{submission.name!a}: {error}")
                    continue
                own = [each for each in names if each not in given]
                if not own:
                    reasons.append(f"{submission.name!a}: has no programs")
                    continue
                for each in own:
                    _put(folder / SUBMISSIONS / name / each, (taken / each).read_bytes())
            there.append(name)
    return there, reasons


def command(out: Path) -> str:
    """The command that compares what `write` has written."""
    base, result, root = (shlex.quote(str(out / name)) for name in (BASE, RESULT, SUBMISSIONS))
    return f"java -jar jplag.jar -l python3 -bc {base} -r {result} {root}"


def _put(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
