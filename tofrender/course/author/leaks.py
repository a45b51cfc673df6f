"""What an edition must not give away, and whether all the rest of it works.

Each withheld name must say which problem it is, no function of a withheld module may be anywhere
in what students get, and all else must work.
"""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..assignments import PACKAGE, Assignment
from ..edition import chosen, path_of, withheld

LEAST_NODES = 25
"""Syntax nodes from which on a function's body is one that only its author would write."""

_PUBLIC_NAME = re.compile(r"\btofrender\.([A-Za-z]\w*)\b(?!\.\w)")

_SMOKE_TEST = Path(__file__).with_name("smoke_test.py")


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
    for module in chosen(assignment.rubric):
        path = folder / "tofrender" / path_of(module)
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


def _secret_files(assignment: Assignment) -> Iterator[Path]:
    """Python files of which no function may be in what students get."""
    for module in chosen(assignment.rubric):
        path = PACKAGE / path_of(module)
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


def smoke_test(assignment: Assignment, folder: Path) -> list[str]:
    """Import an edition in a process of its own, and say what is wrong with it.

    Args:
        assignment: The assignment that it is for.
        folder: The edition.

    Returns:
        A line for each: a withheld name that is there or does not say its problem, a module that
        cannot be imported, a name that handout or notebook use and that is not there, a part that
        does not work.
    """
    rubric = assignment.rubric
    question: dict[str, Any] = {
        "modules": withheld(rubric),
        "names": [[p.reference, name, p.id] for p in rubric.problems for name in p.names],
        "used": sorted(_used(assignment) - rubric.home_of.keys()),
        "assignment": rubric.id,
    }
    result = subprocess.run(
        [sys.executable, "-P", str(_SMOKE_TEST), json.dumps(question)],
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
        return [f"the edition cannot be tried: {last}"]


def _used(assignment: Assignment) -> set[str]:
    """Names of the package that handout and notebook use, as `tofrender.NAME`."""
    files = (assignment.folder / name for name in ("README.md", "notebook.py"))
    text = "\n".join(file.read_text(encoding="utf-8") for file in files if file.is_file())
    return set(_PUBLIC_NAME.findall(text))
