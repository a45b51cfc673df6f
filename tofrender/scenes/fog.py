"""Scenes with participating media: fog, milk and smoke.

Each scene has one medium with a Henyey-Greenstein phase function. The option `sigma_t` is the
extinction, and 0 gives clear air. Lengths are in meters, y is up.
"""

from functools import cache
from typing import Unpack

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from .boxes import CORNELL_VIEW, cornell_box
from .parts import (
    LAMP_COLOR,
    Dict,
    X,
    Y,
    area_light,
    ball_light,
    cylinder,
    diffuse,
    extinction,
    medium,
    medium_boundary,
    pose,
    ref,
    rgb,
    shape,
    sphere,
)
from .views import TransientOptions, transient_scene

VOLPATH = {"max_depth": -1, "integrator": "transient_volpath"}  # Defaults of all scenes with media
MAX_FOG = 20.0  # Largest extinction in the Cornell box [1/m]


def cornell_box_fog(*, sigma_t: float = 0.3, **options: Unpack[TransientOptions]) -> Dict:
    """The Cornell box with thin fog in it.

    The fog ends at the open front of the box, and the camera is outside of the fog.

    Args:
        sigma_t: Extinction of the fog [1/m], 0 to 20. The mean free path is 1 / sigma_t.
        **options: As for `caustic`. A scattering event in the medium ends a segment. By default
            `temporal_bins` is 500, `start_opl` 3.5, `max_depth` -1 and `integrator`
            "transient_volpath".

    Return value and errors are as in `caustic`.

    Example:
        >>> scene = cornell_box_fog(width=64, height=64, sigma_t=0.5)
        >>> scene["fog"]["sigma_t"]
        0.5
    """
    window = {"temporal_bins": 500, "start_opl": 3.5}
    scene = cornell_box() | transient_scene(*CORNELL_VIEW, options, **window, **VOLPATH)
    # The boundary is a centimeter behind the walls, so that no two surfaces coincide
    around = pose([0, 0, -0.005], Y, 0, [1.01, 1.01, 1.005])
    return scene | {
        "fog": medium(extinction(sigma_t, MAX_FOG), [0.98, 0.98, 0.98], 0.6),
        "fog-end": medium_boundary(around, "fog"),
    }


MILK_INDEX = 1.35
"""Index of refraction of the milk."""

MAX_MILK = 1000.0  # Largest extinction of the milk [1/m]


def lamp_in_milk(*, sigma_t: float = 100.0, **options: Unpack[TransientOptions]) -> Dict:
    """A small lamp in a glass of thin milk that lights a table.

    The milk has the index of refraction 1.35, so optical path lengths in the milk are 1.35 times
    the geometric lengths. The wall of the glass is not modeled.

    Args:
        sigma_t: Extinction of the milk [1/m], 0 to 1000.
        **options: As for `cornell_box_fog`; by default `temporal_bins` is 300, `start_opl` 0.4,
            `bin_width_opl` 0.004.

    Example:
        >>> scene = lamp_in_milk()
        >>> scene["milk-side"]["radius"] > scene["light"]["radius"]
        True
    """
    # Size of the glass [m]
    radius = 0.035
    bottom = 0.001
    top = 0.1
    cap = [radius, radius, 1]

    inside = {"interior": ref("milk")}
    lamp = ball_light([0, 0.045, 0], 0.01, 0.08, LAMP_COLOR)
    view = [0.07, 0.19, 0.42], [0.005, 0.045, 0], 26
    return transient_scene(*view, options, start_opl=0.4, bin_width_opl=0.004, **VOLPATH) | {
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.8, 0.78, 0.74]),
        "wood": diffuse([0.7, 0.55, 0.4]),
        "orange": diffuse([0.75, 0.3, 0.08]),
        "blue": diffuse([0.2, 0.36, 0.45]),
        "milk-surface": {"type": "dielectric", "int_ior": MILK_INDEX, "ext_ior": 1.0},
        "milk": medium(extinction(sigma_t, MAX_MILK), [0.9995, 0.999, 0.996], 0.7),
        "table": shape("rectangle", pose([0, 0, 0], X, -90, [0.5, 0.5, 1]), "wood"),
        "wall": shape("rectangle", pose([0, 0.2, -0.12], X, 0, [0.5, 0.21, 1]), "white"),
        "milk-side": cylinder(0, 0, [bottom, top], radius, "milk-surface") | inside,
        "milk-top": shape("disk", pose([0, top, 0], X, -90, cap), "milk-surface") | inside,
        "milk-bottom": shape("disk", pose([0, bottom, 0], X, 90, cap), "milk-surface") | inside,
        "light": lamp | {"exterior": ref("milk")},
        "ball": sphere([0.08, 0.0221, 0.02], 0.022, "orange"),
        "cube": shape("cube", pose([-0.08, 0.0171, -0.02], Y, 25, [0.017] * 3), "blue"),
    }


