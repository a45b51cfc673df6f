# pyright: reportArgumentType=false, reportCallIssue=false
"""Emitters and the vertices of a path that came from one."""

from __future__ import annotations

from copy import copy
from typing import Any

import drjit as dr
import mitsuba as mi

from ...signals.polarisation import apply_light_path
from ..emission import Emission
from ..lens import Lens
from ..protocols import Scattering
from ..records import Bounce, Connection, Hit, Path, Turn, Vertex
from ..sharing import Rivals, Sharing
from .camera import LightPath
from .scene_lights import SceneLights


class LightPaths(SceneLights):
    """Emitters, and each vertex of a light path beside: all strategies with t > 1.

    Args:
        scene: The scene.
        sensor: As in `SceneLights`.
        lens: Its lens, where the paths start.
        emission: How light starts.
        adjoint: How paths from the lights go on.
        sharing: Which strategies count.
        max_depth: Longest path in segments.
        hide_emitters, discard_direct_light: As in `SceneLights`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        lens: Lens,
        emission: Emission,
        adjoint: Scattering,
        sharing: Sharing,
        max_depth: int,
        hide_emitters: bool = False,
        discard_direct_light: bool = False,
    ) -> None:
        super().__init__(scene, sensor, hide_emitters, discard_direct_light)
        self.lens, self.emission, self.sharing = lens, emission, sharing
        self.adjoint, self.max_depth = adjoint, max_depth
        self.light: LightPath | None = None
        self.weight, self.direction = mi.UnpolarizedSpectrum(0), mi.Vector3f(0)

    def beside(self, direction: mi.Vector3f, light: LightPath | None, weight: Any) -> LightPaths:
        """For camera rays of a direction, and light paths that started with a weight."""
        other = copy(self)
        other.direction, other.light, other.weight = direction, light, weight
        return other

    def memory(self) -> Rivals:
        """Of the lens."""
        rivals = self.sharing.none()
        if self.sharing.camera_connections and self.sharing.exponent:
            rivals.a = dr.rcp(self.sharing.power(self.lens.density(self.direction)))
        return rivals

    def remember(self, path: Path, vertex: Vertex, active: mi.Bool) -> Rivals:
        """The rivals at a vertex."""
        return self.sharing.arrive(path.memory, path, vertex)

    def leave(self, path: Path, vertex: Vertex, bounce: Bounce) -> Rivals:
        """The rivals of the next segment."""
        if not self.sharing.exponent:
            return path.memory
        return self.sharing.leave(path.memory, vertex, bounce)

    # --------------------------------------------------------------------- s = 0, and s = 1

    def share_of_hit(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Share of the strategy (0, t)."""
        x, power = mi.Float(0), self.sharing.power
        if self.sharing.exponent:
            si = vertex.si
            ds = mi.DirectionSample3f(self.scene, si=si, ref=path.prev)
            emitted = self.emission.density(path.prev, ds, hit.pdf, vertex.length)
            x = power(hit.pdf) * path.memory.a + power(emitted) * path.memory.b
        return self.sharing.share(x, 0, path.depth + 2)

    def linked(self, vertex: Vertex, ds: Any, weight: Any, active: mi.Bool) -> Connection:
        """A connection that knows how often light starts that way."""
        link = super().linked(vertex, ds, weight, active)
        if self.sharing.exponent:
            link.rival = self.emission.ratio(ds.emitter, ds, ds.pdf, ds.dist)
        return link

    def share_of_link(self, path: Path, vertex: Vertex, link: Connection, turn: Turn) -> mi.Float:
        """Share of the strategy (1, t), or of that of a kept vertex."""
        if isinstance(link.rival, _Other):
            return self._share_of_kept(path, vertex, link, turn)
        x = mi.Float(0)
        if self.sharing.exponent:
            power = self.sharing.power
            cos = vertex.cosine(link.direction)
            x = power(cos / link.rival) * self.sharing.sum(path.memory, turn.back)
            if self.sharing.hits:
                x += dr.select(link.delta, 0, power(turn.pdf / link.pdf))
        return self.sharing.share(x, 1, path.depth + 2)

    # ---------------------------------------------------------------------------- s > 1

    def more_links(self, path: Path, first: Connection) -> mi.UInt32 | None:
        """As many as vertices are kept, while paths are not too long."""
        if self.light is None:
            return None
        room = mi.Int32(self.max_depth - 2) - mi.Int32(path.depth)
        return dr.minimum(self.light.count, mi.UInt32(dr.maximum(room, 0)))

    def link(
        self,
        k: mi.UInt32,
        first: Connection,
        vertex: Vertex,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Vertex number k of the light path."""
        assert self.light is not None
        active = active & (k < self.light.count)
        kept = self.light.vertices.read(dr.select(active, k, 0), active)
        # What was never written is no shape, and would be called
        kept.si.shape = dr.select(active, kept.si.shape, dr.zeros(mi.ShapePtr))
        kept.si.instance = dr.select(active, kept.si.instance, dr.zeros(mi.ShapePtr))
        to_vertex = kept.si.p - vertex.si.p
        d2 = dr.squared_norm(to_vertex)
        distance = dr.sqrt(d2)
        d = to_vertex / distance
        active = active & (d2 > 0) & (kept.depth + path.depth + 3 <= self.max_depth)
        there = kept.vertex(distance, active)
        turn = self.adjoint.turn(there, -d, active)
        weight = apply_light_path(self.weight, kept.β, turn.f) / d2
        return Connection(
            point=kept.si.p,
            direction=d,
            weight=dr.select(active, weight, 0),
            pdf=turn.pdf,
            delta=mi.Bool(True),
            length=distance + kept.opl / (kept.η * turn.η),
            active=active,
            clear=mi.Bool(False),
            rival=_Other(kept, there, turn.back),
        )

    def _share_of_kept(self, path, vertex, link, turn) -> mi.Float:
        x, kept, sharing = mi.Float(0), link.rival.kept, self.sharing
        if sharing.exponent:
            d2 = dr.squared_norm(kept.si.p - vertex.si.p)
            here = turn.pdf * link.rival.vertex.cosine(link.direction) / d2
            there = link.pdf * vertex.cosine(link.direction) / d2
            x = sharing.power(here) * sharing.sum(Rivals(kept.a, kept.b), link.rival.back)
            x += sharing.power(there) * sharing.sum(path.memory, turn.back)
        return self.sharing.share(x, kept.depth + 2, path.depth + 2)


class _Other:
    """The far end of a connection: a kept vertex, and its density of the way back."""

    def __init__(self, kept: Any, vertex: Vertex, back: Any) -> None:
        self.kept, self.vertex, self.back = kept, vertex, back
