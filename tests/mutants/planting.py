"""Planted bugs: one operation of one function, found on the syntax tree, and what replaces it.

A bug is an entry of `<package>.toml` in this folder:

    [[bug]]
    name = "gate_sees_pulse_reversed"
    file = "tofrender/films/time_bins.py"
    function = "Gates.weights"
    replace = "pulse.eval((k + 0.5) * width - opl)"
    with = "pulse.eval(opl - (k + 0.5) * width)"
    wrong = "Gates see an asymmetric pulse reversed in time."
    tests = ["tests/films/test_film.py::test_a_gate_sees_the_pulse"]

`function` is the qualified name of a function or class, or "" for the whole module. `replace` is an
expression, or one or more statements, that must occur once in that function. Layout, comments and
line numbers do not matter. An empty `with` deletes statements. For a file that is not Python,
`replace` and `with` are plain text.

Tools for mutation testing were considered. mutmut and Cosmic Ray apply a fixed list of operators
everywhere and count the places. An edit above a place changes its number, and most of these bugs
are not in the list. pytest-mutagen requires a second version of each whole function.
"""

import ast
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Bug:
    """A planted bug."""

    name: str  # its name
    file: str  # the file of the package that has it
    function: str  # qualified name of the function that has it, or "" for the module
    replace: str  # code that occurs once in the function
    replacement: str  # what replaces it; `with` in the TOML files
    wrong: str  # what a user would notice
    tests: tuple[str, ...]  # node ids of tests that must fail


def bugs() -> list[Bug]:
    """Return all planted bugs."""
    found: list[Bug] = []
    for path in sorted(Path(__file__).parent.glob("*.toml")):
        for entry in tomllib.loads(path.read_text(encoding="utf-8"))["bug"]:
            replacement = entry.pop("with")
            tests = tuple(entry.pop("tests"))
            found.append(Bug(**entry, replacement=replacement, tests=tests))
    return found


def planted(bug: Bug, root: Path = ROOT) -> str:
    """Return the text of the bug's file with the bug.

    Raises:
        ValueError: The code to replace does not occur once.
    """
    text = (root / bug.file).read_text(encoding="utf-8")
    if bug.file.endswith(".py"):
        tree = ast.parse(text)
        count = _replace(tree, bug)
        changed = ast.unparse(tree)
    else:
        count = text.count(bug.replace)
        changed = text.replace(bug.replace, bug.replacement)

    if count != 1:
        place = f"{bug.file} {bug.function}".rstrip()
        raise ValueError(f"{bug.name}: `{bug.replace}` occurs {count} times in {place}")
    return changed


def _replace(tree: ast.Module, bug: Bug) -> int:
    """Replace the bug's operation in a syntax tree; return how often the operation occurs."""
    old: list[ast.AST] = list(ast.parse(bug.replace).body)
    new: list[ast.AST] = list(ast.parse(bug.replacement).body)

    # An expression may occur inside of a statement.
    if len(old) == len(new) == 1 and isinstance(old[0], ast.Expr) and isinstance(new[0], ast.Expr):
        old = [old[0].value]
        new = [new[0].value]

    places = [
        (node, field, start)
        for scope in _scopes(tree, bug.function)
        for node in ast.walk(scope)
        for field, value in ast.iter_fields(node)
        for start in _starts(value if isinstance(value, list) else [value], old)
    ]
    for node, field, start in places:
        value = getattr(node, field)
        if isinstance(value, list):
            value[start : start + len(old)] = new
        else:
            setattr(node, field, new[0])
    return len(places)


def _starts(nodes: list[Any], old: list[ast.AST]) -> list[int]:
    """Return where a sequence of nodes has a part that equals `old`."""
    starts = range(len(nodes) - len(old) + 1)
    return [start for start in starts if _same(nodes[start : start + len(old)], old)]


def _scopes(tree: ast.AST, function: str) -> Iterator[ast.AST]:
    """Yield the definitions that have a qualified name, such as a property and its setter."""
    if not function:
        yield tree
        return

    name, _, inner = function.partition(".")
    for node in ast.iter_child_nodes(tree):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            # Look for definitions under `if` and `with`.
            yield from _scopes(node, function)
        elif node.name == name:
            yield from _scopes(node, inner)


def _same(nodes: list[Any], others: list[ast.AST]) -> bool:
    """Whether syntax trees are equal, whether an expression is read or assigned to."""
    if any(type(node) is not type(other) for node, other in zip(nodes, others, strict=True)):
        return False
    texts = [_text(node) for node in nodes]
    return texts == [_text(other) for other in others]


def _text(node: ast.AST) -> str:
    return re.sub(r"(, )?ctx=\w+\(\)", "", ast.dump(node))
