# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAttributeAccessIssue=false, reportReturnType=false
"""Points where media scatter, and how paths go on from them by their phase functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..scenes.media import FLAKES, RAYLEIGH, has_flakes
from ..signals.polarisation import depolarise, rayleigh
from .protocols import Scattering
from .records import Bounce, Connection, Path, Turn, Vertex


@dataclass
class Scattered:
    """A point in a medium: the `inside` of a vertex.

    Attributes:
        mei: The point, with what the medium is like there.
        here: Lanes whose vertex is such a point; the others are on surfaces.
    """

    mei: mi.MediumInteraction3f
    here: mi.Bool

    @classmethod
    def again(cls, si: mi.SurfaceInteraction3f, medium: mi.MediumPtr) -> Scattered:
        """A point that is kept as `as_surface` gave it, with its `medium`."""
        mei: Any = dr.zeros(mi.MediumInteraction3f, dr.width(medium))
        mei.p, mei.t, mei.wi, mei.sh_frame = si.p, si.t, si.wi, si.sh_frame
        mei.time, mei.wavelengths, mei.medium = si.time, si.wavelengths, medium
        return cls(mei, medium != None)  # noqa: E711 (a Dr.Jit mask)

    @property
    def medium(self) -> mi.MediumPtr:
        """The medium that scatters, null on surfaces."""
        return dr.select(self.here, self.mei.medium, dr.zeros(mi.MediumPtr))


def as_surface(
    si: mi.SurfaceInteraction3f, mei: mi.MediumInteraction3f, here: mi.Bool
) -> mi.SurfaceInteraction3f:
    """The surface point, or a point in a medium as one without a surface and without normal."""
    point: Any = dr.zeros(mi.SurfaceInteraction3f, dr.width(mei))
    point.p, point.t, point.time, point.wavelengths = mei.p, mei.t, mei.time, mei.wavelengths
    point.wi, point.sh_frame = mei.wi, mei.sh_frame
    return dr.select(here, point, si)


class Phases:
    """Scattering in media by their phase functions, and on surfaces as before.

    Args:
        surfaces: How paths go on from surfaces.
        importance: Whether paths come from the lights.
        both_ways: Whether densities of the way back are asked for.
        connects: Whether all media connect, whatever their `sample_emitters` says.
        media: The media, of which some may polarise what they scatter.
    """

    def __init__(
        self,
        surfaces: Scattering,
        importance: bool = False,
        both_ways: bool = False,
        connects: bool = False,
        media: Sequence[mi.Medium] = (),
    ) -> None:
        self.surfaces, self.both_ways, self.connects = surfaces, both_ways, connects
        polarising = [m for m in media if m.phase_function().class_name() == RAYLEIGH]
        self.polarising = polarising if mi.is_polarized else []
        self.importance, flakes = importance, [m for m in media if has_flakes(m)]
        self.flakes = bool(flakes)
        for medium in flakes if importance else ():
            if medium.phase_function().class_name() != FLAKES:
                raise ValueError(
                    f"{medium.id() or medium.class_name()}.phase = blendphase: must have no sggx "
                    "for paths from lights, from which it scatters otherwise"
                )
        mode = mi.TransportMode.Importance if importance else mi.TransportMode.Radiance
        self.context = mi.PhaseFunctionContext(None, mode)

    @property
    def refracts(self) -> bool:
        """Whether surfaces do."""
        return self.surfaces.refracts

    def guide(self) -> Any:
        """That of the surfaces."""
        return self.surfaces.guide()

    def arrive(self, path: Path, vertex: Vertex) -> Path:
        """What surfaces want to know."""
        return self.surfaces.arrive(path, vertex)

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Points of media that ask for connections, and what surfaces say."""
        return self._connects(vertex) | self.surfaces.smooth(vertex)

    def _connects(self, vertex: Vertex) -> mi.Bool:
        """Points of media whose `sample_emitters` is not off."""
        if self.connects:
            return vertex.inside.here
        return vertex.inside.here & vertex.inside.mei.medium.use_emitter_sampling()

    def turn(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> Turn:
        """What the phase function, or the surface, makes of a direction."""
        turn = self.surfaces.turn(vertex, direction, active & ~vertex.inside.here)
        return self._in_both(turn, vertex, direction, active)

    def _in_both(self, turn: Turn, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> Turn:
        """What the phase function makes of a direction in media; on surfaces, what they do."""
        here, mei = vertex.inside.here, vertex.inside.mei
        phase = mei.medium.phase_function()
        f, pdf = phase.eval_pdf(self.context, mei, direction, active & here)
        back = turn.back
        if self.both_ways:
            back = dr.select(here, self._pdf_back(mei, direction, active & here), back)
        return Turn(
            dr.select(here, self._scattered(f, mei, direction), turn.f),
            dr.select(here, pdf, turn.pdf),
            dr.select(here, 1, turn.η),
            back,
        )

    def scatter(
        self, vertex: Vertex, link: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, Bounce]:
        """Towards a connection, if there is one, and where phase function or surface choose."""
        here, mei = vertex.inside.here, vertex.inside.mei
        on_surface = None if link is None else link.only(~here)
        turn, bounce = self.surfaces.scatter(vertex, on_surface, sampler, active & ~here)
        phase = mei.medium.phase_function()
        if link is not None:
            turn = self._in_both(turn, vertex, link.direction, link.active)
        xi, u = sampler.next_1d(), sampler.next_2d()
        at = mei
        if self.flakes:
            at = mi.MediumInteraction3f(mei)
            at.sh_frame = _symmetric_frame(mei.wi)
        wo, weight, pdf = phase.sample(self.context, at, xi, u, active & here)
        ray = dr.select(here, mei.spawn_ray(wo), bounce.ray)
        back = bounce.back
        if self.both_ways:
            back = dr.select(here, self._pdf_back(mei, wo, active & here), back)
        return turn, Bounce(
            ray,
            dr.select(here, self._scattered(weight, mei, wo), bounce.weight),
            dr.select(here, pdf, bounce.pdf),
            dr.select(here, 1, bounce.η),
            dr.select(here, ~self._connects(vertex), bounce.specular),
            bounce.guide,
            back,
            ~here & bounce.straight,
        )

    def _scattered(self, f: Any, mei: mi.MediumInteraction3f, wo: mi.Vector3f) -> Any:
        """What the light becomes: unpolarised, but for media that polarise it."""
        factor = depolarise(f)
        comes, goes = (mei.wi, wo) if self.importance else (wo, mei.wi)
        for medium in self.polarising:
            here = mei.medium == mi.MediumPtr(medium)
            factor = dr.select(here, rayleigh(f, comes, goes), factor)
        return factor

    def _pdf_back(self, mei: mi.MediumInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """Density of where a path has come from, for one that comes from `wo` [1/sr]."""
        other = mi.MediumInteraction3f(mei)
        other.wi, came = wo, mei.wi
        other.sh_frame = mi.Frame3f(wo)
        return other.medium.phase_function().eval_pdf(self.context, other, came, active)[1]


def _symmetric_frame(n: mi.Vector3f) -> mi.Frame3f:
    """A frame around `n` whose matrix is its own transpose.

    Mitsuba 3.9 turns an `sggx` by the transpose of the frame that it samples in.
    """
    side = dr.select(n.z < 0, mi.Float(-1), 1)
    x, y, z = mi.Vector3f(side, 0, 0), mi.Vector3f(0, side, 0), mi.Vector3f(0, 0, side)
    v = side * (n + z) / (1 + dr.abs(n.z))
    return mi.Frame3f(v * n.x - x, v * n.y - y, n)
