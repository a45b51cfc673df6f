"""Scenes of non-line-of-sight captures: a device looks at a relay wall, which sees what is hidden.

The relay wall is 2 m wide and 2 m high, at z = 0, and faces +z. Device and hidden object are both
in front of it, the object farther away, and an occluder beside the device may keep the object out
of its sight. Laser and sensor are one device. Metres, y up.

Shapes go by their ids: `relay_wall`, `occluder`, and the hidden one is `hidden_...`. Each has a
material of its own, so that Mitsuba, which merges meshes and rectangles of equal material when it
loads a scene, keeps them apart: the wall by its sensor, the others by their reflectance, and
ready-made meshes are never merged.
"""

from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ..runtime import checks
from .meshes import bunny_mesh, letter_z, letter_z_mesh, stored, transformed
from .parts import Dict, Y, diffuse, extinction, medium, medium_boundary, pose, rgb
from .views import SAMPLER, transient_film

DEVICE = (-0.5, 0.0, 0.25)  # Position of laser and sensor [m]
OCCLUDER_WIDTH = 0.1  # Width of the occluder in its wider direction, less its margin [m]
MARGIN = 1.05  # The occluder is this much wider than what it has to hide
LEAD = 0.15  # Path length between the default start of a window and the first hidden light [m]
BUNNY_TURN = 25.0  # Rotation of the bunny about y, from +x towards -z [degrees]


def nlos_z(*, distance: float = 1.0, occluder: bool = True, **options: Any) -> Dict:
    """The letter Z, flat, before a relay wall.

    The letter is 0.8 m wide and high, its strokes 0.103 m wide, and it faces the wall. It reads as
    a Z for who looks at the wall from behind it.

    Args:
        distance: Distance of the letter from the wall [m].
        occluder: Whether a black plate keeps the letter out of the device's sight. It shadows a
            small part of what passes between wall and letter too.
        **options: `width` and `height`, points of the wall, from 1 to 65536, by default 64;
            `temporal_bins` from 1 to 1048576 (300); `start_opl` [m], where None is 0.15 m before
            the first hidden light; `bin_width_opl` [m] above 0 (0.006); `spp` (1024); `device`,
            where laser and sensor are, (x, y, z) [m] with z above 0; `target`, where the laser
            meets the wall, (x, y) in [-1, 1]; `wall_reflectance` (0.8) from 0 and
            `hidden_reflectance` (0.7) above 0, both up to 1.

    Returns:
        A dict for `mi.load_dict` with sensor `nlos_capture_meter`, a part of the wall, integrator
        `transient_nlos_path` and film `transient_hdr_film`. Path lengths are counted from wall to
        wall. The letter in it is a mesh of the active variant.

    Raises:
        ValueError: An argument is out of range; one line with its name, value and what is allowed.

    Example:
        >>> scene = nlos_z(width=32, height=32)
        >>> scene["relay_wall"]["sensor"]["film"]["start_opl"]
        1.85
    """
    z = checks.metres("distance", distance, positive=True)
    letter = letter_z_mesh(pose([0, 0, z], Y, 0, [1, 1, 1]), bsdf=_hidden_material(options))
    corners = letter_z()[0] + [0, 0, z]
    return _scene({"hidden_z": letter}, corners, occluder, **options)


