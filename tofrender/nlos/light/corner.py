"""Light around one corner: three bounces, from the laser spot over a target to the seen point.

For every camera ray, `CornerConnections` samples several points y on the targets and connects each
to the point x that the camera sees and to the laser spot, so that no path has to be walked. Near
the wall such connections are noisy (they have a factor 1/r^2); there the paths of `walk`, which
find y by the wall's material too, are better. Both are combined by the balance heuristic: of n
connections with the density p_A and one walked path with the density p_w,

    a connection has the weight n p_A / (n p_A + p_w), the walked path p_w / (n p_A + p_w).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...films.contribution import Contribution
from ...paths.protocols import Space
from ...paths.records import Connection, Path, Vertex
from ...paths.walk import accumulate
from .guided import REACHED, Guided, ray_to
from .laser_spot import LaserSpot

CONNECTIONS = 16  # target points for each camera ray

SHORT = 1e-4  # last part of the way to a target that shadow rays leave out, because of rounding
CLOSE = 1e-3  # last part of it, in which a target's surface is looked for
GOLDEN = 0.6180339887498949  # step of the lattice's second coordinate


def walked_weight(guided: Guided, vertex: Vertex, path: Path) -> mi.Float:
    """MIS weight of a walked path's connection to the laser spot."""
    by_area = CONNECTIONS * guided.targets.density(vertex.si, path.prev)
    found_twice = (path.depth == 1) & guided.competed(path)
    return dr.select(found_twice, path.pdf / (path.pdf + by_area), 1)


class CornerConnections:
    """Three-bounce light by connections, weighted against the paths that are walked."""

    def __init__(self, space: Space, guided: Guided, laser: LaserSpot) -> None:
        self.space, self.guided, self.laser = space, guided, laser

    def connect(
        self, seen: Vertex, path: Path, u: mi.Point2f, sampler: mi.Sampler, active: mi.Bool
    ) -> Contribution:
        """Connect the seen point over one target point to the laser spot."""
        si, guided, scene = seen.si, self.guided, self.laser.scan.scene
        targets, space = guided.targets, self.space

        # Sample a target point y, and attenuate the light on the way to it
        ps, shape = targets.sample(u, active)
        r = dr.norm(ps.p - si.p)
        d = (ps.p - si.p) / r
        transmittance, medium = mi.Float(1), path.medium
        if space.scatters:
            to_target = Connection.to_point(ps.p, d, r, active)
            transmittance, medium = space.transmittance_and_medium(path, seen, to_target, sampler)
        if targets.plain:  # The sample has all of the surface interaction
            y = _interaction_at(si, ps, shape, d, r)
            if not space.scatters:
                ray = si.spawn_ray_to(ps.p)
                ray.maxt = dr.norm(ps.p - ray.o) * (1 - SHORT)
                active = active & ~scene.ray_test(ray, active)
        else:
            ray = ray_to(si, d, r)
            if space.scatters:  # Behind boundaries of media
                ray.o = dr.fma(ray.d, (1 - CLOSE) * r, ray.o)
            y = scene.ray_intersect(ray, active)
            active = active & y.is_valid() & (dr.abs(dr.norm(y.p - si.p) - r) <= REACHED * r)

        # Evaluate the BSDF at the seen point, and the density of both techniques
        bsdf_eval = guided.eval_pdf(seen, d, active)
        by_area = targets.density(y, mi.Interaction3f(si))
        density = bsdf_eval.pdf + (guided.probability + CONNECTIONS) * by_area

        # Connect y to the laser spot
        weight, opl = path.β * transmittance, path.opl
        history = self.laser.history
        start = None if history is None else history.start()
        path = Path.start(si.spawn_ray(d), si.p, active, start, medium=medium)
        path.depth, path.opl = mi.UInt32(1), opl + r
        middle = Vertex(y, r, active)
        if history is not None:
            path.history = history.at_vertex(path, middle, active)
        connection = self.laser.unweighted(middle, path, sampler, active)
        connection.weight *= space.transmittance(path, middle, connection, sampler)
        wo = y.to_local(connection.direction)
        f_y = y.bsdf().eval(mi.BSDFContext(), y, wo, connection.active)
        f = mi.unpolarized_spectrum(bsdf_eval.f) * mi.unpolarized_spectrum(f_y)
        spectrum = f * connection.weight * weight / density
        lit = connection.active & (by_area > 0)
        return Contribution(spectrum, path.opl + connection.length, lit)


def _interaction_at(
    si: mi.SurfaceInteraction3f, ps: mi.PositionSample3f, shape: mi.ShapePtr, d: Any, r: Any
) -> mi.SurfaceInteraction3f:
    """Make the interaction of a sampled point that is seen from `si` along `d`."""
    y: Any = dr.zeros(mi.SurfaceInteraction3f)
    y.p, y.n, y.shape, y.t = ps.p, ps.n, shape, r
    y.sh_frame = mi.Frame3f(ps.n)
    y.wi = y.to_local(-d)
    y.time, y.wavelengths = si.time, si.wavelengths
    return y


@dr.syntax
def accumulate_corner(corner, seen, path, shift, sampler, measurement, active):
    """Loop over a lattice of target points, shifted by one random number.

    Returns the measurement, and the number of contributions that were not finite.
    """
    k, not_finite = mi.UInt32(0), mi.UInt32(0)
    while k < CONNECTIONS:
        u = shift + mi.Point2f(mi.Float(k) / CONNECTIONS, GOLDEN * mi.Float(k))
        found = corner.connect(seen, path, u - dr.floor(u), sampler, active)
        not_finite += accumulate(measurement, found)
        k += 1
    return measurement, not_finite
