"""Features that a handout does not allow, found in a submission's text.

`forbids` in the rubric, for an assignment or for one problem, names parts to be written by hand:

| word | not allowed |
|---|---|
| `warps` | `mi.warp` |
| `integrators` | Mitsuba's integrators, see `guard` |
| `light sampling` | Mitsuba's sampling of emitters and shapes, and its densities |

This reads the problem's file and those of its folder that it imports. Methods that these define
may have the names of Mitsuba's. A name that is put together when the program runs is not seen
here; `guard` lets `mi.warp` and what loads integrators refuse then.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable, Collection, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

LIGHT_SAMPLING = frozenset(
    "sample_emitter sample_emitter_ray sample_emitter_direction pdf_emitter sample_position "  # noqa: SIM905
    "pdf_emitter_direction sample_ray sample_direction pdf_direction pdf_position".split()
)
LOADERS = {"load_dict", "load_string", "load_file"}
MITSUBA = ("mi", "mitsuba")


@cache
def find(path: Path, words: frozenset[str]) -> str:
    """First use of a feature of `words`: "tent.py, line 8: mi.warp", "" if there is none."""
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
    files = [path]
    for file in files:
        try:
            tree = ast.parse(file.read_bytes())
        except (SyntaxError, ValueError, OSError, RecursionError):
            continue  # importing it says why
        yield file, tree
        for name in imported(tree):
            other = path.parent / f"{name}.py"
            if other not in files and other.is_file():
                files.append(other)


def imported(tree: ast.Module) -> Iterator[str]:
    """First names of the modules that a file imports, wherever in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (alias.name for alias in node.names if node.module is None)
            yield (node.module or "").partition(".")[0]


def _forbidden(node: ast.AST, words: frozenset[str], own: set[str]) -> str:
    """Forbidden feature that a syntax node uses, "" if none; the submission defines `own` names."""
    if "warps" in words and (_imports(node, "mitsuba.warp") or _names(node, "warp", of=MITSUBA)):
        return "mi.warp"
    if "light sampling" in words:
        for name in LIGHT_SAMPLING - own:
            if _names(node, name):
                return name
    return ""


def _imports(node: ast.AST, module: str) -> bool:
    """Whether a statement imports a module, or a name from it."""
    names = []
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.module:
        names = [f"{node.module}.{alias.name}" for alias in node.names]
    return any(f"{name}.".startswith(f"{module}.") for name in names)


def _names(node: ast.AST, name: str, of: tuple[str, ...] = ()) -> bool:
    """Whether an expression is an attribute, of names `of` if given: `x.name`, or by `getattr`."""
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


class Forbidden(Exception):
    """A submission has used a forbidden feature; one line."""


def guard(folder: Path, words: Collection[str]) -> None:
    """Let Mitsuba refuse what `words` forbid to files of a folder, however they come by it."""
    import mitsuba as mi

    def is_mitsubas(found: Any) -> bool:
        return isinstance(found, mi.Integrator) and type(found).__module__.startswith("mitsuba")

    if "integrators" in words:
        for module in [m for name, m in sys.modules.items() if name.startswith("mitsuba")]:
            for name in LOADERS & vars(module).keys():
                _check_results(module, name, folder, is_mitsubas)
        _check_results(mi.PluginManager, "create_object", folder, is_mitsubas)
        _check_results(mi.Scene, "integrator", folder, is_mitsubas)
        common = importlib.import_module("mitsuba.python.ad.integrators.common")
        _check_results(common.ADIntegrator, "__init__", folder, lambda _: True)
    if "warps" in words:
        warp = mi.warp

        def attribute(name: str) -> Any:
            if sys._getframe(1).f_code.co_filename.startswith(str(folder)):
                raise Forbidden(f"{warp.__name__}.{name} is not allowed in this assignment")
            return getattr(warp, name)

        guarded = ModuleType(warp.__name__)
        vars(guarded)["__getattr__"] = attribute
        mi.warp = sys.modules["mitsuba.warp"] = guarded


def _check_results(owner: Any, name: str, folder: Path, refuses: Callable[[Any], bool]) -> None:
    """Let a function refuse results that files of a folder ask for, directly or not."""
    function = getattr(owner, name)

    def checked(*arguments: Any, **keywords: Any) -> Any:
        found = function(*arguments, **keywords)
        if refuses(found):
            frame = sys._getframe(1)
            while frame is not None:
                if frame.f_code.co_filename.startswith(str(folder)):
                    raise Forbidden("Mitsuba's integrators are not allowed in this assignment")
                frame = frame.f_back
        return found

    setattr(owner, name, checked)
