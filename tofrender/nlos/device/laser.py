"""The laser of a scene: its position, its beam, and its aim."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...runtime import checks
from ...runtime.backend import tracing_lock
from ...runtime.interface import pose as pose_of, pose_name, world_transform

RAYS = 32
"""Rays that bound a beam, along each side."""

CELLS = 256
"""Cells of the midpoint rule that integrates a beam, along each side."""

VISIBLE_NM = (460.0, 530.0, 590.0, 640.0)
"""Wavelengths at which spectral variants compare a beam's brightness."""


def find_laser(scene: mi.Scene) -> Any:
    """Return the only emitter of the scene, which must be a projector or a spot.

    Raises:
        ValueError: The scene has other emitters.
    """
    emitters = scene.emitters()
    delta = mi.EmitterFlags.DeltaPosition
    if len(emitters) != 1 or not mi.has_flag(emitters[0].flags(), delta):
        kinds = ", ".join(e.class_name() for e in emitters) or "none"
        raise ValueError(f"emitters: {kinds}; must be one laser, a projector or a spot")
    return emitters[0]


def axis(laser: Any) -> tuple[mi.Point3f, mi.Vector3f]:
    """Return the position of a laser [m], and the unit vector along its optical axis."""
    pose = world_transform(laser)
    return pose @ mi.Point3f(0), dr.normalize(pose @ mi.Vector3f(0, 0, 1))


def solid_angle(laser: Any) -> float:
    """Integrate I(w) / I(axis) over the directions of a laser's beam [sr].

    The midpoint rule is applied on a plane in front of the laser. Sampled rays bound the lit part
    of this plane.
    """
    # Sample rays of the beam
    sides = (dr.arange(mi.Float, RAYS) + 0.5) / RAYS
    u = mi.Point2f(*dr.meshgrid(sides, sides))
    rays, _ = laser.sample_ray(0.0, 0.5, u, u, True)
    origin, forward = axis(laser)
    frame = mi.Frame3f(forward)

    def intensity(d: mi.Vector3f) -> mi.Float:
        # Intensity in a direction, by one emitter sample at the unit distance
        at: Any = dr.zeros(mi.SurfaceInteraction3f)
        at.p = origin + d
        if mi.is_spectral:
            at.wavelengths = type(at.wavelengths)(*VISIBLE_NM)
        return dr.max(mi.unpolarized_spectrum(laser.sample_direction(at, mi.Point2f(0.5))[1]))

    on_axis = intensity(forward)
    if not on_axis[0] > 0:
        raise ValueError("laser: dark along its axis. Use a laser that is bright along its axis")

    # Bound the beam on the plane
    local = frame.to_local(rays.d)
    sides = (dr.arange(mi.Float, CELLS) + 0.5) / CELLS
    plane = []
    extents = []
    for along, unit in zip((local.x, local.y), dr.meshgrid(sides, sides), strict=True):
        low = dr.min(along / local.z)
        high = dr.max(along / local.z)
        margin = 0.05 * (high - low)
        extents.append(high - low + 2 * margin)
        plane.append(low - margin + unit * extents[-1])

    # Sum over the cells of the plane, with dw = cos³ dx dy
    d = mi.Vector3f(*plane, 1)
    cos = dr.rsqrt(dr.squared_norm(d))
    cell = extents[0] * extents[1] / CELLS**2
    total = dr.sum(intensity(frame.to_world(d * cos)) * cos**3) * cell
    return float((total / on_axis)[0])


def aim_laser(laser: Any, target: Any) -> None:
    """Aim a laser, a projector or spot, at a point [m].

    Raises:
        ValueError: The point is the position of the laser.
    """
    origin = mi.Point3f(axis(laser)[0])
    target = mi.Point3f(target)
    shown = np.array(target).ravel().tolist()
    checks.require("point", shown, dr.norm(target - origin)[0] > 0, "another than the laser's own")

    # Choose an upward direction that is not along the beam
    along = dr.normalize(target - origin)
    up = mi.Vector3f(0, 1, 0) if abs(along.y[0]) < 0.99 else mi.Vector3f(1, 0, 0)
    _set_pose(laser, mi.Transform4f().look_at(origin, target, up))


