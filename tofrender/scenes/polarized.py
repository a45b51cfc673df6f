"""Scenes with polarized light: a window, and mirrors with strained plastic between them.

These scenes need a polarized variant, such as llvm_ad_mono_polarized, for their effects. In other
variants, a polarizer is a filter that halves the light, and strained plastic is clear. Lengths are
in meters, y is up.
"""

from functools import cache
from math import cos, radians, sin
from typing import Any, Unpack

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..runtime import checks
from .parts import Dict, X, Y, area_light, diffuse, pose, rgb, shape, sphere
from .views import TransientOptions, transient_scene


def _plate(kind: str, angle_name: str, angle: float, **parameters: Any) -> Dict:
    """Return a polarizing material with its axis at an angle [degrees] at all wavelengths.

    Args:
        kind: Name of the plugin.
        angle_name: Name of the angle in error messages.
        angle: The angle [degrees], -180 to 180.
        **parameters: Other parameters of the plugin.
    """
    degrees = checks.number(angle_name, angle, unit="degrees", low=-180, high=180)
    return {"type": kind, "theta": {"type": "uniform", "value": degrees}, **parameters}


def _lamp(to_world: Any, radiance: float) -> Dict:
    """Return a rectangular lamp with the same radiance in all channels [W m^-2 sr^-1]."""
    return shape("rectangle", to_world, "black") | {"emitter": area_light([radiance] * 3)}


INDEX = 1.5  # Index of refraction of the window

BREWSTER = 56.30993247402022
"""Angle of incidence at which glass reflects only one polarization, atan(INDEX) [degrees]."""


def _before(along: float, aside: float, up: float) -> list[float]:
    """Return a point in front of the window [m], relative to the reflected axis of the camera.

    Args:
        along: Distance along the reflected axis, from the center of the window [m].
        aside: Distance to the side [m].
        up: Height above the axis [m].
    """
    s = sin(radians(BREWSTER))
    c = cos(radians(BREWSTER))
    return [-along * s - aside * c, up, along * c - aside * s]


def _behind(along: float, aside: float, up: float) -> list[float]:
    """Return a point behind the window [m], relative to the axis of the camera.

    Args:
        along: Distance along the axis, from the center of the window [m]; negative values are
            between camera and window.
        aside: Distance to the side [m].
        up: Height above the axis [m].
    """
    s = sin(radians(BREWSTER))
    c = cos(radians(BREWSTER))
    return [-along * s + aside * c, up, -along * c - aside * s]


def brewster_window(*, polarizer: float = 0.0, **options: Unpack[TransientOptions]) -> Dict:
    """A window at Brewster's angle: a reflected target, and a room behind.

    Light of the target is reflected by the glass and arrives first, on paths of at most 6.2 m. It
    is polarized along the camera's `up`. Light of the room passes through the glass and is hardly
    polarized. A polarizer in front of the window's center blocks the reflection. In variants
    without polarization, the polarizer is a gray filter.

    Args:
        polarizer: Angle of the polarization that passes, from the picture's right [degrees], -180
            to 180. The reflection is blocked at 0 and passes at 90.
        **options: As for `caustic`; by default `start_opl` is 3, `bin_width_opl` 0.04 and
            `max_depth` -1.

    Example:
        >>> brewster_window(polarizer=90)["sheet"]["theta"]["value"]
        90.0
    """
    view = _behind(-2.0, 0, 0), [0, 0, 0], 36
    scene = transient_scene(*view, options, start_opl=3.0, bin_width_opl=0.04, max_depth=-1)
    scene["integrator"]["rr_depth"] = 20
    to_window = (
        180 - BREWSTER
    )  # Rotation about y of the target, so that it faces the window [degrees]

    def wall(x: float, y: float, half_x: float, half_y: float) -> Dict:
        """Return a part of the wall around the window."""
        return shape("rectangle", pose([x, y, 0], Y, 0, [half_x, half_y, 1]), "wall")

    def disk(along: float, radius: float, bsdf: str) -> Dict:
        """Return a disk of the target."""
        where = pose(_before(along, 0, 0), Y, to_window, [radius, radius, 1])
        return shape("disk", where, bsdf)

    return scene | {
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.8, 0.8, 0.8]),
        "wall": diffuse([0.1, 0.09, 0.08]),
        "gray": diffuse([0.3, 0.3, 0.3]),
        "red": diffuse([0.7, 0.12, 0.08]),
        "plaster": diffuse([0.7, 0.68, 0.64]),
        "orange": diffuse([0.8, 0.4, 0.1]),
        "blue": diffuse([0.1, 0.25, 0.6]),
        "green": diffuse([0.15, 0.5, 0.2]),
        "glass": {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0},
        "sheet": _plate("polarizer", "polarizer", polarizer),
        "window": shape("cube", pose([0, 0, -0.01], Y, 0, [1.4, 0.7, 0.01]), "glass"),
        "wall-left": wall(-3.2, 0, 1.8, 3),
        "wall-right": wall(3.2, 0, 1.8, 3),
        "wall-top": wall(0, 1.85, 1.4, 1.15),
        "wall-bottom": wall(0, -1.85, 1.4, 1.15),
        "polarizer": shape(
            "rectangle", pose(_behind(-1.2, -0.1, 0), Y, BREWSTER, [0.1, 0.13, 1]), "sheet"
        ),
        "target": shape("rectangle", pose(_before(1.4, 0, 0), Y, to_window, [0.8] * 3), "gray"),
        "ring": disk(1.398, 0.7, "white"),
        "gap": disk(1.396, 0.5, "red"),
        "eye": disk(1.394, 0.3, "white"),
        "lamp": _lamp(pose(_before(0.6, 0, 1.1), Y, -10, [0.25, 0.1, 1]), 300.0),
        "back": shape("rectangle", pose(_behind(3.2, 0, 0), Y, BREWSTER, [4, 3, 1]), "plaster"),
        "floor": shape("rectangle", pose([-2.08, -1, -3], X, -90, [5, 3, 1]), "gray"),
        "ball": sphere(_behind(2.6, -0.7, -0.6), 0.4, "blue"),
        "small-ball": sphere(_behind(2.7, 0.35, -0.7), 0.3, "orange"),
        "cube": shape("cube", pose(_behind(2.2, 0.9, -0.8), Y, 25, [0.2] * 3), "green"),
        "room-lamp": _lamp(pose(_behind(2.0, 0.5, 2.0), X, 90, [0.4, 0.4, 1]), 28.0),
    }


