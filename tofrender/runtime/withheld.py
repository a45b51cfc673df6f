"""The student edition of this package: modules that students write themselves.

A file `withheld.json` beside this module, which only a student edition has, names modules and
packages that are not there, each with the problem that it solves:

    {
        "modules": {"tofrender.signals.pulses": "a2.gaussian_pulse", "tofrender.paths.walk": null},
        "names": {"GaussianPulse": "a2.gaussian_pulse"}
    }

Importing one raises `Withheld`, which names the problem; a public name of such a module names the
problem in which that very name is written. A scene that asks for an integrator or an emitter of
such a module still loads: one stands in for it that refuses to render.
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
    return _content().get("modules", {})


def names() -> dict[str, str]:
    """The withheld public names, with the problem in which each is written; none, as a rule."""
    return _content().get("names", {})


def _content() -> dict[str, Any]:
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}


def refusal(module: str) -> str | None:
    """Why `module` cannot be imported; None if it can.

    Example:
        >>> refusal("tofrender.signals.units") is None
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


def of_name(package: str, name: str, reason: Withheld) -> Withheld:
    """Why a public name is not there: the problem in which it is written, else why its module."""
    problem = _NAMES.get(name)
    what = f"{package}.{name}"
    text = (
        f"{what}: {reason}" if problem is None else f"{what} is yours to write: problem {problem}"
    )
    return Withheld(text, name=package)


def stand_in(class_name: str, plugin_name: str, kind: str, home: str) -> Any:
    """A plugin that does nothing, for scenes that ask for one that is withheld.

    There is one for an "integrator" or an "emitter"; other kinds get None.
    """
    import mitsuba as mi

    bases: dict[str, Any] = {"integrator": mi.SamplingIntegrator, "emitter": mi.Emitter}
    if kind not in bases:
        return None
    problem = _NAMES.get(class_name)
    reason = refusal(home)
    if problem is not None:
        reason = (
            f"is yours to write: problem {problem}; import your file before the scene is loaded"
        )

    class YoursToWrite(bases[kind]):
        """Takes any parameters; an integrator says which problem to solve when it renders."""

        withheld = f"{plugin_name!r} {reason}" if problem else f"{plugin_name!r}: {reason}"

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(mi.Properties())
            for name in props.keys():  # noqa: SIM118, Mitsuba's Properties are no dict
                props.mark_queried(name)

        def render(self, *_: Any, **__: Any) -> Any:
            raise Withheld(self.withheld)

        sample = render

        def to_string(self) -> str:
            return f"YoursToWrite[{plugin_name}]"

    return YoursToWrite


_WITHHELD, _NAMES = modules(), names()
if _WITHHELD:
    sys.meta_path.insert(0, _Finder())
