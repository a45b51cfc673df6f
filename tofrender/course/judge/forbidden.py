"""Features that a handout does not allow: they are gone while a submission runs.

`forbids` in the rubric, for an assignment or for one problem, names parts to be written by hand:

| word | not allowed |
|---|---|
| `warps` | `mi.warp` |
| `integrators` | integrators of Mitsuba and of this package |
| `sampling` | everything in Mitsuba that samples: shapes, lights, materials, distributions |

A guard that refuses calls would have to hold what it guards, and Python code can find everything
that its process holds. Therefore `remove` deletes the features before the process loads a
submission, and native integrators are never loaded (`plugins.leave_out`). Nothing refers to the
features any more, so neither closures nor the garbage collector lead to them. In the sandbox the
process can afterwards read none of the `files` that would bring them back, and start no other
program.
"""

import gc
import importlib.util
import inspect
import re
import sys
from collections.abc import Callable, Collection, Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NoReturn

NATIVE_INTEGRATORS = frozenset(
    "aov depth direct moment path ptracer stokes volpath volpathmis".split()  # noqa: SIM905
)
"""Mitsuba's plugins of integrators that are native libraries."""
LOADERS = {"load_dict", "load_string", "load_file"}
SAMPLES = re.compile(r"(sample|pdf|eval_pdf|invert|sggx)(_|$)|.*_(sample|pdf)$")
"""Names of methods and functions of Mitsuba that sample something, or are densities."""
MATERIALS = {"BSDF", "BSDFPtr", "PhaseFunction", "PhaseFunctionPtr", "MicrofacetDistribution"}
"""Classes whose values are densities, too."""
LOOP = "tofrender.paths.walk"  # module of the path loop, which the package's integrators use
OF_INTEGRATORS = (
    "tofrender/integrators",
    "tofrender/nlos/light",
    "tofrender/paths/walk.py",
    "tofrender/paths/__pycache__/walk.*",  # bytecode, which Python runs without its source
)


class Forbidden(Exception):
    """A submission has used a forbidden feature; one line."""


def refuse(what: str) -> NoReturn:
    """Raise `Forbidden`."""
    raise Forbidden(f"{what} not allowed in this problem: write it yourself")


def remove(words: Collection[str]) -> None:
    """Delete forbidden features from this process, for good; Mitsuba's variant is active."""
    if "integrators" in words:
        _remove_integrators()
    if "sampling" in words:
        _remove_sampling()
    if "warps" in words:
        _remove_warps()
    gc.collect()  # Deleted classes and functions refer to each other


def files(words: Collection[str], package: Path) -> list[Path]:
    """Files that would bring forbidden features back; `package` holds the folder `tofrender`."""
    if not words:
        return []
    spec = importlib.util.find_spec("mitsuba")
    assert spec is not None
    assert spec.origin is not None
    mitsuba = Path(spec.origin).parent

    # The modules of Mitsuba's variants hold everything that was deleted
    found = [path for path in mitsuba.iterdir() if path.name.endswith(EXTENSION_SUFFIXES[0])]
    if "integrators" in words:
        found += [path for name in NATIVE_INTEGRATORS for path in mitsuba.glob(f"plugins/{name}.*")]
        found.append(mitsuba / "python" / "ad" / "integrators")
        found += [path for pattern in OF_INTEGRATORS for path in package.glob(pattern)]
    return [path for path in found if path.exists()]


def _remove_warps() -> None:
    """Empty the module `mi.warp`."""
    import mitsuba as mi

    def attribute(name: str) -> Any:
        refuse(f"mi.warp.{name} is")

    for name in list(vars(mi.warp)):
        delattr(mi.warp, name)
    setattr(mi.warp, "__getattr__", attribute)  # noqa: B010


def _remove_sampling() -> None:
    """Replace methods and functions of Mitsuba that sample, except `Integrator.sample`."""
    import mitsuba as mi

    modules = [vars(sys.modules[f"mitsuba.{mi.variant()}"]), vars(mi)]
    for content in modules:
        for name in [name for name, value in content.items() if _is_native(value)]:
            if SAMPLES.match(name) and not name.startswith("sample_tea"):
                content[name] = _refusal(f"mi.{name} is")
    for owner in filter(inspect.isclass, list(modules[0].values())):
        if issubclass(owner, mi.Integrator | mi.Sampler | mi.Film):
            continue
        for name in [name for name, value in vars(owner).items() if _is_native(value)]:
            if SAMPLES.match(name) or (name == "eval" and owner.__name__ in MATERIALS):
                setattr(owner, name, _refusal(f"{owner.__name__}.{name} is"))


def _is_native(value: object) -> bool:
    """Whether an object is a function or a method of a native module."""
    return type(value).__name__ in ("nb_func", "nb_method")


def _refusal(what: str) -> Callable[..., NoReturn]:
    """Function that stands where a forbidden one was."""

    def refused(*_: Any, **__: Any) -> NoReturn:
        refuse(what)

    return refused


def _remove_integrators() -> None:
    """Delete the methods of all integrators in Python, and the package's path loop."""
    import mitsuba as mi

    for integrator in set(_subclasses(mi.Integrator)):
        if integrator.__module__.startswith(("mitsuba.python", "tofrender")):
            for name, value in list(vars(integrator).items()):
                if callable(value) or isinstance(value, property | classmethod | staticmethod):
                    delattr(integrator, name)
            integrator.__init__ = _refusal(INTEGRATORS)
    for module in [m for name, m in sys.modules.items() if name.startswith("tofrender.")]:
        for name, value in list(vars(module).items()):
            if isinstance(value, FunctionType) and value.__module__ == LOOP:
                delattr(module, name)

    # Native integrators cannot be deleted; without the sandbox these functions refuse them
    modules = {id(m): m for name, m in sys.modules.items() if name.startswith("mitsuba")}
    for owner in modules.values():
        for name in LOADERS & vars(owner).keys():
            _refuse_integrators(owner, name)
    _refuse_integrators(mi.PluginManager, "create_object")
    _refuse_integrators(mi.Scene, "integrator")


INTEGRATORS = "integrators of Mitsuba and the package are"


def _subclasses(of: type) -> Iterator[type]:
    for each in of.__subclasses__():
        yield each
        yield from _subclasses(each)


def _refuse_integrators(owner: type | ModuleType, name: str) -> None:
    """Let a function refuse integrators that are its results, or that it cannot load."""
    import mitsuba as mi

    function = getattr(owner, name)
    hidden = re.compile(rf"plugins/({'|'.join(NATIVE_INTEGRATORS)})\.")

    def checked(*arguments: Any, **keywords: Any) -> Any:
        try:
            found = function(*arguments, **keywords)
        except RuntimeError as error:
            if hidden.search(str(error)):
                refuse(INTEGRATORS)
            raise
        if isinstance(found, mi.Integrator) and type(found).__module__.startswith("mitsuba"):
            refuse(INTEGRATORS)
        return found

    setattr(owner, name, checked)
