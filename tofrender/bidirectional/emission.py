"""Emission sampling: rays that start at emitters, and their densities.

Emitters are chosen with the probabilities of next-event estimation. Emitters with the
`sampling_weight` 0 are chosen too if paths can hit them. A ray of light starts as follows:

| emitter | position | direction |
|---|---|---|
| `area` | uniform point of the shape | proportional to the cosine with the normal |
| `directionalarea` | uniform point of the shape | the normal |
| `point`, `spot`, `projector` | position of the emitter | uniform in the cone of lit directions |
| `directional` | uniform point of a disk across the scene | direction of the emitter |
| `constant`, `envmap`, skies | uniform point of a disk | sampled by the emitter |

The disk touches the sphere around scene and sensor, where distant light starts. Paths from the
sensor use the same sphere, see `Wavefronts`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from ..paths.surfaces import EmitterSamples, number_of, table_of
from ..paths.wavefronts import Wavefronts
from ..runtime.interface import pose

CONES = {"PointLight": "point", "SpotLight": "spot", "Projector": "projector"}
SHAPES = {"AreaLight": "area"}
BEAMS = {"DirectionalArea": "directionalarea"}
DISTANT = {
    "DirectionalEmitter": "directional",
    "ConstantBackgroundEmitter": "constant",
    "EnvironmentMapEmitter": "envmap",
    "SunskyEmitter": "sunsky",
}
# Emitters where light paths may start: class names, and plugin names
KINDS = CONES | SHAPES | BEAMS | DISTANT


@dataclass
class Emitted:
    """Rays that start at emitters, one for each lane."""

    # Ray of light
    ray: mi.Ray3f

    # Start of the ray, where path lengths are 0 [m]
    origin: mi.Point3f

    # Emitter
    emitter: mi.EmitterPtr

    # Emitted radiance times cosine over density
    weight: mi.UnpolarizedSpectrum

    # Density of point and direction, including the probability of the emitter
    density: mi.Float

    # Lanes with light that camera paths cannot hit
    delta: mi.Bool

    # Lanes with light
    active: mi.Bool

    # Normal of the emitter, 0 for emitters without a surface
    normal: mi.Normal3f = field(default_factory=lambda: mi.Normal3f(0))

    # Surface parameters of the start
    uv: mi.Point2f = field(default_factory=lambda: mi.Point2f(0))

    # Cosine between ray and normal, 1 for emitters without a surface
    cos: mi.Float = field(default_factory=lambda: mi.Float(1))


class Emission:
    """The emitters of a scene as the start of light paths.

    Args:
        scene: The scene.
        sensor: The sensor. Distant light starts on a sphere around scene and sensor.

    Raises:
        ValueError: If emitters are missing, or an emitter is not supported.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor) -> None:
        # Refuse emitters that are not supported
        emitters = scene.emitters()
        if not emitters:
            raise ValueError("scene: emitter is missing. Add one, for example a point light")
        kinds = [emitter.class_name() for emitter in emitters]
        allowed = allowed_kinds()
        for emitter, kind in zip(emitters, kinds, strict=True):
            if kind not in allowed:
                raise ValueError(
                    f"emitter {emitter.id()!r}: light paths from {KINDS.get(kind, kind)} are not "
                    f"supported. Use {', '.join(allowed.values())}"
                )
        self.scene = scene
        self.samples = EmitterSamples(scene)

        # The sphere and the disk where distant light starts
        self.sphere = Wavefronts.around(scene, sensor)
        self.cross_section = dr.pi * self.sphere.radius * self.sphere.radius

        # Which groups of emitters exist? Unused techniques are not compiled
        self.pointers = scene.emitters_dr()
        self.has_cones, self.has_shapes, self.has_beams, self.has_distant = (
            any(kind in group for kind in kinds) for group in (CONES, SHAPES, BEAMS, DISTANT)
        )

        # Tables of cones, areas and probabilities
        self.cones = _cones(emitters)
        self.by_area = _inverse_areas(emitters)
        self.total = dr.opaque(mi.Float, sum(float(e.sampling_weight()) for e in emitters))
        self.distribution, self.pmf_ratio, self.unweighted_pmf = _probabilities(emitters)

        # Shapes of area lights, with an index for each emitter
        area_lights = [e for e in emitters if e.class_name() in SHAPES]
        self.shapes = [emitter.get_shape() for emitter in area_lights]
        self.shape_index = mi.UInt32(table_of(area_lights, range(len(area_lights)), np.uint32))
        dr.eval(self.pointers, self.cones, self.by_area, self.shape_index)
        dr.eval(self.pmf_ratio, self.unweighted_pmf)
        dr.make_opaque(self.cross_section)

    # --------------------- Sampling ---------------------

    def sample(self, sampler: mi.Sampler, ray: mi.Ray3f) -> Emitted:
        """Sample a ray of light with the wavelengths and the time of a camera ray."""
        xi = sampler.next_1d()
        u_point = sampler.next_2d()
        u_direction = sampler.next_2d()
        return self.sample_at(xi, u_point, u_direction, ray)

    def sample_at(
        self, xi: mi.Float, u_point: mi.Point2f, u_direction: mi.Point2f, ray: mi.Ray3f
    ) -> Emitted:
        """Sample as `sample` does, with uniform numbers for emitter, point and direction."""
        # Choose an emitter
        if self.distribution is None:
            index, inverse_pmf, _ = self.scene.sample_emitter(xi)
        else:
            index, pmf = self.distribution.sample_pmf(xi)
            inverse_pmf = dr.rcp(pmf)

        # Sample point and direction by the technique of each group of emitters
        emitter = dr.gather(mi.EmitterPtr, self.pointers, index)
        flags = emitter.flags()
        delta_direction = mi.has_flag(flags, mi.EmitterFlags.DeltaDirection)
        surface = mi.has_flag(flags, mi.EmitterFlags.Surface)
        techniques = [
            (self.has_cones, mi.has_flag(flags, mi.EmitterFlags.DeltaPosition), self._from_cone),
            (self.has_shapes, surface & ~delta_direction, self._from_shape),
            (self.has_beams, surface & delta_direction, self._from_beam),
            (self.has_distant, mi.has_flag(flags, mi.EmitterFlags.Infinite), self._from_distant),
        ]
        start = None
        for exists, here, sample in techniques:
            if exists:
                emitted = sample(emitter, u_point, u_direction, ray, here)
                start = emitted if start is None else dr.select(here, emitted, start)

        # Divide by the probability of the emitter
        assert start is not None
        start.weight = start.weight * inverse_pmf
        start.density = start.density / inverse_pmf
        start.active = dr.isfinite(start.density) & dr.any(start.weight > 0)
        return start

    def sample_direction(
        self, at: mi.Interaction3f, u: mi.Point2f
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction towards an emitter, with the probabilities of emission sampling.

        Args:
            at: The reference point.
            u: Random numbers.

        Returns:
            The direction sample and its weight.
        """
        if self.distribution is None:
            return self.samples.sample_direction(at, u)
        index, x, pmf = self.distribution.sample_reuse_pmf(u.x)
        emitter = dr.gather(mi.EmitterPtr, self.pointers, index)
        u = mi.Point2f(x, u.y)
        ds, radiance = self.samples.sample_emitter(emitter, at, u)
        ds.pdf *= pmf
        return ds, radiance / pmf

    def _from_cone(self, emitter, u_point, u, like, active) -> Emitted:
        """Sample a uniform direction in the cone of a point emitter."""
        # Sample the height on the unit sphere uniformly, which is precise for narrow cones
        cone = self._cone(emitter, active)
        p = mi.Point3f(*cone[:3])
        size = cone[6]
        height = u.x * size
        radius = dr.safe_sqrt(height * (2 - height))
        sine, cosine = dr.sincos(2 * dr.pi * u.y)
        local = mi.Vector3f(radius * cosine, radius * sine, 1 - height)
        d = mi.Frame3f(mi.Vector3f(*cone[3:6])).to_world(local)

        # Evaluate the intensity at a distance of 1
        at = _interaction(p + d, like)
        _, intensity = emitter.sample_direction(at, mi.Point2f(0.5), active)
        return Emitted(
            ray=mi.Ray3f(p, d, like.time, like.wavelengths),
            origin=p,
            emitter=emitter,
            weight=mi.unpolarized_spectrum(intensity) * (2 * dr.pi * size),
            density=dr.rcp(2 * dr.pi * size),
            delta=mi.Bool(True),
            active=mi.Bool(active),
        )

    def _from_shape(self, emitter, u_point, u, like, active) -> Emitted:
        """Sample a uniform point of an area light, and a direction proportional to the cosine."""
        # Sample position and direction
        ps = self._point_on(emitter, like.time, u_point, active)
        local = mi.warp.square_to_cosine_hemisphere(u)
        n = mi.Normal3f(ps.n)

        # Correct the normal of some shapes. Directions below the surface are dark
        if self.samples.exist:
            n, _ = self.samples.at(emitter, like.time, u_point, ps.n, active)
            active &= dr.dot(ps.n, mi.Frame3f(n).to_world(local)) > 0

        # Evaluate the radiance
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
        si.p = ps.p
        si.n = n
        si.uv = ps.uv
        si.shape = emitter.get_shape()
        si.sh_frame = mi.Frame3f(n)
        si.wi = local
        si.time = like.time
        si.wavelengths = like.wavelengths
        radiance = mi.unpolarized_spectrum(emitter.eval(si, active))
        return Emitted(
            ray=si.spawn_ray(si.to_world(local)),
            origin=ps.p,
            normal=n,
            uv=ps.uv,
            emitter=emitter,
            weight=radiance * dr.select(ps.pdf > 0, dr.pi / ps.pdf, 0),
            cos=local.z,
            density=ps.pdf * local.z * dr.inv_pi,
            delta=mi.Bool(False),
            active=mi.Bool(active),
        )

    def _point_on(self, emitter, time, u, active) -> mi.PositionSample3f:
        """Sample a uniform point on an emitter's shape.

        A call through a shape pointer would compile the method of all shapes in memory, and
        instances cannot be sampled. Mitsuba's method of the emitter samples bright parts of a
        texture more often, which the other strategies do not.
        """
        sample = [each.sample_position for each in self.shapes]
        if len(sample) == 1:
            return sample[0](time, u, active)
        which = dr.gather(mi.UInt32, self.shape_index, number_of(emitter), active)
        return dr.switch(which, sample, time, u, active)

    def _from_beam(self, emitter, u_point, u, like, active) -> Emitted:
        """Sample a uniform point on a surface that emits along its normal."""
        ray, weight = emitter.sample_ray(like.time, mi.Float(0), u_point, u, active)
        return Emitted(
            ray=ray,
            origin=mi.Point3f(ray.o),
            normal=mi.Normal3f(ray.d),
            emitter=emitter,
            weight=mi.unpolarized_spectrum(weight),
            density=dr.rcp(emitter.get_shape().surface_area()),
            delta=mi.Bool(True),
            active=mi.Bool(active),
        )

    def _from_distant(self, emitter, u_point, u, like, active) -> Emitted:
        """Sample a direction of a distant emitter, and a uniform point of the disk."""
        # Sample a direction
        sphere = self.sphere
        at = _interaction(sphere.center, like)
        ds, radiance = emitter.sample_direction(at, u, active)

        # Sample a point of the disk, which touches the sphere
        disk = mi.warp.square_to_uniform_disk_concentric(u_point) * sphere.radius
        across = mi.Frame3f(ds.d).to_world(mi.Vector3f(disk.x, disk.y, sphere.radius))
        p = mi.Point3f(sphere.center + across)
        return Emitted(
            ray=mi.Ray3f(p, -ds.d, like.time, like.wavelengths),
            origin=p,
            emitter=emitter,
            weight=mi.unpolarized_spectrum(radiance) * self.cross_section,
            density=ds.pdf / self.cross_section,
            delta=mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaDirection),
            active=mi.Bool(active),
        )

    # --------------------- Densities ---------------------

    def ratio(
        self, emitter: mi.EmitterPtr, ds: mi.DirectionSample3f, pdf: mi.Float, distance: mi.Float
    ) -> mi.Float:
        """Return the density of a connection to an emitter, relative to the density of emission.

        Let p_c be the density of the connection per area, and p_e the density of emission at the
        same point in the direction of the connection. Both include the probability of the emitter.
        The result is distance² p_c / p_e. For distant light, p_c is the density per solid angle,
        and the result is p_c / p_e.

        Args:
            emitter: The emitters.
            ds: Direction samples of the connections.
            pdf: Solid-angle densities of the connections [1/sr].
            distance: Lengths of the connections [m].
        """
        flags = emitter.flags()
        ratio = mi.Float(0)

        # Point emitters: uniform in their cone
        if self.has_cones:
            here = mi.has_flag(flags, mi.EmitterFlags.DeltaPosition)
            solid_angle = 2 * dr.pi * self._cone(emitter, here)[6]
            ratio = dr.select(here, solid_angle * distance * distance, ratio)

        # Area lights: uniform by area, proportional to the cosine
        if self.has_shapes:
            here = mi.has_flag(flags, mi.EmitterFlags.Surface)
            pmf = emitter.sampling_weight() / self.total
            by_area = pmf * dr.gather(mi.Float, self.by_area, number_of(emitter), here)
            ratio = dr.select(here & (by_area > 0), dr.pi * pdf / by_area, ratio)

        # Distant emitters: the same direction, uniform on the disk
        if self.has_distant:
            here = mi.has_flag(flags, mi.EmitterFlags.Infinite)
            ratio = dr.select(here, self.cross_section, ratio)

        # Correct for different probabilities of emitters
        if self.distribution is not None:
            ratio *= dr.gather(mi.Float, self.pmf_ratio, number_of(emitter))
        return ratio

    def density(
        self, ref: mi.Interaction3f, ds: mi.DirectionSample3f, pdf: mi.Float, distance: mi.Float
    ) -> mi.Float:
        """Return the density of emission at a point that a ray has hit.

        The result is p_e / distance², and p_e for distant light (see `ratio`).

        Args:
            ref: Origin of the ray.
            ds: Direction samples towards the point.
            pdf: Solid-angle densities of next-event estimation [1/sr].
            distance: Lengths of the rays [m].
        """
        # Emitters that next-event estimation samples
        ratio = self.ratio(ds.emitter, ds, pdf, distance)
        density = dr.select(ratio > 0, pdf / ratio, 0)

        # Emitters with the sampling weight 0
        if self.distribution is not None:
            row = number_of(ds.emitter)
            pmf = dr.gather(mi.Float, self.unweighted_pmf, row)
            surface = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Surface)
            by_area = dr.gather(mi.Float, self.by_area, row, surface) * dr.inv_pi
            by_direction = ds.emitter.pdf_direction(ref, ds, ~surface) / self.cross_section
            unweighted = pmf * dr.select(surface, by_area, by_direction)
            density = dr.select(pmf > 0, unweighted, density)
        return density

    def _cone(self, emitter: mi.EmitterPtr, active: mi.Bool) -> list[mi.Float]:
        """Return apex (3), axis (3) and height (1) of an emitter's cone."""
        row = number_of(emitter) * 7
        return [dr.gather(mi.Float, self.cones, row + k, active) for k in range(7)]


def allowed_kinds() -> dict[str, str]:
    """Return the emitters where light paths may start in the active variant, as in `KINDS`."""
    return KINDS if not mi.is_spectral else CONES | SHAPES | DISTANT


def _interaction(p: mi.Point3f, like: mi.Ray3f) -> mi.Interaction3f:
    """Return a point with the wavelengths and the time of a ray."""
    at = dr.zeros(mi.Interaction3f, dr.width(p))
    at.p = mi.Point3f(p)
    at.time = like.time
    at.wavelengths = like.wavelengths
    return at


def _probabilities(
    emitters: list[mi.Emitter],
) -> tuple[mi.DiscreteDistribution | None, mi.Float, mi.Float]:
    """Return the probabilities of emission sampling.

    Returns:
        The distribution over emitters, or None if it only depends on the sampling weights. A table
        of the probability of next-event estimation, relative to this distribution. A table of the
        probability of emitters with the sampling weight 0.
    """
    # Emitters with the weight 0 that paths can hit
    weights = np.array([float(emitter.sampling_weight()) for emitter in emitters])
    hit = [not mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta) for emitter in emitters]
    unsampled = (weights == 0) & hit
    if not unsampled.any():
        return None, mi.Float(1), mi.Float(0)

    # They get the mean weight of the other emitters
    mean = weights.sum() / max(np.count_nonzero(weights), 1) or 1
    completed = np.where(unsampled, mean, weights)
    total = completed.sum()
    ratio = total / (weights.sum() or 1) * (weights > 0)
    tables = (table_of(emitters, v, np.float32) for v in (ratio, unsampled * completed / total))
    return mi.DiscreteDistribution(mi.Float(completed)), *map(mi.Float, tables)


