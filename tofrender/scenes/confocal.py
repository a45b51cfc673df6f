"""Scenes of confocal captures: a laser and a camera share one pinhole and look at a wall.

In the scenes `wall_box_...` they stand at the origin and look down -z at a relay wall, and what
they look for is out of their sight, but not out of the wall's. Metres, y up.

The projector's power is 100 W. The course's fork of mitransient, which these parameters come from,
takes that number as a density over the pattern, so that its direct light is 5.92 times darker in
`wall_box_...` (1 / tan^2(.78 / 2)) and 12.6 times in `ourbox_confocal`: see `confocal_projector`.

Shapes go by their ids: `relay_wall`, `occluder`, and what is hidden is `hidden_...`. Each has a
material of its own, and no two that could be merged into one shape have the same.
"""

from collections.abc import Sequence
from typing import Unpack

from .parts import CORNELL, Dict, X, Y, diffuse, pose, rgb, shape
from .views import TransientOptions, transient_scene

WALL = {"reflectance": [0.8, 0.8, 0.8], "half_width": 2.0, "z": -2.0}
"""The relay wall of the scenes `wall_box_...` [m]; it faces +z."""

HIDDEN_Z = -0.75  # z of the centers of hidden spheres, in the plane of the occluder's back [m]

RED, GREEN = [0.01, 0.0, 0.0], [0.0, 0.05, 0.0]

# x and y of the spheres that make the letters, and their radius [m]
ROWS = (-0.2, -0.36, -0.52, -0.68, -0.84)
LETTERS = {
    "h_left": ([(-0.5, y) for y in ROWS], 0.08),
    "h_right": ([(-0.2, y) for y in ROWS], 0.08),
    "h_bar": ([(-0.39, -0.52), (-0.31, -0.52)], 0.06),
    "i": ([(0.35, y) for y in ROWS], 0.08),
}


def wall_box_sphere_nlos(**options: Unpack[TransientOptions]) -> Dict:
    """A sphere before a relay wall, hidden by a box.

    The box fills the lower half of the view. It and the sphere, radius 0.25 m, retroreflect. The
    box ends at z = -0.75 m, where the sphere's center is: half of the sphere is within the box, the
    other half sees the wall.

    Args:
        **options: As for `caustic`, without `integrator`; by default `width` and `height` are 128,
            `temporal_bins` 1000, `start_opl` 0, `bin_width_opl` 0.01, `spp` 1000, `max_depth` 8.

    Returns:
        A dict for `mi.load_dict` with integrator `transient_path` and film `transient_hdr_film`.
        The laser, a `confocal_projector`, is a part of the integrator.

    Raises:
        ValueError: An argument is out of range; one line with its name, value and what is allowed.

    Example:
        >>> scene = wall_box_sphere_nlos(width=32, height=32)
        >>> scene["hidden_sphere"]["center"]
        [0.0, -0.75, -0.75]
    """
    return _before_wall(options) | {
        "occluder": _box([0, -2, -0.5], [2, 2, 0.25]),
        "hidden_sphere": _ball(0.0, -0.75, 0.25, RED),
    }


def wall_box_spheres_nlos(**options: Unpack[TransientOptions]) -> Dict:
    """Three spheres before a relay wall, hidden by a box.

    Args:
        **options: As for `wall_box_sphere_nlos`.

    Example:
        >>> [name for name in wall_box_spheres_nlos() if "hidden" in name]
        ['hidden_sphere_left', 'hidden_sphere_middle', 'hidden_sphere_right']
    """
    return _before_wall(options) | {
        "occluder": _box([0, -2, -0.5], [2, 2, 0.25]),
        "hidden_sphere_left": _ball(-0.5, -0.75, 0.25, RED),
        "hidden_sphere_middle": _ball(0.0, -0.75, 0.25, RED),
        "hidden_sphere_right": _ball(0.5, -0.75, 0.25, RED),
    }


def wall_box_hi_nlos(**options: Unpack[TransientOptions]) -> Dict:
    """Letters H and I, made of spheres, before a relay wall, hidden by a box.

    Args:
        **options: As for `wall_box_sphere_nlos`.

    Example:
        >>> len([name for name in wall_box_hi_nlos() if "hidden" in name])
        17
    """
    scene = _before_wall(options) | {"occluder": _box([0, -1, -0.5], [2, 1, 0.25])}
    for letter, (centers, radius) in LETTERS.items():
        for number, (x, y) in enumerate(centers, 1):
            scene[f"hidden_{letter}_{number}"] = _ball(x, y, radius, GREEN)
    return scene


def wall_box_behind(**options: Unpack[TransientOptions]) -> Dict:
    """A plate behind the camera, which looks at a relay wall.

    Nothing is in the way: the camera just looks elsewhere. The plate is 1 m wide, 1 m high, 2 mm
    thick, and its middle is 0.25 m behind the camera.

    Args:
        **options: As for `wall_box_sphere_nlos`; `start_opl` is 0.5 by default.

    Example:
        >>> wall_box_behind()["sensor"]["film"]["start_opl"]
        0.5
    """
    plate = pose([0, 0, 0.25], X, 0, [0.5, 0.5, 0.001])
    return _before_wall(options, start_opl=0.5) | {
        "hidden_plate": {"type": "cube", "to_world": plate, "bsdf": diffuse([0.5, 0.5, 0.5])}
    }


