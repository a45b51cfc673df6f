"""The laser of a scene: where it is, what it looks at, and turning it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

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


def turn(laser: Any, target: Any, origin: Any = None) -> None:
    """Let a laser look at a point.

    Args:
        laser: A projector or spot.
        target: The point [m].
        origin: Where to put the laser [m]; by default it stays.

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


@contextmanager
def kept(laser: Any) -> Iterator[None]:
    """Turn a laser back to where it looked before, whatever happens in between."""
    before = mi.Transform4f(laser.world_transform())
    try:
        yield
    finally:
        _place(laser, before)


def follow_meters(scene: mi.Scene) -> None:
    """Put the laser where an `nlos_capture_meter` of the scene says, the first time it is asked.

    Of a pixel that the film does not have, the meter keeps the word; `require_aim` tells it.
    """
    for meter in scene.sensors():
        words: Any = meter
        if getattr(words, "laser_origin", None) is not None:
            laser, origin = find_laser(scene), words.laser_origin
            matrix = np.array(laser.world_transform().matrix).reshape(4, 4)
            matrix[:3, 3] = origin
            _place(laser, mi.Transform4f(matrix))
            words.laser_origin = None
        if getattr(words, "laser_target", None) is not None and not words.misplaced_aim():
            turn(find_laser(scene), words.aim())
            words.laser_target = None


def forget_meters(scene: mi.Scene) -> None:
    """From now on the laser looks where it is turned, whatever a meter says."""
    for meter in scene.sensors():
        if hasattr(meter, "laser_target"):
            words: Any = meter
            words.laser_target = None


def require_aim(scene: mi.Scene) -> None:
    """Refuse a meter whose laser should look at a pixel that its film does not have.

    Raises:
        ValueError: One line with the pixel and those that there are.
    """
    for meter in scene.sensors():
        words: Any = meter
        if getattr(words, "laser_target", None) is not None:
            raise ValueError(words.misplaced_aim())


def _place(laser: Any, to_world: mi.Transform4f) -> None:
    parameters = mi.traverse(laser)
    parameters["to_world"] = to_world
    parameters.update()
