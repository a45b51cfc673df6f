"""Scenes of non-line-of-sight captures: a device looks at a relay wall that faces a hidden object.

The relay wall is at z = 0, is 2 m wide and high, and faces +z. Laser and sensor form one device.
Device and hidden object are both in front of the wall, and the object is farther from the wall. An
occluder next to the device may block the direct view of the object. Lengths are in meters, y is up.

Ids of shapes are `relay_wall`, `occluder`, and `hidden_...` for the hidden object. Mitsuba merges
meshes and rectangles of equal material when it loads a scene. These shapes are not merged: the wall
has a sensor, the other materials differ in reflectance, and loaded meshes are never merged.
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
OCCLUDER_WIDTH = 0.1  # Width of the occluder in its wider direction, without margin [m]
MARGIN = 1.05  # Width of the occluder relative to the width that hides the object exactly
LEAD = 0.15  # Path length between the default start of the window and the first hidden light [m]
BUNNY_TURN = 25.0  # Rotation of the bunny about y, from +x towards -z [degrees]


def nlos_z(*, distance: float = 1.0, occluder: bool = True, **options: Any) -> Dict:
    """The letter Z, flat, in front of a relay wall.

    The letter is 0.8 m wide and high, its strokes are 0.103 m wide, and its front faces the wall.
    It appears as a Z to a viewer who is behind the letter and looks at the wall.

    Args:
        distance: Distance of the letter from the wall [m].
        occluder: Whether a black plate hides the letter from the device. The plate also blocks a
            small part of the light between wall and letter.
        **options: `width` and `height`, the number of points on the wall, from 1 to 65536, by
            default 64; `temporal_bins` from 1 to 1048576 (300); `start_opl` [m] (None, 0.15 m
            before the first hidden light); `bin_width_opl` [m] above 0 (0.006); `spp` (1024);
            `device`, the position (x, y, z) of laser and sensor [m] with z above 0; `target`, the
            point (x, y) of the wall that the laser lights, in [-1, 1]; `wall_reflectance` (0.8)
            from 0 to 1; `hidden_reflectance` (0.7) above 0, up to 1.

    Returns:
        A dict for `mi.load_dict` with integrator `transient_nlos_path`, and with sensor
        `nlos_capture_meter` and film `transient_hdr_film` as parts of the wall. Path lengths are
        measured from wall to wall. The letter is a mesh of the active variant.

    Raises:
        ValueError: If an argument is out of range. The message has its name, value and range.

    Example:
        >>> scene = nlos_z(width=32, height=32)
        >>> scene["relay_wall"]["sensor"]["film"]["start_opl"]
        1.85
    """
    z = checks.meters("distance", distance, positive=True)
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
    """A small square, tilted, in front of a relay wall.

    For a small patch of area A, the light that a point w of the wall receives back from the patch
    has a closed form: Φ ρ_w² ρ_h A cos_w² cos_h² / (π³ r⁴). Φ is the power of the laser, ρ_w and
    ρ_h are the reflectances of wall and patch, and r is the distance. With a `tilt`, both cosines
    differ.

    Args:
        side: Length of the patch's sides [m].
        position: Center of the patch, (x, y, z) [m].
        tilt: Rotation of the patch about y [degrees], between -90 and 90. The normal is
            (-sin tilt, 0, -cos tilt), so that a patch with tilt 0 faces the wall.
        occluder: As in `nlos_z`.
        **options: As for `nlos_z`; `bin_width_opl` is 0.012 by default.

    Example:
        >>> nlos_patch(tilt=45)["hidden_patch"]["type"]
        'rectangle'
    """
    half = checks.meters("side", side, positive=True) / 2
    where = checks.point("position", position)
    angle = checks.number("tilt", tilt, unit="degrees")
    checks.require("tilt", tilt, -90 < angle < 90, "between -90 and 90 degrees")
    to_world = pose(where, Y, 180 + angle, [half, half, 1])
    corners = _corners(to_world)
    if not corners[:, 2].min() > 0:
        raise ValueError(
            f"position = {checks.quote(position)}, side = {checks.quote(side)}: the patch reaches "
            "behind the wall. Increase z of the position or reduce the side"
        )
    patch = {"type": "rectangle", "to_world": to_world, "bsdf": _hidden_material(options)}
    options = {"bin_width_opl": 0.012} | options
    return _scene({"hidden_patch": patch}, corners, occluder, **options)


def nlos_plane(
    *, distance: float = 1.0, half_width: float = 10.0, occluder: bool = False, **options: Any
) -> Dict:
    """A large plane, parallel to a relay wall.

    For an infinite plane at distance D, the light that a point w of the wall receives back has a
    closed form: dL/dr = 2 Φ ρ_w² ρ_h D⁴ / (π² r⁷) for r above D. Φ is the power of the laser, and
    ρ_w and ρ_h are the reflectances of wall and plane. A finite plane with its edge at distance R
    from w lacks the fraction (D/R)⁶ of this light.

    Args:
        distance: Distance of the plane from the wall [m].
        half_width: Half the plane's width and height [m].
        occluder: As in `nlos_z`.
        **options: As for `nlos_z`; `bin_width_opl` is 0.012 by default.

    Example:
        >>> [name for name in nlos_plane() if "hidden" in name]
        ['hidden_plane']
    """
    z = checks.meters("distance", distance, positive=True)
    half = checks.meters("half_width", half_width, positive=True)
    to_world = pose([0, 0, z], Y, 180, [half, half, 1])
    plane = {"type": "rectangle", "to_world": to_world, "bsdf": _hidden_material(options)}
    options = {"bin_width_opl": 0.012} | options
    return _scene({"hidden_plane": plane}, _corners(to_world), occluder, **options)


def nlos_bunny(*, distance: float = 1.0, occluder: bool = True, **options: Any) -> Dict:
    """A rabbit in front of a relay wall, 0.88 m tall.

    The rabbit is seen in profile. Its head is on the right for a viewer who looks at the wall, and
    is turned slightly towards the wall.

    Args:
        distance: Distance of the rabbit's center from the wall [m].
        occluder: As in `nlos_z`.
        **options: As for `nlos_z`; `bin_width_opl` is 0.008 by default.

    Example:
        >>> nlos_bunny()["relay_wall"]["sensor"]["film"]["bin_width_opl"]
        0.008
    """
    z = checks.meters("distance", distance, positive=True)
    to_world = pose([0, -0.44, z], Y, BUNNY_TURN, [1, 1, 1])
    vertices = transformed(stored("bunny")[0], to_world)
    if not vertices[:, 2].min() > 0:
        raise ValueError(
            f"distance = {checks.quote(distance)}: the bunny reaches behind the wall. Increase the "
            "distance"
        )
    mesh = bunny_mesh(to_world, bsdf=_hidden_material(options))
    options = {"bin_width_opl": 0.008} | options
    return _scene({"hidden_bunny": mesh}, vertices, occluder, **options)


MAX_THIN_FOG = 10.0  # Largest extinction of the fog in front of the hidden letter [1/m]


def nlos_behind_fog(*, sigma_t: float = 0.5, occluder: bool = True, **options: Any) -> Dict:
    """The letter Z, hidden behind thin fog, in front of a relay wall.

    The scene is `nlos_z` with the letter at 1 m from the wall. The fog is 4 m wide and high and
    extends from 0.45 m to 0.9 m in front of the wall. Its boundary does not refract light. Device
    and wall are outside of the fog.

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
    """Return a scene with relay wall, device and hidden shapes.

    `hidden` contains the hidden shapes by name, and `points` are points of these shapes [m], shape
    (n, 3). If `occluder` is true, a plate hides these points from the device. The options are
    described at `nlos_z`.
    """
    # Position of the device, and the point that the laser lights
    origin = checks.point("device", device)
    spot = checks.point("target", target, 2)
    checks.require("device", device, origin[2] > 0, "in front of the wall, z above 0")
    valid = max(map(abs, spot)) <= 1
    checks.require("target", target, valid, "on the wall, from -1 to 1 in x and y")

    # The film; its window starts shortly before the first light of the hidden shapes
    nearest = float(points[:, 2].min())
    start = round(max(0.0, 2 * nearest - LEAD), 2) if start_opl is None else start_opl
    film = transient_film(width, height, temporal_bins, start, bin_width_opl)
    count = checks.integer("spp", spp, 1, checks.MAX_SPP)

    # The relay wall with the sensor
    wall = {
        "type": "rectangle",
        "bsdf": _gray("wall_reflectance", wall_reflectance, low=0),
        "sensor": {
            "type": "nlos_capture_meter",
            "sensor_origin": origin,
            "film": film,
            "sampler": {"type": SAMPLER, "sample_count": count},
        },
    }

    # The occluder between device and hidden shapes
    plate = {}
    if checks.boolean("occluder", occluder):
        if not origin[2] < nearest:
            raise ValueError(
                f"device = {checks.quote(device)}: with an occluder, the device must be nearer to "
                f"the wall than the hidden shape. Choose a distance z below {nearest:g} m"
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
    """Return a black plate, parallel to the wall, that hides the points from the device.

    Args:
        device: Position of the device [m], shape (3,).
        points: Points of the hidden shapes [m], shape (n, 3).
    """
    # Range of directions to the points, as x / z and y / z
    slopes = (points - device)[:, :2] / (points - device)[:, 2:]
    low = slopes.min(axis=0)
    high = slopes.max(axis=0)

    # Distance between device and plate, so that the plate is OCCLUDER_WIDTH wide
    depth = points[:, 2].min() - device[2]
    gap = min(OCCLUDER_WIDTH / float((high - low).max()), depth / 2)

    # Size and center of the plate
    half = gap * MARGIN * (high - low) / 2
    center = device[:2] + gap * (low + high) / 2
    to_world = pose([*center.tolist(), float(device[2]) + gap], Y, 0, [*half.tolist(), 1])
    return {"type": "rectangle", "to_world": to_world, "bsdf": diffuse([0.0, 0.0, 0.0])}


def _hidden_material(options: dict[str, Any]) -> Dict:
    """Remove the hidden reflectance from the options, and return the material of the hidden shape.

    The reflectance is above 0, so that the material differs from that of the occluder.
    """
    return _gray("hidden_reflectance", options.pop("hidden_reflectance", 0.7), positive=True)


def _corners(to_world: Any) -> np.ndarray:
    """Return the corners of a rectangle with a transform [m], shape (4, 3)."""
    return transformed(np.array([[x, y, 0] for x in (-1, 1) for y in (-1, 1)]), to_world)


def _gray(name: str, value: Any, **limits: Any) -> Dict:
    """Return a diffuse material with a reflectance up to 1, the checked parameter `name`."""
    return diffuse([checks.number(name, value, high=1, **limits)] * 3)
