"""Packages that only the NLOS part needs."""

from __future__ import annotations

import importlib
from typing import Any


def optional(name: str) -> Any:
    """Import a module of the extra [nlos].

    Raises:
        ModuleNotFoundError: One line that says how to install it.

    Example:
        >>> optional("scipy.fft").__name__
        'scipy.fft'
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        package = name.split(".")[0]
        raise ModuleNotFoundError(
            f"{package} is not installed: run pip install 'tofrender[nlos]'"
        ) from None
