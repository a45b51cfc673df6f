# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""Scattering: how paths go on from surfaces."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import bsdf_to_world, intensity
from .choices import Choices
from .records import Bounce, Connection, Path, Turn, Vertex
from .refraction import Glass
from .surfaces import leave, transmits


class Materials:
    """Every surface by its own material, or all by one.

    Args:
        scene: The scene.
        material: What all surfaces are made of; by default each of its own.
        importance: Whether paths come from the lights: refraction then does not compress what they
            carry, and shading normals count the other way round (Veach 1997, section 5.3).
        both_ways: Whether densities of the way back are asked for.
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
        """The material at a vertex."""
        return vertex.si.bsdf() if self.material is None else self.material

    def guide(self) -> None:
        """Nothing: a material does not remember."""
        return None

    def arrive(self, path: Path, vertex: Vertex) -> Path:
        """Nothing: a material's choice does not depend on what it finds."""
        return path

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Whether a material has a part that connections can find."""
        return mi.has_flag(self.bsdf(vertex).flags(), mi.BSDFFlags.Smooth)

    def turn(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> Turn:
        """What the material makes of a direction."""
        si, bsdf, wo = vertex.si, self.bsdf(vertex), vertex.si.to_local(direction)
        if self.importance:
            f, back = self._adjoint(bsdf, si, wo, active)
            f = bsdf_to_world(si, f, si.wi, wo)
            pdf = bsdf.pdf(self.radiance, si, wo, active)
        else:
            f, pdf = bsdf.eval_pdf(self.radiance, si, wo, active)
            f, back = bsdf_to_world(si, f, wo, si.wi), self._pdf_back(bsdf, si, wo, active)
        return Turn(f, pdf, self._index_behind(bsdf, si, wo, active), back)

    def scatter(
        self, vertex: Vertex, link: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, Bounce]:
        """Towards a connection, if there is one, and where the material chooses to go."""
        si, bsdf, turn = vertex.si, self.bsdf(vertex), None
        xi, u = sampler.next_1d(), sampler.next_2d()
        if self.importance:
            turn = None if link is None else self.turn(vertex, link.direction, link.active)
            bs, weight = bsdf.sample(self.flux, si, xi, u, active)
        elif link is None:
            bs, weight = bsdf.sample(self.radiance, si, xi, u, active)
        else:  # In one call, which is faster
            wo = si.to_local(link.direction)
            f, pdf, bs, weight = bsdf.eval_pdf_sample(self.radiance, si, wo, xi, u, active)
            η = self._index_behind(bsdf, si, wo, link.active)
            f = bsdf_to_world(si, f, wo, si.wi)
            turn = Turn(f, pdf, η, self._pdf_back(bsdf, si, wo, link.active))
        specular = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        straight = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
        if self.importance:
            # A choice without weight has failed: what its direction scatters, others find
            smooth = active & ~specular & (bs.pdf > 0) & dr.any(intensity(weight) > 0)
            f, back = self._adjoint(bsdf, si, bs.wo, smooth)
            weight = dr.select(
                specular,
                weight * _bent(si, bs.wo, bs.eta),
                dr.select(smooth, f / bs.pdf, 0),
            )
            weight = bsdf_to_world(si, weight, si.wi, bs.wo)
        else:
            weight = bsdf_to_world(si, weight, bs.wo, si.wi)
            if self.choices is not None:
                weight *= self.choices.change(bsdf, bs.pdf, specular)
            back = self._pdf_back(bsdf, si, bs.wo, active & ~specular)
        ray = leave(si, si.to_world(bs.wo), specular)
        bounce = Bounce(ray, weight, bs.pdf, bs.eta, specular, back=back, straight=straight)
        return turn, bounce

    def _index_behind(
        self, bsdf: Any, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Index of refraction on the side of a direction, over that on the path's side."""
        if self.glass is None or not self.glass.exists:
            return mi.Float(1)
        return self.glass.index_behind(bsdf, si, wo, active)

    def _pdf_back(
        self, bsdf: Any, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float | None:
        """Density of the way back from `wo`, if that is asked for."""
        if not self.both_ways:
            return None
        return bsdf.pdf(self.radiance, _seen_from(si, wo), si.wi, active)

    def _adjoint(
        self, bsdf: Any, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> tuple[Any, mi.Float]:
        """BSDF times cosine of a path from a light, as a path from the camera would find it.

        That one comes from `wo` and goes on to `si.wi`. Its cosine is the shading normal's, while
        light falls on the surface, and leaves it, by the geometric one.

        Returns:
            The BSDF, and the density of `si.wi` for that path [1/sr].
        """
        f, pdf = bsdf.eval_pdf(self.radiance, _seen_from(si, wo), si.wi, active)
        falls, leaves = (dr.abs(dr.dot(si.n, si.to_world(w))) for w in (si.wi, wo))
        return f * dr.select(falls > 0, leaves / falls, 0), pdf


def _seen_from(si: mi.SurfaceInteraction3f, wi: mi.Vector3f) -> mi.SurfaceInteraction3f:
    """The surface point of a path that comes from another direction."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wi
    return other


def _bent(si: mi.SurfaceInteraction3f, wo: mi.Vector3f, η: mi.Float) -> mi.Float:
    """What a mirror's or glass's shading normal makes of light, beside its reflectance.

    The normal is along wi + η wo, whatever has turned it; light that goes straight on has none.
    """
    normal = dr.fma(wo, η, si.wi)
    straight = dr.squared_norm(si.wi + wo) < 1e-8
    onto, off = dr.abs(dr.dot(normal, si.wi)), dr.abs(dr.dot(normal, wo))
    falls, leaves = (dr.abs(dr.dot(si.n, si.to_world(w))) for w in (si.wi, wo))
    ratio = onto * leaves / (falls * off)
    return dr.select(straight, 1, dr.select((falls > 0) & (off > 0), ratio, 0))
