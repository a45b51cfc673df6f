"""Check that a student edition contains no solution, and that its remaining parts work.

The import of a withheld name must raise an error that names the problem. No function of a withheld
module may be in the released material.
"""

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ...runtime.child_processes import safe_environment
from ..assignments import PACKAGE, Assignment
from ..edition import chosen, path_of, withheld
from ..rubric import STAFF_TEST

LEAST_NODES = 25  # a function with fewer syntax nodes may be equal by coincidence

_PUBLIC_NAME = re.compile(r"\btofrender\.([A-Za-z]\w*)\b(?!\.\w)")
_SMOKE_TEST = Path(__file__).with_name("smoke_test.py")


def leaks(assignment: Assignment, folder: Path) -> list[str]:
    """Find withheld files and functions in an edition.

    Functions that are also in the stubs are allowed.

    Args:
        assignment: Assignment with solutions.
        folder: Folder of the edition.

    Returns:
        A message for each withheld file or function.
    """
    reasons = _found({assignment: chosen(assignment.rubric)}, folder)
    for pattern in ("mutants.toml", STAFF_TEST, "solutions", "*.pyc"):
        found = sorted(folder.rglob(pattern))
        reasons += [f"{path.relative_to(folder)}: is a file of the staff" for path in found]
    return reasons


def later_leaks(assignment: Assignment, folder: Path) -> list[str]:
    """Find solutions of later assignments in an edition.

    Later assignments are in the same folder and have a greater id. Their solutions are the files of
    `solutions/`, and the modules of the package that student editions leave out for their problems.
    A folder without `solutions/` is the working copy of a student, and is skipped.

    Args:
        assignment: Assignment of the edition.
        folder: Folder of the edition.

    Returns:
        A message for each file or function that solves a problem of a later assignment.
    """
    modules = {}
    for path in sorted(assignment.folder.parent.glob("*/rubric.toml")):
        later = Assignment(path.parent)
        if later.solutions.is_dir() and later.rubric.id > assignment.rubric.id:
            withheld_by = chosen(later.rubric)
            modules[later] = [module for module, problem in withheld_by.items() if problem]
    return _found(modules, folder)


def _found(modules: Mapping[Assignment, Iterable[str]], folder: Path) -> list[str]:
    """Search an edition for modules, and for functions of these modules and of the solutions.

    Functions that are also in the stubs are allowed.

    Args:
        modules: Names of modules and packages, by the assignments that withhold them.
        folder: Folder of the edition.

    Returns:
        A message for each module and function that was found.
    """
    reasons = []
    secret: dict[str, str] = {}
    for assignment, names in modules.items():
        # Collect the functions
        paths = {module: path_of(module) for module in names}
        sources = sorted(assignment.solutions.glob("*.py"))
        for path in paths.values():
            path = PACKAGE / path
            sources += sorted(path.rglob("*.py")) if path.is_dir() else [path]
        stubs = {body for file in assignment.starter.glob("*.py") for _, body in _bodies(file)}
        secret |= {
            body: f"{name} of {source.parent.name}/{source.name}"
            for source in sources
            for name, body in _bodies(source)
            if body not in stubs
        }

        # Search the edition for the modules
        for module, path in paths.items():
            path = "tofrender" / path
            if (folder / path).exists():
                reasons.append(f"{path}: {module} is withheld")

    # Search it for the functions
    for file in sorted(folder.rglob("*.py")):
        for name, body in _bodies(file):
            if body in secret:
                where = file.relative_to(folder)
                reasons.append(f"{where}: {name} is {secret[body]}, which is withheld")
    return reasons


def _bodies(path: Path) -> Iterator[tuple[str, str]]:
    """Yield name and body of each function in a file that is longer than a line or two.

    The body is a dump of its syntax tree without the docstring, so comments and layout do not
    matter.
    """
    try:
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except SyntaxError as error:
        raise ValueError(f"{path}: is not Python: {error.msg}, line {error.lineno}") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            block = ast.Module(body=body, type_ignores=[])
            if sum(1 for _ in ast.walk(block)) >= LEAST_NODES:
                yield node.name, ast.dump(block)


def smoke_test(assignment: Assignment, folder: Path) -> list[str]:
    """Test an edition in a separate process, see `smoke_test.py`.

    Returns:
        A message for each error.
    """
    # Collect the names that must be missing, and the public names that handout and notebook use
    rubric = assignment.rubric
    files = (assignment.folder / name for name in ("README.md", "notebook.py"))
    text = "\n".join(file.read_text(encoding="utf-8") for file in files if file.is_file())
    expected: dict[str, Any] = {
        "modules": withheld(rubric),
        "names": [[p.reference, name, p.id] for p in rubric.problems for name in p.names],
        "used": sorted(set(_PUBLIC_NAME.findall(text)) - rubric.problem_by_name.keys()),
        "assignment": rubric.id,
    }

    # Run the script with the edition
    result = subprocess.run(
        [sys.executable, "-P", str(_SMOKE_TEST), json.dumps(expected)],
        env=safe_environment(PYTHONPATH=str(folder.resolve()), PYTHONDONTWRITEBYTECODE="1"),
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    try:
        return json.loads(result.stdout.splitlines()[-1])["reasons"]
    except (IndexError, ValueError, KeyError, TypeError):
        last = (result.stderr.strip() or f"status {result.returncode}").splitlines()[-1]
        return [f"the edition cannot be tested: {last}"]
