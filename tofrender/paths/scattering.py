"""Scattering by the BSDFs of surfaces."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import bsdf_to_world, intensity
from .choices import Choices
from .records import BSDFEval, BSDFSample, Connection, Path, Vertex
from .refraction import Glass
from .surfaces import spawn_ray, transmits


class Materials:
    """The BSDF of each surface, or one for all.

    Args:
        scene: The scene.
        material: BSDF of all surfaces; by default each has its own.
        importance: Whether paths come from the lights: refraction then does not compress what they
            carry, and shading normals count the other way round (Veach 1997, section 5.3).
        both_ways: Whether reverse densities are needed.
    """

    def __init__(
        self,
        scene: mi.Scene,
        material: mi.BSDF | None = None,
        importance: bool = False,
        both_ways: bool = False,
    ) -> None:
        self.material, self.importance, self.both_ways = material, importance, both_ways
        self.radiance = mi.BSDFContext()
        self.flux = mi.BSDFContext(mi.TransportMode.Importance)
        self.glass = Glass(scene) if material is None else None
        self.choices = Choices(scene) if material is None else None
        clear = material is None and transmits(scene, mi.BSDFFlags.DeltaTransmission)
        self.refracts = clear or (self.glass is not None and self.glass.exists)

    def bsdf(self, vertex: Vertex) -> Any:
        """Return the BSDF at a vertex."""
        return vertex.si.bsdf() if self.material is None else self.material

    def guide(self) -> None:
        """Return None: there is no guiding."""

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Return the path unchanged: BSDF samples are complete."""
        return path

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Return lanes whose BSDF has more than delta lobes."""
        return mi.has_flag(self.bsdf(vertex).flags(), mi.BSDFFlags.Smooth)

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the BSDF for a direction."""
        si, bsdf, wo = vertex.si, self.bsdf(vertex), vertex.si.to_local(direction)
        if self.importance:
            f, pdf_reverse = self._adjoint(bsdf, si, wo, active)
            f = bsdf_to_world(si, f, si.wi, wo)
            pdf = bsdf.pdf(self.radiance, si, wo, active)
        else:
            f, pdf = bsdf.eval_pdf(self.radiance, si, wo, active)
            f, pdf_reverse = (
                bsdf_to_world(si, f, wo, si.wi),
                self._pdf_reverse(bsdf, si, wo, active),
            )
        return BSDFEval(f, pdf, self._index_behind(bsdf, si, wo, active), pdf_reverse)

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, BSDFSample]:
        """Sample the BSDF, and evaluate a connection if there is one."""
        si, bsdf, bsdf_eval = vertex.si, self.bsdf(vertex), None
        xi, u = sampler.next_1d(), sampler.next_2d()
        if self.importance:
            bsdf_eval = (
                None
                if connection is None
                else self.eval_pdf(vertex, connection.direction, connection.active)
            )
            bs, weight = bsdf.sample(self.flux, si, xi, u, active)
        elif connection is None:
            bs, weight = bsdf.sample(self.radiance, si, xi, u, active)
        else:  # In one call, which is faster
            wo = si.to_local(connection.direction)
            f, pdf, bs, weight = bsdf.eval_pdf_sample(self.radiance, si, wo, xi, u, active)
            η = self._index_behind(bsdf, si, wo, connection.active)
            f = bsdf_to_world(si, f, wo, si.wi)
            bsdf_eval = BSDFEval(f, pdf, η, self._pdf_reverse(bsdf, si, wo, connection.active))
        specular = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        null = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
        if self.importance:
            # A sample of weight 0 has failed: other samples find what its direction scatters
            smooth = active & ~specular & (bs.pdf > 0) & dr.any(intensity(weight) > 0)
            f, pdf_reverse = self._adjoint(bsdf, si, bs.wo, smooth)
            weight = dr.select(
                specular,
                weight * _specular_adjoint(si, bs.wo, bs.eta),
                dr.select(smooth, f / bs.pdf, 0),
            )
            weight = bsdf_to_world(si, weight, si.wi, bs.wo)
        else:
            weight = bsdf_to_world(si, weight, bs.wo, si.wi)
            if self.choices is not None:
                weight *= self.choices.change(bsdf, bs.pdf, specular)
            pdf_reverse = self._pdf_reverse(bsdf, si, bs.wo, active & ~specular)
        ray = spawn_ray(si, si.to_world(bs.wo), specular)
        bsdf_sample = BSDFSample(
            ray, weight, bs.pdf, bs.eta, specular, pdf_reverse=pdf_reverse, null=null
        )
        return bsdf_eval, bsdf_sample

    def _index_behind(
        self, bsdf: Any, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Index of refraction on the side of a direction, relative to that on the path's side."""
        if self.glass is None or not self.glass.exists:
            return mi.Float(1)
        return self.glass.index_behind(bsdf, si, wo, active)

    def _pdf_reverse(
        self, bsdf: Any, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float | None:
        """Reverse density of `wo`, if needed [1/sr]."""
        if not self.both_ways:
            return None
        return bsdf.pdf(self.radiance, _seen_from(si, wo), si.wi, active)

    def _adjoint(
        self, bsdf: Any, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> tuple[Any, mi.Float]:
        """Evaluate the adjoint BSDF times cosine, for paths from lights.

        A camera path comes from `wo` and goes on to `si.wi`. Its cosine is the shading normal's,
        while light arrives at the surface, and leaves it, by the geometric one.

        Returns:
            The value, and the density of `si.wi` for that camera path [1/sr].
        """
        f, pdf = bsdf.eval_pdf(self.radiance, _seen_from(si, wo), si.wi, active)
        falls, leaves = (dr.abs(dr.dot(si.n, si.to_world(w))) for w in (si.wi, wo))
        return f * dr.select(falls > 0, leaves / falls, 0), pdf


def _seen_from(si: mi.SurfaceInteraction3f, wi: mi.Vector3f) -> mi.SurfaceInteraction3f:
    """Copy a surface interaction, with another incident direction."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wi
    return other


def _specular_adjoint(si: mi.SurfaceInteraction3f, wo: mi.Vector3f, η: mi.Float) -> mi.Float:
    """Return the correction of delta lobes for shading normals, as in `Materials._adjoint`.

    The shading normal is along wi + η wo; light that goes straight on has none.
    """
    normal = dr.fma(wo, η, si.wi)
    straight = dr.squared_norm(si.wi + wo) < 1e-8
    onto, off = dr.abs(dr.dot(normal, si.wi)), dr.abs(dr.dot(normal, wo))
    falls, leaves = (dr.abs(dr.dot(si.n, si.to_world(w))) for w in (si.wi, wo))
    ratio = onto * leaves / (falls * off)
    return dr.select(straight, 1, dr.select((falls > 0) & (off > 0), ratio, 0))
