"""Scattering by the BSDFs of surfaces."""

from __future__ import annotations

from functools import reduce

import drjit as dr
import mitsuba as mi

from ..signals.polarization import bsdf_to_world, intensity
from .protocols import Scattering
from .records import BSDFEval, BSDFSample, Connection, Vertex
from .refraction import Glass
from .surfaces import bsdfs_in, changing, has_lobes, materials, spawn_ray

# Class names of BSDFs in Mitsuba
MASK = "MaskBSDF"
BLEND = "BlendBSDF"


class Materials(Scattering):
    """Scattering by the BSDF of each surface, or by one BSDF for all surfaces.

    Args:
        scene: The scene.
        material: BSDF for all surfaces, None for the BSDF of each surface.
        importance: Whether paths start at lights. Refraction then does not compress their
            throughput, and shading normals have the adjoint correction (Veach 1997, section 5.3).
        both_ways: Whether to compute reverse densities, see `BSDFEval.pdf_reverse`.
        lobes: Lobes of each BSDF to sample and to evaluate, e.g. `mi.BSDFFlags.Delta`. None for all
            lobes.
    """

    def __init__(
        self,
        scene: mi.Scene,
        material: mi.BSDF | None = None,
        importance: bool = False,
        both_ways: bool = False,
        lobes: mi.BSDFFlags | None = None,
    ) -> None:
        self.material = material
        self.importance = importance
        self.both_ways = both_ways

        # Restrict the BSDFs to the chosen lobes
        self.context = mi.BSDFContext()
        self.adjoint_context = mi.BSDFContext(mi.TransportMode.Importance)
        if lobes is not None:
            self.context.type_mask = int(lobes)
            self.adjoint_context.type_mask = int(lobes)

        # Find rough glass and clear glass
        self.glass = Glass(scene) if material is None else None
        self.choices = Choices(scene) if material is None else None
        clear = material is None and has_lobes(scene, mi.BSDFFlags.DeltaTransmission)
        self.refracts = clear or (self.glass is not None and self.glass.exists)

    def bsdf(self, vertex: Vertex) -> mi.BSDFPtr:
        """Return the BSDF at a vertex."""
        return vertex.si.bsdf() if self.material is None else self.material

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Return lanes in which the BSDF has a smooth lobe."""
        return mi.has_flag(self.bsdf(vertex).flags(), mi.BSDFFlags.Smooth)

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the BSDF for a direction."""
        si = vertex.si
        bsdf = self.bsdf(vertex)
        wo = si.to_local(direction)
        if self.importance:
            f, pdf_reverse = self._adjoint(bsdf, si, wo, active)
            f = bsdf_to_world(si, f, si.wi, wo)
            pdf = bsdf.pdf(self.context, si, wo, active)
        else:
            f, pdf = bsdf.eval_pdf(self.context, si, wo, active)
            f = bsdf_to_world(si, f, wo, si.wi)
            pdf_reverse = self._pdf_reverse(bsdf, si, wo, active)
        η = self._index_behind(bsdf, si, wo, active)
        return BSDFEval(f=f, pdf=pdf, η=η, pdf_reverse=pdf_reverse)

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample the BSDF, and evaluate it for the direction of a connection.

        Returns the evaluation for the connection, None without a connection, and the sample.
        """
        si = vertex.si
        bsdf = self.bsdf(vertex)
        bsdf_eval = None
        xi = sampler.next_1d()
        u = sampler.next_2d()

        # ------------------ Sample the BSDF, and evaluate the connection ------------------

        if self.importance:
            bsdf_eval = self.eval_connection(vertex, connection)
            bs, weight = bsdf.sample(self.adjoint_context, si, xi, u, active)
        elif connection is None:
            bs, weight = bsdf.sample(self.context, si, xi, u, active)
        else:
            # One call for both is faster
            wo = si.to_local(connection.direction)
            f, pdf, bs, weight = bsdf.eval_pdf_sample(self.context, si, wo, xi, u, active)
            η = self._index_behind(bsdf, si, wo, connection.active)
            f = bsdf_to_world(si, f, wo, si.wi)
            pdf_reverse = self._pdf_reverse(bsdf, si, wo, connection.active)
            bsdf_eval = BSDFEval(f=f, pdf=pdf, η=η, pdf_reverse=pdf_reverse)

        # Which kind of lobe was sampled?
        specular = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        null = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)

        # ------------------------------ Weight the sample ------------------------------

        if self.importance:
            # Smooth lobes: evaluate the adjoint BSDF. A sample of weight 0 has failed, although
            # the BSDF may scatter into its direction
            smooth = active & ~specular & (bs.pdf > 0) & dr.any(intensity(weight) > 0)
            f, pdf_reverse = self._adjoint(bsdf, si, bs.wo, smooth)

            # Delta lobes: correct the weight for shading normals
            delta = weight * _specular_adjoint(si, bs.wo, bs.eta)
            weight = dr.select(specular, delta, dr.select(smooth, f / bs.pdf, 0))
            weight = bsdf_to_world(si, weight, si.wi, bs.wo)
        else:
            weight = bsdf_to_world(si, weight, bs.wo, si.wi)

            # Attach the derivatives that Mitsuba's weight lacks
            if self.choices is not None:
                weight *= self.choices.change(bsdf, bs.pdf, specular)
            pdf_reverse = self._pdf_reverse(bsdf, si, bs.wo, active & ~specular)

        # ------------------------------ Create the next ray ------------------------------

        ray = spawn_ray(si, si.to_world(bs.wo), specular)
        bsdf_sample = BSDFSample(
            ray=ray,
            weight=weight,
            pdf=bs.pdf,
            η=bs.eta,
            specular=specular,
            pdf_reverse=pdf_reverse,
            null=null,
        )
        return bsdf_eval, bsdf_sample

    def _index_behind(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Return the index of refraction on the side of `wo`, relative to the side of the path.

        The result is 1 in scenes without rough glass.
        """
        if self.glass is None or not self.glass.exists:
            return mi.Float(1)
        return self.glass.index_behind(bsdf, si, wo, active)

    def _pdf_reverse(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float | None:
        """Return the density of the reverse path from `wo` [1/sr], None without `both_ways`."""
        if not self.both_ways:
            return None
        return bsdf.pdf(self.context, _seen_from(si, wo), si.wi, active)

    def _adjoint(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Evaluate the adjoint BSDF times cosine, and the density of the reverse path [1/sr].

        The reverse path is a camera path: it arrives along `wo` and leaves along `si.wi`. The BSDF
        of a camera path contains the cosine to the shading normal. The flux of light depends on the
        cosines to the geometric normal, so that their ratio is a factor of the adjoint BSDF.
        """
        f, pdf = bsdf.eval_pdf(self.context, _seen_from(si, wo), si.wi, active)
        cos_i = dr.abs(dr.dot(si.n, si.to_world(si.wi)))
        cos_o = dr.abs(dr.dot(si.n, si.to_world(wo)))
        return f * dr.select(cos_i > 0, cos_o / cos_i, 0), pdf


def _seen_from(si: mi.SurfaceInteraction3f, wi: mi.Vector3f) -> mi.SurfaceInteraction3f:
    """Return a copy of a surface interaction with another incident direction."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wi
    return other


def _specular_adjoint(si: mi.SurfaceInteraction3f, wo: mi.Vector3f, η: mi.Float) -> mi.Float:
    """Return the correction of delta lobes for shading normals, as in `Materials._adjoint`.

    The shading normal is parallel to wi + η wo. Light that passes straight through a surface needs
    no correction.
    """
    # Cosines to the shading normal, up to a common factor
    normal = dr.fma(wo, η, si.wi)
    shading_cos_i = dr.abs(dr.dot(normal, si.wi))
    shading_cos_o = dr.abs(dr.dot(normal, wo))

    # Cosines to the geometric normal
    cos_i = dr.abs(dr.dot(si.n, si.to_world(si.wi)))
    cos_o = dr.abs(dr.dot(si.n, si.to_world(wo)))

    straight = dr.squared_norm(si.wi + wo) < 1e-8
    ratio = shading_cos_i * cos_o / (cos_i * shading_cos_o)
    return dr.select(straight, 1, dr.select((cos_i > 0) & (shading_cos_o > 0), ratio, 0))


class Choices:
    """Derivatives that Mitsuba's sample weights of delta lobes lack.

    A BSDF chooses a delta lobe f, e.g. reflection or refraction, with a probability p. The weight
    of the sample is f / p. Detached sampling needs the derivative of f only, since the choice is
    fixed. In most of Mitsuba's BSDFs, either both the weight and the returned density contain the
    derivative of p, or neither of them does. For these BSDFs, the weight times p over the detached
    p has the derivative of f. Masks are an exception: the returned density contains the derivative
    of p, and the weight does not. The weight of a mask needs no change.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: mi.Scene) -> None:
        class_names = {
            bsdf: [part.class_name() for part in bsdfs_in(bsdf)] for bsdf in materials(scene)
        }
        self._masks = [bsdf for bsdf, names in class_names.items() if MASK in names]

    def change(self, bsdf: mi.BSDFPtr, pdf: mi.Float, specular: mi.Bool) -> mi.Float:
        """Return 1 with the relative derivative that the weight of a sample lacks.

        Args:
            bsdf: The BSDF of each sample.
            pdf: Density of each sample, as the BSDF has returned it.
            specular: Lanes that sampled a delta lobe.
        """
        mask = reduce(lambda found, each: found | (bsdf == mi.BSDFPtr(each)), self._masks, False)
        return dr.replace_grad(mi.Float(1), changing(pdf, specular & ~mi.Bool(mask)))