def _before_wall(options: TransientOptions, start_opl: float = 0.0) -> Dict:
    half = WALL["half_width"]
    wall = {"type": "rectangle", "to_world": pose([0, 0, WALL["z"]], X, 0, [half, half, 1])}
    scene = _scene([0, 0, 0], [0, 0, -1], 45.0, 0.78, options, start_opl=start_opl)
    return scene | {"relay_wall": wall | {"bsdf": diffuse(WALL["reflectance"])}}


def _box(center: Sequence[float], half_sizes: Sequence[float]) -> Dict:
    bsdf = retroreflector(RED)
    return {"type": "cube", "to_world": pose(center, X, 0, half_sizes), "bsdf": bsdf}


def _ball(x: float, y: float, radius: float, colour: Sequence[float]) -> Dict:
    bsdf = retroreflector(colour)
    return {"type": "sphere", "center": [x, y, HIDDEN_Z], "radius": radius, "bsdf": bsdf}


def retroreflector(reflectance: Sequence[float]) -> Dict:
    """A material that sends light back where it came from, within about 0.14 rad."""
    return {"type": "retroreflector", "reflectance": rgb(reflectance), "lobe_exponent": 100.0}


EYE = [0.0, 0.45, 1.05]
"""Position of the camera and the laser of `ourbox_confocal` [m]; they look down -z."""


def ourbox_confocal(**options: Unpack[TransientOptions]) -> Dict:
    """A closed box with two boxes in it, seen and lit from its front wall.

    Nothing is hidden and no wall is a relay. The box is 1 m wide, 0.9 m high and 1.6 m deep and
    stands on y = 0; its left wall is red, its right wall green, the others white. All are
    two-sided.

    A default load merges the white shapes into one mesh. Where they must be told apart, load with
    `optimize=False`.

    Args:
        **options: As for `wall_box_sphere_nlos`; by default `temporal_bins` is 700, `spp` 4096.

    Example:
        >>> ourbox_confocal()["integrator"]["confocal_projector"]["fov"]
        0.55
    """
    view = EYE, [0.0, 0.45, -1.0], 39.3077
    scene = _scene(*view, 0.55, options, temporal_bins=700, spp=4096)
    scene |= {name: {"type": "twosided", "side": diffuse(c)} for name, c in CORNELL.items()}
    side, end, floor = [0.8, 0.45, 1], [0.5, 0.45, 1], [0.5, 0.8, 1]
    return scene | {
        "floor": shape("rectangle", pose([0, 0, 0.3], X, -90, floor), "white"),
        "ceiling": shape("rectangle", pose([0, 0.9, 0.3], X, 90, floor), "white"),
        "back": shape("rectangle", pose([0, 0.45, -0.5], Y, 0, end), "white"),
        "front": shape("rectangle", pose([0, 0.45, 1.1], Y, 180, end), "white"),
        "red_wall": shape("rectangle", pose([-0.5, 0.45, 0.3], Y, 90, side), "red"),
        "green_wall": shape("rectangle", pose([0.5, 0.45, 0.3], Y, -90, side), "green"),
        "tall_box": shape("cube", pose([-0.17, 0.27, -0.15], Y, 18, [0.14, 0.27, 0.14]), "white"),
        "low_box": shape("cube", pose([0.18, 0.14, 0.1], Y, -17, [0.14, 0.14, 0.14]), "white"),
    }


def confocal_projector(fov: float) -> Dict:
    """One spot of light per camera ray, where it meets the scene; `fov` is the grid's [rad]."""
    return {
        "type": "confocal_projector",
        "grid_rows": 1,
        "grid_cols": 1,
        "grid_sigma": 0.001,
        "grid_intensity": 100.0,
        "grid_spacing": "uniform",
        "fov": fov,
        "is_confocal": True,
        "max_rejection_samples": 4,
        "pulse_type": "gaussian",
        "pulse_width_opl": 0.005,
    }


def _scene(
    origin: Sequence[float],
    target: Sequence[float],
    fov: float,
    projector_fov: float,
    options: TransientOptions,
    **defaults: float,
) -> Dict:
    """A scene without shapes; `fov` in degrees, `projector_fov` in radians."""
    if "integrator" in options:
        raise TypeError("integrator: no such option; it is the one that has the projector")
    window = {"width": 128, "height": 128, "temporal_bins": 1000, "start_opl": 0.0}
    window |= {"bin_width_opl": 0.01, "spp": 1000, "max_depth": 8} | defaults
    scene = transient_scene(origin, target, fov, options, **window)
    scene["sensor"]["sampler"]["type"] = "independent"
    scene["integrator"] = {
        "type": "transient_path",
        "camera_unwarp": False,
        "use_nlos_only": False,
        "max_depth": scene["integrator"]["max_depth"],
        "confocal_projector": confocal_projector(projector_fov),
    }
    return scene
