"""Emission sampling: rays from emitters, and their densities.

An emitter is chosen as next-event estimation chooses it, and those of `sampling_weight` 0 too that
paths can run into. Light starts

| emitter | at | towards |
|---|---|---|
| `area` | a uniform point of its shape | by the cosine to its normal |
| `directionalarea` | a uniform point of its shape | its normal |
| `point`, `spot`, `projector` | the only point | uniform in the cone around all that it lights |
| `directional` | a uniform point of a disk across the scene | the only direction |
| `constant`, `envmap`, skies | the same | as the emitter samples its light |

The disk touches the sphere around scene and sensor, where distant light starts for paths from the
sensor too, see `Wavefronts`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from ..paths.surfaces import EmitterSamples, Wavefronts, number_of, table_of
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
# Emitters that paths may start at: class names, and plugin names
KINDS = CONES | SHAPES | BEAMS | DISTANT


@dataclass
class Emitted:
    """A ray of light, one for each lane."""

    ray: mi.Ray3f
    origin: mi.Point3f  # where it starts, and where lengths are measured from [m]
    emitter: mi.EmitterPtr
    weight: mi.UnpolarizedSpectrum  # emitted radiance times cosine over density
    density: mi.Float  # of point and direction, that of the emitter's choice included
    delta: mi.Bool  # whether the path from the camera cannot run into this light
    active: mi.Bool  # lanes in which there is light
    normal: mi.Normal3f = field(default_factory=lambda: mi.Normal3f(0))  # of the emitter there
    uv: mi.Point2f = field(default_factory=lambda: mi.Point2f(0))
    cos: mi.Float = field(default_factory=lambda: mi.Float(1))  # between ray and normal, if any


class Emission:
    """The emitters of a scene as the start of paths.

    Args:
        scene: The scene.
        sensor: The sensor, whose position the sphere contains where distant light starts.

    Raises:
        ValueError: There is no emitter, or one that light cannot be followed from; one line.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor) -> None:
        emitters = scene.emitters()
        if not emitters:
            raise ValueError("scene: has no emitters; must have one that light can start from")
        kinds, allowed = [emitter.class_name() for emitter in emitters], allowed_kinds()
        for emitter, kind in zip(emitters, kinds, strict=True):
            if kind not in allowed:
                raise ValueError(
                    f"emitter {emitter.id()!r}: is a {KINDS.get(kind, kind)}, whose light cannot "
                    f"be followed here; must be {', '.join(allowed.values())}"
                )
        self.scene, self.samples = scene, EmitterSamples(scene)
        self.sphere = Wavefronts.around(scene, sensor)
        self.cross_section = dr.pi * self.sphere.radius * self.sphere.radius
        self.pointers = scene.emitters_dr()
        self.has_cones, self.has_shapes, self.has_beams, self.has_distant = (
            any(kind in group for kind in kinds) for group in (CONES, SHAPES, BEAMS, DISTANT)
        )
        self.cones, self.by_area = _cones(emitters), _inverse_areas(emitters)
        self.total = dr.opaque(mi.Float, sum(float(e.sampling_weight()) for e in emitters))
        self.distribution, self.pmf_ratio, self.unweighted_pmf = _probabilities(emitters)
        area_lights = [e for e in emitters if e.class_name() in SHAPES]
        self.shapes = [emitter.get_shape() for emitter in area_lights]
        self.shape_index = mi.UInt32(table_of(area_lights, range(len(area_lights)), np.uint32))
        dr.eval(self.pointers, self.cones, self.by_area, self.shape_index)
        dr.eval(self.pmf_ratio, self.unweighted_pmf)
        dr.make_opaque(self.cross_section)

    # -------------------------------------------------------------------------- sampling

    def sample(self, sampler: mi.Sampler, ray: mi.Ray3f) -> Emitted:
        """Sample emission with the wavelengths and the time of a camera ray."""
        xi = sampler.next_1d()
        u_point = sampler.next_2d()
        u_direction = sampler.next_2d()
        return self.sample_at(xi, u_point, u_direction, ray)

    def sample_at(
        self, xi: mi.Float, u_point: mi.Point2f, u_direction: mi.Point2f, ray: mi.Ray3f
    ) -> Emitted:
        """As `sample`, by uniform numbers for the emitter, the point and the direction."""
        # Choose an emitter
        if self.distribution is None:
            index, inverse_pmf, _ = self.scene.sample_emitter(xi)
        else:
            index, pmf = self.distribution.sample_pmf(xi)
            inverse_pmf = dr.rcp(pmf)

        # Sample point and direction by the technique of each kind of emitter
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
                found = sample(emitter, u_point, u_direction, ray, here)
                start = found if start is None else dr.select(here, found, start)

        # Divide by the probability of the emitter
        assert start is not None
        start.weight = start.weight * inverse_pmf
        start.density = start.density / inverse_pmf
        start.active = dr.isfinite(start.density) & dr.any(start.weight > 0)
        return start

    def sample_direction(
        self, at: mi.Interaction3f, u: mi.Point2f
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction to any emitter that light starts at; returns it and its weight."""
        if self.distribution is None:
            return self.samples.sample_direction(at, u)
        index, x, pmf = self.distribution.sample_reuse_pmf(u.x)
        emitter = dr.gather(mi.EmitterPtr, self.pointers, index)
        u = mi.Point2f(x, u.y)
        ds, radiance = self.samples.sample_emitter(emitter, at, u)
        ds.pdf *= pmf
        return ds, radiance / pmf

    def _from_cone(self, emitter, u_point, u, like, active) -> Emitted:
        """Sample a direction uniformly in the cone of an emitter at a point."""
        cone = self._cone(emitter, active)
        p, size = mi.Point3f(*cone[:3]), cone[6]
        height = u.x * size  # Uniform, and exact for narrow cones
        radius = dr.safe_sqrt(height * (2 - height))
        sine, cosine = dr.sincos(2 * dr.pi * u.y)
        local = mi.Vector3f(radius * cosine, radius * sine, 1 - height)
        d = mi.Frame3f(mi.Vector3f(*cone[3:6])).to_world(local)
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
        """Sample a point uniformly on a surface, and a cosine-distributed direction."""
        # Sample position and direction
        ps = self._point_on(emitter, like.time, u_point, active)
        local = mi.warp.square_to_cosine_hemisphere(u)
        n = mi.Normal3f(ps.n)
        if self.samples.exist:
            n, _ = self.samples.at(emitter, like.time, u_point, ps.n, active)
            active &= dr.dot(ps.n, mi.Frame3f(n).to_world(local)) > 0  # Else it is dark there

        # Evaluate the radiance
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
        si.p, si.n, si.uv, si.shape = ps.p, n, ps.uv, emitter.get_shape()
        si.sh_frame, si.wi = mi.Frame3f(n), local
        si.time, si.wavelengths = like.time, like.wavelengths
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
        """Sample a point uniformly on an emitter's shape.

        A call by pointer would compile that of all living shapes, and instances cannot be sampled.
        The emitter's own method prefers bright parts of a texture, unlike all other strategies.
        """
        sample = [each.sample_position for each in self.shapes]
        if len(sample) == 1:
            return sample[0](time, u, active)
        which = dr.gather(mi.UInt32, self.shape_index, number_of(emitter), active)
        return dr.switch(which, sample, time, u, active)

    def _from_beam(self, emitter, u_point, u, like, active) -> Emitted:
        """Sample a point on a surface that emits along its normal."""
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
        """Sample a direction of a distant emitter, and a point of a disk across the scene."""
        sphere = self.sphere
        at = _interaction(sphere.centre, like)
        ds, radiance = emitter.sample_direction(at, u, active)
        disk = mi.warp.square_to_uniform_disk_concentric(u_point) * sphere.radius
        across = mi.Frame3f(ds.d).to_world(mi.Vector3f(disk.x, disk.y, sphere.radius))
        p = mi.Point3f(sphere.centre + across)
        return Emitted(
            ray=mi.Ray3f(p, -ds.d, like.time, like.wavelengths),
            origin=p,
            emitter=emitter,
            weight=mi.unpolarized_spectrum(radiance) * self.cross_section,
            density=ds.pdf / self.cross_section,
            delta=mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaDirection),
            active=mi.Bool(active),
        )

    # -------------------------------------------------------------------------- densities

    def ratio(
        self, emitter: mi.EmitterPtr, ds: mi.DirectionSample3f, pdf: mi.Float, distance: mi.Float
    ) -> mi.Float:
        """Return the density of a connection to an emitter point over that of emission there.

        This is p_c / p_e times distance^2 where p_c is the density of the connection by area, from
        `pdf`, its solid-angle density [1/sr], and p_e that of light that starts in its direction;
        for distant light, by direction and without the distance. Both include the emitter's choice.
        """
        flags = emitter.flags()
        ratio = mi.Float(0)
        if self.has_cones:
            here = mi.has_flag(flags, mi.EmitterFlags.DeltaPosition)
            solid_angle = 2 * dr.pi * self._cone(emitter, here)[6]
            ratio = dr.select(here, solid_angle * distance * distance, ratio)
        if self.has_shapes:
            here = mi.has_flag(flags, mi.EmitterFlags.Surface)
            pmf = emitter.sampling_weight() / self.total
            by_area = pmf * dr.gather(mi.Float, self.by_area, number_of(emitter), here)
            ratio = dr.select(here & (by_area > 0), dr.pi * pdf / by_area, ratio)
        if self.has_distant:
            here = mi.has_flag(flags, mi.EmitterFlags.Infinite)
            ratio = dr.select(here, self.cross_section, ratio)
        if self.distribution is not None:
            ratio *= dr.gather(mi.Float, self.pmf_ratio, number_of(emitter))
        return ratio

    def density(
        self, ref: mi.Interaction3f, ds: mi.DirectionSample3f, pdf: mi.Float, distance: mi.Float
    ) -> mi.Float:
        """Return the density of emission at a point that a ray from `ref` has hit.

        It is p_e over distance^2, see `ratio` for the arguments; for distant light p_e.
        """
        ratio = self.ratio(ds.emitter, ds, pdf, distance)
        density = dr.select(ratio > 0, pdf / ratio, 0)
        if self.distribution is not None:
            row = number_of(ds.emitter)
            pmf = dr.gather(mi.Float, self.unweighted_pmf, row)
            surface = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Surface)
            by_area = dr.gather(mi.Float, self.by_area, row, surface) * dr.inv_pi
            by_direction = ds.emitter.pdf_direction(ref, ds, ~surface) / self.cross_section
            only = pmf * dr.select(surface, by_area, by_direction)
            density = dr.select(pmf > 0, only, density)
        return density

    def _cone(self, emitter: mi.EmitterPtr, active: mi.Bool) -> list[mi.Float]:
        """Return apex, axis and height of an emitter's cone."""
        row = number_of(emitter) * 7
        return [dr.gather(mi.Float, self.cones, row + k, active) for k in range(7)]


def allowed_kinds() -> dict[str, str]:
    """Return emitters that paths may start at in the active variant, see `KINDS`."""
    return KINDS if not mi.is_spectral else CONES | SHAPES | DISTANT


def _interaction(p: mi.Point3f, like: mi.Ray3f) -> mi.Interaction3f:
    """Return a point with the wavelengths and the time of a ray."""
    at = dr.zeros(mi.Interaction3f, dr.width(p))
    at.p, at.time, at.wavelengths = mi.Point3f(p), like.time, like.wavelengths
    return at


def _probabilities(
    emitters: list[mi.Emitter],
) -> tuple[mi.DiscreteDistribution | None, mi.Float, mi.Float]:
    """Return the distribution over emitters, None if their weights alone are used.

    Also two tables: the probability by weight over that of the distribution, and the latter where
    the weight is 0.
    """
    weights = np.array([float(emitter.sampling_weight()) for emitter in emitters])
    hit = [not mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta) for emitter in emitters]
    unsampled = (weights == 0) & hit
    if not unsampled.any():
        return None, mi.Float(1), mi.Float(0)
    own = np.where(unsampled, weights.sum() / max(np.count_nonzero(weights), 1) or 1, weights)
    ratio = own.sum() / (weights.sum() or 1) * (weights > 0)
    tables = (table_of(emitters, v, np.float32) for v in (ratio, unsampled * own / own.sum()))
    return mi.DiscreteDistribution(mi.Float(own)), *map(mi.Float, tables)


def _cones(emitters: list[mi.Emitter]) -> mi.Float:
    """Return the table of apex, axis and height (on the unit sphere) of the emitters' cones."""
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
    """Return the table of 1 over the area of each area light [1/m²].

    That is `pdf_position` of its shape, a call of which would compile that of all living shapes.
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
    # A projector has its angle nowhere else; its image has the aspect ratio
    wide = math.tan(math.radians(float(re.findall(r"x_fov = (\S+),", str(emitter))[0])) / 2)
    height, width = (
        parameters["irradiance.data"].shape[:2] if "irradiance.data" in parameters else (1, 1)
    )
    return math.atan(wide * math.hypot(1, height / width))
