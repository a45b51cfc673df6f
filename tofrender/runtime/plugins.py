"""Mitsuba plugins of this package: a table of all, and their registration in each variant.

Classes that derive from Mitsuba's (films, integrators, samplers) belong to the variant that was
active when their module ran. `MODULES` therefore run once more for every variant that is switched
to, as Mitsuba's own Python integrators do, and `plugin` returns the class of the active variant.
Everything else in the package works in any vectorised variant as it is.
"""

import importlib
import re
import sys
from collections.abc import Collection
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from . import editions, variants


class Plugin(NamedTuple):
    """Name in scenes, kind (as in `mi.register_film`), and module of a plugin's class."""

    name: str
    kind: str
    home: str


# Modules whose classes derive from Mitsuba's, each after those that it builds on: module below
# `tofrender`, and class, name and kind of its plugin, if it has one
_TABLE = (
    ("scenes.angular_area", "AngularArea", "angulararea", "emitter"),
    ("samplers.padded_sobol", "PaddedSobolSampler", "padded_sobol", "sampler"),
    ("films.transient", "TransientHDRFilm", "transient_hdr_film", "film"),
    ("films.phasor", "PhasorHDRFilm", "phasor_hdr_film", "film"),
    ("integrators.base",),
    ("integrators.transient_path", "TransientPath", "transient_path", "integrator"),
    ("integrators.transient_volpath", "TransientVolpath", "transient_volpath", "integrator"),
    ("integrators.time_gated", "TimeGatedTransientPath", "time_gated_transient_path", "integrator"),
    ("integrators.amcw", "AMCWTransientPath", "amcw_transient_path", "integrator"),
    ("integrators.path_tracer",),
    ("integrators.path_tracer_mats", "PathTracerMats", "path_tracer_mats", "integrator"),
    ("integrators.path_tracer_nee", "PathTracerNEE", "path_tracer_nee", "integrator"),
    ("integrators.path_tracer_mis", "PathTracerMIS", "path_tracer_mis", "integrator"),
    ("integrators.first_surface",),
    ("integrators.bidirectional",),
    ("integrators.light_tracer", "TransientLightTracer", "transient_light_tracer", "integrator"),
    ("integrators.bdpt", "TransientBDPT", "transient_bdpt", "integrator"),
    ("integrators.simple", "Simple", "simple", "integrator"),
    ("integrators.ao", "AmbientOcclusion", "ao", "integrator"),
    ("nlos.device.retroreflector", "Retroreflector", "retroreflector", "bsdf"),
    ("nlos.device.projector", "ConfocalProjector", "confocal_projector", "emitter"),
    ("nlos.device.capture_meter", "NLOSCaptureMeter", "nlos_capture_meter", "sensor"),
    ("nlos.light.relay_wall_path",),
    ("nlos.light.confocal", "ConfocalTransientIntegrator", "confocal_transient_path", "integrator"),
    ("nlos.light.transient_nlos", "TransientNLOSPath", "transient_nlos_path", "integrator"),
)

MODULES = tuple(f"tofrender.{module}" for module, *_ in _TABLE)

PLUGINS = {
    plugin[0]: Plugin(plugin[1], plugin[2], f"tofrender.{module}")
    for module, *plugin in _TABLE
    if plugin
}
"""Public plugin classes by name.

Another package may register a plugin of the same name, and the last one to do so gets it. Ours are
therefore registered as "tofrender_..." too, and `qualified_name` returns the name that is safe.
"""

# Modules whose `maker` turns the class of a plugin into its factory, which chooses among classes
_MAKERS = {"transient_path": "tofrender.nlos.light.confocal"}

PEER_DEPTH = 6  # Default of max_depth in mitransient's volumetric integrators

_classes: dict[str, dict[str, type]] = {}  # variant -> class name -> class


def plugin(class_name: str) -> Any:
    """Plugin class of the active variant; an AttributeError or LeftOut if it has none."""
    import mitsuba as mi

    variant = mi.variant()
    if class_name not in PLUGINS or variant is None or variant.startswith("scalar"):
        needed = f"needs an {variants.KINDS} variant; the active one is"
        raise AttributeError(f"tofrender.{class_name} {needed} {variant!r}")
    reason = editions.refusal(PLUGINS[class_name].home)
    if reason is not None:
        raise editions.error_for("tofrender", class_name, editions.LeftOut(reason))
    register(variant)
    return _classes[variant][class_name]


def qualified_name(plugin_name: str) -> str:
    """Name that finds a plugin of ours, whatever other packages have registered."""
    ours = any(plugin_name == each.name for each in PLUGINS.values())
    return f"tofrender_{plugin_name}" if ours else plugin_name


_left_out: set[str] = set()


def leave_out(names: Collection[str]) -> None:
    """Choose native plugins that this process must not load; call it before a variant is active."""
    _left_out.update(names)


@cache
def load_native_plugins() -> frozenset[str]:
    """Load Mitsuba's native plugins from its package's folder, and return their names.

    Mitsuba would search the working folder and that of the scene first, and run what it finds.
    """
    import mitsuba as mi

    untyped: Any = mi  # the stubs of these functions are not callable
    before, package = untyped.file_resolver(), Path(mi.__file__).parent
    names = frozenset(each.stem for each in (package / "plugins").iterdir()) - _left_out
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
    """Raise a ValueError for a plugin whose native code lies outside of Mitsuba's package."""
    import mitsuba as mi

    if not re.fullmatch(r"[\w-]+", name, re.ASCII):
        raise ValueError(f"type = {name!r}: must be a plugin's name, of letters, digits, - and _")
    if name in load_native_plugins() or name == "scene":  # That one is built in
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
    load_native_plugins()
    if variant in _classes:
        return
    import mitsuba as mi

    if variant.startswith("scalar"):
        _classes[variant] = {}
        for each in PLUGINS.values():
            getattr(mi, f"register_{each.kind}")(each.name, _refuse)
        return
    loaded = {name: _run(name) for name in MODULES if editions.refusal(name) is None}
    _classes[variant] = {}
    for class_name, each in PLUGINS.items():
        if each.home in loaded:
            factory: Any = getattr(loaded[each.home], class_name)
            _classes[variant][class_name] = factory
            if _MAKERS.get(each.name) in loaded:
                factory = loaded[_MAKERS[each.name]].maker(factory)
        else:
            factory = editions.placeholder(class_name, each.name, each.kind, each.home)
            if factory is None:
                continue
        for name in (each.name, f"tofrender_{each.name}"):
            getattr(mi, f"register_{each.kind}")(name, factory)
        if each.name == "transient_volpath":
            mi.register_integrator("transient_prbvolpath", partial(_of_peer, factory))


def _of_peer(factory: Any, props: Any) -> Any:
    """Make our integrator of mitransient's properties, whose depth has another default."""
    limit_depth(props)
    return factory(props)


def limit_depth(props: Any) -> None:
    """Set mitransient's default of the depth, unless there is one."""
    if not {"max_depth", "max_bounces"} & set(props.keys()):
        props["max_depth"] = PEER_DEPTH


def _refuse(_: Any) -> Any:
    """Factory of plugins under scalar variants: raises an error that names those that work."""
    variants.require_vectorised()


def _run(module: str) -> Any:
    """Run a module, once more if it was imported, under the active variant."""
    imported = sys.modules.get(module)
    return importlib.reload(imported) if imported else importlib.import_module(module)
