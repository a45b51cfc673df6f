"""Release an assignment to students, and start a new term.

A release contains the handout, and the package without the parts that students write.
"""

import json
import os
import re
import secrets
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import tomlkit

from ...runtime.atomic import replacing
from ...runtime.child_processes import safe_environment
from .. import edition, pages, rubric as rubrics
from ..assignments import PACKAGE, Assignment
from .leaks import later_leaks, leaks, smoke_test

PACKAGE_FOLDER = "package"
PAGES = ("README.md", "exercises.md")  # also released as HTML, to be read without the package
REPOSITORY = {
    "tests.yml": ".github/workflows/tests.yml",
    "devcontainer.json": ".devcontainer/devcontainer.json",
    "gitignore": ".gitignore",
}
"""Files of `.ci/repository/`, and their paths in the release."""
EXPECTED = "tests/expected_staff.py"
"""Script of an assignment that computes what its public tests expect; optional."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PRINTING_S = 120.0  # longest time to print a page [s]
LOCAL_LINK = re.compile(r'<a href="(?!https?:|#)[^"]*">(.*?)</a>', re.DOTALL)


class Leak(RuntimeError):
    """A student edition contains withheld parts or does not work.

    The message has one line for each reason.
    """


def release(assignment: Assignment, out: Path, *, pdf: bool = False) -> Path:
    """Make the folder of a release, for example `out/a2_time_of_flight/`, and return it.

    The folder contains the handout and the exercises as Markdown and HTML, the figures, and a
    workflow that runs the tests. Its subfolder `package` contains the student edition. Students
    install it with pip, and `tofrender start` then makes their folders. If this function fails, no
    partial folder is left.

    Args:
        assignment: Assignment of a checkout, with solutions.
        out: Parent folder of the release.
        pdf: Also write the handout and the exercises as PDF.

    Raises:
        FileExistsError: The folder exists.
        Leak: The edition contains withheld parts, or does not work.
        ValueError: `pdf` is set, and Chromium is not installed or fails.
    """
    # Check before any work
    assignment.require_staff("release")
    if pdf:
        _browser()
    target = Path(out) / assignment.name
    if target.exists() or target.is_symlink():
        raise FileExistsError(f"{target} exists and is not overwritten; remove it first")
    with replacing(target, folder=True) as folder:
        # Write and check the student edition
        package = folder / PACKAGE_FOLDER
        edition.copy(assignment, package)
        edition.make_installable(package, assignment.rubric)
        found = leaks(assignment, package) + later_leaks(assignment, package)
        _refuse(found + smoke_test(assignment, package))

        # Write the pages and figures; links between the pages lead to the HTML files
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

        # Write the files of the repository
        for name, path in REPOSITORY.items():
            text = (PACKAGE.parent / ".ci" / "repository" / name).read_text(encoding="utf-8")
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            text = text.replace('"@TITLE@"', json.dumps(assignment.rubric.title))
            (folder / path).write_text(text, encoding="utf-8")

        # Check the whole folder, which is renamed afterwards
        _refuse(leaks(assignment, folder))
        if target.exists():
            raise FileExistsError(f"{target} was created in the meantime and is not overwritten")
    return target


def _refuse(reasons: list[str]) -> None:
    """Raise `Leak` if there are reasons against a release."""
    if reasons:
        raise Leak("\n".join(reasons))


def _browser() -> str:
    """Return the path of Chromium; raise ValueError if it is not installed."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise ValueError(
            f"--pdf needs one of the programs {', '.join(BROWSERS)}. Install one, for example on "
            "Debian with: apt-get install chromium fonts-stix"
        )
    return found


def _print(page: Path, path: Path) -> None:
    """Print an HTML page to a PDF file with an outline, and with tags for screen readers."""
    # Print a copy without links to local files, which would not work in a PDF
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
            text = f"{path.name}: Chromium took longer than {PRINTING_S:g} s"
            raise ValueError(text) from None
        if done.returncode or not temporary.is_file():
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            raise ValueError(f"{path.name}: Chromium failed: {last}")


def new_term(assignment: Assignment, term: int | None = None) -> tuple[int, int]:
    """Write a new term into the rubric, and return the old and the new term.

    If the assignment has a script `tests/expected_staff.py`, the script then computes what the
    public tests expect with the inputs of the new term.

    Args:
        assignment: Assignment of a checkout.
        term: The new term; by default a random number.

    Raises:
        ValueError: The script failed. The term is then unchanged.
    """
    assignment.require_staff("new-term")
    path = assignment.folder / rubrics.FILE_NAME
    before = assignment.rubric.term
    if term is None:
        term = 1 + secrets.randbelow(rubrics.MAX_SEED)

    # tomlkit keeps the comments and the layout of the file
    content: Any = tomlkit.parse(path.read_text(encoding="utf-8"))
    content["assignment"]["term"] = term
    old_text = path.read_text(encoding="utf-8")
    with replacing(path) as temporary:
        temporary.write_text(tomlkit.dumps(content), encoding="utf-8")

    # Compute the expected results of the public tests; without them, the term stays as it was
    script = assignment.folder / EXPECTED
    if script.is_file():
        done = subprocess.run(
            [sys.executable, "-P", "-B", EXPECTED],
            cwd=assignment.folder,
            env=safe_environment(
                PYTHONPATH=os.pathsep.join([str(script.parent), str(PACKAGE.parent)])
            ),
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            with replacing(path) as temporary:
                temporary.write_text(old_text, encoding="utf-8")
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            raise ValueError(f"{EXPECTED} failed, and the term is still {before}: {last}")
    return before, term
