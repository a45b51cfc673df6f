"""MIS weights of bidirectional path tracing, computed recursively along both sub-paths.

Strategy (s, t) builds a path from s vertices of a light sub-path and t vertices of a camera
sub-path. All strategies with the same s + t can find the same path: s = 0 hits the light, s = 1
connects to the light, t = 1 connects to the lens, and all others connect two vertices. Strategy i
with the density p_i has the MIS weight

    w_i = p_i^β / sum of all p_j^β = 1 / (1 + x)        x = sum over j != i of (p_j / p_i)^β

with β = 2 for the power heuristic and β = 1 for the balance heuristic (Veach 1997, section 10.2).
Each sub-path carries two partial sums a and b, so that x can be computed from the two vertices of a
connection (Georgiev 2012, "Implementing vertex connection and merging"). Let m(x) = x^β. A segment
has the length d and arrives with the cosine c. A BSDF sample has the cosine c', the density p and
the reverse density q. The updates are

    at a vertex             a -> a m(d² / c)        b -> b m(1 / c)
    after a BSDF sample     a -> m(1 / p)           b -> m(c' / p) (b m(q) + a)
    after a delta lobe      a -> 0                  b -> m(c') b

Cosines refer to geometric normals, and are 1 at points of media. Densities do not contain Russian
roulette or transmittance, because weights add up to 1 for any densities. The extinction at vertices
cancels, because all strategies find the same vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..paths.records import BSDFSample, Path, Vertex


@dataclass
class PartialSums:
    """Partial sums of x for a sub-path, over strategies with fewer vertices on this sub-path."""

    # Factor of the density of the last vertex when it is sampled from the other sub-path
    a: mi.Float

    # Factor of the same density times the density of continuing to the vertex before the last one
    b: mi.Float


class BidirectionalMIS:
    """The strategies that are used, and their MIS weights.

    Args:
        exponent: Exponent β. With 0, all weights are 1, which is correct for a single strategy.
        camera_connections: Whether strategies with t = 1 are used.
        only: The only strategy (s, t) with light, None for all strategies.
        hits: Whether strategies with s = 0 are used.
        inner: Whether strategies with s > 1 and t > 1 are used.
    """

    def __init__(
        self,
        exponent: int,
        camera_connections: bool = True,
        only: tuple[int, int] | None = None,
        hits: bool = True,
        inner: bool = True,
    ) -> None:
        self.exponent = exponent
        self.camera_connections = camera_connections
        self.only = only
        self.hits = hits
        self.inner = inner

    def power(self, x: mi.Float) -> mi.Float:
        """Return m(x) = x^β."""
        return x * x if self.exponent == 2 else x

    def at_vertex(self, sums: PartialSums, path: Path, vertex: Vertex) -> PartialSums:
        """Update the partial sums of the MIS weights for the segment that ends at a vertex.

        Args:
            sums: Partial sums at the start of the segment.
            path: The path whose ray leads to the vertex.
            vertex: The vertex.

        Returns:
            The partial sums at the vertex, as the introduction of the module defines them.
        """
        distance = vertex.length
        cos = vertex.cosine(path.ray.d)
        inverse_cos = dr.select(cos > 0, dr.rcp(self.power(cos)), 0)
        a = sums.a * self.power(distance * distance) * inverse_cos
        return PartialSums(a, sums.b * inverse_cos)

    def after_sample(
        self, sums: PartialSums, vertex: Vertex, bsdf_sample: BSDFSample
    ) -> PartialSums:
        """Update the sums for the BSDF sample at a vertex."""
        cos = vertex.cosine(bsdf_sample.ray.d)
        pdf = bsdf_sample.pdf
        specular = bsdf_sample.specular
        inverse_pdf = dr.select(pdf > 0, dr.rcp(self.power(pdf)), 0)
        earlier = inverse_pdf * self.sum(sums, bsdf_sample.pdf_reverse)
        a = dr.select(specular, 0, inverse_pdf) if self.inner else dr.zeros(mi.Float)
        return PartialSums(a, self.power(cos) * dr.select(specular, sums.b, earlier))

    def sum(self, sums: PartialSums, pdf_reverse: mi.Float) -> mi.Float:
        """Return the sum over the strategies of a sub-path, a + b m(pdf_reverse)."""
        return dr.fma(sums.b, self.power(pdf_reverse), sums.a)

    def weight(self, x: mi.Float, s: mi.UInt32 | int, t: mi.UInt32 | int) -> mi.Float:
        """Return the MIS weight of strategy (s, t) for a sum x, 0 for strategies without light."""
        weight = dr.rcp(1 + x) if self.exponent else mi.Float(1)
        if self.only is not None:
            counts = (mi.UInt32(s) == self.only[0]) & (mi.UInt32(t) == self.only[1])
            weight = dr.select(counts, weight, 0)
        return weight
