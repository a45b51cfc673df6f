"""Features that a handout does not allow: Mitsuba refuses them while a submission runs.

`forbids` in the rubric, for an assignment or for one problem, names parts to be written by hand:

| word | not allowed |
|---|---|
| `warps` | `mi.warp` |
| `integrators` | integrators of Mitsuba and of this package |
| `light sampling` | Mitsuba's sampling of emitters and shapes, and its densities |
"""

import importlib
import sys
import threading
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

from ..rubric import Rubric

LIGHT_SAMPLING = frozenset(
    "sample_emitter sample_emitter_ray sample_emitter_direction pdf_emitter sample_position "  # noqa: SIM905
    "pdf_emitter_direction sample_ray sample_direction pdf_direction pdf_position".split()
)
LOADERS = {"load_dict", "load_string", "load_file"}


class Forbidden(Exception):
    """A submission has used a forbidden feature; one line."""


def guard(folder: Path, rubric: Rubric, used: Collection[str] = ()) -> None:
    """Let Mitsuba refuse what a rubric forbids to files of a folder, however they come by it.

    What a problem forbids is refused while `used` has one of its names.
    """
    import mitsuba as mi

    def refuse(word: str, text: str) -> None:
        """Raise `Forbidden` if the folder's files call, directly or not, or may: in a thread."""
        asked = (rubric, *(rubric.problem_by_name[name] for name in used))
        if not any(word in each.forbids for each in asked):
            return
        frame = sys._getframe(2)
        while frame is not None and not frame.f_code.co_filename.startswith(str(folder)):
            frame = frame.f_back
        if frame is not None or threading.current_thread() is not threading.main_thread():
            raise Forbidden(f"{text} not allowed in this problem: write it yourself")

    def check(
        owner: Any, name: str, word: str, text: str, refuses: Callable[[Any], bool] = lambda _: True
    ) -> None:
        """Let a function refuse some results."""
        function = getattr(owner, name)

        def checked(*arguments: Any, **keywords: Any) -> Any:
            found = function(*arguments, **keywords)
            if refuses(found):
                refuse(word, text)
            return found

        setattr(owner, name, checked)

    def is_given(found: Any) -> bool:
        given = type(found).__module__.startswith(("mitsuba", "tofrender"))
        return given and isinstance(found, mi.Integrator)

    words = {word for each in (rubric, *rubric.problems) for word in each.forbids}
    if "integrators" in words:
        told = "integrators", "integrators of Mitsuba and the package are"
        for module in [m for name, m in sys.modules.items() if name.startswith("mitsuba")]:
            for name in LOADERS & vars(module).keys():
                check(module, name, *told, is_given)
        check(mi.PluginManager, "create_object", *told, is_given)
        check(mi.Scene, "integrator", *told, is_given)
        common = importlib.import_module("mitsuba.python.ad.integrators.common")
        check(common.ADIntegrator, "__init__", *told)
        with suppress(ImportError):  # withheld
            base = importlib.import_module("tofrender.integrators.base")
            check(base.TransientIntegrator, "__init__", *told)
    if "light sampling" in words:
        for owner in (mi.Scene, mi.Endpoint, mi.EmitterPtr, mi.Shape, mi.ShapePtr):
            for name in LIGHT_SAMPLING & vars(owner).keys():
                check(owner, name, "light sampling", f"{owner.__name__}.{name} is")
    if "warps" in words:
        warp = mi.warp

        def attribute(name: str) -> Any:
            refuse("warps", f"mi.warp.{name} is")
            return getattr(warp, name)

        guarded = ModuleType(warp.__name__)
        vars(guarded)["__getattr__"] = attribute
        mi.warp = sys.modules["mitsuba.warp"] = guarded
