"""Mitsuba plugins of this package: a table of all plugins, and their registration in a variant.

Classes that derive from Mitsuba's classes (films, integrators, samplers) belong to the variant that
was active when their module was executed. Therefore `MODULES` are executed again for each variant
that is activated, like Mitsuba's own Python integrators. `plugin` returns the class of the active
variant. All other modules of the package support any vectorized variant.
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
    """A plugin: its name in scenes, its kind (as in `mi.register_film`), and its module."""

    name: str
    kind: str
    home: str


# Modules with classes that derive from Mitsuba's classes, in the order of their dependencies. Each
# entry contains the module below `tofrender`, and class, name and kind of its plugin, if any
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

Another package may register a plugin with the same name. Mitsuba uses the last registration.
Therefore our plugins are also registered as "tofrender_...". `qualified_name` returns this name.
"""

# Modules with a function `maker` that converts the class of a plugin to its factory
_MAKERS = {"transient_path": "tofrender.nlos.light.confocal"}

# Default of max_depth in mitransient's volumetric integrators
PEER_DEPTH = 6

# Classes by variant and class name
_classes: dict[str, dict[str, type]] = {}


def plugin(class_name: str) -> Any:
    """Return a plugin class of the active variant.

    Raises:
        AttributeError: The variant does not support the plugin.
        LeftOut: The module of the plugin is not part of this edition.
    """
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
    """Return a name of our plugin that other packages do not use; other names are unchanged."""
    ours = any(plugin_name == each.name for each in PLUGINS.values())
    return f"tofrender_{plugin_name}" if ours else plugin_name


_left_out: set[str] = set()


def leave_out(names: Collection[str]) -> None:
    """Exclude native plugins from loading. Call this function before a variant is active."""
    _left_out.update(names)


@cache
def load_native_plugins() -> frozenset[str]:
    """Load Mitsuba's native plugins from its package's folder, and return their names.

    Mitsuba itself would first search the working folder and the folder of the scene, and execute
    what it finds there.
    """
    import mitsuba as mi

    # The stubs of these functions are not callable
    untyped: Any = mi
    before = untyped.file_resolver()
    package = Path(mi.__file__).parent
    names = frozenset(each.stem for each in (package / "plugins").iterdir()) - _left_out

    # Load all plugins with a search path of this folder only
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
    """Raise a ValueError if a plugin has native code outside Mitsuba's package."""
    import mitsuba as mi

    if not re.fullmatch(r"[\w-]+", name, re.ASCII):
        raise ValueError(f"type = {name!r}: must be a plugin's name, of letters, digits, - and _")

    # "scene" is part of Mitsuba's core
    if name in load_native_plugins() or name == "scene":
        return

    # Search for a native plugin
    resolver: Any = mi.file_resolver
    for suffix in (".so", ".dylib", ".dll"):
        found = Path(str(resolver().resolve(f"plugins/{name}{suffix}")))
        if found.exists():
            raise ValueError(
                f"type = {name!r}: is native code in {str(found)!r}, which is not loaded; must be "
                "a plugin of Mitsuba, or one registered in Python"
            )


def register(variant: str) -> None:
    """Register our plugins in a variant, once. Later registrations of other packages remain."""
    load_native_plugins()
    if variant in _classes:
        return
    import mitsuba as mi

    # Scalar variants are not supported
    if variant.startswith("scalar"):
        _classes[variant] = {}
        for each in PLUGINS.values():
            getattr(mi, f"register_{each.kind}")(each.name, _refuse)
        return

    # Execute the modules, and register their classes
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
    """Create our integrator from properties of mitransient, with mitransient's default depth."""
    limit_depth(props)
    return factory(props)


def limit_depth(props: Any) -> None:
    """Set mitransient's default depth, unless the properties contain a depth."""
    if not {"max_depth", "max_bounces"} & set(props.keys()):
        props["max_depth"] = PEER_DEPTH


def _refuse(_: Any) -> Any:
    """Raise a BackendError that names the supported variants. Scalar variants use this factory."""
    variants.require_vectorized()


def _run(module: str) -> Any:
    """Execute a module in the active variant, also if it was imported before."""
    imported = sys.modules.get(module)
    return importlib.reload(imported) if imported else importlib.import_module(module)
