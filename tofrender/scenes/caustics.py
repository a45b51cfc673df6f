"""Scenes that are difficult for path tracers: caustics, a lamp in a fixture, a hole in a wall.

Each scene has one small lamp, a sphere with a radius of a few centimeters. Paths from the camera
hit the lamp only by chance, so the picture of a path tracer is noisy. Paths that start at the lamp
carry its light through the glass, out of the fixture or through the hole. Lengths are in meters, y
is up.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

from ..runtime import checks
from .boxes import CORNELL_VIEW, cornell_box
from .parts import LAMP_COLOR, Dict, X, Y, ball_light, cylinder, diffuse, pose, shape, sphere
from .views import TransientOptions, transient_scene

MAX_LAMP_RADIUS = 0.2  # Largest radius with which the lamp touches no other shape [m]

HOLE_CENTER = (-1.22, 1.2, -0.45)  # Center of the hole, midway through the wall [m]
MAX_HOLE_WIDTH = 0.5  # Largest width of the hole [m]


def caustic(*, lamp_radius: float = 0.025, **options: Unpack[TransientOptions]) -> Dict:
    """A glass sphere focuses a small lamp's light in the Cornell box.

    The focused light forms a bright ring on the floor, inside the shadow of the sphere. The glass
    blocks connections from the ring to the lamp. Paths that continue through the glass hit the lamp
    by chance, and they hit a smaller lamp less often. The lamp's power is the same for any
    `lamp_radius`, so the picture hardly depends on the radius.

    Args:
        lamp_radius: Radius of the lamp [m], above 0 and at most 0.2.
        **options: `width` and `height` [pixels], from 1 to 65536, by default 256; `temporal_bins`
            from 1 to 1048576 (300); `start_opl` [m] (4.2, slightly before the first light
            arrives); `bin_width_opl` [m] above 0 (0.02); `spp` (256); `max_depth` in segments,
            including the camera's, -1 for no limit (10; each crossing of glass adds a segment);
            `integrator`, a transient integrator with a `max_depth` ("transient_path").

    Returns:
        A dict for `mi.load_dict` with film `transient_hdr_film`. The dict loads in every llvm_*,
        cuda_* and metal_* variant.

    Raises:
        ValueError: If an argument is out of range. The message has its name, value and range.

    Example:
        >>> scene = caustic(width=64, height=64, lamp_radius=0.1)
        >>> scene["glass-sphere"]["radius"], scene["light"]["radius"]
        (0.4, 0.1)
    """
    return _empty_box(options, start_opl=4.2) | {
        "glass-sphere": sphere([-0.25, -0.56, -0.1], 0.4, "glass"),
        "light": _lamp([-0.7, 0.0, -0.45], lamp_radius),
    }


def mirror_and_glass(*, lamp_radius: float = 0.025, **options: Unpack[TransientOptions]) -> Dict:
    """The Cornell box with a mirror block, a glass sphere and a small lamp.

    The sphere focuses light of the lamp on the floor. It also focuses light that the mirror block
    reflects, and this second caustic arrives later.

    Args:
        lamp_radius: Radius of the lamp [m], above 0 and at most 0.2.
        **options: As for `caustic`; by default `start_opl` is 3.35.

    Example:
        >>> mirror_and_glass()["mirror"]["type"]
        'conductor'
    """
    block = pose([-0.42, -0.3, -0.4], Y, 40, [0.3, 0.71, 0.3])
    return _empty_box(options, start_opl=3.35) | {
        "mirror": {"type": "conductor", "material": "none"},
        "mirror-block": shape("cube", block, "mirror"),
        "glass-sphere": sphere([0.42, -0.58, 0.1], 0.37, "glass"),
        "light": _lamp([0.0, 0.55, 0.35], lamp_radius),
    }


def _empty_box(options: Mapping[str, Any], start_opl: float) -> Dict:
    """Return the Cornell box without light and boxes, and with materials `black` and `glass`."""
    scene = cornell_box()
    scene |= transient_scene(*CORNELL_VIEW, options, start_opl=start_opl, max_depth=10)
    for name in ("light", "small-box", "large-box"):
        del scene[name]
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return scene | {"black": diffuse([0, 0, 0]), "glass": glass}


def _lamp(center: Sequence[float], radius: float) -> Dict:
    """Return a spherical lamp of 11 W at a center [m] with a checked radius [m]."""
    limits: Any = {"unit": "meters", "positive": True, "high": MAX_LAMP_RADIUS}
    return ball_light(center, checks.number("lamp_radius", radius, **limits), 11.0, LAMP_COLOR)


def lamp_in_fixture(**options: Unpack[TransientOptions]) -> Dict:
    """A closed room lit by a lamp in a housing that is open at the top.

    The lamp lights the ceiling and the upper part of two walls. These surfaces light the rest of
    the room. Below the lamp, the housing blocks all connections to it.

    Args:
        **options: As for `caustic`; by default `start_opl` is 3.9, `bin_width_opl` 0.04 and
            `max_depth` 8.

    Example:
        >>> scene = lamp_in_fixture(width=64, height=64)
        >>> scene["light"]["center"][1] < scene["housing"]["p1"][1]
        True
    """
    x = -1.05  # Axis of the fixture [m]
    z = -1.15
    view = [0.25, 1.25, 1.9], [-0.05, 1.12, -2], 62
    return transient_scene(*view, options, start_opl=3.9, bin_width_opl=0.04, max_depth=8) | {
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.8, 0.78, 0.74]),
        "wood": diffuse([0.5, 0.36, 0.24]),
        "orange": diffuse([0.75, 0.3, 0.08]),
        "blue": diffuse([0.2, 0.36, 0.45]),
        "enamel": {"type": "twosided", "bsdf": diffuse([0.7, 0.7, 0.7])},
        **_room([-2, 0, -2], [2, 2.5, 2], floor="wood", left="blue", right="white"),
        "housing": cylinder(x, z, [1.45, 1.65], 0.16, "enamel"),
        # A millimeter wider than the tube, so that there is a closed edge
        "housing-bottom": shape("disk", pose([x, 1.47, z], X, -90, [0.161, 0.161, 1]), "enamel"),
        "stem": cylinder(x, z, [0.02, 1.47], 0.015, "enamel"),
        "foot": shape("cube", pose([x, 0.01, z], Y, 20, [0.14, 0.02, 0.14]), "enamel"),
        "light": ball_light([x, 1.54, z], 0.03, 60.0, LAMP_COLOR),
        "table": shape("cube", pose([0.45, 0.22, -0.75], Y, 12, [0.5, 0.23, 0.35]), "white"),
        "ball": sphere([0.4, 0.67, -0.75], 0.22, "orange"),
    }


def light_through_hole(*, hole_width: float = 0.2, **options: Unpack[TransientOptions]) -> Dict:
    """A dark room, lit through a small hole in the wall to the next room.

    The lamp is in the next room and lights a patch of the floor through the hole. All other light
    in the room is reflected by this patch or by the walls of the next room.

    Args:
        hole_width: Width and height of the hole [m], above 0 and at most 0.5.
        **options: As for `caustic`; by default `start_opl` is 3.6, `bin_width_opl` 0.03 and
            `max_depth` 8.

    Example:
        >>> scene = light_through_hole(hole_width=0.1)
        >>> scene["light"]["center"][0] < HOLE_CENTER[0]
        True
    """
    view = [0.25, 1.0, 2.2], [-0.1, 0.85, -1], 55
    return transient_scene(*view, options, start_opl=3.6, bin_width_opl=0.03, max_depth=8) | {
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.8, 0.78, 0.74]),
        "orange": diffuse([0.75, 0.3, 0.08]),
        "blue": diffuse([0.1, 0.25, 0.65]),
        **_room([-2.2, 0, -1], [1.2, 2, 2.3], floor="white", left="white", right="orange"),
        **_wall_with_hole(hole_width),
        "light": ball_light([-1.65, 1.7, -0.6], 0.03, 600.0, LAMP_COLOR),
        "block": shape("cube", pose([0.35, 0.29, -0.3], Y, 25, [0.28, 0.3, 0.28]), "blue"),
    }


def _room(
    low: Sequence[float], high: Sequence[float], *, floor: str, left: str, right: str
) -> Dict:
    """Return six walls between two corners [m] that face inwards, with names of materials."""
    # Center and half sizes of the room [m]
    x, y, z = ((least + most) / 2 for least, most in zip(low, high, strict=True))
    a, b, c = ((most - least) / 2 for least, most in zip(low, high, strict=True))
    return {
        "floor": shape("rectangle", pose([x, low[1], z], X, -90, [a, c, 1]), floor),
        "ceiling": shape("rectangle", pose([x, high[1], z], X, 90, [a, c, 1]), "white"),
        "back": shape("rectangle", pose([x, y, low[2]], X, 0, [a, b, 1]), "white"),
        "front": shape("rectangle", pose([x, y, high[2]], X, 180, [a, b, 1]), "white"),
        "left": shape("rectangle", pose([low[0], y, z], Y, 90, [c, b, 1]), left),
        "right": shape("rectangle", pose([high[0], y, z], Y, -90, [c, b, 1]), right),
    }


def _wall_with_hole(width: float) -> Dict:
    """Return four blocks around a square hole of a width [m].

    The blocks are 4 cm thick and reach one centimeter into the room's walls.
    """
    limits: Any = {"unit": "meters", "positive": True, "high": MAX_HOLE_WIDTH}
    half = checks.number("hole_width", width, **limits) / 2
    x, y, z = HOLE_CENTER

    # Outer edges of the wall with the hole [m]
    bottom = -0.01
    top = 2.01
    back = -1.01
    front = 2.31

    def block(low: float, high: float, near: float, far: float) -> Dict:
        """Return a block between two heights and two depths [m]."""
        center = [x, (low + high) / 2, (near + far) / 2]
        to_world = pose(center, Y, 0, [0.02, (high - low) / 2, (far - near) / 2])
        return shape("cube", to_world, "white")

    return {
        "wall-below": block(bottom, y - half, back, front),
        "wall-above": block(y + half, top, back, front),
        "wall-behind": block(y - half, y + half, back, z - half),
        "wall-before": block(y - half, y + half, z + half, front),
    }
