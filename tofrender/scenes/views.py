"""Cameras, films and integrators of the built-in scenes, and the options of their builders."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import mitsuba as mi

from ..runtime import checks
from ..runtime.settings import CHECKS, INTEGRATORS
from .parts import Dict, Y

SAMPLER = "padded_sobol"  # The sampler of all built-in scenes

PATH_TRACERS = ("path_tracer_mats", "path_tracer_nee", "path_tracer_mis")
"""Integrators with a limit of bounces. Mitsuba's `path` limits segments, which are one more."""

WITH_DEPTH = tuple(name for name in INTEGRATORS if name != "ao")
"""Integrators with a `max_depth`, which transient scenes support."""


class TransientOptions(TypedDict, total=False):
    """Options of the built-in transient scenes, described at `caustic`."""

    width: int
    height: int
    temporal_bins: int
    start_opl: float
    bin_width_opl: float
    spp: int
    max_depth: int
    integrator: str


class SteadyOptions(TypedDict, total=False):
    """Options of the built-in steady scenes for path tracers, described at `veach`."""

    width: int
    height: int
    spp: int
    integrator: str
    max_bounces: int


def transient_scene(
    origin: Sequence[float],
    target: Sequence[float],
    fov: float,
    options: Mapping[str, Any],
    **defaults: Any,
) -> Dict:
    """Return a scene without shapes: an integrator, and a camera with a transient film.

    Args:
        origin: Position of the camera [m].
        target: Point that the camera looks at [m].
        fov: Field of view on the smaller axis [degrees].
        options: Options that the user passed to a builder, a part of `TransientOptions`.
        **defaults: Defaults of the builder for these options.
    """
    general = {
        "width": 256,
        "height": 256,
        "temporal_bins": 300,
        "bin_width_opl": 0.02,
        "spp": 256,
        "integrator": "transient_path",
    }
    merged = _merged(general | defaults, options)

    # The remaining options belong to the film
    depth, kind, spp = (merged.pop(name) for name in ("max_depth", "integrator", "spp"))
    film = transient_film(**merged)
    checks.one_of("integrator", kind, WITH_DEPTH)
    return {
        "type": "scene",
        "integrator": {"type": kind, "max_depth": checks.depth("max_depth", depth)},
        "sensor": camera(origin, target, fov, film, spp),
    }


def steady_scene(
    origin: Sequence[float],
    target: Sequence[float],
    fov: float,
    options: Mapping[str, Any],
    **defaults: Any,
) -> Dict:
    """Return a scene without shapes: a path tracer, and a camera with a steady film.

    Arguments are as in `transient_scene`, with options of `SteadyOptions`.
    """
    general = {
        "width": 256,
        "height": 192,
        "spp": 64,
        "integrator": "path_tracer_mis",
        "max_bounces": 1,
    }
    merged = _merged(general | defaults, options)

    # The path tracers limit bounces, Mitsuba's `path` limits segments
    kind = checks.one_of("integrator", merged["integrator"], (*PATH_TRACERS, "path"))
    depth = checks.depth_of_bounces(merged["max_bounces"])
    limit = {"max_depth": depth} if kind == "path" else {"max_bounces": merged["max_bounces"]}
    film = steady_film(merged["width"], merged["height"])
    return {
        "type": "scene",
        "integrator": {"type": kind} | limit,
        "sensor": camera(origin, target, fov, film, merged["spp"]),
    }


def _merged(defaults: Dict, options: Mapping[str, Any]) -> Dict:
    """Return defaults with the user's options. Raise an error for unknown options."""
    for name in options:
        if name not in defaults:
            raise TypeError(f"{name} is not an option. Use {', '.join(defaults)}")
    return defaults | dict(options)


def camera(
    origin: Sequence[float], target: Sequence[float], fov: float, film: Dict, spp: int
) -> Dict:
    """Return a pinhole camera at `origin` that looks at `target` [m].

    The field of view `fov` [degrees] is measured on the smaller axis. `spp` is the sample count.
    """
    return {
        "type": "perspective",
        "fov_axis": "smaller",
        "fov": fov,
        "near_clip": 0.001,
        "far_clip": 100.0,
        "to_world": mi.ScalarTransform4f().look_at(origin, target, Y),
        "film": film,
        "sampler": {"type": SAMPLER, "sample_count": CHECKS["spp"]("spp", spp)},
    }


def steady_film(width: int, height: int) -> Dict:
    """Return a steady film with a box filter, of a size in pixels."""
    return {"type": "hdrfilm", **_checked(width=width, height=height), "rfilter": {"type": "box"}}


def transient_film(
    width: int, height: int, temporal_bins: int, start_opl: float, bin_width_opl: float
) -> Dict:
    """Return a film with time bins, the first at `start_opl` [m], each `bin_width_opl` [m] wide."""
    bins = {"temporal_bins": temporal_bins, "start_opl": start_opl, "bin_width_opl": bin_width_opl}
    return steady_film(width, height) | {"type": "transient_hdr_film", **_checked(**bins)}


def _checked(**settings: Any) -> Dict:
    """Check each setting, and return the settings."""
    return {name: CHECKS[name](name, value) for name, value in settings.items()}
