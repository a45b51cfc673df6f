"""Folders of students: `start` makes them, `submit` checks and packs them."""

import shutil
import zipfile
from dataclasses import dataclass
from pathlib import Path

from ...runtime import checks
from ...runtime.atomic import replacing
from .. import material, notebooks
from ..assignments import Assignment
from ..judge import running
from ..notebooks import NOTEBOOK
from . import cells

MAX_BYTES = 100 << 20  # largest total size of the files that are handed in [bytes]


def start(assignment: Assignment, folder: Path) -> Path:
    """Make a student's folder with stubs, notebook and public tests, and return it.

    If this fails, no partial folder is left.

    Raises:
        FileExistsError: The folder is not empty, or is the current folder.
    """
    folder = Path(folder)
    if folder.resolve() == Path.cwd():
        raise FileExistsError(f"{folder} is the current folder; pass a folder inside it")
    if folder.is_symlink() or folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise FileExistsError(f"{folder} is not empty; pass a new folder or an empty folder")
    with replacing(folder, folder=True) as inside:
        _write(assignment, inside)
    return folder


def _write(assignment: Assignment, folder: Path) -> None:
    """Write the released material in the form in which students work on it."""
    material.write(assignment, folder)

    # Convert the percent script to a notebook
    source = folder / "notebook.py"
    starter = folder / "starter"
    if source.is_file():
        text = source.read_text(encoding="utf-8")
        notebooks.write(text, starter, folder / NOTEBOOK)
        source.unlink()

    # Move the stubs to the top of the folder
    for file in sorted(starter.iterdir()):
        file.rename(folder / file.name)
    shutil.rmtree(starter)
    cells.remember(folder, [file.name for file in folder.glob("*.py")])

    # Let `pytest` without options judge this folder
    settings = folder / "pytest.ini"
    text = settings.read_text(encoding="utf-8").rstrip()
    settings.write_text(f"{text}\nsubmission = .\n", encoding="utf-8")


@dataclass(frozen=True)
class PackedSubmission:
    """A submission that was packed into an archive."""

    archive: Path
    files: tuple[str, ...]  # names in the archive
    missing: tuple[str, ...]  # requested files and patterns that the folder lacks
    unchanged: tuple[str, ...]  # files that still equal their stubs


def check(assignment: Assignment, folder: Path) -> tuple[dict[str, Path], list[str]]:
    """Find the files to hand in.

    Returns:
        The files by their names in the archive, and the requested files and patterns that are
        missing.

    Raises:
        ValueError: The folder does not exist or contains no file of a problem, a file is a link,
            or the files are too large.
    """
    folder = checks.path("FOLDER", folder)
    if not folder.is_dir():
        text = "does not exist; pass a folder that `tofrender start` made"
        raise ValueError(f"FOLDER = {folder}: {text}")

    # Collect the files that match the patterns of the rubric
    files: dict[str, Path] = {}
    missing = []
    for pattern in assignment.rubric.submit:
        found = [path for path in sorted(folder.glob(pattern)) if not path.name.startswith(".")]
        for path in found:
            if path.resolve() != folder.resolve() / path.relative_to(folder):
                raise ValueError(f"{path} is a link; replace it by the file itself")
        files |= {path.relative_to(folder).as_posix(): path for path in found if path.is_file()}
        if not any(path.is_file() for path in found):
            missing.append(pattern)

    # Which files of problems are missing?
    expected = assignment.rubric.files
    missing += [name for name in expected if name not in files]
    if not any(name in files for name in expected):
        raise ValueError(
            f"FOLDER = {folder}: contains none of {', '.join(expected)}; pass a folder that "
            f"`tofrender start {assignment.rubric.id}` made"
        )

    # Are the files small enough?
    total = sum(path.stat().st_size for path in files.values())
    if total > MAX_BYTES:
        raise ValueError(
            f"FOLDER = {folder}: the files to hand in have {total >> 20} MiB, must have "
            f"{MAX_BYTES >> 20} MiB or less"
        )
    return dict(sorted(files.items())), missing


def unchanged(assignment: Assignment, folder: Path) -> list[str]:
    """Return the names of the problems' files that still equal their stubs.

    Complete files that were provided are not reported.
    """
    names = [path.name for path in assignment.starter.glob("*.py")]
    stubs = [assignment.starter / name for name in names if name not in assignment.provided_files]
    there = [path for path in stubs if (folder / path.name).is_file()]
    return [path.name for path in there if (folder / path.name).read_bytes() == path.read_bytes()]


def run_public_tests(assignment: Assignment, folder: Path) -> dict[str, running.TestOutcome]:
    """Run the public tests of the assignment, not those in the folder, on a student's folder."""
    return running.run(assignment.folder, tests=assignment.rubric.public_tests, submission=folder)


def pack(assignment: Assignment, folder: Path, archive: Path) -> PackedSubmission:
    """Write the archive to hand in. If this fails, no partial archive is left.

    Raises:
        ValueError: The files cannot be handed in, see `check`.
    """
    files, missing = check(assignment, folder)
    with replacing(archive) as temporary, zipfile.ZipFile(temporary, "x") as target:
        for name, path in files.items():
            add_file(target, name, path.read_bytes())
    return PackedSubmission(
        archive=archive,
        files=tuple(files),
        missing=tuple(missing),
        unchanged=tuple(unchanged(assignment, folder)),
    )


def add_file(archive: zipfile.ZipFile, name: str, content: bytes, mode: int = 0o644) -> None:
    """Add a file to an archive with a fixed time, so that equal content gives equal archives."""
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.create_system = 3  # Unix, so that the mode is used
    entry.external_attr = (0o100000 | mode) << 16
    archive.writestr(entry, content)
