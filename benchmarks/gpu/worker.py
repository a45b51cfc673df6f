"""Run one part in a separate process: worker.py NAME VARIANT SIZES SECONDS FILE.

A part that crashes or hangs then ends alone. Its results so far are in FILE.
"""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from .part import FULL, SMALL, Part

PARTS = {
    "machine": ("machine", "machine"),
    "commands": ("commands", "commands"),
    "times": ("times", "times"),
    "deposits": ("deposits", "deposits"),
    "energies": ("energies", "energies"),
    "gradients": ("gradients", "gradients"),
    "film": ("limits", "film"),
    "scenes": ("limits", "scenes"),
}
"""Module and function of each part."""

CHOSEN = "chosen"
"""In place of a variant: the variant that `tofrender` chooses."""


def function_of(name: str) -> Callable[[Part], None]:
    """Import a part."""
    module, function = PARTS[name]
    return getattr(import_module(f"{__package__}.{module}"), function)


def main() -> None:
    """Run a part and write its results."""
    name, variant, sizes, seconds, file = sys.argv[1:]
    if name != "commands":  # Its commands start Mitsuba themselves
        import mitsuba as mi

        from tofrender.runtime import backend

        variant = backend.activate(None if variant == CHOSEN else variant)
        mi.set_log_level(mi.LogLevel.Error)
    logging.getLogger().setLevel(logging.ERROR)
    warnings.simplefilter("ignore")  # Light outside of the window
    part = Part(variant, SMALL if sizes == "small" else FULL, float(seconds), Path(file))
    try:
        function_of(name)(part)
    finally:
        part.save()


if __name__ == "__main__":
    main()
