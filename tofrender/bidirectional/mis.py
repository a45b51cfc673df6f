"""MIS weights of bidirectional path tracing, computed recursively along both sub-paths.

A path of s vertices from a light and t from the lens is found by all strategies (s, t) of the same
s + t: s = 0 hits the light, s = 1 connects to it, t = 1 connects to the lens, and all others
connect two vertices. Strategy i, of density p_i, has the MIS weight

    w_i = p_i^β / sum of all p_j^β = 1 / (1 + x)        x = sum over j != i of (p_j / p_i)^β

with β = 2 for the power heuristic and 1 for the balance heuristic (Veach 1997, section 10.2). Two
partial sums a and b, carried along each sub-path, give x from the vertices of the connection alone
(Georgiev 2012, "Implementing vertex connection and merging"). With m(x) = x^β, a segment of length
d that arrives at cosine c, and a BSDF sample of cosine c', density p and reverse density q,

    at a vertex             a -> a m(d² / c)        b -> b m(1 / c)
    after a BSDF sample     a -> m(1 / p)           b -> m(c' / p) (b m(q) + a)
    after a delta lobe      a -> 0                  b -> m(c') b

Cosines are those to geometric normals, and 1 at points of media. Densities contain neither Russian
roulette nor transmittance: weights add up to 1 with any. The extinction at each vertex would
cancel, as all strategies find the same vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..paths.records import BSDFSample, Path, Vertex


@dataclass
class PartialSums:
    """Partial sums of x of a sub-path, over strategies with fewer vertices on its side."""

    a: mi.Float  # factor of the density of its last vertex from the other end
    # factor of that, times the density with which the other end goes on to the vertex before
    b: mi.Float


class BidirectionalMIS:
    """Strategies that count, and their MIS weights.

    The exponent β = 0 gives every strategy the weight 1, which is right for one alone. Strategies
    with t = 1 take part with `camera_connections`, those with s = 0 with `hits`, those with s > 1
    and t > 1 with `inner`. The light of strategy (s, t) = `only` counts, None for all.
    """

    def __init__(
        self,
        exponent: int,
        camera_connections: bool = True,
        only: tuple[int, int] | None = None,
        hits: bool = True,
        inner: bool = True,
    ) -> None:
        self.exponent, self.camera_connections, self.only = exponent, camera_connections, only
        self.hits, self.inner = hits, inner

    def power(self, x: mi.Float) -> mi.Float:
        """Return m(x)."""
        return x * x if self.exponent == 2 else x

    def at_vertex(self, sums: PartialSums, path: Path, vertex: Vertex) -> PartialSums:
        """Update the sums for the segment to a vertex."""
        distance, cos = vertex.length, vertex.cosine(path.ray.d)
        inverse_cos = dr.select(cos > 0, dr.rcp(self.power(cos)), 0)
        a = sums.a * self.power(distance * distance) * inverse_cos
        return PartialSums(a, sums.b * inverse_cos)

    def after_sample(
        self, sums: PartialSums, vertex: Vertex, bsdf_sample: BSDFSample
    ) -> PartialSums:
        """Update the sums for the BSDF sample at a vertex."""
        cos, pdf, specular = vertex.cosine(bsdf_sample.ray.d), bsdf_sample.pdf, bsdf_sample.specular
        inverse_pdf = dr.select(pdf > 0, dr.rcp(self.power(pdf)), 0)
        earlier = inverse_pdf * self.sum(sums, bsdf_sample.pdf_reverse)
        a = dr.select(specular, 0, inverse_pdf) if self.inner else dr.zeros(mi.Float)
        return PartialSums(a, self.power(cos) * dr.select(specular, sums.b, earlier))

    def sum(self, sums: PartialSums, pdf_reverse: mi.Float) -> mi.Float:
        """Return a + b m(pdf_reverse), see `PartialSums`."""
        return dr.fma(sums.b, self.power(pdf_reverse), sums.a)

    def weight(self, x: mi.Float, s: mi.UInt32 | int, t: mi.UInt32 | int) -> mi.Float:
        """Return the MIS weight of strategy (s, t), 0 if it does not count."""
        weight = dr.rcp(1 + x) if self.exponent else mi.Float(1)
        if self.only is not None:
            counts = (mi.UInt32(s) == self.only[0]) & (mi.UInt32(t) == self.only[1])
            weight = dr.select(counts, weight, 0)
        return weight
