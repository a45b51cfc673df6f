"""Small steady scenes for comparing techniques of light sampling.

The scenes are a bust for integrators without materials, Veach's plates, lights of equal power in
three sizes, and one light in two shapes. Lengths are in meters, y is up.
"""

from copy import deepcopy
from typing import Unpack

from .meshes import HALVES, bust_mesh, half_rectangle
from .parts import Dict, X, Y, area_light, ball_light, diffuse, pose, rgb, shape
from .views import SteadyOptions, camera, steady_film, steady_scene

BUST_LIGHT = {"position": [-0.9, 1.5, 1.3], "energy": 110.0}
"""The point light of `bust_simple`: position [m] and energy [W]."""


def bust_simple(*, width: int = 192, height: int = 256, spp: int = 16) -> Dict:
    """A bust on the ground, lit by a point light of the integrator `simple`.

    Args:
        width: Width of the picture [pixels], 1 to 65536.
        height: Height of the picture [pixels], 1 to 65536.
        spp: Samples per pixel.

    Returns:
        A dict for `mi.load_dict`. The light is a parameter of the integrator `simple`, so the scene
        has no emitter. The bust is a mesh of the active variant.

    Raises:
        ValueError: If an argument is out of range. The message has its name, value and range.

    Example:
        >>> bust_simple()["integrator"]["position"]
        [-0.9, 1.5, 1.3]
    """
    return _bust({"type": "simple", **deepcopy(BUST_LIGHT)}, width, height, spp)


def bust_ao(*, width: int = 192, height: int = 256, spp: int = 64) -> Dict:
    """A bust on the ground under a uniform sky (ambient occlusion).

    Arguments and errors are as in `bust_simple`.

    Returns:
        A dict for `mi.load_dict` with integrator `ao`. The bust is a mesh of the active variant.

    Example:
        >>> bust_ao()["integrator"]
        {'type': 'ao'}
    """
    return _bust({"type": "ao"}, width, height, spp)


def _bust(integrator: Dict, width: int, height: int, spp: int) -> Dict:
    """Return the scene with the bust and an integrator."""
    return {
        "type": "scene",
        "integrator": integrator,
        "sensor": camera([0.55, 1.05, 2.45], [0, 0.325, 0], 16, steady_film(width, height), spp),
        "white": diffuse([0.7, 0.7, 0.7]),
        "ground": shape("rectangle", pose([0, 0, 0], X, -90, [50, 50, 1]), "white"),
        "bust": bust_mesh(bsdf=diffuse([0.7, 0.7, 0.7])),
    }


# Radius [m], x [m] and color; the mean of the color's channels is 1
VEACH_LIGHTS = {
    "blue": (0.04, -3.3, [0.50, 0.90, 1.60]),
    "green": (0.13, -1.3, [0.70, 1.50, 0.80]),
    "yellow": (0.40, 0.9, [1.35, 1.20, 0.45]),
    "red": (0.80, 3.3, [1.70, 0.75, 0.55]),
}
VEACH_POWER = 60.0  # Power of each light of `veach`, mean of its channels [W]

# Roughness, y [m], z [m] and tilt [degrees]; with this tilt the plate reflects the lights to the
# camera
VEACH_PLATES = {
    "smooth": (0.005, 1.9, -1.6, -42),
    "glossy": (0.02, 1.0, -0.6, -54),
    "rough": (0.05, 0.2, 0.8, -65),
    "roughest": (0.1, -0.4, 2.4, -74),
}


def veach(**options: Unpack[SteadyOptions]) -> Dict:
    """Four plates of differing roughness mirror four lights of differing size.

    The scene follows Veach and Guibas (1995). All lights have the same power. BSDF sampling rarely
    hits the small lights, especially from the rough plates. Emitter sampling often misses the
    narrow lobe of the smooth plates, especially for the large light. Multiple importance sampling
    combines both and works well everywhere.

    Args:
        **options: `width` and `height` [pixels], from 1 to 65536, by default 384 and 256; `spp`
            (64); `integrator`: "path_tracer_mats", "path_tracer_nee", "path_tracer_mis" (the
            default) or Mitsuba's "path"; `max_bounces`: largest number of reflections between
            light and camera, from 0, or -1 for no limit (1).

    Returns:
        A dict for `mi.load_dict` with film `hdrfilm`.

    Raises:
        ValueError: If an argument is out of range. The message has its name, value and range.

    Example:
        >>> veach()["smooth"]["alpha"]
        0.005
    """
    scene = steady_scene([0, 4, 14], [0, 1.75, 0], 28, options, width=384, height=256) | {
        "gray": diffuse([0.6, 0.6, 0.6]),
        "black": diffuse([0, 0, 0]),
        "floor": shape("rectangle", pose([0, -1.6, 0], X, -90, [12, 12, 1]), "gray"),
        "back": shape("rectangle", pose([0, 4, -3.2], X, 0, [12, 6, 1]), "gray"),
    }

    # The plates
    for name, (alpha, y, z, tilt) in VEACH_PLATES.items():
        scene[name] = {
            "type": "roughconductor",
            "distribution": "beckmann",
            "alpha": alpha,
            "material": "none",
            "specular_reflectance": rgb([0.45, 0.45, 0.45]),
        }
        scene[f"{name}-plate"] = shape("rectangle", pose([0, y, z], X, tilt, [3.5, 0.45, 1]), name)

    # The lights
    for name, (radius, x, color) in VEACH_LIGHTS.items():
        scene[f"{name}-light"] = ball_light([x, 4.2, -1.0], radius, VEACH_POWER, color)
    return scene


