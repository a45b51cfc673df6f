"""Light around one corner by three bounces: the laser spot, a hidden target, and the visible point.

For each camera ray, `CornerConnections` samples several target points y. Each y is connected to the
point x that the camera sees, and to the laser spot. Near the wall such connections are noisy,
because they contain the factor 1/r^2. There the paths of `walk` are better, because they also
sample y by the BSDF of the wall. The balance heuristic combines n connections with the density p_A
and one walked path with the density p_w:

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

# Number of target points for each camera ray
CONNECTIONS = 16

# Last part of the way to a target that shadow rays leave out, because of rounding
SHORT = 1e-4

# Last part of the way to a target in which its surface is searched
CLOSE = 1e-3

# Step of the lattice's second coordinate
GOLDEN = 0.6180339887498949


def walked_weight(guided: Guided, vertex: Vertex, path: Path) -> mi.Float:
    """Return the MIS weight of a walked path's connection to the laser spot."""
    by_area = CONNECTIONS * guided.targets.density(vertex.si, path.prev)
    found_twice = (path.depth == 1) & guided.is_combined(path)
    return dr.select(found_twice, path.pdf / (path.pdf + by_area), 1)


class CornerConnections:
    """Light of three bounces, by connections that are combined with walked paths.

    Args:
        space: The space between surfaces, with its media.
        guided: Scattering at the wall, with the target surfaces.
        laser: Connections to the laser spot.
    """

    def __init__(self, space: Space, guided: Guided, laser: LaserSpot) -> None:
        self.space = space
        self.guided = guided
        self.laser = laser

    def connect(
        self, seen: Vertex, path: Path, u: mi.Point2f, sampler: mi.Sampler, active: mi.Bool
    ) -> Contribution:
        """Connect the visible point to the laser spot through one target point.

        Args:
            seen: Vertex at the visible point x.
            path: Camera path up to this vertex.
            u: Random numbers of the target point.
            sampler: The sampler.
            active: Active lanes.
        """
        si = seen.si
        guided = self.guided
        scene = self.laser.scan.scene
        targets = guided.targets
        space = self.space

        # ---------------------- Sample a target point y ----------------------

        ps, shape = targets.sample(u, active)
        r = dr.norm(ps.p - si.p)
        d = (ps.p - si.p) / r

        # Attenuate the light on the way to y
        transmittance = mi.Float(1)
        medium = path.medium
        if space.scatters:
            to_target = Connection.to_point(ps.p, d, r, active)
            passed = space.transmittance(path, seen, to_target, sampler)
            transmittance = passed.value
            medium = passed.medium

        # Is y visible? On plain surfaces, the sample determines the surface interaction
        if targets.plain:
            y = _interaction_at(si, ps, shape, d, r)
            if not space.scatters:
                ray = si.spawn_ray_to(ps.p)
                ray.maxt = dr.norm(ps.p - ray.o) * (1 - SHORT)
                active = active & ~scene.ray_test(ray, active)

        # Otherwise, intersect a ray. Boundaries of media are before its start
        else:
            ray = ray_to(si, d, r)
            if space.scatters:
                ray.o = dr.fma(ray.d, (1 - CLOSE) * r, ray.o)
            y = scene.ray_intersect(ray, active)
            active = active & y.is_valid() & (dr.abs(dr.norm(y.p - si.p) - r) <= REACHED * r)

        # ------------- Evaluate the BSDF at x, and the density of both techniques -------------

        bsdf_eval = guided.eval_pdf(seen, d, active)
        by_area = targets.density(y, mi.Interaction3f(si))
        density = bsdf_eval.pdf + (guided.probability + CONNECTIONS) * by_area

        # ---------------------- Connect y to the laser spot ----------------------

        # Extend the path to y
        weight = path.β * transmittance
        opl = path.opl

        history = self.laser.history
        start = None if history is None else history.start()
        path = Path.start(si.spawn_ray(d), si.p, active, start, medium=medium)
        path.depth = mi.UInt32(1)
        path.opl = opl + r
        middle = Vertex(y, r, active)
        if history is not None:
            path.history = history.at_vertex(path, middle, active)

        # Evaluate the BSDF at y
        connection = self.laser.unweighted(middle, path, sampler, active)
        connection.weight *= space.transmittance(path, middle, connection, sampler).value
        wo = y.to_local(connection.direction)
        f_y = y.bsdf().eval(mi.BSDFContext(), y, wo, connection.active)
        f = mi.unpolarized_spectrum(bsdf_eval.f) * mi.unpolarized_spectrum(f_y)
        spectrum = f * connection.weight * weight / density
        lit = connection.active & (by_area > 0)
        return Contribution(spectrum, path.opl + connection.length, lit)


def _interaction_at(
    si: mi.SurfaceInteraction3f, ps: mi.PositionSample3f, shape: mi.ShapePtr, d: Any, r: Any
) -> mi.SurfaceInteraction3f:
    """Create the surface interaction of a sampled point.

    Args:
        si: Point from which the sampled point is seen.
        ps: Position sample.
        shape: Shape of the sampled point.
        d: Direction from `si` to the sampled point.
        r: Distance from `si` to the sampled point [m].
    """
    y: Any = dr.zeros(mi.SurfaceInteraction3f)
    y.p = ps.p
    y.n = ps.n
    y.shape = shape
    y.t = r
    y.sh_frame = mi.Frame3f(ps.n)
    y.wi = y.to_local(-d)
    y.time = si.time
    y.wavelengths = si.wavelengths
    return y


@dr.syntax
def accumulate_corner(corner, seen, path, shift, sampler, measurement, active):
    """Accumulate connections to a lattice of target points, shifted by a random offset.

    Returns:
        The measurement, and the number of contributions that were not finite.
    """
    k = mi.UInt32(0)
    not_finite = mi.UInt32(0)
    while k < CONNECTIONS:
        u = shift + mi.Point2f(mi.Float(k) / CONNECTIONS, GOLDEN * mi.Float(k))
        found = corner.connect(seen, path, u - dr.floor(u), sampler, active)
        not_finite += accumulate(measurement, found)
        k += 1
    return measurement, not_finite
