"""Scattering by the phase functions of participating media."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..paths.protocols import Scattering, ScatteringWrapper
from ..paths.records import BSDFEval, BSDFSample, Connection, MediumPoint, Vertex
from ..scenes.media import FLAKES, RAYLEIGH, has_flakes
from ..signals.polarization import depolarize, rayleigh


def stored_medium_point(si: mi.SurfaceInteraction3f, medium: mi.MediumPtr) -> MediumPoint:
    """Restore the point of a medium from a stored result of `as_surface` and its medium."""
    mei = dr.zeros(mi.MediumInteraction3f, dr.width(medium))
    mei.p = si.p
    mei.t = si.t
    mei.wi = si.wi
    mei.sh_frame = si.sh_frame
    mei.time = si.time
    mei.wavelengths = si.wavelengths
    mei.medium = medium
    return MediumPoint(mei, medium != None)  # noqa: E711 (a Dr.Jit mask)


def as_surface(
    si: mi.SurfaceInteraction3f, mei: mi.MediumInteraction3f, here: mi.Bool
) -> mi.SurfaceInteraction3f:
    """Merge surface and medium interactions into one record.

    Args:
        si: Surface interactions.
        mei: Medium interactions.
        here: Lanes with a medium interaction. Shape and normal are zero in these lanes.
    """
    point = dr.zeros(mi.SurfaceInteraction3f, dr.width(mei))
    point.p = mei.p
    point.t = mei.t
    point.time = mei.time
    point.wavelengths = mei.wavelengths
    point.wi = mei.wi
    point.sh_frame = mei.sh_frame
    return dr.select(here, point, si)


class Phases(ScatteringWrapper):
    """Phase functions in media, combined with another scattering on surfaces.

    Args:
        surfaces: Scattering on surfaces.
        media: The media of the scene.
        importance: Whether paths start at lights.
        both_ways: Whether reverse densities are computed.
        connects: Whether all media connect to emitters, even if their `sample_emitters` is false.
    """

    def __init__(
        self,
        surfaces: Scattering,
        media: Sequence[mi.Medium] = (),
        importance: bool = False,
        both_ways: bool = False,
        connects: bool = False,
    ) -> None:
        super().__init__(surfaces)
        self.both_ways = both_ways
        self.connects = connects
        self.importance = importance

        # Media that polarize light
        polarizing = [m for m in media if m.phase_function().class_name() == RAYLEIGH]
        self.polarizing = polarizing if mi.is_polarized else []

        # Media with flakes, which Mitsuba does not evaluate correctly in a blend on light paths
        flakes = [m for m in media if has_flakes(m)]
        self.flakes = bool(flakes)
        for medium in flakes if importance else ():
            if medium.phase_function().class_name() != FLAKES:
                raise ValueError(
                    f"{medium.id() or medium.class_name()}.phase = blendphase: sggx inside a blend "
                    "is not supported for paths from lights. Use sggx alone, or transient_volpath"
                )
        mode = mi.TransportMode.Importance if importance else mi.TransportMode.Radiance
        self.context = mi.PhaseFunctionContext(None, mode)

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Return the lanes on smooth surfaces, or at points of media with emitter sampling."""
        return self._connects(vertex) | self.inner.smooth(vertex)

    def _connects(self, vertex: Vertex) -> mi.Bool:
        """Return the lanes at points of media with emitter sampling."""
        if self.connects:
            return vertex.medium_point.here
        return vertex.medium_point.here & vertex.medium_point.mei.medium.use_emitter_sampling()

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the phase function in media, or the BSDF on surfaces, for a direction."""
        bsdf_eval = self.inner.eval_pdf(vertex, direction, active & ~vertex.medium_point.here)
        return self._merge_phase_function(bsdf_eval, vertex, direction, active)

    def _merge_phase_function(
        self, bsdf_eval: BSDFEval, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool
    ) -> BSDFEval:
        """Evaluate the phase function in media, and keep `bsdf_eval` on surfaces."""
        # Evaluate the phase function
        here = vertex.medium_point.here
        mei = vertex.medium_point.mei
        phase = mei.medium.phase_function()
        f, pdf = phase.eval_pdf(self.context, mei, direction, active & here)
        pdf_reverse = bsdf_eval.pdf_reverse
        if self.both_ways:
            reverse = self._pdf_reverse(mei, direction, active & here)
            pdf_reverse = dr.select(here, reverse, pdf_reverse)

        # Merge with the BSDF
        return BSDFEval(
            f=dr.select(here, self._scattered(f, mei, direction), bsdf_eval.f),
            pdf=dr.select(here, pdf, bsdf_eval.pdf),
            η=dr.select(here, 1, bsdf_eval.η),
            pdf_reverse=pdf_reverse,
        )

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample the phase function or the BSDF, and evaluate a connection if it is not None."""
        # --------------------- Evaluate the connection, sample the BSDF ---------------------

        here = vertex.medium_point.here
        mei = vertex.medium_point.mei
        on_surface = connection and replace(connection, active=connection.active & ~here)
        bsdf_eval, bsdf_sample = self.inner.sample(vertex, on_surface, sampler, active & ~here)
        if connection is not None:
            bsdf_eval = self._merge_phase_function(
                bsdf_eval, vertex, connection.direction, connection.active
            )

        # --------------------- Sample the phase function ---------------------

        xi = sampler.next_1d()
        u = sampler.next_2d()
        at = mei
        if self.flakes:
            at = mi.MediumInteraction3f(mei)
            at.sh_frame = _symmetric_frame(mei.wi)
        wo, weight, pdf = mei.medium.phase_function().sample(self.context, at, xi, u, active & here)
        ray = dr.select(here, mei.spawn_ray(wo), bsdf_sample.ray)
        pdf_reverse = bsdf_sample.pdf_reverse
        if self.both_ways:
            pdf_reverse = dr.select(here, self._pdf_reverse(mei, wo, active & here), pdf_reverse)

        # --------------------- Merge both samples ---------------------

        return bsdf_eval, replace(
            bsdf_sample,
            ray=ray,
            weight=dr.select(here, self._scattered(weight, mei, wo), bsdf_sample.weight),
            pdf=dr.select(here, pdf, bsdf_sample.pdf),
            η=dr.select(here, 1, bsdf_sample.η),
            specular=dr.select(here, ~self._connects(vertex), bsdf_sample.specular),
            pdf_reverse=pdf_reverse,
            null=~here & bsdf_sample.null,
        )

    def _scattered(
        self, f: mi.Spectrum, mei: mi.MediumInteraction3f, wo: mi.Vector3f
    ) -> mi.Spectrum:
        """Return the Mueller matrix of scattering: a depolarizer, or Rayleigh scattering."""
        factor = depolarize(f)
        incident, outgoing = (mei.wi, wo) if self.importance else (wo, mei.wi)
        for medium in self.polarizing:
            here = mei.medium == mi.MediumPtr(medium)
            factor = dr.select(here, rayleigh(f, incident, outgoing), factor)
        return factor

    def _pdf_reverse(
        self, mei: mi.MediumInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Return the density of sampling the reverse direction, from `wo` to `mei.wi` [1/sr]."""
        other = mi.MediumInteraction3f(mei)
        other.wi = wo
        previous = mei.wi
        other.sh_frame = mi.Frame3f(wo)
        return other.medium.phase_function().eval_pdf(self.context, other, previous, active)[1]


def _symmetric_frame(n: mi.Vector3f) -> mi.Frame3f:
    """Return a frame around `n` with a symmetric matrix.

    Mitsuba 3.9 rotates samples of `sggx` by the transpose of the frame. A symmetric frame gives the
    correct result.
    """
    side = dr.select(n.z < 0, mi.Float(-1), 1)
    x = mi.Vector3f(side, 0, 0)
    y = mi.Vector3f(0, side, 0)
    z = mi.Vector3f(0, 0, side)
    v = side * (n + z) / (1 + dr.abs(n.z))
    return mi.Frame3f(v * n.x - x, v * n.y - y, n)
