"""Scattering: how paths go on from surfaces."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from .records import Bounce, Connection, Path, Vertex
from .refraction import RoughGlass
from .space import leave
from .surfaces import transmits


class Materials:
    """Every surface by its own material, or all by one.

    Args:
        scene: The scene.
        material: What all surfaces are made of; by default each of its own.
    """

    def __init__(self, scene: mi.Scene, material: mi.BSDF | None = None) -> None:
        self.material = material
        self.glass = RoughGlass(scene) if material is None else None
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

    def eval_pdf(
        self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool
    ) -> tuple[Any, mi.Float]:
        """BSDF times cosine, and the density of a direction [1/sr]."""
        wo = vertex.si.to_local(direction)
        return self.bsdf(vertex).eval_pdf(mi.BSDFContext(), vertex.si, wo, active)

    def scatter(
        self, vertex: Vertex, link: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> Bounce:
        """Towards a connection, if there is one, and where the material chooses to go."""
        si, bsdf, ctx = vertex.si, self.bsdf(vertex), mi.BSDFContext()
        f, pdf_f, η_f = mi.UnpolarizedSpectrum(0), mi.Float(0), mi.Float(1)
        xi, u = sampler.next_1d(), sampler.next_2d()
        if link is None:
            bs, weight = bsdf.sample(ctx, si, xi, u, active)
        else:
            wo = si.to_local(link.direction)
            f, pdf_f, bs, weight = bsdf.eval_pdf_sample(ctx, si, wo, xi, u, active)
            if self.glass is not None and self.glass.exists:
                η_f = self.glass.index_behind(bsdf, si, wo, link.active)
        specular = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        ray = leave(si, si.to_world(bs.wo), specular)
        return Bounce(f, pdf_f, η_f, ray, weight, bs.pdf, bs.eta, specular)