def apply_meters(scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
    """Move and aim the laser as the `nlos_capture_meter` of the scene defines, once.

    If the laser is aimed at a pixel that the film does not have, this aim remains unchanged, and
    `require_aim` refuses it. If the `sensor` looks at the laser spot, it is informed of the spot.
    """
    for meter in _meters(scene):
        if meter.laser_origin is not None:
            laser = find_laser(scene)
            origin = meter.laser_origin
            matrix = pose_of(laser)
            matrix[:3, 3] = origin
            _set_pose(laser, mi.Transform4f(matrix))
            meter.laser_origin = None
        if meter.laser_target is not None and not meter.misplaced_aim():
            aim_laser(find_laser(scene), meter.aim())
            meter.laser_target = None
    # Let the sensor follow the laser
    follow: Any = getattr(sensor, "follow_laser", None)
    if follow is not None:
        follow(scene)


@contextmanager
def restored_pose(laser: Any) -> Iterator[None]:
    """Restore the pose of a laser after the block, also after an error."""
    pose = mi.Transform4f(world_transform(laser))
    try:
        yield
    finally:
        _set_pose(laser, pose)


def position_of(device: mi.Sensor | mi.Emitter) -> np.ndarray:
    """Return the position of a sensor or laser [m], shape (3,)."""
    return np.array(world_transform(device) @ mi.Point3f(0)).ravel()


def require_aim(scene: mi.Scene) -> None:
    """Raise a ValueError if the laser of a meter is aimed at a pixel outside the film."""
    for meter in _meters(scene):
        if meter.laser_target is not None:
            raise ValueError(meter.misplaced_aim())


def _meters(scene: mi.Scene) -> list[Any]:
    """Return the sensors of a scene that are an `nlos_capture_meter`."""
    return [sensor for sensor in scene.sensors() if hasattr(sensor, "laser_target")]


def _set_pose(laser: Any, to_world: mi.Transform4f) -> None:
    """Set the to-world transform of a laser."""
    parameters = mi.traverse(laser)
    parameters[pose_name(parameters)] = to_world
    parameters.update()


@tracing_lock()
def focus_laser(
    scene: mi.Scene, *, point: Any = None, uv: Any = None, pixel: Any = None, sensor: int = 0
) -> np.ndarray:
    """Aim the scene's laser at a point of the relay wall.

    Exactly one of `point`, `uv` and `pixel` must be given.

    Args:
        scene: A scene with one emitter, a projector or spot.
        point: The point [m].
        uv: Coordinates in the uv square of the shape to which the sensor is attached, from 0 to 1.
        pixel: Pixel (x, y) of the sensor's whole film, also with a crop window. The laser is aimed
            at the center of the pixel.
        sensor: Index of the sensor.

    Returns:
        The point [m], shape (3,).

    Raises:
        ValueError: Not exactly one of the three is set, an argument is out of range, or the pixel
            sees no surface.

    Example:
        >>> from tofrender import load_scene
        >>> scene = load_scene("nlos_z", width=4, height=4, optimize=False)
        >>> focus_laser(scene, pixel=(3, 0)).round(2).tolist()
        [0.75, -0.75, 0.0]
    """
    checks.instance("scene", scene, mi.Scene, "a loaded scene; load_scene loads one")
    # Exactly one target must be given
    given = (point, uv, pixel)
    if sum(value is not None for value in given) != 1:
        shown = ", ".join(map(checks.quote, given))
        raise ValueError(f"point, uv, pixel = {shown}: must be one of them, and None the others")

    # Later calls must not aim the laser again
    laser = find_laser(scene)
    apply_meters(scene)
    for meter in _meters(scene):
        meter.laser_target = None
    sensors = scene.sensors()
    camera = sensors[checks.integer("sensor", sensor, 0, len(sensors) - 1)]

    # Find the center of a pixel on the wall
    if pixel is not None:
        numbers = checks.items("pixel", pixel, 2, "its column and row")
        film = camera.film()
        size = film.size()
        x, y = (
            checks.integer(f"pixel {axis}", k, 0, n - 1) + 0.5
            for axis, k, n in zip("xy", numbers, size, strict=True)
        )
        if camera.get_shape() is None:
            # Sample the center of the pixel; samples are relative to the crop window
            crop = film.crop_size()
            offset = film.crop_offset()
            sample = mi.Point2f((x - offset.x) / crop.x, (y - offset.y) / crop.y)
            # Import here, because editions without `paths` contain lasers
            from ...paths.surfaces import first_surface

            ray, _ = camera.sample_ray(0.0, 0.5, sample, mi.Point2f(0.5))
            si = first_surface(scene, mi.Ray3f(ray))
            if not dr.all(si.is_valid()):
                raise ValueError(f"pixel = {pixel}: sees no surface. Choose another pixel")
            target = si.p
        else:
            target = _at_uv(camera, (x / size.x, y / size.y))

    # Find a point in the uv square, or use the given point
    elif uv is not None:
        sides = checks.items("uv", uv, 2, "two numbers from 0 to 1")
        target = _at_uv(camera, [checks.number("uv", side, low=0, high=1) for side in sides])
    else:
        target = mi.Point3f(*checks.point("point", point))
    aim_laser(laser, target)
    return np.array(target).ravel()


def _at_uv(camera: mi.Sensor, uv: Any) -> mi.Point3f:
    """Return the point at coordinates in the uv square of the camera's shape [m]."""
    shape: Any = camera.get_shape()
    if shape is None:
        raise ValueError("uv: the sensor is not attached to a wall. Use point or pixel instead")
    return shape.sample_position(0.0, mi.Point2f(*uv), True).p
