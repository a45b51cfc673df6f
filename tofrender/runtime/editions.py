"""Editions of this package that leave out modules.

Only an edition contains the file `edition.json` next to this module. Whoever makes the edition
writes this file. It lists the missing modules and packages, and public names, each with a text that
follows the name in errors:

    {
        "modules": {"tofrender.signals.pulses": "is yours to write: problem a2.gaussian_pulse"},
        "names": {"GaussianPulse": "is yours to write: problem a2.gaussian_pulse"},
        "remedy": "import your file before loading the scene"
    }

The import of a missing module raises `LeftOut` with its text. A scene with an integrator or an
emitter of a missing module can be loaded. It gets a placeholder that refuses to render.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("edition.json")


class LeftOut(ImportError):
    """Error for a module that is not part of this edition."""


def refusal(module: str) -> str | None:
    """Return the reason why `module` cannot be imported; None if it can be imported."""
    parts = module.split(".")
    for count in range(len(parts), 1, -1):
        text = _MODULES.get(".".join(parts[:count]))
        if text is not None:
            return f"{module} {text}"
    return None


class _Finder(MetaPathFinder):
    """Finder of modules that raises `LeftOut` before the other finders search."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: Any = None) -> None:
        """Raise `LeftOut` for a missing module."""
        reason = refusal(fullname)
        if reason is not None:
            raise LeftOut(reason, name=fullname)


def error_for(package: str, name: str, reason: LeftOut) -> LeftOut:
    """Return the error for a public name whose module is missing."""
    text = _NAMES.get(name)
    message = f"{package}.{name}: {reason}" if text is None else f"{package}.{name} {text}"
    return LeftOut(message, name=package)


def placeholder(class_name: str, plugin_name: str, kind: str, home: str) -> Any:
    """Make a class that replaces an integrator or emitter that this edition lacks.

    A scene with the placeholder can be loaded, because the placeholder accepts all parameters. An
    integrator raises `LeftOut` on render. The message contains the reason from `edition.json`.

    Args:
        class_name: Name of the missing class.
        plugin_name: Name of the plugin in scenes.
        kind: Kind of the plugin, for example "integrator".
        home: Module that defines the class.

    Returns:
        The class, None if the kind is neither "integrator" nor "emitter".
    """
    import mitsuba as mi

    bases: dict[str, Any] = {"integrator": mi.SamplingIntegrator, "emitter": mi.Emitter}
    if kind not in bases:
        return None
    text = _NAMES.get(class_name)
    message = f"{plugin_name!r}: {refusal(home)}"
    if text is not None:
        message = f"{plugin_name!r} {text}; {_REMEDY}"

    class Placeholder(bases[kind]):
        """Placeholder that accepts all parameters. An integrator raises `LeftOut` on render."""

        left_out = message

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(mi.Properties())
            for name in props.keys():  # noqa: SIM118, Mitsuba's Properties are no dict
                props.mark_queried(name)

        def render(self, *_: Any, **__: Any) -> Any:
            raise LeftOut(message)

        sample = render

        def to_string(self) -> str:
            return f"Placeholder[{plugin_name}]"

    return Placeholder


_CONTENT = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
_MODULES: dict[str, str] = _CONTENT.get("modules", {})
_NAMES: dict[str, str] = _CONTENT.get("names", {})
_REMEDY: str = _CONTENT.get("remedy", "")
if _MODULES:
    sys.meta_path.insert(0, _Finder())
