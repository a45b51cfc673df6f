"""Which modules of the package cannot be imported without which others."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from pathlib import Path

from .assignments import PACKAGE


def dependents(withheld: Collection[str]) -> dict[str, str]:
    """Modules that need a withheld one as soon as they are imported.

    Imports inside functions do not count, nor those for type checkers.

    Args:
        withheld: Modules and packages, like "tofrender.signals.pulses".

    Returns:
        Each such module, and the one that it needs: withheld, or another of this list.

    Example:
        >>> dependents(["tofrender.rendering.arrivals"])["tofrender.rendering.job"]
        'tofrender.rendering.arrivals'
    """
    needs = {_module(path): set(_imports(path)) for path in sorted(PACKAGE.rglob("*.py"))}
    found: dict[str, str] = {}
    grew = True
    while grew:
        grew = False
        gone = {*withheld, *found}
        for module in needs.keys() - gone:
            if is_in(module, gone):
                continue
            cause = next((need for need in sorted(needs[module]) if is_in(need, gone)), None)
            if cause is not None:
                found[module], grew = cause, True
    return dict(sorted(found.items()))


def is_in(module: str, packages: Collection[str]) -> bool:
    """Whether a module is one of these modules and packages, or inside of one."""
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def _module(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def _imports(path: Path) -> Iterator[str]:
    """Modules of the package that a file imports when it runs."""
    package = _module(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    for node in _at_import(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
            continue
        above = package[: len(package) + 1 - node.level] if node.level else []
        base = ".".join([*above, *(node.module or "").split(".")]).strip(".")
        yield base
        for alias in node.names:
            if _exists(f"{base}.{alias.name}"):
                yield f"{base}.{alias.name}"


def _exists(module: str) -> bool:
    path = PACKAGE.parent / module.replace(".", "/")
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def _at_import(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """The import statements that run with the module."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            yield from (n for part in child.orelse for n in _at_import(part))
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _at_import(child)