SPHERE_LIGHT_CENTER = [0.0, 2.8, 0.0]  # Center of the light of `sphere_light_...` [m]
SPHERE_LIGHT_POWER = 260.0  # Power of the light of `sphere_light_...` [W]

SPHERE_LIGHT_RADII = {"small": 0.03, "medium": 0.3, "large": 0.9}
"""Radii of the light [m]. Each light is above the floor and in front of the wall."""


def sphere_light_small(**options: Unpack[SteadyOptions]) -> Dict:
    """A floor and a wall under a sphere light of radius 0.03 m.

    The whole light is above the horizon of every point of floor and wall. Therefore lights of the
    same power give the same irradiance at any radius: E = Φ cosθ / (4 pi d²), where d is the
    distance from the light's center.

    Args:
        **options: As for `veach`; by default `width` is 256, `height` 192.

    Example:
        >>> sphere_light_small(spp=4)["light"]["radius"]
        0.03
    """
    return _sphere_light("small", options)


def sphere_light_medium(**options: Unpack[SteadyOptions]) -> Dict:
    """A floor and a wall under a sphere light of radius 0.3 m, of equal power.

    Args:
        **options: As for `sphere_light_small`.

    Example:
        >>> sphere_light_medium()["light"]["radius"]
        0.3
    """
    return _sphere_light("medium", options)


def sphere_light_large(**options: Unpack[SteadyOptions]) -> Dict:
    """A floor and a wall under a sphere light of radius 0.9 m, of equal power.

    Args:
        **options: As for `sphere_light_small`.

    Example:
        >>> sphere_light_large()["light"]["radius"]
        0.9
    """
    return _sphere_light("large", options)


def _sphere_light(size: str, options: SteadyOptions) -> Dict:
    """Return the scene `sphere_light_...` with a light of one size."""
    scene = steady_scene([0, 2.2, 4.5], [0, 0.3, -0.7], 28, options)

    # With a fixed vertical field of view, the light is above the picture at any aspect ratio
    scene["sensor"]["fov_axis"] = "y"
    radius = SPHERE_LIGHT_RADII[size]
    white = [1.0, 1.0, 1.0]
    return scene | {
        "black": diffuse([0, 0, 0]),
        "sand": diffuse([0.75, 0.65, 0.5]),
        "teal": diffuse([0.2, 0.5, 0.55]),
        "floor": shape("rectangle", pose([0, 0, 0], X, -90, [6, 6, 1]), "sand"),
        "wall": shape("rectangle", pose([0, 0, -1.6], X, 0, [6, 6, 1]), "teal"),
        "light": ball_light(SPHERE_LIGHT_CENTER, radius, SPHERE_LIGHT_POWER, white),
    }


PANEL_RADIANCE = [40.0, 36.0, 31.0]  # [W m^-2 sr^-1]
PANEL = [-0.75, 2.0, -1.1], X, 50, [0.65, 0.3, 1]
"""Position [m], axis, angle [degrees] and scale of the panel, arguments of `pose`."""


def rectangle_light_quad(**options: Unpack[SteadyOptions]) -> Dict:
    """A dark monolith in a room, lit by a panel that is one rectangle.

    Args:
        **options: As for `sphere_light_small`.

    Example:
        >>> rectangle_light_quad()["light"]["type"]
        'rectangle'
    """
    panel = shape("rectangle", pose(*PANEL), "black")
    return _monolith(options) | {"light": panel | {"emitter": area_light(PANEL_RADIANCE)}}


def rectangle_light_triangles(**options: Unpack[SteadyOptions]) -> Dict:
    """A dark monolith in a room, lit by a panel that is two triangles.

    The two triangles are separate shapes and separate emitters, meshes of the active variant. The
    picture is the same as with one rectangle.

    Args:
        **options: As for `sphere_light_small`.

    Example:
        >>> len(rectangle_light_triangles()) - len(rectangle_light_quad())
        1
    """
    scene = _monolith(options)
    for half in HALVES:
        parts = {"bsdf": diffuse([0, 0, 0]), "emitter": area_light(PANEL_RADIANCE)}
        scene[f"{half}-light"] = half_rectangle(half, pose(*PANEL), **parts)
    return scene


def _monolith(options: SteadyOptions) -> Dict:
    """Return the room with the monolith, without its light."""
    return steady_scene([0.2, 1.3, 5.2], [0, 1.25, 0], 33, options) | {
        "black": diffuse([0, 0, 0]),
        "gray": diffuse([0.6, 0.6, 0.6]),
        "blue": diffuse([0.25, 0.4, 0.6]),
        "tiles": _plastic([0.5, 0.45, 0.4], 0.12),
        "stone": _plastic([0.03, 0.03, 0.035], 0.15),
        "floor": shape("rectangle", pose([0, 0, 0], X, -90, [2, 2.5, 1]), "tiles"),
        "ceiling": shape("rectangle", pose([0, 2.7, 0], X, 90, [2, 2.5, 1]), "gray"),
        "back": shape("rectangle", pose([0, 1.35, -1.8], X, 0, [2, 1.35, 1]), "gray"),
        "left": shape("rectangle", pose([-2, 1.35, 0], Y, 90, [2.5, 1.35, 1]), "blue"),
        "right": shape("rectangle", pose([2, 1.35, 0], Y, -90, [2.5, 1.35, 1]), "gray"),
        # Its sides have the ratio 1 : 4 : 9
        "monolith": shape("cube", pose([0.5, 0.9, -0.3], Y, -50, [0.4, 0.9, 0.1]), "stone"),
    }


def _plastic(color: list[float], alpha: float) -> Dict:
    """Return a rough plastic with a diffuse color and a roughness."""
    return {"type": "roughplastic", "diffuse_reflectance": rgb(color), "alpha": alpha}
