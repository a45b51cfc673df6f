"""The window of a camera: what of the plane before its lens the film sees.

The film looks through a window in the plane at distance 1 before the lens. The window is that of
the pixels which are sampled: of the crop, and of a filter's border if that is sampled.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.interface import pose
from .camera import sampled_size

KINDS = {"PerspectiveCamera": "perspective", "ThinLensCamera": "thinlens"}


@dataclass
class Arrival:
    """Connection of a point to the lens, one for each lane."""

    lens: mi.Point3f  # the point on the lens [m]
    near: mi.Point3f  # where the camera's ray to the point starts: nothing before it is seen [m]
    direction: mi.Vector3f  # unit vector from the point to the lens
    distance: mi.Float  # between point and lens [m]
    density: mi.Float  # p(ω) of the camera's ray to the point [1/sr], 0 outside of the window
    position: mi.Point2f  # position on the film [pixels]
    seen: mi.Bool  # whether the point is in the window, and between near and far clip


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
            wrong = f"sensor = {kind}: has no lens that light could be connected to"
            raise ValueError(f"{wrong}; must be {' or '.join(KINDS.values())}")
        parameters = mi.traverse(sensor)

        # Frame and position
        to_world = pose(sensor)
        scale = float(np.linalg.norm(to_world[:3, 2]))
        frame = to_world[:3, :3] / np.linalg.norm(to_world[:3, :3], axis=0)
        self.right, self.up, self.axis = (mi.Vector3f(*frame[:, k].tolist()) for k in range(3))
        self.position = mi.Point3f(*to_world[:3, 3].tolist())

        def depth(name: str) -> mi.Float:
            return mi.Float(float(np.ravel(parameters[name])[0]) * scale)

        # Clip planes, and lens
        self.near_clip, self.far_clip = depth("near_clip"), depth("far_clip")
        self.is_thin = kind == "ThinLensCamera"
        self.radius = depth("aperture_radius") if self.is_thin else mi.Float(0)
        self.focus = depth("focus_distance") if self.is_thin else mi.Float(0)
        self._find_window(sensor, sensor.film())
        dr.make_opaque(self.right, self.up, self.axis, self.position, self.near_clip)
        dr.make_opaque(self.far_clip, self.radius, self.focus, self.corner, self.extent)

    def _find_window(self, sensor: mi.Sensor, film: mi.Film) -> None:
        """Find corner and extent of the sampled film in the plane at distance 1, by its rays."""
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

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project points (n, 3) through the middle of the lens [pixels]; NaN if not in front."""
        ahead = mi.Point3f(points.T) - self.position
        across = (mi.Vector2f(*self.plane(ahead)) - self.corner) / self.extent
        seen = dr.dot(ahead, self.axis) > self.near_clip
        return np.array(dr.select(seen, self.first + across * self.size, dr.nan)).T

    def pixels_of(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the first and the last position on the film that sees a box [pixels].

        The box is between two corners in world space [m]; None if part of it is not in front.
        """
        frame = np.array([np.ravel(axis) for axis in (self.right, self.up, self.axis)], float)
        position = np.array(self.position, float).reshape(3, 1)
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, 8)
        x, y, z = frame @ (corners - position)
        if z.min() <= np.ravel(self.near_clip)[0]:
            return None
        radius, focus = (float(np.ravel(each)[0]) for each in (self.radius, self.focus))
        xy = np.stack([x, y])
        across = xy / z
        if self.is_thin:  # Rays of lens points at the edge, where they cross the plane in focus
            crossings = [(lens + (xy - lens) * focus / z) / focus for lens in (-radius, radius)]
            across = np.concatenate(crossings, axis=1)
        window = self.corner, self.extent, self.first, self.size
        corner, extent, first, size = (np.ravel(each).reshape(2, 1) for each in window)
        pixels = first + (across - corner) / extent * size
        return pixels.min(axis=1), pixels.max(axis=1)
