"""What students get: the handout, and the package without what they write themselves."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

from ...runtime.atomic import replacing
from .. import edition, material, pages
from ..assignments import PACKAGE, Assignment
from ..rubric import Rubric
from . import printing, repository
from .leaks import leaks, smoke_test

PACKAGE_FOLDER = "package"
EXTRAS = ("course",)
PAGES = ("README.md", "exercises.md")
"""What students also get as HTML."""


class Leak(RuntimeError):
    """A student edition that must not be given to students; one line a reason."""


def release(assignment: Assignment, out: Path, *, pdf: bool = False) -> Path:
    """Make `out/a2_time_of_flight/`, whole or not at all.

    It holds the handout and the exercises, as Markdown and as HTML, the figures, what makes it a
    repository that tests itself, and the folder `package`, which pip installs
    and which has the rest: `tofrender start` makes a student's folder from it.

    Args:
        assignment: The whole assignment.
        out: Folder to make it in.
        pdf: Whether students get handout and exercises as PDF, too; needs Chromium.

    Returns:
        The folder that was made.

    Raises:
        FileExistsError: It is there already.
        ValueError: The assignment has no solutions, or does not hold together, or there is no
            Chromium.
        Leak: The edition is not fit to be given away; says why.
    """
    assignment.require_staff("release")
    if pdf:
        printing.browser()  # before any work
    target = Path(out) / assignment.name
    if target.exists() or target.is_symlink():
        raise FileExistsError(f"{target}: exists; must be a new folder, nothing is overwritten")
    with replacing(target, folder=True) as folder:
        package = folder / PACKAGE_FOLDER
        edition.copy(assignment, package)
        _make_installable(package, assignment.rubric)
        _refuse([*leaks(assignment, package), *smoke_test(assignment, package)])
        inside = package / "tofrender" / "course" / "material" / assignment.name
        for name in material.HANDED_OUT:
            if (inside / name).is_dir():
                shutil.copytree(inside / name, folder / name)
            elif (inside / name).is_file():
                shutil.copyfile(inside / name, folder / name)
        for name in PAGES:
            if (folder / name).is_file():
                text = (folder / name).read_text(encoding="utf-8")
                html = pages.page(text)
                for other in PAGES:
                    html = html.replace(f'href="{other}', f'href="{Path(other).stem}.html')
                page = (folder / name).with_suffix(".html")
                page.write_text(html, encoding="utf-8")
                if pdf:
                    printing.pdf(page, page.with_suffix(".pdf"))
        repository.write(folder, assignment.rubric, PACKAGE_FOLDER)
        _refuse(leaks(assignment, folder))
        if target.exists():
            raise FileExistsError(f"{target}: has appeared meanwhile; nothing is overwritten")
    return target


def _refuse(reasons: list[str]) -> None:
    if reasons:
        raise Leak("\n".join(reasons))


def _make_installable(package: Path, rubric: Rubric) -> None:
    """Write what pip needs: the checkout's licence, and its dependencies in a `pyproject.toml`."""
    checkout = PACKAGE.parent
    if not (checkout / "pyproject.toml").is_file():
        raise ValueError(f"{checkout}: has no pyproject.toml; release needs the course's checkout")
    shutil.copyfile(checkout / "LICENSE", package / "LICENSE")
    project = tomllib.loads((checkout / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    lines = [
        "[build-system]",
        'requires = ["hatchling>=1.27"]',
        'build-backend = "hatchling.build"',
        "",
        "[project]",
        'name = "tofrender"',
        f'version = "{edition.version(rubric)}"',
        'description = "Light in flight on Mitsuba 3: the student edition"',
        'license = "BSD-3-Clause"',
        'license-files = ["LICENSE"]',
        f"requires-python = {json.dumps(project['requires-python'])}",
        f"dependencies = {json.dumps(project['dependencies'], indent=2)}",
        "",
        "[project.optional-dependencies]",
        *(f"{name} = {json.dumps(extras[name], indent=2)}" for name in EXTRAS),
        "",
        "[project.scripts]",
        'tofrender = "tofrender.cli:main"',
        "",
        "[tool.hatch.build.targets.wheel]",
        'packages = ["tofrender"]',
        "",
    ]
    (package / "pyproject.toml").write_text("\n".join(lines), encoding="utf-8")
