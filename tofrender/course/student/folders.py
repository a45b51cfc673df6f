"""Folders of students: made by `start`, checked and packed by `submit`."""

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

MAX_BYTES = 100 << 20  # of the files that are handed in


def start(assignment: Assignment, folder: Path) -> Path:
    """Make a student's folder, whole or not at all; FileExistsError if it is not empty."""
    folder = Path(folder)
    if folder.resolve() == Path.cwd():
        raise FileExistsError(f"{folder}: is the current folder; must be one inside it")
    if folder.is_symlink() or folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise FileExistsError(f"{folder}: is not empty; must be a new folder, or an empty one")
    with replacing(folder, folder=True) as inside:
        _write(assignment, inside)
    return folder


def _write(assignment: Assignment, folder: Path) -> None:
    """Write released material as a folder to work in."""
    material.write(assignment, folder)
    source, starter = folder / "notebook.py", folder / "starter"
    if source.is_file():
        text = source.read_text(encoding="utf-8")
        notebooks.write(text, starter, folder / NOTEBOOK)
        source.unlink()
    for file in sorted(starter.iterdir()):
        file.rename(folder / file.name)
    shutil.rmtree(starter)
    cells.remember(folder, [file.name for file in folder.glob("*.py")])
    settings = folder / "pytest.ini"
    text = settings.read_text(encoding="utf-8").rstrip()
    settings.write_text(f"{text}\nsubmission = .\n", encoding="utf-8")


@dataclass(frozen=True)
class Packed:
    """A packed submission."""

    archive: Path
    files: tuple[str, ...]  # in the archive
    missing: tuple[str, ...]  # files or patterns that were asked for
    unchanged: tuple[str, ...]  # files that are still stubs


def check(assignment: Assignment, folder: Path) -> tuple[dict[str, Path], list[str]]:
    """Files that `submit` asks for by their names, and those that are missing."""
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
    expected = list(dict.fromkeys(p.file for p in assignment.rubric.problems if p.file))
    missing += [name for name in expected if name not in files]
    total = sum(path.stat().st_size for path in files.values())
    if total > MAX_BYTES:
        raise ValueError(
            f"FOLDER = {folder}: {total >> 20} MiB to hand in, must be {MAX_BYTES >> 20} or less"
        )
    if not any(name in files for name in expected):
        raise ValueError(
            f"FOLDER = {folder}: must be one that `tofrender start {assignment.rubric.id}` has "
            f"made; has no {', '.join(expected)}"
        )
    return dict(sorted(files.items())), missing


def unchanged(assignment: Assignment, folder: Path) -> list[str]:
    """Files of the problems that are still stubs; given ones may be."""
    stubs = [path for path in assignment.starter.glob("*.py") if path.name not in assignment.given]
    there = [path for path in stubs if (folder / path.name).is_file()]
    return [path.name for path in there if (folder / path.name).read_bytes() == path.read_bytes()]


def run_public_tests(assignment: Assignment, folder: Path) -> dict[str, running.Outcome]:
    """Run the assignment's own public tests on a student's folder."""
    return running.run(assignment.folder, tests=assignment.rubric.public_tests, submission=folder)


def pack(assignment: Assignment, folder: Path, archive: Path) -> Packed:
    """Write the archive, whole or not at all; ValueError if files are unfit to be packed."""
    files, missing = check(assignment, folder)
    with replacing(archive) as temporary, zipfile.ZipFile(temporary, "x") as target:
        for name, path in files.items():
            add_file(target, name, path.read_bytes())
    return Packed(archive, tuple(files), tuple(missing), tuple(unchanged(assignment, folder)))


def add_file(archive: zipfile.ZipFile, name: str, content: bytes, mode: int = 0o644) -> None:
    """Add a file without a time of its own, so that equal content gives equal archives."""
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.create_system = 3  # Unix, which has modes
    entry.external_attr = (0o100000 | mode) << 16
    archive.writestr(entry, content)