CORRIDOR = 10.0  # Distance between the two mirrors [m]

LAMP_HALF = 0.9  # Half the width of the square lamp [m]
HOLE_HALF = 0.5  # Half the width of the hole in the lamp, in front of the camera [m]

MOST_RETARDANCE = 60.0  # Largest retardance of the plastic [degrees]

# x, y and radius of each screw's strain (half width at half maximum), in halves of the plate's
# width
SCREWS = np.array([(-0.7, -0.6, 0.35), (0.6, -0.75, 0.25), (0.75, 0.5, 0.4), (-0.45, 0.8, 0.3)])


@cache
def retardance_of_plastic() -> NDArray[np.float32]:
    """Return the retardance of the plastic in `strained_mirror_corridor`, largest at four screws.

    Returns:
        A read-only array [degrees] of shape (64, 64, 1), the top row first; later calls return the
        same array.
    """
    centers = (2 * np.arange(64) + 1) / 64 - 1
    x, y = np.meshgrid(centers, centers[::-1])
    total = sum(1 / (1 + ((x - a) ** 2 + (y - b) ** 2) / r**2) for a, b, r in SCREWS)
    found = (MOST_RETARDANCE * total / np.max(total))[..., None].astype(np.float32)
    found.flags.writeable = False
    return found


def strained_mirror_corridor(*, angle: float = 45.0, **options: Unpack[TransientOptions]) -> Dict:
    """A lamp between mirrors, seen repeatedly through strained plastic.

    The camera looks through a hole in a square lamp. The light of the lamp is polarized along the
    picture's right. The mirrors show images of the lamp inside each other. Light of the k-th image,
    counted from outside, has traveled 20 k m and has passed the plastic 2 k times. Each pass
    changes the polarization, and each image arrives in separate time bins. No path depends on
    random numbers, so the picture has no noise. In variants without polarization, all images are
    gray.

    Args:
        angle: Angle from the lamp's polarization to the axis of the strain [degrees], -180 to 180.
            At 0 the plastic does not change the polarization.
        **options: As for `caustic`; by default `temporal_bins` is 250, `start_opl` 19.5,
            `bin_width_opl` 1, `spp` 64 and `max_depth` 100; the k-th image needs 4 k + 1. The
            integrator must be one with paths that hit the lamp.

    Example:
        >>> strained_mirror_corridor(angle=30)["strained"]["theta"]["value"]
        30.0
    """
    view = [0, 0, CORRIDOR - 0.01], [0, 0, 0], 5.1
    window = {"temporal_bins": 250, "start_opl": 19.5, "bin_width_opl": 1.0}
    scene = transient_scene(*view, options, **window, spp=64, max_depth=100)
    scene["integrator"]["rr_depth"] = 60
    strain = mi.Bitmap(retardance_of_plastic().copy())
    retardance = {"type": "bitmap", "bitmap": strain, "raw": True}

    def across(z: float, bsdf: str, angle: float = 0) -> Dict:
        """Return a square across the corridor, rotated about y [degrees]."""
        return shape("rectangle", pose([0, 0, z], Y, angle, [1, 1, 1]), bsdf)

    return scene | {
        "black": diffuse([0, 0, 0]),
        "mirror": {"type": "conductor", "eta": 0.0, "k": 30.0}
        | {"specular_reflectance": rgb([0.85, 0.85, 0.85])},
        "sheet": {"type": "polarizer"},
        "strained": _plate("retarder", "angle", angle, delta=retardance),
        "far-mirror": across(0.0, "mirror"),
        "near-mirror": across(CORRIDOR, "mirror", 180),
        "plastic": across(CORRIDOR / 2, "strained"),
        **{f"lamp-{side}": _lamp(where, 1.0) for side, where in _frame(CORRIDOR - 0.01).items()},
        **{
            f"sheet-{side}": shape("rectangle", where, "sheet")
            for side, where in _frame(CORRIDOR - 0.012, 0.0005).items()
        },
    }


def _frame(z: float, margin: float = 0.0) -> Dict:
    """Return transforms of the four sides of the square lamp, which face the far mirror.

    With a `margin` [m], the sides are wider, for the polarizers in front of the lamp.
    """
    center = (LAMP_HALF + HOLE_HALF) / 2
    half = (LAMP_HALF - HOLE_HALF) / 2 + margin
    vertical = [half, LAMP_HALF + margin, 1]
    horizontal = [HOLE_HALF, half, 1]
    return {
        "left": pose([-center, 0, z], Y, 180, vertical),
        "right": pose([center, 0, z], Y, 180, vertical),
        "top": pose([0, center, z], Y, 180, horizontal),
        "bottom": pose([0, -center, z], Y, 180, horizontal),
    }
