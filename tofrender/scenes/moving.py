"""Scenes with moving parts: a fan, a walking figure, a mirror behind glass.

Load these scenes with `tofrender.load_scene`, because Mitsuba's own loader does not support
velocities. Lengths are in meters, y is up.
"""

from collections.abc import Sequence
from typing import Unpack

from ..runtime import checks
from .motion import FASTEST
from .parts import Dict, X, Y, area_light, cylinder, diffuse, pose, rgb, shape, sphere
from .views import TransientOptions, transient_scene

HUB = [0.0, 0.0, 0.0]  # Center of the fan [m]; the fan rotates about the z axis
TIP = 0.62  # Radius of the fan [m]

FIGURE = {
    "body": ([0.0, 1.14, 0.0], [0.19, 0.3, 0.11]),
    "head": ([0.0, 1.6, 0.0], [0.09, 0.12, 0.1]),
}
"""Center and half sizes of the boxes of the walking figure that do not swing [m]."""

LIMBS = {
    "left-leg": ([0.1, 0.84, 0.0], 0.42, 20.0, 1.0),
    "right-leg": ([-0.1, 0.84, 0.0], 0.42, -20.0, -1.0),
    "left-arm": ([0.25, 1.4, 0.0], 0.34, -20.0, -1.0),
    "right-arm": ([-0.25, 1.4, 0.0], 0.34, 20.0, 1.0),
}
"""Joint [m], half length [m], angle about x [degrees] and sign of the swing of each limb."""


def _speed(name: str, value: float, low: float = -FASTEST / 10, unit: str = "m/s") -> float:
    """Check the range of a speed or an angular speed, and return it."""
    return checks.number(name, value, low=low, high=FASTEST / 10, unit=unit)


def _flash(position: Sequence[float], intensity: float) -> Dict:
    """Return a point light at a position [m] with the same intensity in all channels [W/sr]."""
    return {"type": "point", "position": [*position], "intensity": rgb([intensity] * 3)}


def fan(*, angular_speed: float = 40.0, **options: Unpack[TransientOptions]) -> Dict:
    """A spinning fan in front of a wall, lit by a flash at the camera.

    The camera is to the side of the fan's axis. Therefore the blades on one side approach the
    camera, and the blades on the other side recede, with speeds up to 15 m/s.

    Args:
        angular_speed: Angular speed of the blades about the z axis [rad/s], -1e5 to 1e5.
        **options: As for `caustic`; by default `start_opl` is 5, `bin_width_opl` 0.02 and
            `max_depth` 4.

    Example:
        >>> fan(angular_speed=10)["blade-0"]["angular_velocity"]
        [0.0, 0.0, 10.0]
    """
    eye = [-1.7, 0.5, 2.4]
    spin = {"angular_velocity": [0.0, 0.0, _speed("angular_speed", angular_speed, unit="rad/s")]}
    scene = transient_scene(eye, HUB, 30, options, start_opl=5.0, max_depth=4)

    # Five blades around the hub
    for k in range(5):
        place = pose(HUB, [0, 0, 1], 72.0 * k + 10, [1, 1, 1]) @ pose(
            [0, (TIP + 0.12) / 2, 0], Y, 25, [0.15, (TIP - 0.12) / 2, 0.006]
        )
        scene[f"blade-{k}"] = shape("cube", place, "blue") | spin | {"rotation_center": HUB.copy()}
    return scene | {
        "white": diffuse([0.8, 0.78, 0.74]),
        "gray": diffuse([0.3, 0.3, 0.3]),
        "blue": diffuse([0.1, 0.3, 0.6]),
        "flash": _flash(eye, 12.0),
        "wall": shape("rectangle", pose([0, 0, -0.8], Y, 0, [4, 4, 1]), "white"),
        "hub": sphere(HUB, 0.13, "gray") | spin | {"rotation_center": HUB.copy()},
        "stand": cylinder(0.0, -0.2, [-1.5, 0.0], 0.03, "gray"),
        "motor": shape("cube", pose([0, 0, -0.18], Y, 0, [0.07, 0.07, 0.1]), "gray"),
    }


