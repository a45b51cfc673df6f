"""The window of a camera: what of the plane before its lens the film sees.

The film looks through a window in the plane at distance 1 before the lens. The window is that of
the pixels which are sampled: of the crop, and of a filter's border if that is sampled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .camera import sampled_size

KINDS = {"PerspectiveCamera": "perspective", "ThinLensCamera": "thinlens"}


@dataclass
class Arrival:
    """Connection of a point to the lens, one for each lane.

    Attributes:
        lens: The point on the lens [m].
        near: Where the camera's ray to the point starts: nothing before it is seen [m].
        direction: Unit vector from the point to the lens.
        distance: Between point and lens [m].
        density: p(ω) of the camera's ray to the point [1/sr], 0 outside of the window.
        position: Where it lands on the film [pixels].
        seen: Whether the point is in the window, and between near and far clip.
    """

    lens: mi.Point3f
    near: mi.Point3f
    direction: mi.Vector3f
    distance: mi.Float
    density: mi.Float
    position: mi.Point2f
    seen: mi.Bool


class Window:
    """Position of a `perspective` or `thinlens` sensor, and the window of its film.

    Args:
        sensor: The camera.

    Raises:
        ValueError: Nothing can connect to the sensor; one line.

    Attributes:
        sensor: The camera.
        position: The middle of the lens [m].
        right, up, axis: Unit vectors: along the film's two sides, and where the camera looks.
        near_clip, far_clip: Depths along the axis between which the camera sees [m].
        is_thin: Whether the lens has an extent.
        radius, focus: Radius of the lens, and the depth of the plane in focus [m]; else 0.
        corner: Where the first sampled pixel's corner is in the plane at distance 1.
        extent: Sides of the window there, along `right` and `up`; they may be negative.
        first: The first sampled pixel's corner on the film [pixels].
        size: Width and height of what is sampled [pixels].
    """

    def __init__(self, sensor: mi.Sensor) -> None:
        self.sensor, kind = sensor, sensor.class_name()
        if kind not in KINDS:
            raise ValueError(
                f"sensor = {kind}: has no lens that light could be connected to; must be "
                f"{' or '.join(KINDS.values())}"
            )
        parameters: Any = mi.traverse(sensor)
        film = sensor.film()
        to_world = np.array(sensor.world_transform().matrix, dtype=float).reshape(4, 4)
        scale = float(np.linalg.norm(to_world[:3, 2]))
        frame = to_world[:3, :3] / np.linalg.norm(to_world[:3, :3], axis=0)
        self.right, self.up, self.axis = (mi.Vector3f(*frame[:, k].tolist()) for k in range(3))
        self.position = mi.Point3f(*to_world[:3, 3].tolist())
        self.near_clip = mi.Float(float(np.ravel(parameters["near_clip"])[0]) * scale)
        self.far_clip = mi.Float(float(np.ravel(parameters["far_clip"])[0]) * scale)
        self.is_thin = kind == "ThinLensCamera"
        self.radius = self.focus = mi.Float(0)
        if self.is_thin:
            self.radius = mi.Float(float(np.ravel(parameters["aperture_radius"])[0]) * scale)
            self.focus = mi.Float(float(np.ravel(parameters["focus_distance"])[0]) * scale)
        self._find_window(sensor, film)
        dr.make_opaque(self.right, self.up, self.axis, self.position, self.near_clip)
        dr.make_opaque(self.far_clip, self.radius, self.focus, self.corner, self.extent)

    def _find_window(self, sensor: mi.Sensor, film: mi.Film) -> None:
        """Corner and extent of the sampled film in the plane at distance 1, by rays through it."""
        width, height = sampled_size(film)
        offset, crop = np.array(film.crop_offset(), float), np.array(film.crop_size(), float)
        border = film.rfilter().border_size() if film.sample_border() else 0
        first = offset - border
        corners = first + np.array([[0, 0], [width, 0], [0, height]])
        uv = mi.Point2f(((corners - offset) / crop).T)
        ray, _ = sensor.sample_ray(0.0, 0.5, uv, mi.Point2f(0.5))
        x, y = (np.array(each, dtype=float).tolist() for each in self.plane(ray.d))
        self.corner = mi.Point2f(x[0], y[0])
        self.extent = mi.Vector2f(x[1] - x[0], y[2] - y[0])
        self.first, self.size = mi.Point2f(*first.tolist()), mi.Vector2f(width, height)

    def plane(self, d: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
        """Intersect a direction from the lens with the plane at distance 1."""
        z = dr.dot(d, self.axis)
        return dr.dot(d, self.right) / z, dr.dot(d, self.up) / z

    def pixels_of(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """First and last position on the film that sees something in a box [pixels].

        Args:
            low: The box's least corner in world space [m].
            high: The opposite one.

        Returns:
            Two arrays (x, y) that bound all its images; None if part of the box is not in front.
        """
        frame, position = (
            np.array(each, dtype=float).reshape(3, -1)
            for each in (
                [np.ravel(axis) for axis in (self.right, self.up, self.axis)],
                np.ravel(self.position),
            )
        )
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, 8)
        x, y, z = frame @ (corners - position)
        if z.min() <= np.ravel(self.near_clip)[0]:
            return None
        radius, focus = (float(np.ravel(each)[0]) for each in (self.radius, self.focus))
        across = np.concatenate(
            [
                # Lens points at the edge, and where their rays cross the plane in focus
                (lens + (np.stack([x, y]) - lens) * focus / z) / focus
                for lens in (-radius, radius)
            ]
            if self.is_thin
            else [np.stack([x, y]) / z],
            axis=1,
        )
        corner, extent, first, size = (
            np.ravel(each).reshape(2, 1)
            for each in (self.corner, self.extent, self.first, self.size)
        )
        pixels = first + (across - corner) / extent * size
        return pixels.min(axis=1), pixels.max(axis=1)
