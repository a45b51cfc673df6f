"""Features that a handout does not allow: they are removed while a submission runs.

`forbids` in the rubric names the features that students write themselves. It applies to an
assignment or to one problem:

| word | not allowed |
|---|---|
| `warps` | `mi.warp` |
| `integrators` | integrators of Mitsuba and of this package |
| `sampling` | everything in Mitsuba that samples: shapes, lights, materials, distributions |

A wrapper that refuses calls would keep a reference to the wrapped feature, and Python code can
find every object of its process. Therefore `remove` deletes the features before the process loads
a submission, and native integrators are never loaded (`plugins.leave_out`). No object refers to
the features afterwards, so neither closures nor the garbage collector lead to them. In the
sandbox, the process can then read none of the `files` that would bring the features back, and
cannot start another program.
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
"""Names of Mitsuba's methods and functions that sample, or that return probability densities."""
MATERIALS = {"BSDF", "BSDFPtr", "PhaseFunction", "PhaseFunctionPtr", "MicrofacetDistribution"}
"""Classes with a method `eval` that also gives away a density."""
LOOP = "tofrender.paths.walk"  # module of the path loop, which the package's integrators use
INTEGRATOR_FILES = (
    "tofrender/integrators",
    "tofrender/nlos/light",
    "tofrender/paths/walk.py",
    "tofrender/paths/__pycache__/walk.*",  # Python runs bytecode without the source
)
INTEGRATORS = "integrators of Mitsuba and the package are"


class Forbidden(Exception):
    """A submission used a forbidden feature; the message is one line."""


def refuse(what: str) -> NoReturn:
    """Raise `Forbidden`. `what` is the feature with a verb, for example "mi.warp is"."""
    raise Forbidden(f"{what} not allowed in this problem: write it yourself")


def remove(words: Collection[str]) -> None:
    """Delete forbidden features from this process, in the active variant of Mitsuba.

    The features cannot be restored.

    Args:
        words: Words of the table above.
    """
    if "integrators" in words:
        _remove_integrators()
    if "sampling" in words:
        _remove_sampling()
    if "warps" in words:
        _remove_warps()
    gc.collect()  # Deleted classes and functions refer to each other


def files(words: Collection[str], package: Path) -> list[Path]:
    """Return the files that would bring forbidden features back.

    Args:
        words: Words of the table above.
        package: Folder that contains the package `tofrender`.
    """
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
        found += [path for pattern in INTEGRATOR_FILES for path in package.glob(pattern)]
    return [path for path in found if path.exists()]


def _remove_warps() -> None:
    """Delete the functions in the module `mi.warp`."""
    import mitsuba as mi

    def attribute(name: str) -> Any:
        """Raise an error on the access to a deleted function."""
        refuse(f"mi.warp.{name} is")

    for name in list(vars(mi.warp)):
        delattr(mi.warp, name)
    setattr(mi.warp, "__getattr__", attribute)  # noqa: B010


def _remove_sampling() -> None:
    """Replace Mitsuba's sampling methods and functions by functions that raise `Forbidden`.

    Integrators, samplers and films keep their methods.
    """
    import mitsuba as mi

    # Functions; `sample_tea` hashes numbers and stays allowed
    modules = [vars(sys.modules[f"mitsuba.{mi.variant()}"]), vars(mi)]
    for content in modules:
        for name in [name for name, value in content.items() if _is_native(value)]:
            if SAMPLES.match(name) and not name.startswith("sample_tea"):
                content[name] = _refusal(f"mi.{name} is")

    # Methods
    for owner in filter(inspect.isclass, list(modules[0].values())):
        if issubclass(owner, mi.Integrator | mi.Sampler | mi.Film):
            continue
        for name in [name for name, value in vars(owner).items() if _is_native(value)]:
            if SAMPLES.match(name) or (name == "eval" and owner.__name__ in MATERIALS):
                setattr(owner, name, _refusal(f"{owner.__name__}.{name} is"))


def _is_native(value: object) -> bool:
    """Return whether an object is a function or a method of a native module."""
    return type(value).__name__ in ("nb_func", "nb_method")


def _refusal(what: str) -> Callable[..., NoReturn]:
    """Return a function that raises `Forbidden`, as the replacement of a forbidden function."""

    def refused(*_: Any, **__: Any) -> NoReturn:
        refuse(what)

    return refused


def _remove_integrators() -> None:
    """Delete the methods of all integrators in Python, and the package's path loop."""
    import mitsuba as mi

    # Methods of the integrators
    for integrator in set(_subclasses(mi.Integrator)):
        if integrator.__module__.startswith(("mitsuba.python", "tofrender")):
            for name, value in list(vars(integrator).items()):
                if callable(value) or isinstance(value, property | classmethod | staticmethod):
                    delattr(integrator, name)
            integrator.__init__ = _refusal(INTEGRATORS)

    # Functions of the path loop, in all modules that imported them
    for module in [m for name, m in sys.modules.items() if name.startswith("tofrender.")]:
        for name, value in list(vars(module).items()):
            if isinstance(value, FunctionType) and value.__module__ == LOOP:
                delattr(module, name)

    # Native integrators cannot be deleted. Without the sandbox, these functions refuse them
    modules = {id(m): m for name, m in sys.modules.items() if name.startswith("mitsuba")}
    for owner in modules.values():
        for name in LOADERS & vars(owner).keys():
            _refuse_integrators(owner, name)
    _refuse_integrators(mi.PluginManager, "create_object")
    _refuse_integrators(mi.Scene, "integrator")


def _subclasses(of: type) -> Iterator[type]:
    """Yield all direct and indirect subclasses of a class."""
    for each in of.__subclasses__():
        yield each
        yield from _subclasses(each)


def _refuse_integrators(owner: type | ModuleType, name: str) -> None:
    """Wrap a function that makes Mitsuba objects so that it raises `Forbidden` for integrators.

    Args:
        owner: Class or module of the function.
        name: Name of the function.
    """
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