def corridor(
    *, speed: float = 1.4, swing: float = 2.5, **options: Unpack[TransientOptions]
) -> Dict:
    """A corridor with a figure of boxes that walks towards the camera.

    Body and head move with one velocity. Arms and legs also swing about shoulders and hips, as at
    one moment of a step. A flash at the camera lights the corridor.

    Args:
        speed: Speed of the figure towards the camera [m/s], -1e5 to 1e5.
        swing: Angular speed of arms and legs [rad/s], 0 to 1e5.
        **options: As for `caustic`; by default `start_opl` is 6.5, `bin_width_opl` 0.06 and
            `max_depth` 4.

    Example:
        >>> corridor(swing=3)["right-leg"]["angular_velocity"]
        [-3.0, 0.0, 0.0]
    """
    eye = [0.0, 1.4, 5.0]
    walk = {"velocity": [0.0, 0.0, _speed("speed", speed)]}
    angular_speed = _speed("swing", swing, 0, "rad/s")
    window = {"start_opl": 6.5, "bin_width_opl": 0.06}
    scene = transient_scene(eye, [0, 1.1, 0], 40, options, **window, max_depth=4)

    # Body and head
    for name, (center, half) in FIGURE.items():
        scene[name] = shape("cube", pose(center, Y, 0, half), "cloth") | walk

    # Arms and legs
    for name, (joint, half, angle, sign) in LIMBS.items():
        place = pose(joint, X, angle, [1, 1, 1]) @ pose([0, -half, 0], X, 0, [0.055, half, 0.065])
        rotation = {
            "angular_velocity": [sign * angular_speed, 0.0, 0.0],
            "rotation_center": joint.copy(),
        }
        scene[name] = shape("cube", place, "cloth") | walk | rotation

    def wall(position: list[float], axis: list[int], angle: float, half: list[float]) -> Dict:
        """Return a white wall."""
        return shape("rectangle", pose(position, axis, angle, half), "white")

    return scene | {
        "white": diffuse([0.7, 0.68, 0.64]),
        "wood": diffuse([0.4, 0.28, 0.18]),
        "cloth": diffuse([0.7, 0.35, 0.15]),
        "flash": _flash(eye, 40.0),
        "floor": shape("rectangle", pose([0, 0, 0], X, -90, [1.2, 6, 1]), "wood"),
        "ceiling": wall([0, 2.6, 0], X, 90, [1.2, 6, 1]),
        "left": wall([-1.2, 1.3, 0], Y, 90, [6, 1.3, 1]),
        "right": wall([1.2, 1.3, 0], Y, -90, [6, 1.3, 1]),
        "end": wall([0, 1.3, -6], Y, 0, [1.2, 1.3, 1]),
    }


def moving_mirror(*, speed: float = 10.0, **options: Unpack[TransientOptions]) -> Dict:
    """A mirror that moves away behind glass, and the wall that both reflect.

    The camera sees the wall behind itself twice. The glass reflects the wall dimly, on paths of
    constant length. The mirror reflects the wall later, and the lengths of these paths grow by
    nearly twice the mirror's speed.

    Args:
        speed: Speed of the mirror away from the camera [m/s], -1e5 to 1e5.
        **options: As for `caustic`; by default `start_opl` is 3.6, `bin_width_opl` 0.03 and
            `max_depth` 12.

    Example:
        >>> moving_mirror(speed=2)["mirror"]["velocity"]
        [0.0, 0.0, 2.0]
    """
    window = {"start_opl": 3.6, "bin_width_opl": 0.03}
    scene = transient_scene([0, 0, 0], [0, 0, 1], 40, options, **window, max_depth=12)

    def disk(x: float, y: float, radius: float, bsdf: str) -> Dict:
        """Return a disk on the wall."""
        return shape("disk", pose([x, y, -0.49], Y, 0, [radius, radius, 1]), bsdf)

    return scene | {
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.8, 0.78, 0.74]),
        "orange": diffuse([0.75, 0.3, 0.08]),
        "blue": diffuse([0.1, 0.25, 0.6]),
        "silver": {"type": "conductor", "material": "none"},
        "glass": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
        "mirror": shape("rectangle", pose([0, 0, 2], Y, 180, [0.5, 0.5, 1]), "silver")
        | {"velocity": [0.0, 0.0, _speed("speed", speed)]},
        "pane": shape("cube", pose([0, 0, 1.01], Y, 0, [0.5, 0.5, 0.01]), "glass"),
        "wall": shape("rectangle", pose([0, 0, -0.5], Y, 0, [2, 2, 1]), "white"),
        "orange-disk": disk(-0.6, 0.2, 0.4, "orange"),
        "blue-disk": disk(0.5, -0.3, 0.5, "blue"),
        "lamp": shape("rectangle", pose([0, 1.6, 0.5], X, 140, [0.4, 0.2, 1]), "black")
        | {"emitter": area_light([25.0] * 3)},
    }
