"""Release of an assignment: the handout, and the package without the students' parts."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from ...runtime.atomic import replacing
from .. import edition, material, pages, toml
from ..assignments import PACKAGE, Assignment
from ..rubric import Rubric
from .leaks import leaks, smoke_test

PACKAGE_FOLDER = "package"
EXTRAS = ("course",)
PAGES = ("README.md", "exercises.md")  # also released as HTML
PYTHON = "3.12"
LLVM = "libllvm19"
WORKFLOW = f"""# Runs the public tests of each student's folder in this repository.
name: tests
on: [push, pull_request, workflow_dispatch]
permissions:
  contents: read
jobs:
  tests:
    runs-on: ubuntu-24.04
    timeout-minutes: 30
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: "{PYTHON}"
          cache: pip
          cache-dependency-path: package/pyproject.toml
      - run: sudo apt-get update && sudo apt-get install -y --no-install-recommends {LLVM}
      - run: pip install "./package[course]"
      - run: tofrender doctor
      - name: The public tests
        run: |
          found=
          for rubric in */rubric.toml; do
            [ -e "$rubric" ] || continue
            found=yes
            folder=$(dirname "$rubric")
            (cd "$folder" && pytest -q) || failed=yes
          done
          [ -n "$found" ] || echo "::notice::no folder yet: tofrender start ASSIGNMENT my-work"
          [ -z "${{failed:-}}" ]
"""
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PRINTING_S = 120.0
LOCAL_LINK = re.compile(r'<a href="(?!https?:|#)[^"]*">(.*?)</a>', re.DOTALL)


class Leak(RuntimeError):
    """A student edition that must not be given to students; one line a reason."""


def release(assignment: Assignment, out: Path, *, pdf: bool = False) -> Path:
    """Make `out/a2_time_of_flight/`, whole or not at all; returns it.

    It holds the handout and the exercises, as Markdown, HTML and with `pdf` as PDF, the figures, a
    workflow that runs the tests, and the folder `package`, which pip installs and from which
    `tofrender start` makes a student's folder.

    FileExistsError if it exists; ValueError if the assignment has no solutions or is inconsistent,
    or Chromium is missing; `Leak` if the edition must not be given away.
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
                    _print(page, page.with_suffix(".pdf"))
        _write_repository(folder, assignment.rubric)
        _refuse(leaks(assignment, folder))
        if target.exists():
            raise FileExistsError(f"{target}: has appeared meanwhile; nothing is overwritten")
    return target


def _refuse(reasons: list[str]) -> None:
    if reasons:
        raise Leak("\n".join(reasons))


def _make_installable(package: Path, rubric: Rubric) -> None:
    """Write the checkout's licence, and a `pyproject.toml` with its dependencies."""
    checkout = PACKAGE.parent
    if not (checkout / "pyproject.toml").is_file():
        raise ValueError(f"{checkout}: has no pyproject.toml; release needs the course's checkout")
    shutil.copyfile(checkout / "LICENSE", package / "LICENSE")
    project = toml.read(checkout / "pyproject.toml")["project"]
    content = {
        "build-system": {"requires": ["hatchling>=1.27"], "build-backend": "hatchling.build"},
        "project": {
            "name": "tofrender",
            "version": edition.version(rubric),
            "description": "Light in flight on Mitsuba 3: the student edition",
            "license": "BSD-3-Clause",
            "license-files": ["LICENSE"],
            "requires-python": project["requires-python"],
            "dependencies": project["dependencies"],
        },
        "project.optional-dependencies": {
            name: project["optional-dependencies"][name] for name in EXTRAS
        },
        "project.scripts": {"tofrender": "tofrender.cli:main"},
        "tool.hatch.build.targets.wheel": {"packages": ["tofrender"]},
    }
    (package / "pyproject.toml").write_text(toml.text(content), encoding="utf-8")


def _write_repository(folder: Path, rubric: Rubric) -> None:
    """Write `.github/workflows/tests.yml`, `.devcontainer/` and `.gitignore`."""
    workflow = folder / ".github" / "workflows" / "tests.yml"
    workflow.parent.mkdir(parents=True)
    workflow.write_text(WORKFLOW, encoding="utf-8")
    container = {
        "name": rubric.title,
        "image": f"mcr.microsoft.com/devcontainers/python:{PYTHON}-bookworm",
        "hostRequirements": {"cpus": 2, "memory": "8gb"},
        "onCreateCommand": "sudo apt-get update && sudo apt-get install -y --no-install-recommends "
        f"wget && (sudo apt-get install -y {LLVM} || wget -qO- https://apt.llvm.org/llvm.sh | "
        "sudo bash -s -- 19)",
        "postCreateCommand": f'pip install "./{PACKAGE_FOLDER}[course]" jupyterlab '
        "&& tofrender doctor",
        "customizations": {"vscode": {"extensions": ["ms-python.python", "ms-toolsai.jupyter"]}},
    }
    path = folder / ".devcontainer" / "devcontainer.json"
    path.parent.mkdir()
    path.write_text(json.dumps(container, indent=2) + "\n", encoding="utf-8")
    ignored = (".venv/", "__pycache__/", ".pytest_cache/", ".ipynb_checkpoints/", "failures/")
    (folder / ".gitignore").write_text("\n".join(ignored) + "\n", encoding="utf-8")


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
    """Print a page of HTML, with an outline and the tags that screen readers need.

    Pictures are taken relative to the page. ValueError if Chromium is missing or fails.
    """
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
