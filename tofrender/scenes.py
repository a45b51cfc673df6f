"""Built-in scenes: functions that return dicts for `mi.load_dict`.

All are the Cornell box of Mitsuba's tutorials, two metres wide, with the camera at z = 3.9 m: lit
from the ceiling or by a flash at the camera, and with a mirror or a glass sphere in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mitsuba as mi

from . import checks

SAMPLER = "padded_sobol"
"""The sampler of all built-in scenes."""

START_OPL = {"area": 3.5, "flash": 6.0}
"""Where the built-in window starts [m], by light; from each light, nothing arrives earlier."""

CAMERA_Z = 3.9
WHITE = [0.885809, 0.698859, 0.666422]
GREEN = [0.105421, 0.37798, 0.076425]
RED = [0.570068, 0.0430135, 0.0443706]
LIGHT_RADIANCE = [18.387, 13.9873, 6.75357]
FLASH_INTENSITY = [8.0, 8.0, 8.0]

Dict = dict[str, Any]


# ------------------------------------------------------------------------------------- parts


def _rgb(value: Sequence[float]) -> Dict:
    return {"type": "rgb", "value": list(value)}


def _shape(kind: str, to_world: Any, bsdf: str) -> Dict:
    return {"type": kind, "to_world": to_world, "bsdf": {"type": "ref", "id": bsdf}}


def _place(
    position: Sequence[float], axis: Sequence[float], angle: float, scale: Sequence[float]
) -> Any:
    """Scale, turn about `axis` by `angle` degrees, then move to `position` [m]."""
    transform = mi.ScalarTransform4f()
    return transform.translate(position).rotate(axis, angle).scale(scale)


def _materials() -> Dict:
    colours = {"white": WHITE, "green": GREEN, "red": RED}
    return {name: {"type": "diffuse", "reflectance": _rgb(c)} for name, c in colours.items()}


def _walls() -> Dict:
    x, y, unit = [1, 0, 0], [0, 1, 0], [1, 1, 1]
    return {
        "floor": _shape("rectangle", _place([0, -1, 0], x, -90, unit), "white"),
        "ceiling": _shape("rectangle", _place([0, 1, 0], x, 90, unit), "white"),
        "back": _shape("rectangle", _place([0, 0, -1], y, 0, unit), "white"),
        "green-wall": _shape("rectangle", _place([1, 0, 0], y, -90, unit), "green"),
        "red-wall": _shape("rectangle", _place([-1, 0, 0], y, 90, unit), "red"),
    }


def _boxes() -> Dict:
    small = _place([0.335, -0.7, 0.38], [0, 1, 0], -17, [0.3, 0.3, 0.3])
    large = _place([-0.33, -0.4, -0.28], [0, 1, 0], 18.25, [0.3, 0.61, 0.3])
    return {
        "small-box": _shape("cube", small, "white"),
        "large-box": _shape("cube", large, "white"),
    }


def _light(kind: str) -> Dict:
    if kind == "flash":
        position = [0, 0, CAMERA_Z]
        return {"type": "point", "position": position, "intensity": _rgb(FLASH_INTENSITY)}
    panel = _shape("rectangle", _place([0, 0.99, 0.01], [1, 0, 0], 90, [0.23, 0.19, 0.19]), "white")
    return panel | {"emitter": {"type": "area", "radiance": _rgb(LIGHT_RADIANCE)}}


def _camera(film: Dict, spp: int) -> Dict:
    to_world = mi.ScalarTransform4f().look_at([0, 0, CAMERA_Z], [0, 0, 0], [0, 1, 0])
    return {
        "type": "perspective",
        "fov_axis": "smaller",
        "fov": 39.3077,
        "near_clip": 0.001,
        "far_clip": 100.0,
        "to_world": to_world,
        "film": film,
        "sampler": {"type": SAMPLER, "sample_count": checks.integer("spp", spp, 1, checks.MAX_SPP)},
    }


def _film(width: int, height: int) -> Dict:
    return {
        "type": "hdrfilm",
        "width": checks.integer("width", width, 1, checks.MAX_SIZE),
        "height": checks.integer("height", height, 1, checks.MAX_SIZE),
        "rfilter": {"type": "box"},
    }


def _transient(film: Dict, temporal_bins: int, start_opl: float, bin_width_opl: float) -> Dict:
    return film | {
        "type": "transient_hdr_film",
        "temporal_bins": checks.integer("temporal_bins", temporal_bins, 1, checks.MAX_BINS),
        "start_opl": checks.metres("start_opl", start_opl),
        "bin_width_opl": checks.metres("bin_width_opl", bin_width_opl, positive=True),
    }


def _cornell(integrator: str, film: Dict, spp: int, max_depth: int, light: str) -> Dict:
    checks.one_of("light", light, START_OPL)
    depth = checks.depth("max_depth", max_depth)
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": depth},
        "sensor": _camera(film, spp),
        **_materials(),
        "light": _light(light),
        **_walls(),
        **_boxes(),
    }


# ------------------------------------------------------------------------------------ scenes


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
    film = _transient(_film(width, height), temporal_bins, start, bin_width_opl)
    return _cornell("transient_path", film, spp, max_depth, light)


def cornell_box_steady_state(
    *,
    width: int = 256,
    height: int = 256,
    spp: int = 256,
    max_depth: int = 8,
    light: str = "area",
) -> Dict:
    """The Cornell box for Mitsuba's own `path` integrator, without time.

    Args:
        width: Picture's width [pixels], 1 to 65536.
        height: Picture's height [pixels], 1 to 65536.
        spp: Samples per pixel.
        max_depth: Longest path, as in `cornell_box`.
        light: "area" or "flash", as in `cornell_box`.

    Returns:
        A dict for `mi.load_dict` with integrator `path` and film `hdrfilm`.

    Raises:
        ValueError: An argument is out of range; one line with its name, value and what is allowed.

    Example:
        >>> cornell_box_steady_state(spp=64)["integrator"]["type"]
        'path'
    """
    return _cornell("path", _film(width, height), spp, max_depth, light)


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
    """The Cornell box with a glass sphere (index 1.5) in place of its small box.

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


BUILT_IN: dict[str, Callable[..., Dict]] = {
    builder.__name__: builder
    for builder in (
        cornell_box,
        cornell_box_mirror,
        cornell_box_glass,
        cornell_box_flash,
        cornell_box_steady_state,
    )
}
"""The built-in scenes by name; a builder's first line of documentation describes its scene."""


def describe(name: str) -> str:
    """The first line of a built-in scene's documentation.

    Example:
        >>> describe("cornell_box")
        'The Cornell box with two white boxes, lit from the ceiling.'
    """
    return (BUILT_IN[name].__doc__ or "").partition("\n")[0]
