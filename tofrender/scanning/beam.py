"""Plan of lidar shots: light that returns on its own way, and connections to the laser spot."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.contribution import Contribution
from ..integrators.plan import Plan
from ..nlos.light.laser_spot import LaserSpot, Spot, scatter_beam
from ..nlos.light.scan import Scan
from ..paths.protocols import Space
from ..paths.records import Limits, Path
from ..paths.scattering import Materials
from ..paths.space import transmittance_between
from ..paths.surfaces import has_lobes, materials
from ..runtime import checks
from ..signals.illuminants import white

MOST = 64  # Mirrors and glass surfaces of a way whose depth is unlimited


def require_followed(scene: mi.Scene, space: Space) -> None:
    """Refuse water around the lidar, fog with mirrors, rough glass, and masks."""
    flags, has = mi.BSDFFlags, mi.has_flag
    checks.require("index around the sensor", space.index, space.index == 1, "1, in air")
    if space.scatters and has_lobes(scene, flags.DeltaReflection, flags.DeltaTransmission):
        raise ValueError("scene: has media; must have none, or no mirrors and clear glass")
    for bsdf in materials(scene):
        each = bsdf.flags()
        clear = has(each, flags.DeltaTransmission) or has(each, flags.Null)
        if has(each, flags.GlossyTransmission) or (clear and has(each, flags.Smooth)):
            raise ValueError(f"bsdf {bsdf.id()!r}: is rough glass or a mask; must not be")


def sample_cone(axis: mi.Vector3f, u: mi.Point2f, half_angle: float) -> mi.Vector3f:
    """Sample directions uniformly in cones, also in narrow ones, where 1 - cos would cancel."""
    disk = mi.warp.square_to_uniform_disk_concentric(u) * math.sin(half_angle / 2)
    r2 = dr.squared_norm(disk)
    across = disk * (2 * dr.sqrt(1 - r2))
    return mi.Frame3f(axis).to_world(mi.Vector3f(across.x, across.y, 1 - 2 * r2))


class LidarPlan(Plan):
    """Laser and receiver with one cone, of the solid angle W, around each ray's `d_x`.

    A pulse has 1/W of its energy per steradian. Its light that returns on its own way, from the
    first vertex that is no delta lobe, contributes with the wavefront's area A per solid angle

        W (1/W) f cos / A   [1/m^2 of the aperture],   A = r^2 on a straight way.

    All other light is found by connections to laser spots of rays of the beam, times W.
    """

    def __init__(self, scene: mi.Scene, space: Space, half_angle: float, max_depth: int) -> None:
        self.half_angle, self.depth = half_angle, max_depth - 1 if max_depth > 0 else -1
        self.scan = Scan(scene, space, [], [], None, False, -1, True, False)
        materials, endpoint = (
            space.with_phase_functions(Materials(scene)),
            LaserSpot(self.scan, None),
        )
        super().__init__(scene, space, endpoint, materials, Limits(self.depth))

    def illuminate(self, ray, origin, sampler, active):
        """Return the laser spots of the beam around each ray, and light on the ray's own way."""
        power = white(ray.wavelengths) * (4 * math.pi * math.sin(self.half_angle / 2) ** 2)

        def beam(sampler: mi.Sampler, active: mi.Bool) -> Spot:
            d = sample_cone(ray.d_x, sampler.next_2d(), self.half_angle)
            aimed = mi.Ray3f(ray.o, d, ray.time, ray.wavelengths)
            return Spot(dr.zeros(mi.SurfaceInteraction3f), power, mi.Float(0), aimed, origin)

        spots = LaserSpot(self.scan, scatter_beam(self.scan, beam))
        return spots, [self._returned(ray, origin, sampler, active)]

    @dr.syntax
    def _returned(self, ray: Any, origin: Any, sampler: Any, active: Any) -> Contribution:
        """Light that returns on the rays' own ways, by mirrors and clear glass, too."""
        space, scattering = self.space, self.scattering
        path = Path.start(ray, origin, active, medium=space.medium_at_sensor(ray))
        path, vertex = space.next_vertex(path, sampler)
        path.opl, light = mi.Float(vertex.length), white(path.ray.wavelengths)
        d1, d2 = (
            mi.Vector3f(each) for each in (mi.Frame3f(path.ray.d).s, mi.Frame3f(path.ray.d).t)
        )
        p1, p2 = d1 * vertex.length, d2 * vertex.length
        passing = path.active & vertex.valid & ~scattering.smooth(vertex)
        while passing & (path.depth < (MOST if self.depth < 0 else self.depth - 1)):
            _, sample = scattering.sample(vertex, None, sampler, passing)
            # The light is not compressed as radiance is; both ways share one choice of the lobe
            light = light * mi.unpolarized_spectrum(sample.weight) * (sample.pdf * sample.η**2)
            p1, d1 = self._bend(p1, d1, path.ray, sample, passing)
            p2, d2 = self._bend(p2, d2, path.ray, sample, passing)
            path.β, path.η = path.β * sample.weight, path.η * sample.η
            path.ray, path.prev = sample.ray, mi.Interaction3f(vertex.si)
            path.depth, path.active = path.depth + 1, passing
            path, vertex = space.next_vertex(path, sampler)
            path.opl = dr.fma(path.η, vertex.length, path.opl)
            p1, p2 = dr.fma(d1, vertex.length, p1), dr.fma(d2, vertex.length, p2)
            passing = passing & vertex.valid & ~scattering.smooth(vertex)
        d, active = path.ray.d, path.active & vertex.valid & ~passing
        f = mi.unpolarized_spectrum(path.β * scattering.eval_pdf(vertex, -d, active).f)
        if space.scatters:
            f *= transmittance_between(space, vertex.si, origin, sampler, active)
        return Contribution(light * f / dr.abs(dr.dot(dr.cross(p1, p2), d)), 2 * path.opl, active)

    def _bend(self, p: Any, v: Any, ray: mi.Ray3f, sample: Any, active: mi.Bool) -> tuple[Any, Any]:
        """Differentials of point and direction behind a delta lobe (Igehy, SIGGRAPH 1999)."""
        flags, d = mi.RayFlags.All | mi.RayFlags.dNSdUV, ray.d
        si = self.scene.ray_intersect(ray, flags, False, active)
        # Move along the ray onto the surface, and find how its normal changes there
        p = p - d * (dr.dot(p, si.n) / dr.dot(d, si.n))
        uu, uv, vv = (
            dr.squared_norm(si.dp_du),
            dr.dot(si.dp_du, si.dp_dv),
            dr.squared_norm(si.dp_dv),
        )
        pu, pv, area2 = dr.dot(p, si.dp_du), dr.dot(p, si.dp_dv), uu * vv - uv * uv
        dn = (si.dn_du * (vv * pu - uv * pv) + si.dn_dv * (uu * pv - uv * pu)) / area2
        side = -dr.sign(dr.dot(si.sh_frame.n, d))
        n, dn = mi.Vector3f(si.sh_frame.n) * side, mi.Vector3f(dn) * side
        # Differentiate d + 2 c n, or η d + (η c - c') n with the cosines c and c'
        c, out, η = -dr.dot(d, n), -dr.dot(sample.ray.d, n), 1 / sample.η
        dc = -dr.dot(v, n) - dr.dot(d, dn)
        refracted = η * v + (η * c - out) * dn + η * dc * (1 - η * c / out) * n
        return p, dr.select(out < 0, v + 2 * (dc * n + c * dn), refracted)