def nlos_patch(
    *,
    side: float = 0.02,
    position: Sequence[float] = (0.2, 0.1, 1.0),
    tilt: float = 30.0,
    occluder: bool = False,
    **options: Any,
) -> Dict:
    """A small square, tilted, before a relay wall.

    Of a patch of area A that is small, what the wall's point w sends back to itself has a closed
    form, which `tilt` makes sensitive to each of the cosines:
    Φ ρ_w² ρ_h A cos_w² cos_h² / (π³ r⁴).

    Args:
        side: Length of the patch's sides [m].
        position: Its middle, (x, y, z) [m].
        tilt: How far it is turned about y [degrees], between -90 and 90. Its normal is
            (-sin tilt, 0, -cos tilt): 0 faces the wall.
        occluder: As in `nlos_z`.
        **options: As for `nlos_z`; `bin_width_opl` is 0.012 by default.

    Example:
        >>> nlos_patch(tilt=45)["hidden_patch"]["type"]
        'rectangle'
    """
    half = checks.metres("side", side, positive=True) / 2
    where = checks.point("position", position)
    angle = checks.number("tilt", tilt, unit="degrees")
    checks.require("tilt", tilt, -90 < angle < 90, "between -90 and 90 degrees")
    to_world = pose(where, Y, 180 + angle, [half, half, 1])
    corners = _corners(to_world)
    if not corners[:, 2].min() > 0:
        raise ValueError(
            f"position = {checks.quote(position)}, side = {checks.quote(side)}: must leave all of "
            "the patch before the wall"
        )
    patch = {"type": "rectangle", "to_world": to_world, "bsdf": _hidden_material(options)}
    options = {"bin_width_opl": 0.012} | options
    return _scene({"hidden_patch": patch}, corners, occluder, **options)


def nlos_plane(
    *, distance: float = 1.0, half_width: float = 10.0, occluder: bool = False, **options: Any
) -> Dict:
    """A large plane, parallel to a relay wall.

    For an infinite plane at distance D, what the wall's point w sends back to itself has a closed
    form: dL/dr = 2 Φ ρ_w² ρ_h D⁴ / (π² r⁷) for r above D. Of that, an edge at distance R from w
    takes away the fraction (D/R)⁶.

    Args:
        distance: Distance of the plane from the wall [m].
        half_width: Half the plane's width and height [m].
        occluder: As in `nlos_z`.
        **options: As for `nlos_z`; `bin_width_opl` is 0.012 by default.

    Example:
        >>> [name for name in nlos_plane() if "hidden" in name]
        ['hidden_plane']
    """
    z = checks.metres("distance", distance, positive=True)
    half = checks.metres("half_width", half_width, positive=True)
    to_world = pose([0, 0, z], Y, 180, [half, half, 1])
    plane = {"type": "rectangle", "to_world": to_world, "bsdf": _hidden_material(options)}
    options = {"bin_width_opl": 0.012} | options
    return _scene({"hidden_plane": plane}, _corners(to_world), occluder, **options)


def nlos_bunny(*, distance: float = 1.0, occluder: bool = True, **options: Any) -> Dict:
    """A rabbit before a relay wall, 0.88 m tall.

    It sits in profile, its head to the right for who looks at the wall, a little turned towards it.

    Args:
        distance: Distance of its middle from the wall [m].
        occluder: As in `nlos_z`.
        **options: As for `nlos_z`; `bin_width_opl` is 0.008 by default.

    Example:
        >>> nlos_bunny()["relay_wall"]["sensor"]["film"]["bin_width_opl"]
        0.008
    """
    z = checks.metres("distance", distance, positive=True)
    to_world = pose([0, -0.44, z], Y, BUNNY_TURN, [1, 1, 1])
    vertices = transformed(stored("bunny")[0], to_world)
    if not vertices[:, 2].min() > 0:
        raise ValueError(
            f"distance = {checks.quote(distance)}: must leave all of the bunny before the wall"
        )
    mesh = bunny_mesh(to_world, bsdf=_hidden_material(options))
    options = {"bin_width_opl": 0.008} | options
    return _scene({"hidden_bunny": mesh}, vertices, occluder, **options)


MAX_THIN_FOG = 10.0  # Largest extinction of the fog before the hidden letter [1/m]


def nlos_behind_fog(*, sigma_t: float = 0.5, occluder: bool = True, **options: Any) -> Dict:
    """The letter Z, hidden behind thin fog, before a relay wall.

    As `nlos_z`, 1 m from the wall. The fog is 4 m wide and high, from 0.45 m to 0.9 m before the
    wall; it is in a box that bends no light. Device and wall are outside of it.

    Args:
        sigma_t: Extinction of the fog [1/m], 0 to 10.
        occluder: As in `nlos_z`.
        **options: As for `nlos_z`.

    Example:
        >>> nlos_behind_fog(sigma_t=2)["fog"]["sigma_t"]
        2.0
    """
    fog = medium(extinction(sigma_t, MAX_THIN_FOG), [0.97, 0.97, 0.97], 0.6)
    end = medium_boundary(pose([0, 0, 0.675], Y, 0, [2, 2, 0.225]), "fog")
    return nlos_z(occluder=occluder, **options) | {"fog": fog, "fog-end": end}


