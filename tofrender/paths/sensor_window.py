"""Window of a camera: the rectangle in front of the lens that the film sees.

The window is in the plane at distance 1 in front of the lens. It contains all sampled pixels: the
crop, and the border of the reconstruction filter if the film samples the border.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.interface import pose
from .camera import sampled_size

# Class name of supported sensors -> name of the plugin
KINDS = {"PerspectiveCamera": "perspective", "ThinLensCamera": "thinlens"}


@dataclass
class Arrival:
    """Connection of a point to the lens, one per lane."""

    # Point on the lens [m]
    lens: mi.Point3f

    # Start of the camera ray to the point [m]. The camera does not see points between the lens and
    # this start
    near: mi.Point3f

    # Unit vector from the point to the lens, in world space
    direction: mi.Vector3f

    # Distance between point and lens [m]
    distance: mi.Float

    # Density p(ω) of the camera ray to the point [1/sr], 0 outside of the window
    density: mi.Float

    # Position on the film [pixels]
    position: mi.Point2f

    # Lanes in which the point is in the window, and between near and far clip
    seen: mi.Bool


class Window:
    """Pose of a `perspective` or `thinlens` sensor, and the window of its film.

    Args:
        sensor: The camera.

    Raises:
        ValueError: The sensor is not supported.

    Attributes:
        sensor: The camera.
        position: Center of the lens [m].
        right, up, axis: Unit vectors in world space: along the sides of the film, and along the
            viewing direction.
        near_clip, far_clip: Smallest and largest depth along the axis that the camera sees [m].
        is_thin: Whether the lens has an extent.
        radius, focus: Radius of the lens, and depth of the plane in focus [m]. Both are 0 without
            an extent.
        corner: Position of the first sampled pixel's corner in the plane at distance 1.
        extent: Width and height of the window in this plane, along `right` and `up`. Both may be
            negative.
        first: Corner of the first sampled pixel on the film [pixels].
        size: Width and height of the sampled area [pixels].
    """

    def __init__(self, sensor: mi.Sensor) -> None:
        self.sensor = sensor
        kind = sensor.class_name()
        if kind not in KINDS:
            raise ValueError(
                f"sensor {kind} is not supported for connections to the lens. Use a "
                f"{' or '.join(KINDS.values())} sensor"
            )
        parameters = mi.traverse(sensor)

        # Pose of the camera, and the scale of its depths
        to_world = pose(sensor)
        scale = float(np.linalg.norm(to_world[:3, 2]))
        frame = to_world[:3, :3] / np.linalg.norm(to_world[:3, :3], axis=0)
        self.right = mi.Vector3f(*frame[:, 0].tolist())
        self.up = mi.Vector3f(*frame[:, 1].tolist())
        self.axis = mi.Vector3f(*frame[:, 2].tolist())
        self.position = mi.Point3f(*to_world[:3, 3].tolist())

        def depth(name: str) -> mi.Float:
            return mi.Float(float(np.ravel(parameters[name])[0]) * scale)

        # Clip planes, and lens
        self.near_clip = depth("near_clip")
        self.far_clip = depth("far_clip")
        self.is_thin = kind == "ThinLensCamera"
        self.radius = depth("aperture_radius") if self.is_thin else mi.Float(0)
        self.focus = depth("focus_distance") if self.is_thin else mi.Float(0)

        # Window of the film. Opaque numbers give one kernel for all cameras
        self._find_window(sensor, sensor.film())
        dr.make_opaque(self.right, self.up, self.axis, self.position, self.near_clip)
        dr.make_opaque(self.far_clip, self.radius, self.focus, self.corner, self.extent)

    def _find_window(self, sensor: mi.Sensor, film: mi.Film) -> None:
        """Set corner and extent of the window, and position and size of the sampled area.

        Camera rays through three corners of the sampled area show the window.
        """
        # Corners of the sampled area on the film [pixels]
        width, height = sampled_size(film)
        offset = np.array(film.crop_offset(), float)
        crop = np.array(film.crop_size(), float)
        border = film.rfilter().border_size() if film.sample_border() else 0
        first = offset - border
        corners = first + np.array([[0, 0], [width, 0], [0, height]])

        # Intersect their rays with the plane at distance 1
        uv = mi.Point2f(((corners - offset) / crop).T)
        ray, _ = sensor.sample_ray(0.0, 0.5, uv, mi.Point2f(0.5))
        x, y = (np.array(each, dtype=float).tolist() for each in self.plane(ray.d))
        self.corner = mi.Point2f(x[0], y[0])
        self.extent = mi.Vector2f(x[1] - x[0], y[2] - y[0])
        self.first = mi.Point2f(*first.tolist())
        self.size = mi.Vector2f(width, height)

    def plane(self, d: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
        """Intersect a direction from the center of the lens with the plane at distance 1.

        Returns the coordinates along `right` and `up`.
        """
        z = dr.dot(d, self.axis)
        return dr.dot(d, self.right) / z, dr.dot(d, self.up) / z

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project points through the center of the lens.

        Returns positions on the film [pixels], of shape (n, 2). They are NaN for points that are
        not farther away than the near clip.

        Args:
            points: Points in world space [m], of shape (n, 3).
        """
        ahead = mi.Point3f(points.T) - self.position
        across = (mi.Vector2f(*self.plane(ahead)) - self.corner) / self.extent
        seen = dr.dot(ahead, self.axis) > self.near_clip
        return np.array(dr.select(seen, self.first + across * self.size, dr.nan)).T

    def pixels_of(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return a rectangle on the film that contains all pixels that see a box.

        Returns the smallest and the largest position [pixels], or None if a part of the box is
        closer than the near clip.

        Args:
            low: Corner of the box with the smallest coordinates, in world space [m].
            high: Corner of the box with the largest coordinates [m].
        """
        # Corners of the box in the frame of the camera
        frame = np.array([np.ravel(axis) for axis in (self.right, self.up, self.axis)], float)
        position = np.array(self.position, float).reshape(3, 1)
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, 8)
        x, y, z = frame @ (corners - position)
        if z.min() <= np.ravel(self.near_clip)[0]:
            return None

        # Project the corners to the plane at distance 1
        radius = float(np.ravel(self.radius)[0])
        focus = float(np.ravel(self.focus)[0])
        xy = np.stack([x, y])
        across = xy / z
        # With a lens, project through points at its edge, by way of the plane in focus
        if self.is_thin:
            crossings = [(lens + (xy - lens) * focus / z) / focus for lens in (-radius, radius)]
            across = np.concatenate(crossings, axis=1)

        # Convert to positions on the film
        corner = np.ravel(self.corner).reshape(2, 1)
        extent = np.ravel(self.extent).reshape(2, 1)
        first = np.ravel(self.first).reshape(2, 1)
        size = np.ravel(self.size).reshape(2, 1)
        pixels = first + (across - corner) / extent * size
        return pixels.min(axis=1), pixels.max(axis=1)
