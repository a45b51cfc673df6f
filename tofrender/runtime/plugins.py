"""The Mitsuba plugins of this package: one table of all, and their registration in each variant.

Classes that derive from Mitsuba's (films, integrators, samplers) belong to the variant that was
active when their module ran. `MODULES` therefore run once more for every variant that is switched
to, as Mitsuba's own Python integrators do, and `plugin` finds the class that belongs to the active
variant. Everything else in the package works in any vectorised variant as it is.
"""

from __future__ import annotations

import importlib
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from . import withheld

MODULES = (
    "tofrender.samplers.padded_sobol",
    "tofrender.films.transient",
    "tofrender.films.phasor",
    "tofrender.integrators.base",
    "tofrender.integrators.transient_path",
    "tofrender.integrators.transient_volpath",
    "tofrender.integrators.time_gated",
    "tofrender.integrators.amcw",
    "tofrender.integrators.path_tracer",
    "tofrender.integrators.path_tracer_mats",
    "tofrender.integrators.path_tracer_nee",
    "tofrender.integrators.path_tracer_mis",
    "tofrender.integrators.first_surface",
    "tofrender.integrators.bidirectional",
    "tofrender.integrators.light_tracer",
    "tofrender.integrators.bdpt",
    "tofrender.integrators.simple",
    "tofrender.integrators.ao",
    "tofrender.nlos.device.retroreflector",
    "tofrender.nlos.device.projector",
    "tofrender.nlos.device.capture_meter",
    "tofrender.nlos.light.relay_wall_path",
    "tofrender.nlos.light.confocal",
    "tofrender.nlos.light.transient_nlos",
)
"""Modules whose classes derive from Mitsuba's, each after those that it builds on."""


class Plugin(NamedTuple):
    """Where a plugin is.

    Attributes:
        name: What scenes call it.
        kind: What it is to Mitsuba: "integrator", "film", "sampler", "sensor", "emitter", "bsdf".
        home: The module that defines its class.
        maker: A module whose `maker` turns the class into what makes the plugin, where one name
            stands for several classes.
    """

    name: str
    kind: str
    home: str
    maker: str | None = None


PLUGINS = {
    "AmbientOcclusion": Plugin("ao", "integrator", "tofrender.integrators.ao"),
    "AMCWTransientPath": Plugin("amcw_transient_path", "integrator", "tofrender.integrators.amcw"),
    "ConfocalProjector": Plugin("confocal_projector", "emitter", "tofrender.nlos.device.projector"),
    "ConfocalTransientIntegrator": Plugin(
        "confocal_transient_path", "integrator", "tofrender.nlos.light.confocal"
    ),
    "NLOSCaptureMeter": Plugin(
        "nlos_capture_meter", "sensor", "tofrender.nlos.device.capture_meter"
    ),
    "PaddedSobolSampler": Plugin("padded_sobol", "sampler", "tofrender.samplers.padded_sobol"),
    "PathTracerMIS": Plugin(
        "path_tracer_mis", "integrator", "tofrender.integrators.path_tracer_mis"
    ),
    "PathTracerMats": Plugin(
        "path_tracer_mats", "integrator", "tofrender.integrators.path_tracer_mats"
    ),
    "PathTracerNEE": Plugin(
        "path_tracer_nee", "integrator", "tofrender.integrators.path_tracer_nee"
    ),
    "PhasorHDRFilm": Plugin("phasor_hdr_film", "film", "tofrender.films.phasor"),
    "Retroreflector": Plugin("retroreflector", "bsdf", "tofrender.nlos.device.retroreflector"),
    "Simple": Plugin("simple", "integrator", "tofrender.integrators.simple"),
    "TimeGatedTransientPath": Plugin(
        "time_gated_transient_path", "integrator", "tofrender.integrators.time_gated"
    ),
    "TransientBDPT": Plugin("transient_bdpt", "integrator", "tofrender.integrators.bdpt"),
    "TransientHDRFilm": Plugin("transient_hdr_film", "film", "tofrender.films.transient"),
    "TransientLightTracer": Plugin(
        "transient_light_tracer", "integrator", "tofrender.integrators.light_tracer"
    ),
    "TransientNLOSPath": Plugin(
        "transient_nlos_path", "integrator", "tofrender.nlos.light.transient_nlos"
    ),
    "TransientPath": Plugin(
        "transient_path",
        "integrator",
        "tofrender.integrators.transient_path",
        maker="tofrender.nlos.light.confocal",
    ),
    "TransientVolpath": Plugin(
        "transient_volpath", "integrator", "tofrender.integrators.transient_volpath"
    ),
}
"""Public plugin classes by name.

Another package may register a plugin of the same name; the last one to do so has it. Ours are
therefore registered as "tofrender_..." too, and `own_name` says which name is safe.
"""