MAX_SMOKE = 10.0  # Largest extinction of the smoke [1/m]

SMOKE_LOW = (-1.01, -0.01, -0.01)
SMOKE_HIGH = (1.01, 2.41, 8.4)
"""Corners of the box with the smoke [m], a centimeter behind walls, floor and ceiling."""

# Center x, y, z; horizontal and vertical radius [m]; fraction of the largest density
PUFFS = np.array(
    [
        (-0.45, 0.9, 6.6, 0.30, 0.45, 1.0),
        (0.40, 1.7, 5.7, 0.40, 0.35, 0.8),
        (-0.20, 1.9, 4.4, 0.55, 0.30, 0.7),
        (0.50, 0.7, 3.6, 0.35, 0.50, 1.0),
        (-0.55, 1.2, 2.4, 0.45, 0.60, 0.9),
        (0.30, 1.9, 1.2, 0.60, 0.35, 0.8),
    ]
)


@cache
def smoke_density() -> NDArray[np.float32]:
    """Return the relative density of the smoke in `smoke_corridor`, from 0 to 1.

    The density is a sum of puffs exp(-r²), limited to 1.

    Returns:
        A read-only array of shape (z, y, x, 1) = (64, 20, 16, 1), the same array in every call.
    """
    # Coordinates of the voxels' centers [m]
    sizes = (16, 20, 64)
    axes = [
        low + (high - low) * (np.arange(n) + 0.5) / n
        for low, high, n in zip(SMOKE_LOW, SMOKE_HIGH, sizes, strict=True)
    ]
    z, y, x = np.meshgrid(*reversed(axes), indexing="ij")

    # Sum the puffs
    total = np.zeros_like(x)
    for px, py, pz, across, up, fraction in PUFFS:
        r2 = ((x - px) ** 2 + (z - pz) ** 2) / across**2 + ((y - py) / up) ** 2
        total += fraction * np.exp(-r2)
    density = np.minimum(total, 1.0)[..., None].astype(np.float32)
    density.flags.writeable = False
    return density


def smoke_corridor(*, sigma_t: float = 3.0, **options: Unpack[TransientOptions]) -> Dict:
    """A corridor with puffs of smoke, lit from the camera's end.

    The density is a grid volume. A pulse travels along the corridor and lights one puff after the
    other.

    Args:
        sigma_t: Extinction at the largest density [1/m], 0 to 10.
        **options: As for `cornell_box_fog`; by default `temporal_bins` is 400, `start_opl` 3.5,
            `bin_width_opl` 0.06.

    Example:
        >>> smoke_corridor(sigma_t=1)["smoke"]["scale"]
        1.0
    """
    # The box with the smoke [m]
    low = np.array(SMOKE_LOW)
    high = np.array(SMOKE_HIGH)
    center = ((low + high) / 2).tolist()
    half = ((high - low) / 2).tolist()

    # The smoke
    grid = {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(smoke_density()),
        "raw": True,
        "to_world": mi.ScalarTransform4f().translate(low.tolist()).scale((high - low).tolist()),
    }
    smoke = {
        "type": "heterogeneous",
        "sigma_t": grid,
        "scale": extinction(sigma_t, MAX_SMOKE),
        "albedo": rgb([0.93, 0.93, 0.95]),
        "phase": {"type": "hg", "g": 0.2},
    }

    # Doors on both sides, camera and time window
    doors = {
        f"door{k}": shape("cube", pose([x, 1.0, z], Y, 0, [0.03, 1.0, 0.45]), "door")
        for k, (x, z) in enumerate([(-1, 6.2), (1, 4.6), (-1, 3.0), (1, 1.4)])
    }
    view = [0.1, 1.45, 9.7], [0, 1.2, 0], 50
    window = {"temporal_bins": 400, "start_opl": 3.5, "bin_width_opl": 0.06}
    return transient_scene(*view, options, **window, **VOLPATH) | {
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.7, 0.7, 0.7]),
        "floor-material": diffuse([0.35, 0.3, 0.26]),
        "left-material": diffuse([0.2, 0.36, 0.45]),
        "right-material": diffuse([0.5, 0.36, 0.24]),
        "door": diffuse([0.12, 0.1, 0.09]),
        "end-material": diffuse([0.65, 0.28, 0.1]),
        "floor": shape("rectangle", pose([0, 0, 5], X, -90, [1, 5, 1]), "floor-material"),
        "ceiling": shape("rectangle", pose([0, 2.4, 5], X, 90, [1, 5, 1]), "white"),
        "far-end": shape("rectangle", pose([0, 1.2, 0], X, 0, [1, 1.2, 1]), "end-material"),
        "near-end": shape("rectangle", pose([0, 1.2, 10], X, 180, [1, 1.2, 1]), "white"),
        "left": shape("rectangle", pose([-1, 1.2, 5], Y, 90, [5, 1.2, 1]), "left-material"),
        "right": shape("rectangle", pose([1, 1.2, 5], Y, -90, [5, 1.2, 1]), "right-material"),
        **doors,
        "light": shape("rectangle", pose([0, 2.1, 9.95], X, 180, [0.5, 0.15, 1]), "black")
        | {"emitter": area_light([240.0, 228.0, 204.0])},
        "smoke": smoke,
        "smoke-end": medium_boundary(pose(center, Y, 0, half), "smoke"),
    }


