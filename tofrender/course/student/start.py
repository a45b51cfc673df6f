"""A student's folder: stubs, tests, rubric, handout and notebook."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from ...runtime.atomic import replacing
from .. import material, notebooks
from ..assignments import Assignment
from ..notebooks import NOTEBOOK
from . import cells


def start(assignment: Assignment, folder: Path) -> Path:
    """Make a student's folder, whole or not at all.

    Args:
        assignment: What students get of it, or all of it.
        folder: A new or empty folder.

    Returns:
        `folder`.

    Raises:
        FileExistsError: There is something in it.
    """
    folder = Path(folder)
    if folder.resolve() == Path.cwd():
        raise FileExistsError(f"{folder}: is the current folder; must be one inside it")
    if folder.is_symlink() or folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise FileExistsError(f"{folder}: is not empty; must be a new folder, or an empty one")
    with replacing(folder, folder=True) as inside:
        material.write(assignment, inside)
        _flatten(inside)
    return folder


def stubs(assignment: Assignment) -> dict[str, bytes]:
    """The files that a student starts from, with their content."""
    with tempfile.TemporaryDirectory() as scratch:
        inside = Path(scratch)
        material.write(assignment, inside)
        _flatten(inside)
        names = [p.name for p in assignment.starter.glob("*.py")] + [NOTEBOOK]
        return {name: (inside / name).read_bytes() for name in names if (inside / name).is_file()}


def _flatten(folder: Path) -> None:
    """From what students get of an assignment to a folder that they work in."""
    source = folder / "notebook.py"
    starter = folder / "starter"
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
