"""Problem a3.lens: importance of the camera."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tofrender.paths.sensor_window import Arrival, Window


class Lens(Window):
    """The lens of a `perspective` camera, which is a pinhole.

    `Window` is given, see `help(Window)`. It contains the position of the camera (`position`, and
    the unit vectors `right`, `up`, `axis`), and the part of the plane at distance 1 that the film
    shows (`corner` and `extent`). The sampled part of the film begins at `first` and has `size`
    pixels.

    Attributes:
        area: Area A of the window at distance 1.
    """

    def __init__(self, sensor: mi.Sensor) -> None:
        super().__init__(sensor)
        self.area = mi.Float(1)  # replace this value

    def density(self, d: mi.Vector3f) -> mi.Float:
        """Density p of camera rays through uniform points of the film [1/sr].

        Args:
            d: Unit vectors from the camera, in the window.
        """
        raise NotImplementedError("a3.lens: Lens.density")

    def importance(self, d: mi.Vector3f) -> mi.Float:
        """Importance We, p over the cosine to the axis [1/sr].

        Args:
            d: Unit vectors from the camera, in the window.
        """
        raise NotImplementedError("a3.lens: Lens.importance")

    def sample(self, sampler: mi.Sampler) -> mi.Point3f:
        """A point on the lens; for a pinhole this is always its position."""
        raise NotImplementedError("a3.lens: Lens.sample")

    def arrive(self, p: mi.Point3f, lens: mi.Point3f) -> Arrival:
        """Connect points of the scene to a point on the lens.

        Args:
            p: The points [m]; do not change them.
            lens: The point on the lens, of `sample` [m].

        Returns:
            An `Arrival`, one for each of the points:

            - `lens`: the argument `lens`
            - `near`: intersection of the camera's ray to the point with the near plane, the plane
              at the depth `near_clip` along the axis [m]
            - `direction`: unit vector from the point to the lens
            - `distance`: distance from the point to the lens [m]
            - `position`: position of the point on the film [pixels]; (0, 0) is the corner of the
              first pixel of the whole film, also if the film is cropped
            - `seen`: whether the point is in the window, and its depth along the axis is from
              `near_clip` to `far_clip`; points behind the camera are not
            - `density`: density of the camera's ray to the point, 0 if the point is not `seen`
        """
        raise NotImplementedError("a3.lens: Lens.arrive")
