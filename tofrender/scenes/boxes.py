"""Boxes with light that is reflected many times.

The Cornell box of Mitsuba's tutorials, two metres wide, with the camera at z = 3.9 m, is lit from
the ceiling or by a flash at the camera; one has a mirror, one a glass sphere in it. A smaller box
with two spheres is steady.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

from ..runtime import checks
from .parts import (
    CORNELL,
    Dict,
    area_light,
    camera,
    diffuse,
    path_tracer,
    place,
    rgb,
    shape,
    sphere,
    steady_film,
    transient_film,
)

START_OPL = {"area": 3.5, "flash": 6.0}
"""Where the built-in window starts [m], by light; from each light, nothing arrives earlier."""

CAMERA_Z = 3.9
LIGHT_RADIANCE = [18.387, 13.9873, 6.75357]
FLASH_INTENSITY = [8.0, 8.0, 8.0]

X, Y, UNIT = [1, 0, 0], [0, 1, 0], [1, 1, 1]
LARGE_BOX = [0.3, 0.61, 0.3]


# ---------------------------------------------------------------------- parts of Cornell box


def _light(kind: str) -> Dict:
    if kind == "flash":
        position = [0, 0, CAMERA_Z]
        return {"type": "point", "position": position, "intensity": rgb(FLASH_INTENSITY)}
    panel = shape("rectangle", place([0, 0.99, 0.01], X, 90, [0.23, 0.19, 0.19]), "white")
    return panel | {"emitter": area_light(LIGHT_RADIANCE)}


def _cornell(integrator: str, film: Dict, spp: int, max_depth: int, light: str) -> Dict:
    checks.one_of("light", light, START_OPL)
    depth = checks.depth("max_depth", max_depth)
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": depth},
        "sensor": camera([0, 0, CAMERA_Z], [0, 0, 0], 39.3077, film, spp),
        **{name: diffuse(reflectance) for name, reflectance in CORNELL.items()},
        "light": _light(light),
        "floor": shape("rectangle", place([0, -1, 0], X, -90, UNIT), "white"),
        "ceiling": shape("rectangle", place([0, 1, 0], X, 90, UNIT), "white"),
        "back": shape("rectangle", place([0, 0, -1], Y, 0, UNIT), "white"),
        "green-wall": shape("rectangle", place([1, 0, 0], Y, -90, UNIT), "green"),
        "red-wall": shape("rectangle", place([-1, 0, 0], Y, 90, UNIT), "red"),
        "small-box": shape("cube", place([0.335, -0.7, 0.38], Y, -17, [0.3, 0.3, 0.3]), "white"),
        "large-box": shape("cube", place([-0.33, -0.4, -0.28], Y, 18.25, LARGE_BOX), "white"),
    }


# ------------------------------------------------------------------------------- Cornell box


def cornell_box(
    *,
    width: int = 256,
    height: int = 256,
    temporal_bins: int = 300,
    start_opl: float | None = None,
    bin_width_opl: float = 0.02,
    spp: int = 256,
    max_depth: int = 8,
    light: str = "area",
) -> Dict:
    """The Cornell box with two white boxes, lit from the ceiling.

    Args:
        width: Picture's width [pixels], 1 to 65536.
        height: Picture's height [pixels], 1 to 65536.
        temporal_bins: Number of time bins, 1 to 1048576.
        start_opl: Start of the first bin, an optical path length [m]. By default 3.5 with the
            ceiling light and 6.0 with the flash, a little before the first light arrives.
        bin_width_opl: Width of a bin [m], above 0.
        spp: Samples per pixel.
        max_depth: Longest path in segments, camera's included; 8 is seven bounces.
        light: "area" for the light in the ceiling, "flash" for a point light at the camera.

    Returns:
        A dict for `mi.load_dict` with integrator `transient_path` and film `transient_hdr_film`.
        It loads under every llvm_* and cuda_* variant.

    Raises:
        ValueError: An argument is out of range; one line with its name, value and what is allowed.

    Example:
        >>> scene = cornell_box(width=64, height=64, light="flash")
        >>> scene["sensor"]["film"]["start_opl"]
        6.0
    """
    checks.one_of("light", light, START_OPL)
    start = START_OPL[light] if start_opl is None else start_opl
    window = transient_film(width, height, temporal_bins, start, bin_width_opl)
    return _cornell("transient_path", window, spp, max_depth, light)


def cornell_box_steady_state(
    *,
    width: int = 256,
    height: int = 256,
    spp: int = 256,
    max_depth: int = 8,
    light: str = "area",
) -> Dict:
    """The Cornell box for Mitsuba's own `path` integrator, without time.

    Args and errors are those of `cornell_box`.

    Returns:
        A dict for `mi.load_dict` with integrator `path` and film `hdrfilm`.

    Example:
        >>> cornell_box_steady_state(spp=64)["integrator"]["type"]
        'path'
    """
    return _cornell("path", steady_film(width, height), spp, max_depth, light)


def cornell_box_mirror(**options: Any) -> Dict:
    """The Cornell box with a mirror for its red wall.

    Args:
        **options: The keyword arguments of `cornell_box`.

    Example:
        >>> cornell_box_mirror()["red-wall"]["bsdf"]["type"]
        'conductor'
    """
    scene = cornell_box(**options)
    scene["red-wall"]["bsdf"] = {"type": "conductor", "material": "none"}
    return scene


def cornell_box_glass(**options: Any) -> Dict:
    """The Cornell box with a glass sphere (index 1.5) instead of its small box.

    Args:
        **options: The keyword arguments of `cornell_box`.

    Example:
        >>> cornell_box_glass()["glass-sphere"]["bsdf"]["int_ior"]
        1.5
    """
    scene = cornell_box(**options)
    del scene["small-box"]
    scene["glass-sphere"] = {
        "type": "sphere",
        "center": [0.335, -0.65, 0.38],
        "radius": 0.35,
        "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    }
    return scene


def cornell_box_flash(**options: Any) -> Dict:
    """The Cornell box lit by a flash at the camera.

    Light and camera coincide, as in a time-of-flight camera: the first light at a pixel has
    travelled twice the distance of what the pixel sees.

    Args:
        **options: The keyword arguments of `cornell_box`, `light` excepted.

    Example:
        >>> cornell_box_flash()["light"]["type"]
        'point'
    """
    return cornell_box(light="flash", **options)


# --------------------------------------------------------------------------------- small box

SPHERES = {
    "diffuse": (diffuse([0.7, 0.7, 0.7]), diffuse([0.7, 0.7, 0.7])),
    "mirror_glass": (
        {"type": "conductor", "material": "none"},
        {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    ),
}
"""Materials of the left and the right sphere of `small_box`."""


def small_box(
    *,
    width: int = 256,
    height: int = 256,
    spp: int = 64,
    integrator: str = "path_tracer_mis",
    max_bounces: int = 8,
    spheres: str = "diffuse",
) -> Dict:
    """A small box with two spheres in it, much of whose light is indirect.

    Args:
        width: Picture's width [pixels], 1 to 65536.
        height: Picture's height [pixels], 1 to 65536.
        spp: Samples per pixel.
        integrator: "path_tracer_mats", "path_tracer_nee", "path_tracer_mis" or Mitsuba's "path".
        max_bounces: Most reflections between light and camera, from 0, or -1 for no limit.
        spheres: "diffuse", or "mirror_glass" for a mirror on the left and glass on the right.

    Returns:
        A dict for `mi.load_dict` with film `hdrfilm`.

    Raises:
        ValueError: An argument is out of range; one line with its name, value and what is allowed.

    Example:
        >>> small_box(spheres="mirror_glass")["right-material"]["int_ior"]
        1.5
    """
    checks.one_of("spheres", spheres, SPHERES)
    left, right = deepcopy(SPHERES[spheres])
    return {
        "type": "scene",
        "integrator": path_tracer(integrator, max_bounces),
        "sensor": camera([0, 0.5, 2.75], [0, 0.5, 0], 27, steady_film(width, height), spp),
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.75, 0.75, 0.75]),
        "orange": diffuse([0.75, 0.3, 0.08]),
        "blue": diffuse([0.1, 0.25, 0.65]),
        "left-material": left,
        "right-material": right,
        "floor": shape("rectangle", place([0, 0, 0], X, -90, [0.6, 0.6, 1]), "white"),
        "ceiling": shape("rectangle", place([0, 1, 0], X, 90, [0.6, 0.6, 1]), "white"),
        "back": shape("rectangle", place([0, 0.5, -0.6], X, 0, [0.6, 0.5, 1]), "white"),
        "orange-wall": shape("rectangle", place([-0.6, 0.5, 0], Y, 90, [0.6, 0.5, 1]), "orange"),
        "blue-wall": shape("rectangle", place([0.6, 0.5, 0], Y, -90, [0.6, 0.5, 1]), "blue"),
        "left-sphere": sphere([-0.25, 0.22, -0.2], 0.22, "left-material"),
        "right-sphere": sphere([0.26, 0.2, 0.2], 0.2, "right-material"),
        "light": shape("rectangle", place([0, 0.995, 0.1], X, 90, [0.15, 0.15, 1]), "black")
        | {"emitter": area_light([16.0, 14.0, 11.0])},
    }
