"""Choosing the Mitsuba variant, and keeping our plugins registered when it changes.

Classes that derive from Mitsuba's (films, integrators, samplers) belong to the variant that was
active when their module ran. `PLUGIN_MODULES` therefore run once more for every variant that is
switched to, as Mitsuba's own Python integrators do, and `plugin` finds the class that belongs to
the active variant. Everything else in the package works in any vectorised variant as it is.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

from . import checks, llvm, withheld

PLUGIN_MODULES = (
    "tofrender.sampling.padded_sobol",
    "tofrender.films.transient",
    "tofrender.integrators.base",
    "tofrender.integrators.transient_path",
    "tofrender.integrators.time_gated",
    "tofrender.films.phasor",
    "tofrender.integrators.amcw",
    "tofrender.integrators.path_tracer",
    "tofrender.integrators.path_tracer_mats",
    "tofrender.integrators.path_tracer_nee",
    "tofrender.integrators.path_tracer_mis",
    "tofrender.integrators.first_surface",
    "tofrender.integrators.simple",
    "tofrender.integrators.ao",
    "tofrender.bsdfs.retroreflector",
    "tofrender.emitters.confocal_projector",
    "tofrender.integrators.relay_wall_path",
    "tofrender.integrators.confocal",
    "tofrender.integrators.transient_nlos",
    "tofrender.sensors.capture_meter",
)
"""Modules that define Mitsuba plugins, each after those that it builds on."""

PLUGINS = {
    "AmbientOcclusion": ("ao", "tofrender.integrators.ao"),
    "AMCWTransientPath": ("amcw_transient_path", "tofrender.integrators.amcw"),
    "ConfocalProjector": ("confocal_projector", "tofrender.emitters.confocal_projector"),
    "ConfocalTransientIntegrator": (
        "confocal_transient_path",
        "tofrender.integrators.confocal",
    ),
    "NLOSCaptureMeter": ("nlos_capture_meter", "tofrender.sensors.capture_meter"),
    "PaddedSobolSampler": ("padded_sobol", "tofrender.sampling.padded_sobol"),
    "PathTracerMIS": ("path_tracer_mis", "tofrender.integrators.path_tracer_mis"),
    "PathTracerMats": ("path_tracer_mats", "tofrender.integrators.path_tracer_mats"),
    "PathTracerNEE": ("path_tracer_nee", "tofrender.integrators.path_tracer_nee"),
    "PhasorHDRFilm": ("phasor_hdr_film", "tofrender.films.phasor"),
    "Retroreflector": ("retroreflector", "tofrender.bsdfs.retroreflector"),
    "Simple": ("simple", "tofrender.integrators.simple"),
    "TimeGatedTransientPath": (
        "time_gated_transient_path",
        "tofrender.integrators.time_gated",
    ),
    "TransientHDRFilm": ("transient_hdr_film", "tofrender.films.transient"),
    "TransientNLOSPath": ("transient_nlos_path", "tofrender.integrators.transient_nlos"),
    "TransientPath": ("transient_path", "tofrender.integrators.transient_path"),
}
"""Public plugin classes: the plugin's name, and the module that defines it.

