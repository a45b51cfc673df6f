"""Records of emitter samples, and the base class of shapes that emit."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..signals.color import LUMINANCE


@dataclass
class EmitterRecord:
    """One direction from a reference point, and the light that arrives from this direction.

    Attributes:
        o: Reference point, which is lit.
        p: Emitting point: the first point of the shape or group in this direction.
        n: Unit normal at `p`, on the emitting side.
        d: Unit vector from `o` to `p`.
        distance: Distance from `o` to `p` [m].
        pdf: Density of `d` [1/sr].
        radiance: Radiance from `p` towards `o`; 0 on the dark side.
        weight: radiance / pdf.
        valid: Lanes that hit the shape. In other lanes, pdf, radiance and weight are 0.
    """

    o: mi.Point3f
    p: mi.Point3f
    n: mi.Vector3f
    d: mi.Vector3f
    distance: mi.Float
    pdf: mi.Float
    radiance: mi.UnpolarizedSpectrum
    weight: mi.UnpolarizedSpectrum
    valid: mi.Bool


class Shape(ABC):
    """Base class of shapes that can be sampled. Subclasses define `sample` and `record`."""

    area: float
    emission: tuple[float, ...]

    @abstractmethod
    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """Sample a direction from `o` towards the shape, with its density per solid angle.

        In debug mode, a sample outside of the unit square raises an AssertionError.
        """

    @abstractmethod
    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Return the first hit from `o` along `v`, with the density of `sample` there."""

    def pdf(self, o: mi.Point3f, v: mi.Vector3f) -> mi.Float:
        """Return the density of `sample` from `o` in the direction `v` [1/sr], 0 without a hit."""
        return self.record(o, v).pdf

    def intersect(self, o: mi.Point3f, v: mi.Vector3f) -> tuple[mi.Float, mi.Bool, mi.Vector3f]:
        """Intersect a ray from `o` along `v` with the shape. Both sides of a surface are hit.

        Returns:
            The distance of the first hit [m], the mask of hits, and the normal.
        """
        record = self.record(o, v)
        return record.distance, record.valid, record.n

    @property
    def is_emissive(self) -> bool:
        """Return whether any channel of the emission is above 0."""
        return any(each > 0 for each in self.emission)

    def filled(
        self,
        o: mi.Point3f,
        p: mi.Point3f,
        n: mi.Vector3f,
        d: mi.Vector3f,
        distance: mi.Float,
        pdf: mi.Float,
        valid: mi.Bool,
    ) -> EmitterRecord:
        """Complete a hit to a record, with radiance on the side of the normal, and weight.

        Args:
            o: Reference point.
            p: Hit point.
            n: Unit normal at the hit point.
            d: Direction from `o` to `p`.
            distance: Distance from `o` to `p` [m].
            pdf: Density of the direction [1/sr].
            valid: Mask of hits.
        """
        valid &= (pdf > 0) & dr.isfinite(pdf)
        radiance = dr.select(valid & (dr.dot(n, d) < 0), spectrum(self.emission), 0)
        pdf = dr.select(valid, pdf, 0)
        weight = dr.select(valid, radiance / pdf, 0)

        # Convert to the types of the record
        return EmitterRecord(
            o=mi.Point3f(o),
            p=mi.Point3f(p),
            n=mi.Vector3f(n),
            d=mi.Vector3f(d),
            distance=distance,
            pdf=pdf,
            radiance=radiance,
            weight=weight,
            valid=valid,
        )


def visible(
    scene: mi.Scene | Shape, record: EmitterRecord, n: mi.Vector3f | None = None
) -> mi.Bool:
    """Return whether the shadow ray from `record.o` to the light at `record.p` is unoccluded.

    The shadow ray ends Mitsuba's shadow epsilon (0.09 % of the distance) before the light, so that
    the light does not occlude itself. Another light in front of it does. The result is false in
    lanes without a valid record.

    Args:
        scene: An `mi.Scene`, with or without the light itself, or a shape or group.
        record: Records.
        n: Normal of the surface at `record.o`. The shadow ray is offset along this normal, like all
            rays in Mitsuba. Without a normal, the ray is offset along its own direction, which may
            be too little for rays at grazing angles.

    Example:
        >>> from tofrender.sampling import Sphere, SurfaceGroup
        >>> lamp, moon = Sphere((0, 0, 1), 0.1), Sphere((0, 0, 9), 3)
        >>> record = moon.sample(mi.Point3f(0, 0, 0), mi.Point2f([0, 1], 0))
        >>> visible(SurfaceGroup([lamp, moon]), record), visible(moon, record)
        ([False, True], [True, True])
    """
    checks.instance("scene", scene, mi.Scene | Shape, "a loaded scene or a shape of sampling")
    checks.instance("record", record, EmitterRecord, "a record of a shape's sample")
    if n is not None and (not dr.is_array_v(n) or dr.size_v(n) != 3):
        raise ValueError(f"n = {checks.quote(n)}: must be an mi.Vector3f or None")

    # Trace the shadow ray
    normal = record.d if n is None else n
    start = mi.Interaction3f(0, 0, mi.Color0f(), record.o, normal)
    ray = start.spawn_ray_to(record.p)
    if isinstance(scene, Shape):
        distance, hit, _ = scene.intersect(ray.o, ray.d)
        blocked = hit & (distance < ray.maxt)
    else:
        blocked = scene.ray_test(ray, record.valid)
    return record.valid & ~blocked


def emission_values(emission: Any) -> tuple[float, ...]:
    """Return an emission, one or three numbers, as a tuple of finite numbers >= 0."""
    try:
        numbers = np.atleast_1d(np.squeeze(checks.real_array("", emission, np.float64)))
    except ValueError:
        numbers = np.array([math.nan])
    right = numbers.shape in ((1,), (3,)) and np.all(np.isfinite(numbers) & (numbers >= 0))
    checks.require("emission", emission, right, "one number or three, each finite and 0 or more")
    return tuple(numbers.tolist())


def spectrum(emission: tuple[float, ...]) -> mi.UnpolarizedSpectrum:
    """Convert an emission to the color representation of the active variant."""
    checks.require("variant", mi.variant(), not mi.is_spectral, "an rgb or mono variant")
    if mi.is_monochromatic and len(emission) == 3:
        emission = (float(LUMINANCE @ emission),)
    return mi.UnpolarizedSpectrum(*emission)


def affine(transform: Any) -> np.ndarray:
    """Return a transform as a 4 x 4 array, float64. None is the identity."""
    matrix: Any = np.eye(4) if transform is None else getattr(transform, "matrix", transform)
    try:
        matrix = checks.real_array("", matrix, np.float64)
    except ValueError:
        matrix = np.empty(0)
    # An mi.Transform4f has one lane
    matrix = matrix[..., 0] if matrix.shape == (4, 4, 1) else matrix
    right = matrix.shape == (4, 4) and np.all(np.isfinite(matrix))
    right = right and np.array_equal(matrix[3], [0, 0, 0, 1])
    allowed = "None, an mi.ScalarTransform4f or 4 x 4 finite numbers, the last row 0, 0, 0, 1"
    checks.require("transform", transform, right, allowed)
    return matrix
