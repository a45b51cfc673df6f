"""Boxes in which light is reflected many times.

The Cornell box of Mitsuba's tutorials is two meters wide, and its camera is at z = 3.9 m. A light
in the ceiling or a flash at the camera illuminates it. Variants contain a mirror or a glass sphere.
The scene `small_box` is a smaller box with two spheres and a steady film.
"""

from copy import deepcopy
from typing import Any, Unpack

from ..runtime import checks
from .parts import CORNELL, Dict, X, Y, area_light, diffuse, pose, rgb, shape, sphere
from .views import SteadyOptions, camera, steady_film, steady_scene, transient_film

START_OPL = {"area": 3.5, "flash": 6.0}
"""Start of the default time window [m] for each light, slightly before the first light arrives."""

CORNELL_VIEW = [0, 0, 3.9], [0, 0, 0], 39.3077
"""Origin [m], target [m] and field of view [degrees] of the Cornell box's camera."""

UNIT = [1, 1, 1]


def _cornell(integrator: str, film: Dict, spp: int, max_depth: int, light: str) -> Dict:
    """Return the Cornell box with an integrator, a film and a light ("area" or "flash")."""
    checks.one_of("light", light, START_OPL)

    # The light: a point light at the camera, or a panel below the ceiling
    if light == "flash":
        lamp = {
            "type": "point",
            "position": CORNELL_VIEW[0].copy(),
            "intensity": rgb([8.0, 8.0, 8.0]),
        }
    else:
        panel = shape("rectangle", pose([0, 0.99, 0.01], X, 90, [0.23, 0.19, 0.19]), "white")
        lamp = panel | {"emitter": area_light([18.387, 13.9873, 6.75357])}

    # Half sizes of the two boxes [m]
    small = [0.3, 0.3, 0.3]
    large = [0.3, 0.61, 0.3]
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": checks.depth("max_depth", max_depth)},
        "sensor": camera(*CORNELL_VIEW, film, spp),
        **{name: diffuse(reflectance) for name, reflectance in CORNELL.items()},
        "light": lamp,
        "floor": shape("rectangle", pose([0, -1, 0], X, -90, UNIT), "white"),
        "ceiling": shape("rectangle", pose([0, 1, 0], X, 90, UNIT), "white"),
        "back": shape("rectangle", pose([0, 0, -1], Y, 0, UNIT), "white"),
        "green-wall": shape("rectangle", pose([1, 0, 0], Y, -90, UNIT), "green"),
        "red-wall": shape("rectangle", pose([-1, 0, 0], Y, 90, UNIT), "red"),
        "small-box": shape("cube", pose([0.335, -0.7, 0.38], Y, -17, small), "white"),
        "large-box": shape("cube", pose([-0.33, -0.4, -0.28], Y, 18.25, large), "white"),
    }


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
        width: Width of the picture [pixels], 1 to 65536.
        height: Height of the picture [pixels], 1 to 65536.
        temporal_bins: Number of time bins, 1 to 1048576.
        start_opl: Optical path length at the start of the first bin [m]. The default is 3.5 with
            the ceiling light and 6.0 with the flash, slightly before the first light arrives.
        bin_width_opl: Width of a bin [m], above 0.
        spp: Samples per pixel.
        max_depth: Longest path in segments, including the camera's; 8 allows seven bounces.
        light: "area" for the light in the ceiling, "flash" for a point light at the camera.

    Returns:
        A dict for `mi.load_dict` with integrator `transient_path` and film `transient_hdr_film`.
        The dict loads in every llvm_*, cuda_* and metal_* variant.

    Raises:
        ValueError: If an argument is out of range. The message has its name, value and range.

    Example:
        >>> scene = cornell_box(width=64, height=64, light="flash")
        >>> scene["sensor"]["film"]["start_opl"]
        6.0
    """
    start = START_OPL[checks.one_of("light", light, START_OPL)] if start_opl is None else start_opl
    window = transient_film(width, height, temporal_bins, start, bin_width_opl)
    return _cornell("transient_path", window, spp, max_depth, light)


def cornell_box_steady_state(
    *, width: int = 256, height: int = 256, spp: int = 256, max_depth: int = 8, light: str = "area"
) -> Dict:
    """The Cornell box for Mitsuba's own `path` integrator, without time.

    Arguments and errors are as in `cornell_box`.

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
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    scene["glass-sphere"] = sphere([0.335, -0.65, 0.38], 0.35, "") | {"bsdf": glass}
    return scene


def cornell_box_flash(**options: Any) -> Dict:
    """The Cornell box lit by a flash at the camera.

    Light and camera are at the same point, as in a time-of-flight camera. The first light that
    arrives at a pixel has traveled twice the distance to the surface that the pixel sees.

    Args:
        **options: The keyword arguments of `cornell_box` except `light`.

    Example:
        >>> cornell_box_flash()["light"]["type"]
        'point'
    """
    return cornell_box(light="flash", **options)


SPHERES = {
    "diffuse": (diffuse([0.7, 0.7, 0.7]), diffuse([0.7, 0.7, 0.7])),
    "mirror_glass": (
        {"type": "conductor", "material": "none"},
        {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    ),
}
"""Materials of the left and the right sphere of `small_box`."""


def small_box(*, spheres: str = "diffuse", **options: Unpack[SteadyOptions]) -> Dict:
    """A small box with two spheres and much indirect light.

    Args:
        spheres: "diffuse", or "mirror_glass" for a mirror on the left and glass on the right.
        **options: As for `veach`; by default `width` and `height` are 256, `max_bounces` is 8.

    Return value and errors are as in `veach`.

    Example:
        >>> small_box(spheres="mirror_glass")["right-material"]["int_ior"]
        1.5
    """
    checks.one_of("spheres", spheres, SPHERES)
    left, right = deepcopy(SPHERES[spheres])
    view = [0, 0.5, 2.75], [0, 0.5, 0], 27
    return steady_scene(*view, options, height=256, max_bounces=8) | {
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.75, 0.75, 0.75]),
        "orange": diffuse([0.75, 0.3, 0.08]),
        "blue": diffuse([0.1, 0.25, 0.65]),
        "left-material": left,
        "right-material": right,
        "floor": shape("rectangle", pose([0, 0, 0], X, -90, [0.6, 0.6, 1]), "white"),
        "ceiling": shape("rectangle", pose([0, 1, 0], X, 90, [0.6, 0.6, 1]), "white"),
        "back": shape("rectangle", pose([0, 0.5, -0.6], X, 0, [0.6, 0.5, 1]), "white"),
        "orange-wall": shape("rectangle", pose([-0.6, 0.5, 0], Y, 90, [0.6, 0.5, 1]), "orange"),
        "blue-wall": shape("rectangle", pose([0.6, 0.5, 0], Y, -90, [0.6, 0.5, 1]), "blue"),
        "left-sphere": sphere([-0.25, 0.22, -0.2], 0.22, "left-material"),
        "right-sphere": sphere([0.26, 0.2, 0.2], 0.2, "right-material"),
        "light": shape("rectangle", pose([0, 0.995, 0.1], X, 90, [0.15, 0.15, 1]), "black")
        | {"emitter": area_light([16.0, 14.0, 11.0])},
    }
