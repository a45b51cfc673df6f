"""The laser of a scene: its position, its beam, and its aim."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import drjit as dr
import mitsuba as mi
import numpy as np

RAYS, CELLS = 32, 256
"""Rays that bound a beam, and cells of the midpoint rule that integrates it, on each side."""

VISIBLE_NM = (460.0, 530.0, 590.0, 640.0)
"""Wavelengths at which spectral variants compare a beam's brightness."""


def find_laser(scene: mi.Scene) -> Any:
    """Return the scene's one emitter.

    Raises:
        ValueError: It has none, several, or one that is neither a projector nor a spot; one line.
    """
    emitters = scene.emitters()
    delta = mi.EmitterFlags.DeltaPosition
    if len(emitters) != 1 or not mi.has_flag(emitters[0].flags(), delta):
        kinds = ", ".join(e.class_name() for e in emitters) or "none"
        raise ValueError(f"emitters: {kinds}; must be one laser, a projector or a spot")
    return emitters[0]


def axis(laser: Any) -> tuple[mi.Point3f, mi.Vector3f]:
    """Position of a laser [m], and the unit vector along its optical axis."""
    pose = laser.world_transform()
    return pose @ mi.Point3f(0), dr.normalize(pose @ mi.Vector3f(0, 0, 1))


def solid_angle(laser: Any) -> float:
    """Integrate I(w) / I(axis) over the directions of a laser's beam [sr].

    The midpoint rule on a plane before the laser, whose extent sampled rays bound.

    Raises:
        ValueError: The laser is dark along its axis; one line.
    """
    sides = (dr.arange(mi.Float, RAYS) + 0.5) / RAYS
    u = mi.Point2f(*dr.meshgrid(sides, sides))
    rays, _ = laser.sample_ray(0.0, 0.5, u, u, True)
    origin, forward = axis(laser)
    frame = mi.Frame3f(forward)

    def intensity(d: mi.Vector3f) -> mi.Float:
        at: Any = dr.zeros(mi.SurfaceInteraction3f)
        at.p = origin + d
        if mi.is_spectral:
            at.wavelengths = type(at.wavelengths)(*VISIBLE_NM)
        return dr.max(mi.unpolarized_spectrum(laser.sample_direction(at, mi.Point2f(0.5))[1]))

    on_axis = intensity(forward)
    if not on_axis[0] > 0:
        raise ValueError("laser: is dark along its axis; must shine where it looks")
    local = frame.to_local(rays.d)
    sides = (dr.arange(mi.Float, CELLS) + 0.5) / CELLS
    plane, extents = [], []
    for along, unit in zip((local.x, local.y), dr.meshgrid(sides, sides), strict=True):
        low, high = dr.min(along / local.z), dr.max(along / local.z)
        margin = 0.05 * (high - low)
        extents.append(high - low + 2 * margin)
        plane.append(low - margin + unit * extents[-1])
    d = mi.Vector3f(*plane, 1)
    cos = dr.rsqrt(dr.squared_norm(d))
    cell = extents[0] * extents[1] / CELLS**2
    total = dr.sum(intensity(frame.to_world(d * cos)) * cos**3) * cell
    return float((total / on_axis)[0])


def aim_laser(laser: Any, target: Any) -> None:
    """Aim a laser, a projector or spot, at a point [m].

    Raises:
        ValueError: The point is the laser's own; one line.
    """
    origin, target = mi.Point3f(axis(laser)[0]), mi.Point3f(target)
    if not dr.norm(target - origin)[0] > 0:
        raise ValueError(
            f"point = {np.array(target).ravel().tolist()}: must not be the laser's own"
        )
    along = dr.normalize(target - origin)
    up = mi.Vector3f(0, 1, 0) if abs(along.y[0]) < 0.99 else mi.Vector3f(1, 0, 0)
    _set_pose(laser, mi.Transform4f().look_at(origin, target, up))


def apply_meters(scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
    """Move and aim the laser as an `nlos_capture_meter` of the scene says, once.

    An aim at a pixel that the film does not have stays with the meter, for `require_aim`. A
    `sensor` that looks at the laser spot is then told where that is.
    """
    for meter in cast(Any, scene.sensors()):
        if getattr(meter, "laser_origin", None) is not None:
            laser, origin = find_laser(scene), meter.laser_origin
            matrix = np.array(laser.world_transform().matrix).reshape(4, 4)
            matrix[:3, 3] = origin
            _set_pose(laser, mi.Transform4f(matrix))
            meter.laser_origin = None
        if getattr(meter, "laser_target", None) is not None and not meter.misplaced_aim():
            aim_laser(find_laser(scene), meter.aim())
            meter.laser_target = None
    follow: Any = getattr(sensor, "follow_laser", None)
    if follow is not None:
        follow(scene)


@contextmanager
def restored_pose(laser: Any) -> Iterator[None]:
    """Restore a laser's pose after the block, whatever happens."""
    pose = mi.Transform4f(laser.world_transform())
    try:
        yield
    finally:
        _set_pose(laser, pose)


def position_of(device: mi.Sensor | mi.Emitter) -> np.ndarray:
    """Position of a sensor or laser [m], shape (3,)."""
    return np.array(device.world_transform() @ mi.Point3f(0)).ravel()


def discard_meter_aims(scene: mi.Scene) -> None:
    """Let the laser stay where it is aimed from now on, whatever a meter says."""
    for meter in cast(Any, scene.sensors()):
        if hasattr(meter, "laser_target"):
            meter.laser_target = None


def require_aim(scene: mi.Scene) -> None:
    """Refuse a meter whose laser is aimed at a pixel that its film does not have."""
    for meter in cast(Any, scene.sensors()):
        if getattr(meter, "laser_target", None) is not None:
            raise ValueError(meter.misplaced_aim())


def _set_pose(laser: Any, to_world: mi.Transform4f) -> None:
    parameters = mi.traverse(laser)
    parameters["to_world"] = to_world
    parameters.update()
