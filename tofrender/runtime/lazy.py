"""Lazy import of the public names of a package (PEP 562).

The stub `__init__.pyi` of the package lists the names by imports, which editors and type checkers
also read:

    from .pulses import GaussianPulse as GaussianPulse
    from . import io as io

A module that cannot be imported makes its own names unavailable, and no others. The package
`lazy_loader` does the same, but does not support stubs with imports from parent packages.
"""

import ast
import difflib
import importlib
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from .editions import LeftOut, error_for

_REPLACEMENTS = {"focus_emitter_at_relay_wall_pixel": "use focus_laser(scene, pixel=(x, y))"}
"""Names of mitransient, and what to use instead."""


def public_names(package: str, file: str) -> dict[str, str | None]:
    """Return the names in the stub of a package, each with its module; None for modules."""
    found: dict[str, str | None] = {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            parent = package.rsplit(".", node.level - 1)[0]
            module = node.module and f"{parent}.{node.module}"
            found |= {alias.name: module for alias in node.names}
    return found


@cache
def _hint(package: str, file: str, name: str) -> str:
    """Return the end of the message for an unknown name: where it is, or a similar name."""
    if name in _REPLACEMENTS:
        return f"; {_REPLACEMENTS[name]}"

    # Names of all packages with a stub, the package itself first
    root = package.partition(".")[0]
    folder = Path(file).parents[package.count(".")]
    homes = {package: public_names(package, file)}
    for stub in [*sorted(folder.glob("*/__init__.pyi")), folder / "__init__.pyi"]:
        home = root if stub.parent == folder else f"{root}.{stub.parent.name}"
        homes.setdefault(home, public_names(home, str(stub)))

    # The same name in another package
    for home, names in homes.items():
        if name in names:
            return f"; use {home}.{name}"

    # A similar name, in this package if possible
    for home, names in homes.items():
        spelled = {known.lower(): known for known in names}
        similar = difflib.get_close_matches(name.lower(), spelled, n=1, cutoff=0.75)
        if similar:
            return f"; did you mean {home}.{spelled[similar[0]]}?"
    return ""


def attach_stub(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package, made from its stub."""
    modules = public_names(package, file)

    def get(name: str) -> Any:
        if name not in modules:
            hint = "" if name.startswith("_") else _hint(package, file, name)
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint}")
        if (parent := modules[name]) is None:
            return importlib.import_module(f"{package}.{name}")
        try:
            module = importlib.import_module(parent)
        except LeftOut as reason:
            raise error_for(package, name, reason) from None
        if not hasattr(module, name):
            return importlib.import_module(f"{parent}.{name}")
        value = getattr(module, name)
        setattr(sys.modules[package], name, value)
        return value

    return get, lambda: sorted({*vars(sys.modules[package]), *modules}), sorted(modules)
