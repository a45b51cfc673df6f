"""Packages whose public names are imported when they are asked for (PEP 562).

The list of names stands once, in the package's stub `__init__.pyi`, as imports that editors and
type checkers follow too:

    from .pulses import GaussianPulse as GaussianPulse
    from . import io as io

A module that cannot be imported then costs a package its own names and no others.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .withheld import Withheld, of_name

INSTEAD = {"focus_emitter_at_relay_wall_pixel": "use focus_laser(scene, pixel=(x, y))"}
"""Names of mitransient's that its users look for here, and what there is instead."""


def public_names(package: str, file: str) -> dict[str, str | None]:
    """The names that a package's stub lists, with the module that has each, None if it is one.

    Example:
        >>> import tofrender
        >>> public_names("tofrender", tofrender.__file__)["GaussianPulse"]
        'tofrender.signals.pulses'
    """
    found: dict[str, str | None] = {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            room = package.rsplit(".", node.level - 1)[0]
            module = node.module and f"{room}.{node.module}"
            found |= {alias.name: module for alias in node.names}
    return found


def on_demand(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """The `__getattr__`, `__dir__` and `__all__` of a package that imports its names on demand."""
    homes = public_names(package, file)

    def get(name: str) -> Any:
        if name not in homes:
            instead = f"; {INSTEAD[name]}" if name in INSTEAD else ""
            raise AttributeError(f"module {package!r} has no attribute {name!r}{instead}")
        module = homes[name]
        if module is None:
            return importlib.import_module(f"{package}.{name}")
        try:
            home = importlib.import_module(module)
        except Withheld as reason:
            raise of_name(package, name, reason) from None
        if not hasattr(home, name):
            return importlib.import_module(f"{module}.{name}")
        value = getattr(home, name)
        setattr(sys.modules[package], name, value)
        return value

    return get, lambda: sorted({*vars(sys.modules[package]), *homes}), sorted(homes)
