"""Sensor of a scanning lidar: each pixel of a film is a shot."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .beam import sample_cone


class Scanner:
    """Samples rays of shots, as `sample_camera` asks a sensor for them.

    Args:
        origin: Where all shots start [m].
        axes: Unit vectors of the shots, world space, shape (shots, 3).
        half_angle: Of the cone around each axis [rad].
        size: Columns and rows of the film; pixels behind the last shot repeat it.
    """

    looks_at_pixel_centers = True

    def __init__(
        self, origin: mi.Point3f, axes: np.ndarray, half_angle: float, size: tuple[int, int]
    ) -> None:
        self.origin, self.axes = origin, mi.Vector3f(axes.T.copy())
        self.half_angle, self.size = half_angle, size

    def sample_ray_differential(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f
    ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """Sample a ray in the cone of the shot at a film position; `d_x` is the cone's axis."""
        columns, rows = self.size
        shot = mi.UInt32(sample2.y * rows) * columns + mi.UInt32(sample2.x * columns)
        axis = dr.gather(mi.Vector3f, self.axes, dr.minimum(shot, dr.width(self.axes) - 1))
        wavelengths, weight = [], mi.Spectrum(1)
        if mi.is_spectral:
            wavelengths, weight = mi.sample_rgb_spectrum(mi.sample_shifted(sample1))
        d = sample_cone(axis, sample3, self.half_angle)
        ray = mi.RayDifferential3f(self.origin, d, time, wavelengths)
        ray.d_x = axis
        return ray, weight

    def needs_aperture_sample(self) -> bool:
        """Whether rays need `sample3`: for the cone."""
        return True

    def shutter_open(self) -> float:
        """Time at which the shutter opens [s]."""
        return 0.0

    def shutter_open_time(self) -> float:
        """Time for which it is open [s]."""
        return 0.0

    def class_name(self) -> str:
        """Name by which kinds of sensors are told apart."""
        return "Scanner"
