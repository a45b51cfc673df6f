# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false
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

from ...films.contribution import Contribution
from ...paths.guided import REACHED, Guided, ray_to
from ...paths.protocols import Space
from ...paths.records import Connection, Path, Vertex
from ...paths.walk import accumulate
from .laser_spot import LaserSpot

CONNECTIONS = 16
"""Target points for each camera ray."""

SHORT = 1e-4
"""Part of the way to a target point in which nothing is looked for, because of rounding."""

CLOSE = 1e-3
"""The last part of it, in which a target's surface is looked for."""

GOLDEN = 0.6180339887498949
"""Step of the lattice's second coordinate, which no few multiples of come close to 0."""


class CornerShare:
    """The share that `count` connections for each camera ray leave to walked paths."""

    def __init__(self, guided: Guided, count: int = CONNECTIONS) -> None:
        self.guided, self.count = guided, count

    def __call__(self, vertex: Vertex, path: Path) -> mi.Float:
        """Weight of the connection of a walked path."""
        by_area = self.count * self.guided.targets.density(vertex.si, path.prev)
        found_twice = (path.depth == 1) & self.guided.competed(path)
        return dr.select(found_twice, path.pdf / (path.pdf + by_area), 1)


class CornerConnections:
    """Three-bounce light by connections, shared with the paths that are walked."""

    def __init__(self, space: Space, share: CornerShare, laser: LaserSpot) -> None:
        self.space, self.scene, self.laser = space, laser.scene, laser
        self.guided, self.targets, self.count = share.guided, share.guided.targets, share.count

    def add(
        self,
        ray: mi.Ray3f,
        origin: mi.Point3f,
        unwarp: bool,
        sampler: mi.Sampler,
        measurement: Any,
        active: mi.Bool,
    ) -> tuple[Any, mi.UInt32]:
        """Hand the light of camera rays to a measurement, which is returned.

        Lengths start at `origin`, or with `unwarp` at the first vertex.
        """
        start = Path.start(ray, origin, active, medium=self.space.medium_at_sensor(ray))
        path, seen = self.space.next_vertex(start, sampler)
        path.opl = mi.Float(0) if unwarp else seen.length
        active = self.guided.sends(seen, active)
        return _connect(self, seen, path, sampler.next_2d(), sampler, measurement, active)

    def at(
        self, seen: Vertex, path: Path, u: mi.Point2f, sampler: mi.Sampler, active: mi.Bool
    ) -> Contribution:
        """Connect over one target point."""
        si, guided, targets = seen.si, self.guided, self.targets
        ps, shape = targets.sample(u, active)
        r = dr.norm(ps.p - si.p)
        d = (ps.p - si.p) / r
        transmittance, medium = mi.Float(1), path.medium
        if self.space.scatters:
            connection = Connection.to_point(ps.p, d, r, active)
            transmittance, medium = self.space.transmittance_and_medium(
                path, seen, connection, sampler
            )
        if targets.plain:  # There is no need to find a point that is known
            y = _at_point(si, ps, shape, d, r)
            if not self.space.scatters:
                ray = si.spawn_ray_to(ps.p)
                ray.maxt = dr.norm(ps.p - ray.o) * (1 - SHORT)
                active = active & ~self.scene.ray_test(ray, active)
        else:
            ray = ray_to(si, d, r)
            if self.space.scatters:  # Behind boundaries of media
                ray.o = dr.fma(ray.d, (1 - CLOSE) * r, ray.o)
            y = self.scene.ray_intersect(ray, active)
            active = active & y.is_valid() & (dr.abs(dr.norm(y.p - si.p) - r) <= REACHED * r)

        bsdf_eval = guided.eval_pdf(seen, d, active)
        by_area = targets.density(y, mi.Interaction3f(si))
        density = bsdf_eval.pdf + (guided.probability + self.count) * by_area

        weight, opl = path.β * transmittance, path.opl
        history = self.laser.history
        start = None if history is None else history.start()
        path = Path.start(si.spawn_ray(d), si.p, active, start, medium=medium)
        path.depth, path.opl = mi.UInt32(1), opl + r
        middle = Vertex(y, r, active)
        if history is not None:
            path.history = history.at_vertex(path, middle, active)
        connection = self.laser.lit(middle, path, sampler, active)
        connection.weight *= self.space.transmittance(path, middle, connection, sampler)
        f_y = y.bsdf().eval(
            mi.BSDFContext(), y, y.to_local(connection.direction), connection.active
        )
        f = mi.unpolarized_spectrum(bsdf_eval.f) * mi.unpolarized_spectrum(f_y)
        spectrum = f * connection.weight * weight / density
        found = connection.active & (by_area > 0)
        return Contribution(spectrum, path.opl + connection.length, found)


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
def _connect(corner, seen, path, shift, sampler, measurement, active):
    """The loop over target points: a lattice of them, moved by one random number."""
    k, not_finite = mi.UInt32(0), mi.UInt32(0)
    while k < corner.count:
        u = shift + mi.Point2f(mi.Float(k) / corner.count, GOLDEN * mi.Float(k))
        found = corner.at(seen, path, u - dr.floor(u), sampler, active)
        not_finite += accumulate(measurement, found)
        k += 1
    return measurement, not_finite