def _cones(emitters: list[mi.Emitter]) -> mi.Float:
    """Return a table of the emitters' cones: apex [m], axis, and height on the unit sphere."""
    rows = np.zeros((len(emitters), 7))
    for row, emitter in zip(rows, emitters, strict=True):
        if emitter.class_name() in CONES:
            frame = pose(emitter)
            parameters = mi.traverse(emitter)
            apex = parameters["position"] if "position" in parameters else frame[:3, 3]
            axis = frame[:3, 2] / np.linalg.norm(frame[:3, 2])
            row[:] = [*np.ravel(np.array(apex)), *axis, 1 - math.cos(_half_angle(emitter))]
    return mi.Float(table_of(emitters, rows, np.float32).ravel())


def _inverse_areas(emitters: list[mi.Emitter]) -> mi.Float:
    """Return a table of one over the area of each area light [1/m²].

    These are values of `pdf_position` of the shapes. A call of this method would compile the method
    of all shapes in memory.
    """
    shapes = [emitter.get_shape() for emitter in emitters]
    inverse = [0 if shape is None else 1 / float(shape.surface_area()[0]) for shape in shapes]
    return mi.Float(table_of(emitters, inverse, np.float32))


def _half_angle(emitter: mi.Emitter) -> float:
    """Return the half angle of a point emitter's cone [rad]."""
    if emitter.class_name() == "PointLight":
        return math.pi
    parameters = mi.traverse(emitter)
    if emitter.class_name() == "SpotLight":
        return math.radians(float(np.ravel(parameters["cutoff_angle"])[0]))

    # A projector shows its angle only in the printed form. Its image has the aspect ratio
    wide = math.tan(math.radians(float(re.findall(r"x_fov = (\S+),", str(emitter))[0])) / 2)
    height, width = (
        parameters["irradiance.data"].shape[:2] if "irradiance.data" in parameters else (1, 1)
    )
    return math.atan(wide * math.hypot(1, height / width))
