# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportReturnType=false
"""The camera as what light arrives at: its lens, its importance, and where light lands on the film.

The film looks through a window of area A in the plane at distance 1 before the lens. Rays through
points that are even on the film have the solid-angle density

    p(ω) = 1 / (A cos³θ)            θ: angle between the ray and the axis

and the importance We = p / cosθ (over the area of the lens, if it has one), whose integral over
directions, cosine and lens is 1: a film pixel is the mean of what arrives on it. The window is
that of the pixels which are sampled: of the crop, and of a filter's border if that is sampled.
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
    """Where a point is connected to the lens, one for each lane.

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


class Lens:
    """The lens of a `perspective` or `thinlens` sensor.

    Args:
        sensor: The camera.

    Raises:
        ValueError: Nothing can connect to the sensor; one line.
    """

    def __init__(self, sensor: mi.Sensor) -> None:
        kind = sensor.class_name()
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
        dr.make_opaque(self.far_clip, self.radius, self.focus, self.corner, self.extent, self.area)

    def _find_window(self, sensor: mi.Sensor, film: mi.Film) -> None:
        """Corner and extent of the sampled film in the plane at distance 1, by rays through it."""
        width, height = sampled_size(film)
        offset, crop = np.array(film.crop_offset(), float), np.array(film.crop_size(), float)
        border = film.rfilter().border_size() if film.sample_border() else 0
        first = offset - border
        corners = first + np.array([[0, 0], [width, 0], [0, height]])
        uv = mi.Point2f(((corners - offset) / crop).T)
        ray, _ = sensor.sample_ray(0.0, 0.5, uv, mi.Point2f(0.5))
        x, y = (np.array(each, dtype=float).tolist() for each in self._plane(ray.d))
        self.corner = mi.Point2f(x[0], y[0])
        self.extent = mi.Vector2f(x[1] - x[0], y[2] - y[0])
        self.area = mi.Float(abs((x[1] - x[0]) * (y[2] - y[0])))
        self.first, self.size = mi.Point2f(*first.tolist()), mi.Vector2f(width, height)

    def _plane(self, d: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
        """Where a direction from the lens meets the plane at distance 1."""
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

    def density(self, d: mi.Vector3f) -> mi.Float:
        """Density p(ω) of a camera ray's direction, which is in the window [1/sr]."""
        cos = dr.abs(dr.dot(d, self.axis))
        return dr.rcp(self.area * cos * cos * cos)

    def sample(self, sampler: mi.Sampler) -> mi.Point3f:
        """A point on the lens, even in area; of a pinhole the only one, and no random number."""
        if not self.is_thin:
            return self.position
        disk = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d()) * self.radius
        return self.position + self.right * disk.x + self.up * disk.y

    def arrive(self, p: mi.Point3f, lens: mi.Point3f, distant: mi.Bool | bool = False) -> Arrival:
        """Connect points to a point on the lens; `distant` ones are behind any clip."""
        to_point = p - lens
        distance = dr.norm(to_point)
        d = to_point / distance
        cos, depth = dr.dot(d, self.axis), dr.dot(to_point, self.axis)
        # A lens point sees what the middle sees where the ray crosses the plane in focus
        offset = mi.Vector3f(lens - self.position) if self.is_thin else mi.Vector3f(0)
        crossing = offset + d * (self.focus / cos)
        x, y = self._plane(crossing) if self.is_thin else self._plane(d)
        share = (mi.Point2f(x, y) - self.corner) / self.extent
        seen = (cos > 0) & (distant | ((depth >= self.near_clip) & (depth <= self.far_clip)))
        seen &= dr.all((share >= 0) & (share < 1))
        return Arrival(
            lens=mi.Point3f(lens),
            near=lens + d * (self.near_clip / cos),
            direction=-d,
            distance=distance,
            density=dr.select(seen, self.density(d), 0),
            position=self.first + share * self.size,
            seen=seen,
        )