_classes: dict[str, dict[str, type]] = {}  # variant -> class name -> class


def plugin(class_name: str) -> Any:
    """The plugin class of the active variant.

    Raises:
        AttributeError: There is no such class, or the active variant cannot have it.
        Withheld: Students write it.
    """
    import mitsuba as mi

    variant = mi.variant()
    if class_name not in PLUGINS or variant is None or variant.startswith("scalar"):
        raise AttributeError(
            f"tofrender.{class_name} needs an llvm_* or cuda_* variant; the active one is "
            f"{variant!r}"
        )
    reason = withheld.refusal(PLUGINS[class_name].home)
    if reason is not None:
        raise withheld.of_name("tofrender", class_name, withheld.Withheld(reason))
    register(variant)
    return _classes[variant][class_name]


def own_name(plugin_name: str) -> str:
    """The name by which a plugin of ours is found, whatever other packages have registered.

    Example:
        >>> own_name("transient_path"), own_name("path")
        ('tofrender_transient_path', 'path')
    """
    ours = any(plugin_name == each.name for each in PLUGINS.values())
    return f"tofrender_{plugin_name}" if ours else plugin_name


@cache
def load_mitsubas() -> frozenset[str]:
    """Load Mitsuba's native plugins from its package's folder, and return their names.

    Mitsuba would look for each in the working folder and beside the scene first, and run it there.
    """
    import mitsuba as mi

    untyped: Any = mi  # the stubs of these functions are not callable
    before, package = untyped.file_resolver(), Path(mi.__file__).parent
    names = frozenset(each.stem for each in (package / "plugins").iterdir())
    only = mi.FileResolver()
    only.clear()
    only.append(str(package))
    untyped.set_file_resolver(only)
    try:
        for name in names:
            mi.PluginManager.instance().plugin_type(name)
    finally:
        untyped.set_file_resolver(before)
    return names


def require_safe_type(name: str) -> None:
    """Refuse a plugin's name that would make Mitsuba run native code from outside its package.

    Raises:
        ValueError: It is no word, or the name of a file in a folder `plugins` that Mitsuba
            searches; one line.
    """
    import mitsuba as mi

    if not re.fullmatch(r"[\w-]+", name, re.ASCII):
        raise ValueError(f"type = {name!r}: must be a plugin's name, of letters, digits, - and _")
    if name in load_mitsubas() or name == "scene":  # That one is built in
        return
    resolver: Any = mi.file_resolver
    for suffix in (".so", ".dylib", ".dll"):
        found = Path(str(resolver().resolve(f"plugins/{name}{suffix}")))
        if found.exists():
            raise ValueError(
                f"type = {name!r}: is native code in {str(found)!r}, which is not loaded; must be "
                "a plugin of Mitsuba, or one registered in Python"
            )


def register(variant: str) -> None:
    """Register our plugins in `variant`, once: another package's later ones stay in place."""
    load_mitsubas()
    if variant in _classes:
        return
    import mitsuba as mi

    if variant.startswith("scalar"):
        _classes[variant] = {}
        for each in PLUGINS.values():
            getattr(mi, f"register_{each.kind}")(each.name, _refuse)
        return
    loaded = {name: _run(name) for name in MODULES if withheld.refusal(name) is None}
    _classes[variant] = {}
    for class_name, each in PLUGINS.items():
        if each.home in loaded:
            made: Any = getattr(loaded[each.home], class_name)
            _classes[variant][class_name] = made
            if each.maker in loaded:
                made = loaded[each.maker].maker(made)
        else:
            made = withheld.stand_in(class_name, each.name, each.kind, each.home)
            if made is None:
                continue
        for name in (each.name, f"tofrender_{each.name}"):
            getattr(mi, f"register_{each.kind}")(name, made)


def _refuse(_: Any) -> Any:
    """What plugins say under a scalar variant."""
    from .backend import require_vectorised

    require_vectorised()


def _run(module: str) -> Any:
    """A module, run under the active variant."""
    before = sys.modules.get(module)
    return importlib.reload(before) if before else importlib.import_module(module)
