"""Student edition of this package: modules that students write themselves.

Only a student edition contains the file `withheld.json` next to this module. The file lists the
missing modules and packages with the problems that they solve:

    {
        "modules": {"tofrender.signals.pulses": "a2.gaussian_pulse", "tofrender.paths.walk": null},
        "names": {"GaussianPulse": "a2.gaussian_pulse"}
    }

The import of a missing module raises `Withheld` with the name of the problem. A scene with an
integrator or an emitter of a missing module can be loaded. It gets a placeholder that refuses to
render.
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
    """Error for a module that is not part of the student edition."""


def refusal(module: str) -> str | None:
    """Return the reason why `module` cannot be imported; None if it can be imported."""
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
    """Finder of modules that raises `Withheld` before the other finders search."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: Any = None) -> None:
        """Raise `Withheld` for a withheld module."""
        reason = refusal(fullname)
        if reason is not None:
            raise Withheld(reason, name=fullname)


def error_for(package: str, name: str, reason: Withheld) -> Withheld:
    """Return the error for a public name, with the problem in which students write it."""
    problem = _NAMES.get(name)
    text = f": {reason}" if problem is None else f" is yours to write: problem {problem}"
    return Withheld(f"{package}.{name}{text}", name=package)


def placeholder(class_name: str, plugin_name: str, kind: str, home: str) -> Any:
    """Make a placeholder for a withheld "integrator" or "emitter"; None for other kinds."""
    import mitsuba as mi

    bases: dict[str, Any] = {"integrator": mi.SamplingIntegrator, "emitter": mi.Emitter}
    if kind not in bases:
        return None
    problem = _NAMES.get(class_name)
    message = f"{plugin_name!r}: {refusal(home)}"
    if problem is not None:
        needed = "import your file before loading the scene"
        message = f"{plugin_name!r} is yours to write: problem {problem}; {needed}"

    class YoursToWrite(bases[kind]):
        """Placeholder that accepts all parameters. An integrator raises `Withheld` on render."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(mi.Properties())
            for name in props.keys():  # noqa: SIM118, Mitsuba's Properties are no dict
                props.mark_queried(name)

        def render(self, *_: Any, **__: Any) -> Any:
            raise Withheld(message)

        sample = render

        def to_string(self) -> str:
            return f"YoursToWrite[{plugin_name}]"

    return YoursToWrite


_CONTENT = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
_WITHHELD: dict[str, str | None] = _CONTENT.get("modules", {})
_NAMES: dict[str, str] = _CONTENT.get("names", {})
if _WITHHELD:
    sys.meta_path.insert(0, _Finder())
