"""The student edition: this package without the modules that students write themselves.

Whole modules are left out, so nothing has to be cut from a file. What is left is looked at before
anybody gets it: each withheld name must say which problem it is, no function of a withheld module
may be anywhere in the edition, and all the rest must work.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from . import material
from .assignments import PACKAGE, Assignment
from .dependents import dependents

EXTRAS = ("course",)
LEAST_NODES = 25
"""Syntax nodes from which on a function's body is one that only its author would write."""

_LOOK = Path(__file__).with_name("edition_check.py")


class Leak(RuntimeError):
    """A student edition that must not be given to students; one line a reason."""


def build(assignment: Assignment, folder: Path) -> Path:
    """Build the student edition of the package for an assignment, and check it.

    Args:
        assignment: The whole assignment.
        folder: A new or empty folder; `pip install "./FOLDER[course]"` installs what is in it.

    Returns:
        `folder`, which is also what a `PYTHONPATH` needs.

    Raises:
        ValueError: The rubric withholds a module that does not exist.
        Leak: Something withheld is still there, or what is left does not work.
    """
    folder = Path(folder)
    copy(assignment, folder)
    reasons = [*leaks(assignment, folder), *look(assignment, folder)]
    if reasons:
        raise Leak("\n".join(reasons))
    return folder


def copy(assignment: Assignment, folder: Path) -> None:
    """Write the edition without checking it; arguments and errors as for `build`."""
    rubric = assignment.rubric
    modules = withheld(assignment)
    skipped = {_path_of(module): module for module in modules}
    package = folder / "tofrender"

    def left_out(parent: str, names: list[str]) -> set[str]:
        inside = Path(parent).relative_to(PACKAGE)
        bad = {name for name in names if name.startswith(".") or name == "__pycache__"}
        bad |= {name for name in names if inside / name in skipped}
        return bad | ({"material"} if inside == Path("course") else set())

    shutil.copytree(PACKAGE, package, ignore=left_out)
    names = {name: problem.id for name, problem in rubric.home_of.items()}
    text = json.dumps({"modules": modules, "names": names}, indent=1)
    (package / "runtime" / "withheld.json").write_text(text + "\n", encoding="utf-8")
    version = _mark_version(package / "__init__.py", rubric.id)
    folder.joinpath("pyproject.toml").write_text(_pyproject(version), encoding="utf-8")
    shutil.copyfile(_license(), folder / "LICENSE")
    place = package / "course" / "material" / assignment.name
    place.mkdir(parents=True)
    material.write(assignment, place)


def withheld(assignment: Assignment) -> dict[str, str | None]:
    """The modules that an edition does without, with the problem that each solves.

    Those of the rubric, and with them all that cannot be imported without one of them.

    Raises:
        ValueError: The rubric withholds a module that does not exist.
    """
    modules = assignment.rubric.withheld
    for module in modules:
        _path_of(module)
    return modules | dict.fromkeys(dependents(modules))


def _path_of(module: str) -> Path:
    """Where a withheld module or package is, from the package's folder."""
    head, *parts = module.split(".")
    path = Path(*parts)
    if head == "tofrender" and parts:
        if (PACKAGE / path / "__init__.py").is_file():
            return path
        if (PACKAGE / path).with_suffix(".py").is_file():
            return path.with_suffix(".py")
    raise ValueError(f"rubric.toml: withheld module {module}: does not exist in the package")


def _mark_version(init: Path, label: str) -> str:
    """Give the edition a version of its own, "0.1.0+a2", and return it."""
    from tofrender import __version__

    version = f"{__version__}+{label}"
    before = f'__version__ = "{__version__}"'
    text = init.read_text(encoding="utf-8")
    if before not in text:
        raise ValueError(f"{init.name}: has no line {before}")
    init.write_text(text.replace(before, f'__version__ = "{version}"'), encoding="utf-8")
    return version


def _license() -> Path:
    """The project's licence, in the checkout or among the installed metadata."""
    for path in metadata.files("tofrender") or [] if _is_installed() else []:
        if path.name == "LICENSE":
            return Path(str(path.locate()))
    return PACKAGE.parent / "LICENSE"


def _is_installed() -> bool:
    try:
        return not (PACKAGE.parent / "LICENSE").is_file() and bool(metadata.version("tofrender"))
    except metadata.PackageNotFoundError:
        return False


