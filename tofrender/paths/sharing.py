# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""How the ways to find a path from both its ends share the light that it carries.

A path of s vertices from a light and t from the lens is found by all strategies (s, t) of the same
s + t: s = 0 runs into the light, s = 1 connects to it, t = 1 connects to the lens, and all others
connect two vertices. Strategy i, of the density p_i, has the share

    w_i = p_i^β / sum of all p_j^β = 1 / (1 + x)        x = sum over j != i of (p_j / p_i)^β

with β = 2 by the power heuristic and 1 by the balance heuristic (Veach 1997, section 10.2). x takes
no other vertices than those at the connection, because each sub-path carries two sums along
(Georgiev 2012, "Implementing vertex connection and merging"). With m(x) = x^β, arriving over the
distance d at the cosine c, and leaving at the cosine c' with the density p of the direction, and q
of the way back,

    arriving                a -> a m(d² / c)        b -> b m(1 / c)
    leaving                 a -> m(1 / p)           b -> m(c' / p) (b m(q) + a)
    leaving from a mirror   a -> 0                  b -> m(c') b

Cosines are those to geometric normals, and 1 at points of media. Neither Russian roulette nor what
media let through is in the densities, which need not be exact: shares add up to 1 for any. The
extinction at each vertex would cancel, as all strategies find the same vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .records import Bounce, Path, Vertex


@dataclass
class Rivals:
    """What a sub-path knows of the strategies that find it with fewer vertices of its own.

    Attributes:
        a: What the density of its last vertex from the other end is multiplied by.
        b: The same, and by the density with which that end goes on to the vertex before.
    """

    a: mi.Float
    b: mi.Float


class Sharing:
    """Which strategies count, and how they share what several of them find.

    Args:
        exponent: β; 0 lets each count in full, which is right for a strategy alone.
        camera_connections: Whether strategies with t = 1 take part.
        only: The strategy (s, t) whose light counts; None for all.
        hits: Whether strategies with s = 0 take part.
        inner: Whether strategies with s > 1 and t > 1 take part.
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
        """m(x)."""
        return x * x if self.exponent == 2 else x

    def none(self) -> Rivals:
        """Of a path that nothing else finds."""
        return Rivals(mi.Float(0), mi.Float(0))

    def arrive(self, rivals: Rivals, path: Path, vertex: Vertex) -> Rivals:
        """After the segment to a vertex."""
        distance, cos = vertex.length, vertex.cosine(path.ray.d)
        across = dr.select(cos > 0, dr.rcp(self.power(cos)), 0)
        return Rivals(rivals.a * self.power(distance * distance) * across, rivals.b * across)

    def leave(self, rivals: Rivals, vertex: Vertex, bounce: Bounce) -> Rivals:
        """After a vertex, in the direction of a bounce."""
        cos = vertex.cosine(bounce.ray.d)
        chance = dr.select(bounce.pdf > 0, dr.rcp(self.power(bounce.pdf)), 0)
        earlier = dr.select(bounce.specular, rivals.b, chance * self.sum(rivals, bounce.back))
        cut = dr.select(bounce.specular, 0, chance) if self.inner else dr.zeros(mi.Float)
        return Rivals(cut, self.power(cos) * earlier)

    def sum(self, rivals: Rivals, back: mi.Float) -> mi.Float:
        """A + b m(back): all rivals, over the density of the last vertex from the other end."""
        return dr.fma(rivals.b, self.power(back), rivals.a)

    def share(self, x: mi.Float, s: mi.UInt32 | int, t: mi.UInt32 | int) -> mi.Float:
        """Share of strategy (s, t), whose rivals add up to x."""
        share = dr.rcp(1 + x) if self.exponent else mi.Float(1)
        if self.only is not None:
            chosen = (mi.UInt32(s) == self.only[0]) & (mi.UInt32(t) == self.only[1])
            share = dr.select(chosen, share, 0)
        return share
