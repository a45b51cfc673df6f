"""Aiming the laser at a point of the relay wall."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...paths.surfaces import first_surface
from ...runtime import checks
from ...runtime.backend import tracing_lock
from .laser import aim_laser, apply_meters, discard_meter_aims, find_laser


@tracing_lock()
def focus_laser(
    scene: mi.Scene, *, point: Any = None, uv: Any = None, pixel: Any = None, sensor: int = 0
) -> np.ndarray:
    """Aim the scene's laser at a point of the relay wall.

    Args:
        scene: A scene with one emitter, a projector or spot.
        point: The point [m], or
        uv: its coordinates in the uv square of the shape that the sensor is a child of, or
        pixel: (x, y) of the sensor's whole film, whatever its crop window; its centre is meant.
        sensor: Number of the sensor.

    Returns:
        The point [m], shape (3,).

    Raises:
        ValueError: Not exactly one of the three is given, it is out of range, or the pixel sees
            nothing; one line.

    Example:
        >>> from tofrender import load_scene
        >>> scene = load_scene("nlos_z", width=4, height=4, optimize=False)
        >>> focus_laser(scene, pixel=(3, 0)).round(2).tolist()
        [0.75, -0.75, 0.0]
    """
    if not isinstance(scene, mi.Scene):
        raise ValueError(
            f"scene = {checks.quote(scene)}: must be a loaded scene; load_scene loads one"
        )
    given = (point, uv, pixel)
    if sum(value is not None for value in given) != 1:
        shown = ", ".join(map(checks.quote, given))
        raise ValueError(f"point, uv, pixel = {shown}: must be one of them, and None the others")
    laser = find_laser(scene)
    apply_meters(scene)
    discard_meter_aims(scene)
    sensors = scene.sensors()
    camera = sensors[checks.integer("sensor", sensor, 0, len(sensors) - 1)]
    if pixel is not None:
        _require_two("pixel", pixel, "its column and row")
        film = camera.film()
        size = film.size()
        x, y = (
            checks.integer(f"pixel {axis}", k, 0, n - 1) + 0.5
            for axis, k, n in zip("xy", pixel, size, strict=True)
        )
        if camera.get_shape() is None:
            crop, offset = film.crop_size(), film.crop_offset()  # Rays are sampled in the window
            sample = mi.Point2f((x - offset.x) / crop.x, (y - offset.y) / crop.y)
            ray, _ = camera.sample_ray(0.0, 0.5, sample, mi.Point2f(0.5))
            si = first_surface(scene, mi.Ray3f(ray))
            if not dr.all(si.is_valid()):
                raise ValueError(f"pixel = {pixel}: sees nothing; must be one that sees a surface")
            target = si.p
        else:
            target = _at_uv(camera, (x / size.x, y / size.y))
    elif uv is not None:
        _require_two("uv", uv, "two numbers from 0 to 1")
        u, v = (checks.number("uv", x, unit="the side") for x in uv)
        if not (0 <= u <= 1 and 0 <= v <= 1):
            raise ValueError(f"uv = {checks.quote(uv)}: must be two numbers from 0 to 1")
        target = _at_uv(camera, (u, v))
    else:
        target = mi.Point3f(*checks.point("point", point))
    aim_laser(laser, target)
    return np.array(target).ravel()


def _require_two(name: str, value: Any, rule: str) -> None:
    """Refuse anything but two values."""
    try:
        count = len(value)
    except TypeError:
        count = 0
    if count != 2:
        raise ValueError(f"{name} = {checks.quote(value)}: must be {rule}")


def _at_uv(camera: mi.Sensor, uv: Any) -> mi.Point3f:
    shape: Any = camera.get_shape()
    if shape is None:
        raise ValueError("uv: the sensor is no child of a wall; must be a point or a pixel")
    return shape.sample_position(0.0, mi.Point2f(*uv), True).p
