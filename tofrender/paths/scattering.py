"""Scattering by the BSDFs of surfaces."""

from __future__ import annotations

from functools import reduce

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import bsdf_to_world, intensity
from .protocols import Scattering
from .records import BSDFEval, BSDFSample, Connection, Vertex
from .refraction import Glass
from .surfaces import bsdfs_in, changing, has_lobes, materials, spawn_ray

MASK, BLEND = "MaskBSDF", "BlendBSDF"


class Materials(Scattering):
    """The BSDF of each surface, or one for all.

    With `importance`, paths come from lights: refraction then does not compress their throughput,
    and shading normals have the adjoint correction (Veach 1997, section 5.3). With `both_ways`,
    there are reverse densities. With `lobes`, only these lobes of each BSDF are sampled and
    evaluated, e.g. `mi.BSDFFlags.Delta`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        material: mi.BSDF | None = None,
        importance: bool = False,
        both_ways: bool = False,
        lobes: mi.BSDFFlags | None = None,
    ) -> None:
        self.material, self.importance, self.both_ways = material, importance, both_ways
        self.context = mi.BSDFContext()
        self.adjoint_context = mi.BSDFContext(mi.TransportMode.Importance)
        if lobes is not None:
            self.context.type_mask = int(lobes)
            self.adjoint_context.type_mask = int(lobes)
        self.glass = Glass(scene) if material is None else None
        self.choices = Choices(scene) if material is None else None
        clear = material is None and has_lobes(scene, mi.BSDFFlags.DeltaTransmission)
        self.refracts = clear or (self.glass is not None and self.glass.exists)

    def bsdf(self, vertex: Vertex) -> mi.BSDFPtr:
        """Return the BSDF at a vertex."""
        return vertex.si.bsdf() if self.material is None else self.material

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Return lanes whose BSDF has more than delta lobes."""
        return mi.has_flag(self.bsdf(vertex).flags(), mi.BSDFFlags.Smooth)

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the BSDF for a direction."""
        si, bsdf, wo = vertex.si, self.bsdf(vertex), vertex.si.to_local(direction)
        if self.importance:
            f, pdf_reverse = self._adjoint(bsdf, si, wo, active)
            f = bsdf_to_world(si, f, si.wi, wo)
            pdf = bsdf.pdf(self.context, si, wo, active)
        else:
            f, pdf = bsdf.eval_pdf(self.context, si, wo, active)
            f, pdf_reverse = (
                bsdf_to_world(si, f, wo, si.wi),
                self._pdf_reverse(bsdf, si, wo, active),
            )
        return BSDFEval(f, pdf, self._index_behind(bsdf, si, wo, active), pdf_reverse)

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample the BSDF, and evaluate a connection if there is one."""
        si, bsdf, bsdf_eval = vertex.si, self.bsdf(vertex), None
        xi, u = sampler.next_1d(), sampler.next_2d()

        # Sample the BSDF
        if self.importance:
            bsdf_eval = self.eval_connection(vertex, connection)
            bs, weight = bsdf.sample(self.adjoint_context, si, xi, u, active)
        elif connection is None:
            bs, weight = bsdf.sample(self.context, si, xi, u, active)
        else:  # In one call, which is faster
            wo = si.to_local(connection.direction)
            f, pdf, bs, weight = bsdf.eval_pdf_sample(self.context, si, wo, xi, u, active)
            η = self._index_behind(bsdf, si, wo, connection.active)
            f = bsdf_to_world(si, f, wo, si.wi)
            bsdf_eval = BSDFEval(f, pdf, η, self._pdf_reverse(bsdf, si, wo, connection.active))
        specular = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        null = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)

        # Weight the sample
        if self.importance:
            # A sample of weight 0 has failed, whatever its direction would scatter
            smooth = active & ~specular & (bs.pdf > 0) & dr.any(intensity(weight) > 0)
            f, pdf_reverse = self._adjoint(bsdf, si, bs.wo, smooth)
            delta = weight * _specular_adjoint(si, bs.wo, bs.eta)
            weight = dr.select(specular, delta, dr.select(smooth, f / bs.pdf, 0))
            weight = bsdf_to_world(si, weight, si.wi, bs.wo)
        else:
            weight = bsdf_to_world(si, weight, bs.wo, si.wi)
            if self.choices is not None:
                weight *= self.choices.change(bsdf, bs.pdf, specular)
            pdf_reverse = self._pdf_reverse(bsdf, si, bs.wo, active & ~specular)
        ray = spawn_ray(si, si.to_world(bs.wo), specular)
        return bsdf_eval, BSDFSample(
            ray, weight, bs.pdf, bs.eta, specular, pdf_reverse=pdf_reverse, null=null
        )

    def _index_behind(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Return the index on the side of a direction, relative to that on the path's side."""
        if self.glass is None or not self.glass.exists:
            return mi.Float(1)
        return self.glass.index_behind(bsdf, si, wo, active)

    def _pdf_reverse(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float | None:
        """Return the reverse density of `wo`, if needed [1/sr]."""
        if not self.both_ways:
            return None
        return bsdf.pdf(self.context, _seen_from(si, wo), si.wi, active)

    def _adjoint(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Evaluate the adjoint BSDF times cosine, and the density of the camera path [1/sr].

        That path comes from `wo` and goes on to `si.wi`. Its cosine is the shading normal's, while
        light arrives at the surface, and leaves it, by the geometric one.
        """
        f, pdf = bsdf.eval_pdf(self.context, _seen_from(si, wo), si.wi, active)
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


class Choices:
    """Derivatives that the BSDFs of a scene leave out of their sample weights.

    A BSDF that chooses a delta lobe, such as reflection or refraction, with the probability p
    weights its sample by f/p. A derivative needs that of f alone, as the choice itself stays.
    Mitsuba's BSDFs differ: p has a derivative in both weight and returned density, or in neither.
    The weight times p over its value is right for all but masks, whose p has a derivative in the
    returned density only.
    """

    def __init__(self, scene: mi.Scene) -> None:
        kinds = {bsdf: [part.class_name() for part in bsdfs_in(bsdf)] for bsdf in materials(scene)}
        self._masks = [bsdf for bsdf, parts in kinds.items() if MASK in parts]

    def change(self, bsdf: mi.BSDFPtr, pdf: mi.Float, specular: mi.Bool) -> mi.Float:
        """Return 1, with the derivative that a weight lacks."""
        mask = reduce(lambda found, each: found | (bsdf == mi.BSDFPtr(each)), self._masks, False)
        return dr.replace_grad(mi.Float(1), changing(pdf, specular & ~mi.Bool(mask)))
