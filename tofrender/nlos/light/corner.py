"""Light around one corner: three bounces, from the lit point over a target to the seen point.

For every camera ray, `CornerConnections` takes several points y on the targets and connects each to
the point x that the camera sees and to the point that the laser lights. That is all there is to a
path of three bounces, so no path has to be walked for it. Near the wall such connections are noisy
(they have a factor 1/r^2); there the paths of `walk`, which find y by the wall's material too, are
better. Both count, by the balance heuristic: of n connections with the density p_A and one walked
path with the density p_w,

    a connection has the weight n p_A / (n p_A + p_w), the walked path p_w / (n p_A + p_w).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...paths.endpoints import PathState
from ...paths.targets import REACHED, Targets, is_on
from .laser_spot import LaserSpot

CONNECTIONS = 16
"""Target points for each camera ray."""

SHORT = 1e-4
"""Part of the way to a target point in which nothing is looked for, because of rounding."""

GOLDEN = 0.6180339887498949
"""Step of the lattice's second coordinate, which no few multiples of come close to 0."""


class CornerConnections:
    """Three-bounce light by connections, shared with the paths that are walked.

    Args:
        scene: The scene.
        targets: Where the middle point is chosen.
        laser: The lit point; its connections from target points after one wall point are weighted
            from now on.
        count: Number n of target points for each camera ray.
    """

    def __init__(
        self, scene: mi.Scene, targets: Targets, laser: LaserSpot, count: int = CONNECTIONS
    ) -> None:
        self.scene, self.targets, self.laser, self.count = scene, targets, laser, count
        laser.shared = self.walked_share

    def walked_share(self, si: mi.SurfaceInteraction3f, path: PathState) -> mi.Float:
        """Weight of the connection of a walked path."""
        by_area = self.count * self.targets.density(si, path.previous)
        both = (path.depth == 1) & path.shared
        return dr.select(both, path.pdf / (path.pdf + by_area), 1)

    def add(
        self, ray: mi.Ray3f, origin: Any, sampler: mi.Sampler, measurement: Any, active: mi.Bool
    ) -> Any:
        """Hand the light of camera rays to a measurement.

        Args:
            ray: Camera rays.
            origin: Where their lengths start; None to leave out the first segment.
            sampler: Random numbers.
            measurement: As for `walk`.
            active: Lanes with a ray.

        Returns:
            The measurement.
        """
        si = self.scene.ray_intersect(ray, active)
        bsdf = si.bsdf()
        active = active & is_on(si, self.targets.senders)
        active &= mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        opl = mi.Float(0) if origin is None else dr.norm(si.p - origin)
        return _connect(self, si, bsdf, opl, sampler.next_2d(), sampler, measurement, active)

    def at(
        self,
        si: mi.SurfaceInteraction3f,
        bsdf: Any,
        opl: mi.Float,
        u: mi.Point2f,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> tuple[Any, mi.Float, mi.Bool]:
        """Connect over one target point: spectrum, optical path length and lanes."""
        ctx, targets = mi.BSDFContext(), self.targets
        ps, shape = targets.sample(u, active)
        r = dr.norm(ps.p - si.p)
        d = (ps.p - si.p) / r
        wo = si.to_local(d)
        if targets.plain:  # There is no need to find a point that is known
            y = _at_point(si, ps, shape, d, r)
            ray = si.spawn_ray_to(ps.p)
            ray.maxt = dr.norm(ps.p - ray.o) * (1 - SHORT)
            active = active & ~self.scene.ray_test(ray, active)
        else:
            y = self.scene.ray_intersect(targets.send(si.spawn_ray(d), si, r), active)
            active = active & y.is_valid() & (dr.abs(dr.norm(y.p - si.p) - r) <= REACHED * r)

        f, pdf = bsdf.eval_pdf(ctx, si, wo, active)
        by_area = targets.density(y, mi.Interaction3f(si))
        walked = targets.share * by_area + (1 - targets.share) * pdf
        density = walked + self.count * by_area

        memory = self.laser.remember(mi.Bool(False), y, active)
        seen, one = mi.Interaction3f(si), mi.UInt32(1)
        path = PathState(opl + r, mi.Float(1), one, memory, seen, walked, mi.Bool(True))
        em = self.laser.lit(y, path, sampler, active)
        f_y = mi.unpolarized_spectrum(y.bsdf().eval(ctx, y, y.to_local(em.direction), em.active))
        found = em.active & (by_area > 0)
        spectrum = dr.select(found, mi.unpolarized_spectrum(f) * f_y * em.weight / density, 0)
        return spectrum, opl + r + em.length, found & dr.any(spectrum != 0)


def _at_point(
    si: mi.SurfaceInteraction3f,
    ps: mi.PositionSample3f,
    shape: mi.ShapePtr,
    d: mi.Vector3f,
    r: mi.Float,
) -> mi.SurfaceInteraction3f:
    """What is known of a sampled point that is seen from `si` along `d`."""
    y: Any = dr.zeros(mi.SurfaceInteraction3f)
    y.p, y.n, y.shape, y.t = ps.p, ps.n, shape, r
    y.sh_frame = mi.Frame3f(ps.n)
    y.wi = y.to_local(-d)
    y.time, y.wavelengths = si.time, si.wavelengths
    return y


@dr.syntax
def _connect(corner, si, bsdf, opl, shift, sampler, measurement, active):
    """The loop over target points: a lattice of them, moved by one random number."""
    k = mi.UInt32(0)
    while k < corner.count:
        u = shift + mi.Point2f(mi.Float(k) / corner.count, GOLDEN * mi.Float(k))
        spectrum, length, found = corner.at(si, bsdf, opl, u - dr.floor(u), sampler, active)
        measurement.add(spectrum, length, found)
        k += 1
    return measurement
