"""What students get: the handout, and the package without what they write themselves."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..io.atomic import replacing
from . import edition, material
from .assignments import Assignment

PACKAGE_FOLDER = "package"


def release(assignment: Assignment, out: Path) -> Path:
    """Make `out/a2_time_of_flight/`, whole or not at all.

    It holds the handout, the exercises, the figures, and the folder `package`, which pip installs
    and which has the rest: `tofrender start` makes a student's folder from it.

    Args:
        assignment: The whole assignment.
        out: Folder to make it in.

    Returns:
        The folder that was made.

    Raises:
        FileExistsError: It is there already.
        ValueError: The assignment has no solutions, or does not hold together.
        Leak: The edition is not fit to be given away; says why.
    """
    assignment.require_staff("release")
    target = Path(out) / assignment.name
    if target.exists() or target.is_symlink():
        raise FileExistsError(f"{target}: exists; must be a new folder, nothing is overwritten")
    with replacing(target, folder=True) as folder:
        edition.build(assignment, folder / PACKAGE_FOLDER)
        inside = folder / PACKAGE_FOLDER / "tofrender" / "course" / "material" / assignment.name
        for name in material.HANDED_OUT:
            if (inside / name).is_dir():
                shutil.copytree(inside / name, folder / name)
            elif (inside / name).is_file():
                shutil.copyfile(inside / name, folder / name)
        reasons = edition.leaks(assignment, folder)
        if reasons:
            raise edition.Leak("\n".join(reasons))
        if target.exists():
            raise FileExistsError(f"{target}: has appeared meanwhile; nothing is overwritten")
    return target
