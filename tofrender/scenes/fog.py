"""Scenes with participating media: fog, milk, smoke.

Each has a medium of HG phase function whose extinction, `sigma_t`, can be changed; 0 leaves clear
air. Metres, y up.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..runtime import checks
from .boxes import cornell_box
from .caustics import WITH_DEPTH
from .parts import (
    Dict,
    area_light,
    ball_light,
    camera,
    diffuse,
    place,
    rgb,
    shape,
    sphere,
    transient_film,
)

X, Y = [1, 0, 0], [0, 1, 0]
LAMP_COLOUR = [1.22, 1.02, 0.76]  # its mean is 1


def _integrator(integrator: str, max_depth: int) -> Dict:
    kind = checks.one_of("integrator", integrator, WITH_DEPTH)
    return {"type": kind, "max_depth": checks.depth("max_depth", max_depth)}


def extinction(sigma_t: float, most: float) -> float:
    """A checked extinction [1/m]."""
    return checks.number("sigma_t", sigma_t, unit="1/m", low=0, high=most)


def medium(sigma_t: float, albedo: list[float], g: float) -> Dict:
    """A homogeneous medium of an extinction [1/m] and an HG phase function."""
    phase = {"type": "hg", "g": g}
    return {"type": "homogeneous", "sigma_t": sigma_t, "albedo": rgb(albedo), "phase": phase}


def _ref(name: str) -> Dict:
    return {"type": "ref", "id": name}


def boundary(to_world: Any, medium: str) -> Dict:
    """A cube that holds a medium and bends no light."""
    null = {"type": "null"}
    return {"type": "cube", "to_world": to_world, "bsdf": null, "interior": _ref(medium)}


# --------------------------------------------------------------------------------- Cornell box

MAX_FOG = 20.0
"""Largest extinction in the Cornell box [1/m]."""


def cornell_box_fog(
    *,
    width: int = 256,
    height: int = 256,
    temporal_bins: int = 500,
    start_opl: float = 3.5,
    bin_width_opl: float = 0.02,
    spp: int = 256,
    max_depth: int = -1,
    integrator: str = "transient_volpath",
    sigma_t: float = 0.3,
) -> Dict:
    """The Cornell box with thin fog in it.

    The fog ends at the open front of the box; the camera is outside of it.

    Args:
        width: Picture's width [pixels], 1 to 65536.
        height: Picture's height [pixels], 1 to 65536.
        temporal_bins: Number of time bins, 1 to 1048576.
        start_opl: Start of the first bin, an optical path length [m]. The default is a little
            before the first light arrives.
        bin_width_opl: Width of a bin [m], above 0.
        spp: Samples per pixel.
        max_depth: Longest path in segments, camera's included, -1 for no limit; each point where
            the medium scatters ends one.
        integrator: An integrator in time that has a `max_depth`, e.g. "path_tracer_nee".
        sigma_t: Extinction of the fog [1/m], 0 to 20; light goes 1 / sigma_t between collisions.

    Returns:
        A dict for `mi.load_dict` with film `transient_hdr_film`. It loads under every llvm_* and
        cuda_* variant.

    Raises:
        ValueError: An argument is out of range; one line with its name, value and what is allowed.

    Example:
        >>> scene = cornell_box_fog(width=64, height=64, sigma_t=0.5)
        >>> scene["fog"]["sigma_t"]
        0.5
    """
    film = transient_film(width, height, temporal_bins, start_opl, bin_width_opl)
    scene = cornell_box(spp=spp)
    scene["sensor"]["film"] = film
    scene["integrator"] = _integrator(integrator, max_depth)
    # A centimetre behind the walls, so that no two surfaces coincide
    around = place([0, 0, -0.005], Y, 0, [1.01, 1.01, 1.005])
    return scene | {
        "fog": medium(extinction(sigma_t, MAX_FOG), [0.98, 0.98, 0.98], 0.6),
        "fog-end": boundary(around, "fog"),
    }


# ----------------------------------------------------------------------------------------- milk

MILK_INDEX = 1.35
MAX_MILK = 1000.0
"""Largest extinction of the milk [1/m]."""


def lamp_in_milk(
    *,
    width: int = 256,
    height: int = 256,
    temporal_bins: int = 300,
    start_opl: float = 0.4,
    bin_width_opl: float = 0.004,
    spp: int = 256,
    max_depth: int = -1,
    integrator: str = "transient_volpath",
    sigma_t: float = 100.0,
) -> Dict:
    """A small lamp in a glass of thin milk that lights a table.

    The milk has the index of refraction 1.35, so light in it takes that much longer. The glass
    itself is left out.

    Args:
        width: Picture's width [pixels], 1 to 65536.
        height: Picture's height [pixels], 1 to 65536.
        temporal_bins: Number of time bins, 1 to 1048576.
        start_opl: Start of the first bin, an optical path length [m]. The default is a little
            before the first light arrives.
        bin_width_opl: Width of a bin [m], above 0.
        spp: Samples per pixel.
        max_depth: Longest path in segments, camera's included, -1 for no limit; each point where
            the medium scatters ends one.
        integrator: As for `cornell_box_fog`.
        sigma_t: Extinction of the milk [1/m], 0 to 1000.

    Returns:
        A dict for `mi.load_dict` with film `transient_hdr_film`.

    Example:
        >>> scene = lamp_in_milk()
        >>> scene["milk-side"]["radius"] > scene["light"]["radius"]
        True
    """
    film = transient_film(width, height, temporal_bins, start_opl, bin_width_opl)
    radius, bottom, top = 0.035, 0.001, 0.1
    surface = {"bsdf": _ref("milk-surface"), "interior": _ref("milk")}
    ends = {
        "milk-top": place([0, top, 0], X, -90, [radius, radius, 1]),
        "milk-bottom": place([0, bottom, 0], X, 90, [radius, radius, 1]),
    }
    lamp = ball_light([0, 0.045, 0], 0.01, 0.08, LAMP_COLOUR)
    side = {"type": "cylinder", "p0": [0, bottom, 0], "p1": [0, top, 0], "radius": radius}
    return {
        "type": "scene",
        "integrator": _integrator(integrator, max_depth),
        "sensor": camera([0.07, 0.19, 0.42], [0.005, 0.045, 0], 26, film, spp),
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.8, 0.78, 0.74]),
        "wood": diffuse([0.7, 0.55, 0.4]),
        "orange": diffuse([0.75, 0.3, 0.08]),
        "blue": diffuse([0.2, 0.36, 0.45]),
        "milk-surface": {"type": "dielectric", "int_ior": MILK_INDEX, "ext_ior": 1.0},
        "milk": medium(extinction(sigma_t, MAX_MILK), [0.9995, 0.999, 0.996], 0.7),
        "table": shape("rectangle", place([0, 0, 0], X, -90, [0.5, 0.5, 1]), "wood"),
        "wall": shape("rectangle", place([0, 0.2, -0.12], X, 0, [0.5, 0.21, 1]), "white"),
        "milk-side": side | surface,
        **{name: {"type": "disk", "to_world": where} | surface for name, where in ends.items()},
        "light": lamp | {"exterior": _ref("milk")},
        "ball": sphere([0.08, 0.0221, 0.02], 0.022, "orange"),
        "cube": shape("cube", place([-0.08, 0.0171, -0.02], Y, 25, [0.017] * 3), "blue"),
    }


# ---------------------------------------------------------------------------------------- smoke

MAX_SMOKE = 10.0
"""Largest extinction of the smoke [1/m]."""

SMOKE_LOW, SMOKE_HIGH = (-1.01, -0.01, -0.01), (1.01, 2.41, 8.4)
"""Corners of the box that the smoke is in [m]; a centimetre behind walls, floor and ceiling."""

# center x, y, z; radius across, radius up [m]; share of the largest density
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
    """Density of the smoke in `smoke_corridor`, 0 to 1: puffs exp(-r²), one at the most.

    Returns:
        The same array every time, which cannot be written to, shape (z, y, x, 1) = (64, 20, 16, 1).

    Example:
        >>> float(smoke_density().max()) <= 1
        True
    """
    sizes = (16, 20, 64)
    axes = [
        low + (high - low) * (np.arange(n) + 0.5) / n
        for low, high, n in zip(SMOKE_LOW, SMOKE_HIGH, sizes, strict=True)
    ]
    z, y, x = np.meshgrid(*reversed(axes), indexing="ij")
    total = np.zeros_like(x)
    for px, py, pz, across, up, share in PUFFS:
        r2 = ((x - px) ** 2 + (z - pz) ** 2) / across**2 + ((y - py) / up) ** 2
        total += share * np.exp(-r2)
    density = np.minimum(total, 1.0)[..., None].astype(np.float32)
    density.flags.writeable = False
    return density


def smoke_corridor(
    *,
    width: int = 256,
    height: int = 256,
    temporal_bins: int = 400,
    start_opl: float = 3.5,
    bin_width_opl: float = 0.06,
    spp: int = 256,
    max_depth: int = -1,
    integrator: str = "transient_volpath",
    sigma_t: float = 3.0,
) -> Dict:
    """A corridor with puffs of smoke, lit from the camera's end.

    The density is a grid. A pulse runs down the corridor and lights one puff after the other.

    Args:
        width: Picture's width [pixels], 1 to 65536.
        height: Picture's height [pixels], 1 to 65536.
        temporal_bins: Number of time bins, 1 to 1048576.
        start_opl: Start of the first bin, an optical path length [m]. The default is a little
            before the first light arrives.
        bin_width_opl: Width of a bin [m], above 0.
        spp: Samples per pixel.
        max_depth: Longest path in segments, camera's included, -1 for no limit; each point where
            the medium scatters ends one.
        integrator: As for `cornell_box_fog`.
        sigma_t: Extinction where the smoke is thickest [1/m], 0 to 10.

    Returns:
        A dict for `mi.load_dict` with film `transient_hdr_film`.

    Example:
        >>> smoke_corridor(sigma_t=1)["smoke"]["scale"]
        1.0
    """
    film = transient_film(width, height, temporal_bins, start_opl, bin_width_opl)
    low, high = np.array(SMOKE_LOW), np.array(SMOKE_HIGH)
    center, half = ((low + high) / 2).tolist(), ((high - low) / 2).tolist()
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
    doors = {
        f"door{k}": shape("cube", place([x, 1.0, z], Y, 0, [0.03, 1.0, 0.45]), "door")
        for k, (x, z) in enumerate([(-1, 6.2), (1, 4.6), (-1, 3.0), (1, 1.4)])
    }
    return {
        "type": "scene",
        "integrator": _integrator(integrator, max_depth),
        "sensor": camera([0.1, 1.45, 9.7], [0, 1.2, 0], 50, film, spp),
        "black": diffuse([0, 0, 0]),
        "white": diffuse([0.7, 0.7, 0.7]),
        "floor-material": diffuse([0.35, 0.3, 0.26]),
        "left-material": diffuse([0.2, 0.36, 0.45]),
        "right-material": diffuse([0.5, 0.36, 0.24]),
        "door": diffuse([0.12, 0.1, 0.09]),
        "end-material": diffuse([0.65, 0.28, 0.1]),
        "floor": shape("rectangle", place([0, 0, 5], X, -90, [1, 5, 1]), "floor-material"),
        "ceiling": shape("rectangle", place([0, 2.4, 5], X, 90, [1, 5, 1]), "white"),
        "far-end": shape("rectangle", place([0, 1.2, 0], X, 0, [1, 1.2, 1]), "end-material"),
        "near-end": shape("rectangle", place([0, 1.2, 10], X, 180, [1, 1.2, 1]), "white"),
        "left": shape("rectangle", place([-1, 1.2, 5], Y, 90, [5, 1.2, 1]), "left-material"),
        "right": shape("rectangle", place([1, 1.2, 5], Y, -90, [5, 1.2, 1]), "right-material"),
        **doors,
        "light": shape("rectangle", place([0, 2.1, 9.95], X, 180, [0.5, 0.15, 1]), "black")
        | {"emitter": area_light([240.0, 228.0, 204.0])},
        "smoke": smoke,
        "smoke-end": boundary(place(center, Y, 0, half), "smoke"),
    }


# ------------------------------------------------------------------------------------ headlight

SIGN_DISTANCE = 15.0
"""From the camera to the sign [m]."""

MAX_ROAD_FOG = 2.0
"""Largest extinction of the fog on the road [1/m]."""


def headlight_in_fog(
    *,
    width: int = 256,
    height: int = 256,
    temporal_bins: int = 400,
    start_opl: float = 0.5,
    bin_width_opl: float = 0.1,
    spp: int = 256,
    max_depth: int = -1,
    integrator: str = "transient_volpath",
    sigma_t: float = 0.16,
) -> Dict:
    """A sign on a road, hidden by what fog scatters back from a headlight.

    The headlight is 0.6 m beside the camera, the sign 15 m before both. What the fog scatters back
    arrives first, half of it before a path length of 6.3 m, nine tenths before 15 m. The light of
    the sign arrives at 30.0 to 30.15 m: a gate there shows the sign.

    Args:
        width: Picture's width [pixels], 1 to 65536.
        height: Picture's height [pixels], 1 to 65536.
        temporal_bins: Number of time bins, 1 to 1048576.
        start_opl: Start of the first bin, an optical path length [m]. The default is before the
            first light arrives.
        bin_width_opl: Width of a bin [m], above 0.
        spp: Samples per pixel.
        max_depth: Longest path in segments, camera's included, -1 for no limit; each point where
            the medium scatters ends one.
        integrator: As for `cornell_box_fog`.
        sigma_t: Extinction of the fog [1/m], 0 to 2.

    Returns:
        A dict for `mi.load_dict` with film `transient_hdr_film`.

    Example:
        >>> headlight_in_fog()["sensor"]["medium"]["id"]
        'fog'
    """
    film = transient_film(width, height, temporal_bins, start_opl, bin_width_opl)
    lamp = {
        "type": "spot",
        "intensity": rgb([2600.0, 2400.0, 2000.0]),
        "cutoff_angle": 14.0,
        "beam_width": 9.0,
        "to_world": mi.ScalarTransform4f().look_at(
            [0.6, 0, 0], [0.1, 0.2, -SIGN_DISTANCE], [0, 1, 0]
        ),
    }
    z = -SIGN_DISTANCE

    def post(x: float, z: float, top: float, radius: float) -> Dict:
        rod = {"type": "cylinder", "p0": [x, -1.2, z], "p1": [x, top, z], "radius": radius}
        return rod | {"bsdf": _ref("white")}

    return {
        "type": "scene",
        "integrator": _integrator(integrator, max_depth),
        "fog": medium(extinction(sigma_t, MAX_ROAD_FOG), [0.97, 0.97, 0.97], 0.6),
        "sensor": camera([0, 0, 0], [0, 0.1, z], 17, film, spp) | {"medium": _ref("fog")},
        "light": lamp | {"medium": _ref("fog")},
        "white": diffuse([0.8, 0.8, 0.8]),
        "red": diffuse([0.6, 0.04, 0.04]),
        "asphalt": diffuse([0.12, 0.12, 0.12]),
        "road": shape("rectangle", place([0, -1.2, -18], X, -90, [20, 20, 1]), "asphalt"),
        "sign": shape("disk", place([0, 0.45, z], X, 0, [0.9, 0.9, 1]), "red"),
        "bar": shape("rectangle", place([0, 0.45, z + 0.005], X, 0, [0.62, 0.17, 1]), "white"),
        "sign-post": post(0.0, z - 0.06, 0.45, 0.05),
        "left-post": post(-1.3, -12.0, -0.3, 0.07),
        "right-post": post(2.1, -19.0, -0.3, 0.07),
    }
