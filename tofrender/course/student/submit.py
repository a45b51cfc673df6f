"""Handing in: run the public tests, and pack what is asked for and nothing else."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

from ...runtime import checks
from ...runtime.atomic import replacing
from ..assignments import Assignment
from ..judge import running
from ..notebooks import NOTEBOOK
from .start import stubs

LONG_AGO = (1980, 1, 1, 0, 0, 0)
"""Time of every file in the archive, so that equal content gives equal archives."""

MAX_BYTES = 100 << 20


@dataclass(frozen=True)
class Handed:
    """What was handed in.

    Attributes:
        archive: The archive.
        files: What it holds.
        missing: Files or patterns that were asked for and are not there.
        unchanged: Files that are as they came.
    """

    archive: Path
    files: tuple[str, ...]
    missing: tuple[str, ...]
    unchanged: tuple[str, ...]


def check(assignment: Assignment, folder: Path) -> tuple[dict[str, Path], list[str]]:
    """The files that `submit` asks for by their names, and what of it is not there.

    Args:
        assignment: Says what is asked for.
        folder: A student's folder.

    Raises:
        ValueError: It is no folder, or holds a link or too much; one line.
    """
    folder = checks.path("FOLDER", folder)
    if not folder.is_dir():
        raise ValueError(f"FOLDER = {folder}: does not exist; must be one that `start` has made")
    files: dict[str, Path] = {}
    missing = []
    for pattern in assignment.rubric.submit:
        found = [path for path in sorted(folder.glob(pattern)) if not path.name.startswith(".")]
        for path in found:
            if path.resolve() != folder.resolve() / path.relative_to(folder):
                raise ValueError(f"{path}: is a link; must be the file itself")
        files |= {path.relative_to(folder).as_posix(): path for path in found if path.is_file()}
        if not any(path.is_file() for path in found):
            missing.append(pattern)
    wanted = list(dict.fromkeys(p.file for p in assignment.rubric.problems if p.file))
    missing += [name for name in wanted if name not in files]
    total = sum(path.stat().st_size for path in files.values())
    if total > MAX_BYTES:
        raise ValueError(
            f"FOLDER = {folder}: {total >> 20} MiB to hand in, must be {MAX_BYTES >> 20} or less"
        )
    if not any(name in files for name in wanted):
        raise ValueError(
            f"FOLDER = {folder}: must be one that `tofrender start {assignment.rubric.id}` has "
            f"made; has no {', '.join(wanted)}"
        )
    return dict(sorted(files.items())), missing


def unchanged(assignment: Assignment, folder: Path) -> list[str]:
    """Files of the problems that are as they came; those that are given have to be."""
    kept = {NOTEBOOK, *assignment.given}
    came = {name: text for name, text in stubs(assignment).items() if name not in kept}
    there = [name for name in came if (folder / name).is_file()]
    return [name for name in there if (folder / name).read_bytes() == came[name]]


def run_public_tests(assignment: Assignment, folder: Path) -> dict[str, running.Outcome]:
    """Run the public tests on a student's folder.

    The tests are the assignment's own, not what the student's folder has of them.
    """
    names = {file.name for file in (assignment.folder / "tests").glob("test_*.py")}
    tests = [
        test.id
        for problem in assignment.rubric.problems
        for test in problem.tests
        if test.visibility == "visible" and test.id.partition("::")[0] in names
    ]
    return running.run(assignment.folder, tests=tests, submission=folder)


def pack(assignment: Assignment, folder: Path, archive: Path) -> Handed:
    """Write the archive, whole or not at all.

    Args:
        assignment: Says what is asked for.
        folder: A student's folder.
        archive: The file to write, which an earlier one may be replaced by.

    Raises:
        ValueError: There is nothing to pack, or something that cannot be.
    """
    files, missing = check(assignment, folder)
    with replacing(archive) as temporary, zipfile.ZipFile(temporary, "x") as target:
        for name, path in files.items():
            information = zipfile.ZipInfo(name, LONG_AGO)
            information.compress_type = zipfile.ZIP_DEFLATED
            information.external_attr = 0o644 << 16
            target.writestr(information, path.read_bytes())
    return Handed(archive, tuple(files), tuple(missing), tuple(unchanged(assignment, folder)))
