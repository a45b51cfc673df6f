"""What every scene is made of: cameras, films, materials, and shapes in their places."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any

import mitsuba as mi

from ..runtime import checks

SAMPLER = "padded_sobol"
"""The sampler of all built-in scenes."""

PATH_TRACERS = ("path_tracer_mats", "path_tracer_nee", "path_tracer_mis")
"""Integrators that count bounces; Mitsuba's `path` counts segments, one more."""

Dict = dict[str, Any]

CORNELL = {
    "white": [0.885809, 0.698859, 0.666422],
    "green": [0.105421, 0.37798, 0.076425],
    "red": [0.570068, 0.0430135, 0.0443706],
}
"""Reflectances of the Cornell box's walls."""


def rgb(value: Sequence[float]) -> Dict:
    """A colour, linear RGB."""
    return {"type": "rgb", "value": list(value)}


def diffuse(reflectance: Sequence[float]) -> Dict:
    """A diffuse material."""
    return {"type": "diffuse", "reflectance": rgb(reflectance)}


def area_light(radiance: Sequence[float]) -> Dict:
    """What makes a shape a light; radiance [W m^-2 sr^-1]."""
    return {"type": "area", "radiance": rgb(radiance)}


def shape(kind: str, to_world: Any, bsdf: str) -> Dict:
    """A shape that uses the scene's material `bsdf`."""
    return {"type": kind, "to_world": to_world, "bsdf": {"type": "ref", "id": bsdf}}


def sphere(center: Sequence[float], radius: float, bsdf: str) -> Dict:
    """A sphere [m] that uses the scene's material `bsdf`."""
    return {
        "type": "sphere",
        "center": list(center),
        "radius": radius,
        "bsdf": {"type": "ref", "id": bsdf},
    }


def ball_light(
    center: Sequence[float], radius: float, power: float, colour: Sequence[float]
) -> Dict:
    """A black sphere that radiates `power` times `colour` [W]: radiance power / (4 pi² radius²)."""
    radiance = power / (4 * pi**2 * radius**2)
    light = {"emitter": area_light([radiance * channel for channel in colour])}
    return sphere(center, radius, "black") | light


def place(
    position: Sequence[float], axis: Sequence[float], angle: float, scale: Sequence[float]
) -> Any:
    """Scale, turn about `axis` by `angle` degrees, then move to `position` [m]."""
    transform = mi.ScalarTransform4f()
    return transform.translate(position).rotate(axis, angle).scale(scale)


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
        "to_world": mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0]),
        "film": film,
        "sampler": {"type": SAMPLER, "sample_count": checks.integer("spp", spp, 1, checks.MAX_SPP)},
    }


def steady_film(width: int, height: int) -> Dict:
    """A steady film with a box filter [pixels]."""
    return {
        "type": "hdrfilm",
        "width": checks.integer("width", width, 1, checks.MAX_SIZE),
        "height": checks.integer("height", height, 1, checks.MAX_SIZE),
        "rfilter": {"type": "box"},
    }


def transient_film(
    width: int, height: int, temporal_bins: int, start_opl: float, bin_width_opl: float
) -> Dict:
    """A film with time bins, from `start_opl` [m] on, each `bin_width_opl` [m] wide."""
    return steady_film(width, height) | {
        "type": "transient_hdr_film",
        "temporal_bins": checks.integer("temporal_bins", temporal_bins, 1, checks.MAX_BINS),
        "start_opl": checks.metres("start_opl", start_opl),
        "bin_width_opl": checks.metres("bin_width_opl", bin_width_opl, positive=True),
    }


def path_tracer(integrator: str, max_bounces: int) -> Dict:
    """One of `PATH_TRACERS`, or Mitsuba's `path` for the same paths.

    Args:
        integrator: Its name.
        max_bounces: Most reflections between light and camera; 1 is direct light only.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> path_tracer("path", 1)
        {'type': 'path', 'max_depth': 2}
    """
    checks.one_of("integrator", integrator, (*PATH_TRACERS, "path"))
    depth = checks.depth_of_bounces(max_bounces)
    if integrator == "path":
        return {"type": "path", "max_depth": depth}
    return {"type": integrator, "max_bounces": max_bounces}
