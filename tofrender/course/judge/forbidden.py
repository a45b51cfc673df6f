"""What a handout does not allow, found in a submission's text.

`forbids` in the rubric, for an assignment or for one problem, names what has to be written by hand:

| word | what is not allowed |
|---|---|
| `warps` | `mi.warp` |
| `integrators` | Mitsuba's integrators: as plugins, and what is in `mi.ad.integrators` |
| `light sampling` | Mitsuba's sampling of emitters and shapes, and its densities |

This reads the problem's file and those of the same folder that it imports. Methods that these
define may have the names of Mitsuba's. A name that is put together when the program runs is not
seen here; `mi.warp` refuses then, too (`guard`).
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

INTEGRATORS = frozenset(
    "path direct volpath volpathmis ptracer aov moment stokes depth prb prb_basic prbvolpath "  # noqa: SIM905
    "prb_threepoint direct_projective prb_projective emission_projective".split()
)
LIGHT_SAMPLING = frozenset(
    "sample_emitter sample_emitter_ray sample_emitter_direction pdf_emitter sample_position "  # noqa: SIM905
    "pdf_emitter_direction sample_ray sample_direction pdf_direction pdf_position".split()
)
MITSUBA = ("mi", "mitsuba")


@cache
def find(path: Path, words: frozenset[str]) -> str:
    """The first use of what is not allowed: "tent.py, line 8: mi.warp", "" if there is none.

    Args:
        path: A problem's file.
        words: What is not allowed, of `rubric.FORBIDDEN`.
    """
    files = list(_files(path)) if words else []
    nodes = [(file, node) for file, tree in files for node in ast.walk(tree)]
    own = {node.name for _, node in nodes if isinstance(node, ast.FunctionDef)}
    for file, node in nodes:
        name = _forbidden(node, words, own)
        if name:
            return f"{file.name}, line {getattr(node, 'lineno', 1)}: {name}"
    return ""


def _files(path: Path) -> Iterator[tuple[Path, ast.Module]]:
    """A file, and those of its folder that it imports, directly or not."""
    to_do, seen = [path], {path}
    while to_do:
        file = to_do.pop()
        try:
            tree = ast.parse(file.read_bytes())
        except (SyntaxError, ValueError, OSError, RecursionError):
            continue  # importing it says why
        yield file, tree
        for name in _imported(tree):
            other = path.parent / f"{name}.py"
            if other not in seen and other.is_file():
                seen.add(other)
                to_do.append(other)


def _imported(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (alias.name for alias in node.names if node.module is None)
            yield (node.module or "").partition(".")[0]


def _forbidden(node: ast.AST, words: frozenset[str], own: set[str]) -> str:
    """What a node of the program uses that is not allowed, "" if nothing.

    Args:
        node: The node.
        words: What is not allowed.
        own: Names of functions and methods that the submission defines.
    """
    if "warps" in words and (_imports(node, "mitsuba.warp") or _names(node, "warp", of=MITSUBA)):
        return "mi.warp"
    if "integrators" in words:
        if _imports(node, "mitsuba.ad") or _names(node, "ad", of=MITSUBA):
            return "mi.ad"
        kind = _plugin(node)
        if kind in INTEGRATORS:
            return f"Mitsuba's integrator {kind!r}"
    if "light sampling" in words:
        for name in LIGHT_SAMPLING - own:
            if _names(node, name):
                return name
    return ""


def _imports(node: ast.AST, module: str) -> bool:
    """Whether a statement imports a module, or something of it."""
    if isinstance(node, ast.Import):
        return any(f"{alias.name}.".startswith(f"{module}.") for alias in node.names)
    if isinstance(node, ast.ImportFrom) and node.module:
        return f"{node.module}.".startswith(f"{module}.") or any(
            f"{node.module}.{alias.name}" == module for alias in node.names
        )
    return False


def _names(node: ast.AST, name: str, of: tuple[str, ...] = ()) -> bool:
    """Whether an expression asks for an attribute: `x.name`, `getattr(x, "name")`.

    Args:
        node: The expression.
        name: The attribute.
        of: Names of what is asked for it; of anything if empty.
    """
    if isinstance(node, ast.Attribute):
        base = node.value.id if isinstance(node.value, ast.Name) else ""
        return node.attr == name and (not of or base in of)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
        called = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
        texts = [a.value for a in node.args if isinstance(a, ast.Constant)]
        return called in ("getattr", "import_module", "__import__") and any(
            text in (name, f"mitsuba.{name}") for text in texts
        )
    return False


def _plugin(node: ast.AST) -> str:
    """The type that a dict for `mi.load_dict` asks for, "" for any other expression."""
    if isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant) and key.value == "type":
                return str(value.value) if isinstance(value, ast.Constant) else ""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "dict":
        for word in node.keywords:
            if word.arg == "type" and isinstance(word.value, ast.Constant):
                return str(word.value.value)
    return ""


# ------------------------------------------------------------------------------ when it runs


class Forbidden(Exception):
    """A submission has used what is not allowed; one line."""


def guard(folder: Path) -> None:
    """Let `mi.warp` refuse whatever is called from a file of a folder."""
    import mitsuba as mi

    mi.warp = sys.modules["mitsuba.warp"] = _Guarded(mi.warp, folder)


class _Guarded(ModuleType):
    """A module that gives nothing to the files of a folder."""

    def __init__(self, module: ModuleType, folder: Path) -> None:
        super().__init__(module.__name__)
        self.__dict__["_those"] = (module, str(folder))

    def __getattr__(self, name: str) -> Any:
        module, folder = self.__dict__["_those"]
        caller = sys._getframe(1)
        if caller.f_code.co_filename.startswith(folder):
            raise Forbidden(f"{self.__name__}.{name} is not allowed in this assignment")
        return getattr(module, name)
