# pyright: reportOperatorIssue=false, reportReturnType=false
"""The laser of a scene: where it is, what it looks at, and turning it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import drjit as dr
import mitsuba as mi
import numpy as np

RAYS, CELLS = 32, 256
"""Rays that say how wide a beam is, and cells of the rule that integrates it, on each side."""

VISIBLE_NM = (460.0, 530.0, 590.0, 640.0)
"""Wavelengths at which spectral variants compare a beam's brightness."""

GRAZING = 1e-4
"""Cosine between a wall's normal and the laser below which the laser is in the wall's plane."""


def find_laser(scene: mi.Scene) -> Any:
    """The scene's one emitter.

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
    """Where a laser is [m], and the unit vector along which it looks."""
    pose = laser.world_transform()
    return pose @ mi.Point3f(0), dr.normalize(pose @ mi.Vector3f(0, 0, 1))


def solid_angle(laser: Any) -> float:
    """Solid angle that a beam of its axis' intensity would need for the laser's power [sr].

    The integral of I(w) / I(axis) dw over the directions in which the laser shines, by the midpoint
    rule on a plane before it.

    Raises:
        ValueError: The laser is dark along its axis; one line.
    """
    sides = (dr.arange(mi.Float, RAYS) + 0.5) / RAYS
    u = mi.Point2f(*dr.meshgrid(sides, sides))
    rays, _ = laser.sample_ray(0.0, 0.5, u, u, True)
    origin, forward = axis(laser)
    frame = mi.Frame3f(forward)
    local = frame.to_local(rays.d)
    x, y = local.x / local.z, local.y / local.z
    low, high = [dr.min(v) for v in (x, y)], [dr.max(v) for v in (x, y)]
    margin = [0.05 * (h - a) for a, h in zip(low, high, strict=True)]
    sides = (dr.arange(mi.Float, CELLS) + 0.5) / CELLS
    s, t = dr.meshgrid(sides, sides)
    spans = [h - a + 2 * m for a, h, m in zip(low, high, margin, strict=True)]
    x, y = (a - m + v * w for a, m, v, w in zip(low, margin, (s, t), spans, strict=True))

    def intensity(d: mi.Vector3f) -> mi.Float:
        at: Any = dr.zeros(mi.SurfaceInteraction3f)
        at.p = origin + d
        if mi.is_spectral:
            at.wavelengths = type(at.wavelengths)(*VISIBLE_NM)
        return dr.max(mi.unpolarized_spectrum(laser.sample_direction(at, mi.Point2f(0.5))[1]))

    on_axis = intensity(forward)
    if not on_axis[0] > 0:
        raise ValueError("laser: is dark along its axis; must shine where it looks")
    d = mi.Vector3f(x, y, 1)
    cos = dr.rsqrt(dr.squared_norm(d))
    cell = spans[0] * spans[1] / CELLS**2
    total = dr.sum(intensity(frame.to_world(d * cos)) * cos**3) * cell
    return float((total / on_axis)[0])


def turn(laser: Any, target: Any, origin: Any = None) -> None:
    """Let a laser, a projector or spot, look at a point [m]; with an origin, from there.

    Raises:
        ValueError: The point is the laser's own; one line.
    """
    place, target = mi.Point3f(axis(laser)[0] if origin is None else origin), mi.Point3f(target)
    if not dr.norm(target - place)[0] > 0:
        raise ValueError(
            f"point = {np.array(target).ravel().tolist()}: must not be the laser's own"
        )
    along = dr.normalize(target - place)
    up = mi.Vector3f(0, 1, 0) if abs(along.y[0]) < 0.99 else mi.Vector3f(1, 0, 0)
    _place(laser, mi.Transform4f().look_at(place, target, up))


def follow_meters(scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
    """Put the laser where an `nlos_capture_meter` of the scene says, the first time it is asked.

    Of a pixel that the film does not have, the meter keeps the word; `require_aim` tells it. A
    `sensor` that looks from where the laser is then learns where that is.
    """
    for meter in cast(Any, scene.sensors()):
        if getattr(meter, "laser_origin", None) is not None:
            laser, origin = find_laser(scene), meter.laser_origin
            matrix = np.array(laser.world_transform().matrix).reshape(4, 4)
            matrix[:3, 3] = origin
            _place(laser, mi.Transform4f(matrix))
            meter.laser_origin = None
        if getattr(meter, "laser_target", None) is not None and not meter.misplaced_aim():
            turn(find_laser(scene), meter.aim())
            meter.laser_target = None
    follow: Any = getattr(sensor, "follow_laser", None)
    if follow is not None:
        follow(scene)


@contextmanager
def kept_aim(laser: Any) -> Iterator[None]:
    """Let a laser look afterwards where it looks now, whatever happens."""
    pose = mi.Transform4f(laser.world_transform())
    try:
        yield
    finally:
        _place(laser, pose)


def place_of(device: mi.Sensor | mi.Emitter) -> np.ndarray:
    """Where a sensor or laser is [m], shape (3,)."""
    return np.array(device.world_transform() @ mi.Point3f(0)).ravel()


def forget_meters(scene: mi.Scene) -> None:
    """From now on the laser looks where it is turned, whatever a meter says."""
    for meter in cast(Any, scene.sensors()):
        if hasattr(meter, "laser_target"):
            meter.laser_target = None


def require_aim(scene: mi.Scene) -> None:
    """Refuse a meter whose laser should look at a pixel that its film does not have.

    Raises:
        ValueError: One line with the pixel and those that there are.
    """
    for meter in cast(Any, scene.sensors()):
        if getattr(meter, "laser_target", None) is not None:
            raise ValueError(meter.misplaced_aim())


def _place(laser: Any, to_world: mi.Transform4f) -> None:
    parameters = mi.traverse(laser)
    parameters["to_world"] = to_world
    parameters.update()
