"""Cameras, films and integrators of the built-in scenes, and their options."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import mitsuba as mi

from ..runtime import checks
from ..runtime.settings import CHECKS, INTEGRATORS
from .parts import Dict, Y

SAMPLER = "padded_sobol"  # The sampler of all built-in scenes

PATH_TRACERS = ("path_tracer_mats", "path_tracer_nee", "path_tracer_mis")
"""Integrators that count bounces; Mitsuba's `path` counts segments, one more."""

WITH_DEPTH = tuple(name for name in INTEGRATORS if name != "ao")
"""Integrators of transient scenes: those that have a `max_depth`."""


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
    """A scene without shapes: integrator, transient film, and a camera as in `camera`.

    `options` are the `TransientOptions` that a builder is given, `defaults` its own.
    """
    given = {"width": 256, "height": 256, "temporal_bins": 300, "bin_width_opl": 0.02, "spp": 256}
    given = _merged(given | {"integrator": "transient_path"} | defaults, options)
    depth, kind, spp = (given.pop(name) for name in ("max_depth", "integrator", "spp"))
    film = transient_film(**given)
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
    """A scene as of `transient_scene` with a steady film and a path tracer or Mitsuba's `path`."""
    given = {"width": 256, "height": 192, "spp": 64, "integrator": "path_tracer_mis"}
    given = _merged(given | {"max_bounces": 1} | defaults, options)
    checks.one_of("integrator", given["integrator"], (*PATH_TRACERS, "path"))
    depth = checks.depth_of_bounces(given["max_bounces"])
    limit = {"max_bounces": given["max_bounces"]}
    if given["integrator"] == "path":
        limit = {"max_depth": depth}
    film = steady_film(given["width"], given["height"])
    return {
        "type": "scene",
        "integrator": {"type": given["integrator"]} | limit,
        "sensor": camera(origin, target, fov, film, given["spp"]),
    }


def _merged(defaults: Dict, options: Mapping[str, Any]) -> Dict:
    for name in options:
        if name not in defaults:
            raise TypeError(f"{name}: no such option; there are {', '.join(defaults)}")
    return defaults | dict(options)


def camera(
    origin: Sequence[float], target: Sequence[float], fov: float, film: Dict, spp: int
) -> Dict:
    """A pinhole camera at `origin` that looks at `target` [m]; `fov` is on the smaller axis."""
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
    """A steady film with a box filter [pixels]."""
    return {"type": "hdrfilm", **_checked(width=width, height=height), "rfilter": {"type": "box"}}


def transient_film(
    width: int, height: int, temporal_bins: int, start_opl: float, bin_width_opl: float
) -> Dict:
    """A film with time bins, from `start_opl` [m] on, each `bin_width_opl` [m] wide."""
    bins = {"temporal_bins": temporal_bins, "start_opl": start_opl, "bin_width_opl": bin_width_opl}
    return steady_film(width, height) | {"type": "transient_hdr_film", **_checked(**bins)}


def _checked(**settings: Any) -> Dict:
    """Settings of a scene, each one checked."""
    return {name: CHECKS[name](name, value) for name, value in settings.items()}
