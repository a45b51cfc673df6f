"""The student edition of this package: modules that students write themselves.

A file `withheld.json` beside this module, which only a student edition has, names modules and
packages that are not there, each with the problem that it solves:

    {"modules": {"tofrender.pulses": "a2.gaussian_pulse", "tofrender.walk": null}}

Importing one raises `Withheld`, which names the problem. A scene that asks for the plugin of such
a module still loads: an integrator stands in for it that refuses to render.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("withheld.json")


class Withheld(ImportError):
    """A module is not part of the student edition; the message is one line."""


def modules() -> dict[str, str | None]:
    """The withheld modules and packages, with the problem that each solves; none, as a rule."""
    return json.loads(FILE.read_text(encoding="utf-8"))["modules"] if FILE.is_file() else {}


def refusal(module: str) -> str | None:
    """Why `module` cannot be imported; None if it can.

    Example:
        >>> refusal("tofrender.units") is None
        True
    """
    parts = module.split(".")
    for count in range(len(parts), 1, -1):
        name = ".".join(parts[:count])
        if name in _WITHHELD:
            problem = _WITHHELD[name]
            if problem is None:
                return f"{module} is not part of the student edition"
            return f"{module} is yours to write: problem {problem}"
    return None


class _Finder(MetaPathFinder):
    """Finds withheld modules first, to say so."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: Any = None) -> None:
        """Refuse a withheld module; leave all others to the other finders.

        Raises:
            Withheld: The module is withheld.
        """
        reason = refusal(fullname)
        if reason is not None:
            raise Withheld(reason, name=fullname)


def stand_in(plugin_name: str, reason: str) -> None:
    """Register an integrator of this name that refuses to render, for scenes that ask for it."""
    import mitsuba as mi

    class YoursToWrite(mi.SamplingIntegrator):
        """Takes any parameters, and says at the first sample which problem to solve."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(mi.Properties())
            for name in props.keys():  # noqa: SIM118, Mitsuba's Properties are no dict
                props.mark_queried(name)

        def render(self, *_: Any, **__: Any) -> Any:
            raise Withheld(f"integrator {plugin_name!r}: {reason}")

        sample = render

        def to_string(self) -> str:
            return f"YoursToWrite[{plugin_name}]"

    mi.register_integrator(plugin_name, YoursToWrite)


_WITHHELD = modules()
if _WITHHELD:
    sys.meta_path.insert(0, _Finder())