def _scene(
    hidden: Dict,
    points: np.ndarray,
    occluder: bool,
    *,
    width: int = 64,
    height: int = 64,
    temporal_bins: int = 300,
    start_opl: float | None = None,
    bin_width_opl: float = 0.006,
    spp: int = 1024,
    device: Sequence[float] = DEVICE,
    target: Sequence[float] = (0.0, 0.0),
    wall_reflectance: float = 0.8,
) -> Dict:
    """Wall and device before the `hidden` shape, which has these `points` (n, 3) [m]."""
    origin, spot = checks.point("device", device), checks.point("target", target, 2)
    checks.require("device", device, origin[2] > 0, "before the wall, z above 0")
    valid = max(map(abs, spot)) <= 1
    checks.require("target", target, valid, "on the wall, from -1 to 1 in x and y")
    nearest = float(points[:, 2].min())
    start = round(max(0.0, 2 * nearest - LEAD), 2) if start_opl is None else start_opl
    film = transient_film(width, height, temporal_bins, start, bin_width_opl)
    count = checks.integer("spp", spp, 1, checks.MAX_SPP)
    wall = {
        "type": "rectangle",
        "bsdf": _grey("wall_reflectance", wall_reflectance, low=0),
        "sensor": {
            "type": "nlos_capture_meter",
            "sensor_origin": origin,
            "film": film,
            "sampler": {"type": SAMPLER, "sample_count": count},
        },
    }
    plate = {}
    if checks.boolean("occluder", occluder):
        if not origin[2] < nearest:
            raise ValueError(
                f"device = {checks.quote(device)}: with an occluder, must be nearer to the wall "
                f"than the hidden shape, z below {nearest:g}"
            )
        plate["occluder"] = _occluder(np.array(origin), points)
    return {
        "type": "scene",
        "integrator": {
            "type": "transient_nlos_path",
            "laser_power": 1.0,
            "nlos_laser_sampling": True,
            "nlos_hidden_geometry_sampling": True,
            "account_first_and_last_bounces": False,
        },
        "relay_wall": wall,
        "laser": {
            "type": "projector",
            "irradiance": rgb([100.0, 100.0, 100.0]),
            "fov": 0.2,
            "to_world": mi.ScalarTransform4f().look_at(origin, [*spot, 0], Y),
        },
        **plate,
        **hidden,
    }


def _occluder(device: np.ndarray, points: np.ndarray) -> Dict:
    """A black plate, parallel to the wall, that just covers the points as seen from the device."""
    slopes = (points - device)[:, :2] / (points - device)[:, 2:]
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    depth = points[:, 2].min() - device[2]
    gap = min(OCCLUDER_WIDTH / float((high - low).max()), depth / 2)
    half = gap * MARGIN * (high - low) / 2
    middle = device[:2] + gap * (low + high) / 2
    to_world = pose([*middle.tolist(), float(device[2]) + gap], Y, 0, [*half.tolist(), 1])
    return {"type": "rectangle", "to_world": to_world, "bsdf": diffuse([0.0, 0.0, 0.0])}


def _hidden_material(options: dict[str, Any]) -> Dict:
    """Material of the hidden shape, removed from the options; never the occluder's black."""
    return _grey("hidden_reflectance", options.pop("hidden_reflectance", 0.7), positive=True)


def _corners(to_world: Any) -> np.ndarray:
    """Corners of a rectangle [m], shape (4, 3)."""
    return transformed(np.array([[x, y, 0] for x in (-1, 1) for y in (-1, 1)]), to_world)


def _grey(name: str, value: Any, **limits: Any) -> Dict:
    """A diffuse material of this reflectance, at most 1."""
    return diffuse([checks.number(name, value, high=1, **limits)] * 3)
