"""Scenes of non-line-of-sight captures for tests, with stand-ins for their sensor and laser."""

import mitsuba as mi
import numpy as np

import tofrender
from tofrender.scenes import BUILT_IN

WALLS = ["nlos_z", "nlos_bunny", "nlos_patch", "nlos_plane"]
BOXES = ["wall_box_sphere_nlos", "wall_box_spheres_nlos", "wall_box_hi_nlos"]
CONFOCAL = [*BOXES, "wall_box_behind", "ourbox_confocal"]
ALL = [*WALLS, *CONFOCAL]
WITH_WALL = [name for name in ALL if name != "ourbox_confocal"]


def builder(name: str, **options) -> dict:
    return BUILT_IN[name](**options)


def stands_alone(scene: dict, optimize: bool = False, lamp: bool = False) -> mi.Scene:
    """A scene for `transient_path`, whatever its own sensor on the wall and its integrator do.

    Args:
        scene: One of the scenes.
        optimize: Whether Mitsuba may merge shapes.
        lamp: Whether a point light takes the place of the integrator's projector.
    """
    scene = dict(scene)
    wall = scene.get("relay_wall", {})
    if "sensor" in wall:
        meter = {k: v for k, v in wall["sensor"].items() if k != "sensor_origin"}
        scene["relay_wall"] = wall | {"sensor": meter | {"type": "irradiancemeter"}}
    scene["integrator"] = {"type": "transient_path", "max_depth": 5}
    if lamp:
        place = scene["sensor"]["to_world"]
        scene["lamp"] = {"type": "point", "position": np.array(place.matrix)[:3, 3].tolist()}
    return tofrender.load_scene(scene, optimize=optimize)