Another package may register a plugin of the same name; the last one to do so has it. Ours are
therefore registered as "tofrender_..." too, and `own_name` says which name is safe.
"""

_classes: dict[str, dict[str, type]] = {}  # variant -> class name -> class


class BackendError(RuntimeError):
    """No variant can render here; the message is one line with the command that mends it."""


def activate(variant: str | None = None) -> str:
    """Make sure that a usable Mitsuba variant is active and our plugins are registered in it.

    Args:
        variant: The variant to switch to. None keeps the one that is active; if there is none,
            picks `cuda_ad_rgb` if CUDA works, else `llvm_ad_rgb`.

    Returns:
        The name of the active variant.

    Raises:
        ValueError: Mitsuba has no such variant.
        BackendError: The variant cannot render on this machine.

    Example:
        >>> activate() in ("cuda_ad_rgb", "llvm_ad_rgb")
        True
    """
    _offer_llvm()
    import mitsuba as mi

    if variant is not None:
        checks.one_of("variant", variant, mi.variants())
    if _on_variant_change not in _callbacks:
        _callbacks.append(_on_variant_change)
        mi.detail.add_variant_callback(_on_variant_change)
    if variant is None and mi.variant() is None:
        variant = "cuda_ad_rgb" if cuda_works() else "llvm_ad_rgb"
    if variant is not None and variant.startswith("llvm"):
        require_llvm()
    if variant is not None and variant.startswith("cuda") and not cuda_works():
        raise BackendError(
            f"variant = {variant!r}: no CUDA device or driver found; use an llvm_* variant"
        )
    if variant is not None and variant != mi.variant():
        mi.set_variant(variant)
    active = str(mi.variant())
    if active.startswith("llvm"):
        require_llvm()
    _register(active)
    return active


def require_vectorised() -> None:
    """Refuse to render under a scalar variant, or under none.

    Raises:
        BackendError: One line that says which call helps.
    """
    import mitsuba as mi

    variant = mi.variant()
    if variant is None or variant.startswith("scalar"):
        raise BackendError(
            f"variant = {variant!r}: cannot render in time, must be an llvm_* or cuda_* variant; "
            "call mi.set_variant('llvm_ad_rgb') first"
        )


def cuda_works() -> bool:
    """Whether Dr.Jit can use a CUDA device on this machine."""
    import drjit as dr

    return dr.has_backend(dr.JitBackend.CUDA)


def require_llvm() -> None:
    """Refuse an LLVM that would abort the process at the first kernel.

    Raises:
        BackendError: One line: what was found and the command that mends it.
    """
    import drjit as dr

    library = llvm.choose()
    if not dr.has_backend(dr.JitBackend.LLVM):
        raise BackendError(
            llvm.refusal()
            if library is None
            else f"{library.path}: Dr.Jit cannot load this LLVM; run `tofrender doctor`"
        )
    major = dr.detail.llvm_version()[0]
    if major < llvm.MINIMUM_MAJOR:
        raise BackendError(
            llvm.refusal()
            if library is None
            else f"Dr.Jit has loaded LLVM {major}, must be {llvm.MINIMUM_MAJOR} or newer: import "
            f"tofrender before mitsuba and drjit, or set {llvm.VARIABLE}={library.path}"
        )


def plugin(name: str) -> Any:
    """The plugin class `name` of the active variant.

    Raises:
        AttributeError: There is no such class, or the active variant cannot have it.
        Withheld: Students write it.
    """
    import mitsuba as mi

    variant = mi.variant()
    if name not in PLUGINS or variant is None or variant.startswith("scalar"):
        raise AttributeError(
            f"tofrender.{name} needs an llvm_* or cuda_* variant; the active one is {variant!r}"
        )
    reason = withheld.refusal(PLUGINS[name][1])
    if reason is not None:
        raise withheld.of_name("tofrender", name, withheld.Withheld(reason))
    _register(variant)
    return _classes[variant][name]


def own_name(plugin_name: str) -> str:
    """The name by which a plugin of ours is found, whatever other packages have registered.

    Example:
        >>> own_name("transient_path"), own_name("path")
        ('tofrender_transient_path', 'path')
    """
    ours = any(plugin_name == name for name, _ in PLUGINS.values())
    return f"tofrender_{plugin_name}" if ours else plugin_name


_callbacks: list = []


def _offer_llvm() -> None:
    """Name the LLVM that Dr.Jit shall load; it reads the variable when it is imported."""
    if not os.environ.get(llvm.VARIABLE):
        library = llvm.choose()
        if library is not None:
            os.environ[llvm.VARIABLE] = str(library.path)


def _on_variant_change(_old: str | None, new: str | None) -> None:
    if new is not None:
        _register(new)


def _register(variant: str) -> None:
    """Register our plugins in `variant`, once: another package's later ones stay in place."""
    if variant in _classes or variant.startswith("scalar"):
        return
    modules = {}
    for name in PLUGIN_MODULES:
        if withheld.refusal(name) is None:
            loaded = sys.modules.get(name)
            modules[name] = importlib.reload(loaded) if loaded else importlib.import_module(name)
    _classes[variant] = {}
    for name, (plugin_name, home) in PLUGINS.items():
        if home in modules:
            _classes[variant][name] = getattr(modules[home], name)
        else:
            withheld.stand_in(name, plugin_name, home)
