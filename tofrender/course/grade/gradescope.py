"""Autograder for Gradescope: a zip that sets itself up and grades submissions.

It holds the student edition and the staff's tests, so no solution of the assignment's code lies
where submissions run, but for that of a problem whose task is to test it.
"""

from __future__ import annotations

import re
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

from ...runtime.atomic import replacing
from .. import edition
from ..assignments import PACKAGE, Assignment
from ..student.folders import add_file
from .grading import MEMORY_GIB, TIME_LIMIT_S, drawn_seed, judging_files

SCRIPTS = Path(__file__).parent / "autograder"
CHECKOUT = (".ci/setup", ".ci/requirements.txt", "pyproject.toml", "README.md", "LICENSE")
"""Files of the checkout that the set-up needs."""


def write(
    assignment: Assignment,
    path: Path,
    *,
    time_limit_s: float = TIME_LIMIT_S,
    memory_gib: float = MEMORY_GIB,
    seed: int = 0,
) -> list[str]:
    """Write the zip, whole or not at all; returns the names of the files in it.

    Gradescope's own time limit has to be longer than `time_limit_s`.
    """
    assignment.require_staff("gradescope")
    missing = [name for name in CHECKOUT if not (PACKAGE.parent / name).is_file()]
    if missing:
        raise ValueError(f"{PACKAGE.parent}: has no {missing[0]}; must be the course's checkout")
    folder = f"assignment/{assignment.name}"
    values = {
        "folder": folder,
        "time_limit_s": f"{time_limit_s:g}",
        "memory_gib": f"{memory_gib:g}",
        "seed": str(drawn_seed(assignment, seed)),
    }
    with tempfile.TemporaryDirectory() as scratch, replacing(path) as temporary:
        edition.copy(assignment, Path(scratch))
        with zipfile.ZipFile(temporary, "x", zipfile.ZIP_DEFLATED) as archive:
            for name in ("setup.sh", "run_autograder"):
                text = (SCRIPTS / name).read_text(encoding="utf-8")
                text = re.sub(r"@(\w+)@", lambda found: values[found[1]], text)
                add_file(archive, name, text.encode(), 0o755)
            for name, file in _files(assignment, Path(scratch), folder):
                add_file(archive, name, file.read_bytes())
            return archive.namelist()


def _files(assignment: Assignment, edition: Path, folder: str) -> Iterator[tuple[str, Path]]:
    """Names in the zip, and the files they come from."""
    for name in CHECKOUT:
        yield f"course/{name}", PACKAGE.parent / name
    for file in sorted([*(edition / "tofrender").rglob("*"), edition / "scenes" / "__init__.py"]):
        if file.is_file():
            yield f"course/{file.relative_to(edition).as_posix()}", file
    for file in judging_files(assignment):
        yield f"course/{folder}/{file.relative_to(assignment.folder).as_posix()}", file