def _pyproject(version: str) -> str:
    """What pip needs; the dependencies are the package's own."""
    project = PACKAGE.parent / "pyproject.toml"
    if project.is_file():
        import tomllib

        content = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
        needs, extras = content["dependencies"], content["optional-dependencies"]
        python, extras = content["requires-python"], {name: extras[name] for name in EXTRAS}
    else:
        python, needs, extras = _installed_requirements()
    lines = [
        "[build-system]",
        'requires = ["hatchling>=1.27"]',
        'build-backend = "hatchling.build"',
        "",
        "[project]",
        'name = "tofrender"',
        f'version = "{version}"',
        'description = "Light in flight on Mitsuba 3: the student edition"',
        'license = "BSD-3-Clause"',
        'license-files = ["LICENSE"]',
        f"requires-python = {json.dumps(python)}",
        f"dependencies = {json.dumps(needs, indent=2)}",
        "",
        "[project.optional-dependencies]",
        *(f"{name} = {json.dumps(wanted, indent=2)}" for name, wanted in extras.items()),
        "",
        "[project.scripts]",
        'tofrender = "tofrender.cli:main"',
        "",
        "[tool.hatch.build.targets.wheel]",
        'packages = ["tofrender"]',
        "",
    ]
    return "\n".join(lines)


def _installed_requirements() -> tuple[str, list[str], dict[str, list[str]]]:
    """Python's version, the dependencies and the extras of the installed package."""
    from packaging.requirements import Requirement

    needs, extras = [], {name: [] for name in EXTRAS}
    for text in metadata.requires("tofrender") or []:
        extra = re.search(r"extra == ['\"](\w+)['\"]", text)
        plain = str(Requirement(text.partition(";")[0].strip()))
        if extra is None:
            needs.append(plain)
        elif extra[1] in extras:
            extras[extra[1]].append(plain)
    return str(metadata.metadata("tofrender")["Requires-Python"]), needs, extras


# -------------------------------------------------------------------------------------- checks


def leaks(assignment: Assignment, folder: Path) -> list[str]:
    """Functions and files of withheld modules and solutions that are in an edition all the same.

    What the stubs have is given on purpose; that they solve nothing is for their tests to say.

    Args:
        assignment: The whole assignment.
        folder: The edition, or all that students get.

    Returns:
        A line for each: where it is, and what it is from.
    """
    given = {body for file in assignment.starter.glob("*.py") for _, body in _bodies(file)}
    secret = {}
    for source in _secret_files(assignment):
        for name, body in _bodies(source):
            if body not in given:
                secret.setdefault(body, f"{name} of {source.parent.name}/{source.name}")
    reasons = []
    for module in assignment.rubric.withheld:
        for path in (folder / "tofrender" / _path_of(module), _compiled(folder, module)):
            if path.exists():
                reasons.append(f"{path.relative_to(folder)}: {module} is withheld")
    for file in sorted(folder.rglob("*.py")):
        for name, body in _bodies(file):
            if body in secret:
                where = file.relative_to(folder)
                reasons.append(f"{where}: {name} is {secret[body]}, which is withheld")
    for pattern in ("mutants.toml", "*_staff.py", "solutions", "*.pyc"):
        found = sorted(folder.rglob(pattern))
        reasons += [f"{path.relative_to(folder)}: is the staff's" for path in found]
    return reasons


def _compiled(folder: Path, module: str) -> Path:
    return folder / "tofrender" / _path_of(module).with_suffix(".pyc")


def _secret_files(assignment: Assignment) -> Iterator[Path]:
    """Python files of which no function may be in what students get."""
    for module in assignment.rubric.withheld:
        path = PACKAGE / _path_of(module)
        yield from sorted(path.rglob("*.py")) if path.is_dir() else [path]
    yield from sorted(assignment.solutions.glob("*.py"))


def _bodies(path: Path) -> Iterator[tuple[str, str]]:
    """Name and normalised body of each function that is more than a line or two."""
    try:
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except SyntaxError as error:
        raise ValueError(f"{path}: is no Python: {error.msg}, line {error.lineno}") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            block = ast.Module(body=body, type_ignores=[])
            if sum(1 for _ in ast.walk(block)) >= LEAST_NODES:
                yield node.name, ast.dump(block)


def look(assignment: Assignment, folder: Path) -> list[str]:
    """Import an edition in a process of its own, and say what is wrong with it.

    Args:
        assignment: The assignment that it is for.
        folder: The edition.

    Returns:
        A line for each: a withheld name that is there or does not say its problem, a module that
        cannot be imported, a part that does not work.
    """
    rubric = assignment.rubric
    question: dict[str, Any] = {
        "modules": withheld(assignment),
        "names": [[p.reference, name, p.id] for p in rubric.problems for name in p.names],
        "assignment": rubric.id,
    }
    result = subprocess.run(
        [sys.executable, "-P", str(_LOOK), json.dumps(question)],
        env=os.environ | {"PYTHONPATH": str(folder.resolve()), "PYTHONDONTWRITEBYTECODE": "1"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    try:
        return json.loads(result.stdout.splitlines()[-1])["reasons"]
    except (IndexError, ValueError, KeyError, TypeError):
        last = (result.stderr.strip() or f"status {result.returncode}").splitlines()[-1]
        return [f"the edition cannot be looked at: {last}"]
