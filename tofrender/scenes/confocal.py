"""Scenes of confocal captures: a laser and a camera share one pinhole and look at a wall.

In the scenes `wall_box_...`, laser and camera are at the origin and look along -z at a relay wall.
The hidden objects are outside of the camera's sight, but the relay wall faces them. Lengths are in
meters, y is up.

The projector's power is 100 W. The parameters come from the course's fork of mitransient, which
uses the number 100 as a density over the pattern instead. The direct light of the fork is darker by
1 / tan^2(fov / 2): 5.92 times in `wall_box_...` and 12.6 times in `ourbox_confocal`. See
`confocal_projector`.

Ids of shapes are `relay_wall`, `occluder`, and `hidden_...` for hidden objects. Mitsuba merges
shapes of equal type and material when it loads a scene, so shapes of equal type have different
materials.
"""

from collections.abc import Sequence
from typing import Unpack

from .parts import CORNELL, Dict, X, Y, diffuse, pose, rgb, shape
from .views import TransientOptions, transient_scene

WALL = {"reflectance": [0.8, 0.8, 0.8], "half_width": 2.0, "z": -2.0}
"""The relay wall of the scenes `wall_box_...`, which faces +z. Lengths are in meters."""

HIDDEN_Z = -0.75  # z of the centers of hidden spheres, in the plane of the occluder's back [m]

RED = [0.01, 0.0, 0.0]  # Reflectance of the occluder and of single spheres
GREEN = [0.0, 0.05, 0.0]  # Reflectance of the spheres that form letters

# x and y of the spheres that form the letters, and their radius [m]
ROWS = (-0.2, -0.36, -0.52, -0.68, -0.84)
LETTERS = {
    "h_left": ([(-0.5, y) for y in ROWS], 0.08),
    "h_right": ([(-0.2, y) for y in ROWS], 0.08),
    "h_bar": ([(-0.39, -0.52), (-0.31, -0.52)], 0.06),
    "i": ([(0.35, y) for y in ROWS], 0.08),
}


def wall_box_sphere_nlos(**options: Unpack[TransientOptions]) -> Dict:
    """A sphere in front of a relay wall, hidden by a box.

    The box fills the lower half of the view. Box and sphere are retroreflectors, and the sphere's
    radius is 0.25 m. The box ends at z = -0.75 m, in the plane of the sphere's center: half of the
    sphere is inside the box, and the other half faces the wall.

    Args:
        **options: As for `caustic`, without `integrator`; by default `width` and `height` are 128,
            `temporal_bins` 1000, `start_opl` 0, `bin_width_opl` 0.01, `spp` 1000, `max_depth` 8.

    Returns:
        A dict for `mi.load_dict` with integrator `transient_path` and film `transient_hdr_film`.
        The laser, a `confocal_projector`, is a part of the integrator.

    Raises:
        ValueError: If an argument is out of range. The message has its name, value and range.

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
    """Three spheres in front of a relay wall, hidden by a box.

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
    """Letters H and I of spheres in front of a relay wall, hidden by a box.

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
    """A plate behind a camera that looks at a relay wall.

    An occluder is not needed, because the camera looks in the other direction. The plate is 1 m
    wide, 1 m high and 2 mm thick, and its center is 0.25 m behind the camera.

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
    """Return a scene with laser, camera and relay wall, without hidden shapes."""
    half = WALL["half_width"]
    wall = {"type": "rectangle", "to_world": pose([0, 0, WALL["z"]], X, 0, [half, half, 1])}
    scene = _scene([0, 0, 0], [0, 0, -1], 45.0, 0.78, options, start_opl=start_opl)
    return scene | {"relay_wall": wall | {"bsdf": diffuse(WALL["reflectance"])}}


def _box(center: Sequence[float], half_sizes: Sequence[float]) -> Dict:
    """Return a retroreflective box [m]."""
    bsdf = retroreflector(RED)
    return {"type": "cube", "to_world": pose(center, X, 0, half_sizes), "bsdf": bsdf}


def _ball(x: float, y: float, radius: float, color: Sequence[float]) -> Dict:
    """Return a hidden retroreflective sphere [m]."""
    bsdf = retroreflector(color)
    return {"type": "sphere", "center": [x, y, HIDDEN_Z], "radius": radius, "bsdf": bsdf}


def retroreflector(reflectance: Sequence[float]) -> Dict:
    """Return a material that reflects light back to its source, within about 0.14 rad."""
    return {"type": "retroreflector", "reflectance": rgb(reflectance), "lobe_exponent": 100.0}


EYE = [0.0, 0.45, 1.05]
"""Position of camera and laser of `ourbox_confocal` [m]. Both look along -z."""


def ourbox_confocal(**options: Unpack[TransientOptions]) -> Dict:
    """A closed box with two boxes in it, seen and lit from its front wall.

    The scene has neither hidden objects nor a relay wall. The box is 1 m wide, 0.9 m high and 1.6 m
    deep, and its floor is at y = 0. The left wall is red, the right wall green, and the other walls
    are white. All walls are two-sided.

    By default, Mitsuba merges the white shapes into one mesh when it loads the scene. Load with
    `optimize=False` to keep them separate.

    Args:
        **options: As for `wall_box_sphere_nlos`; by default `temporal_bins` is 700, `spp` 4096.

    Example:
        >>> ourbox_confocal()["integrator"]["confocal_projector"]["fov"]
        0.55
    """
    view = EYE, [0.0, 0.45, -1.0], 39.3077
    scene = _scene(*view, 0.55, options, temporal_bins=700, spp=4096)
    scene |= {name: {"type": "twosided", "side": diffuse(c)} for name, c in CORNELL.items()}

    # Half sizes of the walls [m]
    side = [0.8, 0.45, 1]
    end = [0.5, 0.45, 1]
    floor = [0.5, 0.8, 1]
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
    """Return a projector that lights one spot per camera ray, where the ray meets the scene.

    Args:
        fov: Field of view of the projector's grid [rad].
    """
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
    """Return a scene without shapes.

    Args:
        origin: Position of camera and laser [m].
        target: Point that both look at [m].
        fov: Field of view of the camera [degrees].
        projector_fov: Field of view of the projector [rad].
        options: Options of the caller.
        **defaults: Defaults of the scene for these options.
    """
    if "integrator" in options:
        raise TypeError(
            "integrator is not an option of this scene: transient_path contains its projector"
        )
    window = {
        "width": 128,
        "height": 128,
        "temporal_bins": 1000,
        "start_opl": 0.0,
        "bin_width_opl": 0.01,
        "spp": 1000,
        "max_depth": 8,
    }
    scene = transient_scene(origin, target, fov, options, **window | defaults)
    scene["sensor"]["sampler"]["type"] = "independent"
    scene["integrator"] = {
        "type": "transient_path",
        "camera_unwarp": False,
        "use_nlos_only": False,
        "max_depth": scene["integrator"]["max_depth"],
        "confocal_projector": confocal_projector(projector_fov),
    }
    return scene
