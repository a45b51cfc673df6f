"""Release of an assignment: the handout, and the package without the students' parts; its terms."""

import json
import os
import re
import secrets
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import tomlkit

from ...runtime.atomic import replacing
from .. import edition, pages, rubric as rubrics
from ..assignments import PACKAGE, Assignment
from .leaks import leaks, smoke_test

PACKAGE_FOLDER = "package"
PAGES = ("README.md", "exercises.md")  # read before anything is installed; also as HTML
REPOSITORY = {
    "tests.yml": ".github/workflows/tests.yml",
    "devcontainer.json": ".devcontainer/devcontainer.json",
    "gitignore": ".gitignore",
}
"""Files of `.ci/repository/`, and their paths in what is released."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PRINTING_S = 120.0
LOCAL_LINK = re.compile(r'<a href="(?!https?:|#)[^"]*">(.*?)</a>', re.DOTALL)


class Leak(RuntimeError):
    """A student edition that must not be given to students; one line a reason."""


def release(assignment: Assignment, out: Path, *, pdf: bool = False) -> Path:
    """Make `out/a2_time_of_flight/`, whole or not at all; returns it.

    It holds the handout and the exercises, as Markdown, HTML and with `pdf` as PDF, the figures, a
    workflow that runs the tests, and the folder `package`, which pip installs and from which
    `tofrender start` makes a student's folder. `Leak` if the edition must not be given away.
    """
    assignment.require_staff("release")
    if pdf:
        _browser()  # before any work
    target = Path(out) / assignment.name
    if target.exists() or target.is_symlink():
        raise FileExistsError(f"{target}: exists; must be a new folder, nothing is overwritten")
    with replacing(target, folder=True) as folder:
        package = folder / PACKAGE_FOLDER
        edition.copy(assignment, package)
        edition.make_installable(package, assignment.rubric)
        _refuse([*leaks(assignment, package), *smoke_test(assignment, package)])
        inside = package / "tofrender" / "course" / "material" / assignment.name
        if (inside / "figures").is_dir():
            shutil.copytree(inside / "figures", folder / "figures")
        for name in PAGES:
            if (inside / name).is_file():
                shutil.copyfile(inside / name, folder / name)
                html = pages.page((folder / name).read_text(encoding="utf-8"))
                for other in PAGES:
                    html = html.replace(f'href="{other}', f'href="{Path(other).stem}.html')
                page = (folder / name).with_suffix(".html")
                page.write_text(html, encoding="utf-8")
                if pdf:
                    _print(page, page.with_suffix(".pdf"))
        for name, path in REPOSITORY.items():
            text = (PACKAGE.parent / ".ci" / "repository" / name).read_text(encoding="utf-8")
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            text = text.replace('"@TITLE@"', json.dumps(assignment.rubric.title))
            (folder / path).write_text(text, encoding="utf-8")
        _refuse(leaks(assignment, folder))
        if target.exists():
            raise FileExistsError(f"{target}: has appeared meanwhile; nothing is overwritten")
    return target


def _refuse(reasons: list[str]) -> None:
    if reasons:
        raise Leak("\n".join(reasons))


def _browser() -> str:
    """Path of Chromium; ValueError if it is not installed."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise ValueError(
            f"--pdf: needs one of {', '.join(BROWSERS)} on the PATH; on Debian: apt-get install "
            "chromium fonts-stix"
        )
    return found


def _print(page: Path, path: Path) -> None:
    """Print a page of HTML, with an outline and the tags that screen readers need."""
    with (
        tempfile.TemporaryDirectory() as profile,
        replacing(path) as temporary,
        tempfile.NamedTemporaryFile("w", suffix=".html", dir=page.parent, encoding="utf-8") as copy,
    ):
        copy.write(LOCAL_LINK.sub(r"\1", page.read_text(encoding="utf-8")))
        copy.flush()
        command = [
            _browser(),
            "--headless=new",
            *(["--no-sandbox"] if hasattr(os, "getuid") and os.getuid() == 0 else []),
            "--disable-gpu",
            f"--user-data-dir={profile}",
            "--no-pdf-header-footer",
            "--generate-pdf-document-outline",
            f"--print-to-pdf={temporary}",
            Path(copy.name).resolve().as_uri(),
        ]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=PRINTING_S, check=False
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"{path.name}: Chromium took over {PRINTING_S:g} s") from None
        if done.returncode or not temporary.is_file():
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            raise ValueError(f"{path.name}: Chromium has failed: {last}")


def new_term(assignment: Assignment, term: int | None = None) -> tuple[int, int]:
    """Write another `term` into the rubric, by default a drawn one; returns the old and the new."""
    assignment.require_staff("new-term")
    path = assignment.folder / rubrics.FILE_NAME
    before = assignment.rubric.term
    if term is None:
        term = 1 + secrets.randbelow(rubrics.MAX_SEED)
    content: Any = tomlkit.parse(path.read_text(encoding="utf-8"))  # keeps its comments and blanks
    content["assignment"]["term"] = term
    with replacing(path) as temporary:
        temporary.write_text(tomlkit.dumps(content), encoding="utf-8")
    return before, term
