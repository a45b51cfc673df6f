"""Lazy import of packages' public names (PEP 562), from the list in their stub `__init__.pyi`.

As with the package `lazy_loader`, which knows no stubs with imports from parent packages: the stub
has imports that editors and type checkers follow, too,

    from .pulses import GaussianPulse as GaussianPulse
    from . import io as io

and a module that cannot be imported costs its own names and no others.
"""

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .withheld import Withheld, error_for

# Names of mitransient that its users look for here, and their replacements
_REPLACEMENTS = {"focus_emitter_at_relay_wall_pixel": "use focus_laser(scene, pixel=(x, y))"}


def public_names(package: str, file: str) -> dict[str, str | None]:
    """Names that a package's stub lists, with the module of each, None if it is a module."""
    found: dict[str, str | None] = {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            parent = package.rsplit(".", node.level - 1)[0]
            module = node.module and f"{parent}.{node.module}"
            found |= {alias.name: module for alias in node.names}
    return found


def attach_stub(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Make `__getattr__`, `__dir__` and `__all__` of a package from its stub."""
    modules = public_names(package, file)

    def get(name: str) -> Any:
        if name not in modules:
            hint = f"; {_REPLACEMENTS[name]}" if name in _REPLACEMENTS else ""
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint}")
        if (parent := modules[name]) is None:
            return importlib.import_module(f"{package}.{name}")
        try:
            module = importlib.import_module(parent)
        except Withheld as reason:
            raise error_for(package, name, reason) from None
        if not hasattr(module, name):
            return importlib.import_module(f"{parent}.{name}")
        value = getattr(module, name)
        setattr(sys.modules[package], name, value)
        return value

    return get, lambda: sorted({*vars(sys.modules[package]), *modules}), sorted(modules)
