"""Packages whose names are imported when they are asked for (PEP 562)."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from .withheld import Withheld, of_name


def names_of(
    package: str, homes: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a package that imports its names on demand.

    A module that cannot be imported then costs a package its own names and no others.

    Args:
        package: The package's `__name__`.
        homes: Modules, as they are named inside the package, and the public names of each. A
            module of the parent package starts with a dot.

    Example:
        >>> get, names = names_of("tofrender", {"units": ("SPEED_OF_LIGHT",)})
        >>> get("SPEED_OF_LIGHT")
        299792458.0
    """
    module_of = {name: module for module, names in homes.items() for name in names}

    def get(name: str) -> Any:
        if name in module_of:
            try:
                value = getattr(importlib.import_module(f".{module_of[name]}", package), name)
            except Withheld as reason:
                raise of_name(package, name, reason) from None
            setattr(sys.modules[package], name, value)
            return value
        if name in homes:
            return importlib.import_module(f".{name}", package)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    def names() -> list[str]:
        submodules = (module for module in homes if not module.startswith("."))
        return sorted({*vars(sys.modules[package]), *module_of, *submodules})

    return get, names