SIGN_DISTANCE = 15.0  # Distance from the camera to the sign [m]
MAX_ROAD_FOG = 2.0  # Largest extinction of the fog on the road [1/m]


def headlight_in_fog(*, sigma_t: float = 0.16, **options: Unpack[TransientOptions]) -> Dict:
    """A sign on a road, hidden by light of a headlight that fog scatters back.

    The headlight is 0.6 m to the right of the camera, and the sign is 15 m in front of both. Light
    from the fog arrives first: half of it before a path length of 6.3 m, and nine tenths before
    15 m. Light from the sign arrives at 30.0 to 30.15 m, so a time gate there shows the sign.

    Args:
        sigma_t: Extinction of the fog [1/m], 0 to 2.
        **options: As for `cornell_box_fog`; by default `temporal_bins` is 400, `start_opl` 0.5,
            `bin_width_opl` 0.1.

    Example:
        >>> headlight_in_fog()["sensor"]["medium"]["id"]
        'fog'
    """
    z = -SIGN_DISTANCE
    window = {"temporal_bins": 400, "start_opl": 0.5, "bin_width_opl": 0.1}
    scene = transient_scene([0, 0, 0], [0, 0.1, z], 17, options, **window, **VOLPATH)
    lamp = {
        "type": "spot",
        "intensity": rgb([2600.0, 2400.0, 2000.0]),
        "cutoff_angle": 14.0,
        "beam_width": 9.0,
        "to_world": mi.ScalarTransform4f().look_at([0.6, 0, 0], [0.1, 0.2, z], Y),
    }
    return {
        "type": "scene",
        "integrator": scene["integrator"],
        "fog": medium(extinction(sigma_t, MAX_ROAD_FOG), [0.97, 0.97, 0.97], 0.6),
        "sensor": scene["sensor"] | {"medium": ref("fog")},
        "light": lamp | {"medium": ref("fog")},
        "white": diffuse([0.8, 0.8, 0.8]),
        "red": diffuse([0.6, 0.04, 0.04]),
        "asphalt": diffuse([0.12, 0.12, 0.12]),
        "road": shape("rectangle", pose([0, -1.2, -18], X, -90, [20, 20, 1]), "asphalt"),
        "sign": shape("disk", pose([0, 0.45, z], X, 0, [0.9, 0.9, 1]), "red"),
        "bar": shape("rectangle", pose([0, 0.45, z + 0.005], X, 0, [0.62, 0.17, 1]), "white"),
        "sign-post": cylinder(0.0, z - 0.06, [-1.2, 0.45], 0.05, "white"),
        "left-post": cylinder(-1.3, -12.0, [-1.2, -0.3], 0.07, "white"),
        "right-post": cylinder(2.1, -19.0, [-1.2, -0.3], 0.07, "white"),
    }
