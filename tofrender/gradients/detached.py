"""Derivatives with detached sampling: the integrand is differentiated, the sampling is not.

A path finds a vertex by a random direction. If the scene changes, the vertex stays at the same
point of its surface, and the direction to the vertex changes. Therefore the integral over
directions becomes an integral over surface points. Its domain does not change when surfaces move:

    f(x, ω) dω = f(x, y) G(x, y) dA(y),     G = |cos θ_y| / |y - x|²

The sampling density of the unchanged scene is used, and f, G and dA change. Camera rays, mirrors
and glass have single directions that are not sampled. There, the next vertex slides along the ray.
MIS weights follow the changed scene, so that they still add up to 1.

This is the material form of T. Zeltner et al., "Monte Carlo Estimators for Differential Light
Transport", SIGGRAPH 2021 (detached sampling), and of C. Zhang et al., "Path-Space Differentiable
Rendering", SIGGRAPH 2020 (material points). Changes of visibility and hard edges of gates are not
included. For free flights through media see `media.attached`.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..paths.protocols import Scattering, ScatteringWrapper
from ..paths.records import BSDFEval, BSDFSample, Connection, Path, Vertex
from ..paths.surfaces import changing, element, spawn_ray
from ..signals.polarization import intensity, multiply_throughput


class Detached(ScatteringWrapper):
    """Scattering with detached sampling: sampled directions lead to fixed surface points.

    Args:
        inner: The scattering that is sampled.
        scene: The scene.
        single: Whether the scattering may sample delta lobes. Their directions have derivatives.
    """

    def __init__(self, inner: Scattering, scene: mi.Scene, single: bool) -> None:
        super().__init__(inner)
        self.scene = scene
        self.single = single

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Complete the inner sample, with a density without derivatives."""
        completed = self.inner.complete_sample(replace(path, β=mi.UnpolarizedSpectrum(1)), vertex)
        return replace(completed, β=multiply_throughput(path.β, dr.detach(intensity(completed.β))))

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Evaluate a connection, and sample a direction to a fixed surface point."""
        bsdf_eval = self.inner.eval_connection(vertex, connection)

        # --------------------- Sample a direction without derivatives ---------------------

        with dr.suspend_grad(when=not self.single):
            _, bsdf_sample = self.inner.sample(vertex, None, sampler, active)
        chosen = active & ~bsdf_sample.specular
        with dr.suspend_grad():
            ray = dr.detach(bsdf_sample.ray)
            pi = self.scene.ray_intersect_preliminary(ray, active=chosen)

        # --------------------- Attach the surface point y to its surface ---------------------

        flags = mi.RayFlags.All | mi.RayFlags.FollowShape
        y = pi.compute_surface_interaction(ray, flags, chosen)
        found = chosen & y.is_valid()
        to_y = dr.select(found, y.p - vertex.si.p, ray.d)
        d = dr.normalize(to_y)

        # --------------------- How do f, G and dA change? ---------------------

        # Evaluate the BSDF towards y, and the factor G dA of the solid angle
        again = self.inner.eval_pdf(vertex, d, chosen)
        seen = dr.abs(dr.dot(y.n, d)) / dr.squared_norm(to_y) * element(y)
        change = changing(seen, found)

        # Attach the derivatives to the weight of the sample
        bsdf_sample.weight = dr.select(
            chosen, _reweighted(bsdf_sample.weight, again.f) * change, bsdf_sample.weight
        )

        # The density is only used in MIS weights, which follow the changed scene
        unchanged = dr.detach(again.pdf)
        pdf = dr.detach(bsdf_sample.pdf) * dr.select(unchanged > 0, again.pdf / unchanged, 1)
        bsdf_sample.pdf = dr.select(chosen, pdf, bsdf_sample.pdf)
        bsdf_sample.η = dr.select(chosen, again.η, bsdf_sample.η)

        # --------------------- Attach the ray towards y ---------------------

        onwards = spawn_ray(vertex.si, d, mi.Bool(False))
        bsdf_sample.ray.o = dr.select(chosen, dr.replace_grad(ray.o, onwards.o), bsdf_sample.ray.o)
        bsdf_sample.ray.d = dr.select(chosen, dr.replace_grad(ray.d, d), bsdf_sample.ray.d)
        return bsdf_eval, bsdf_sample


def _reweighted(weight: mi.Spectrum, f: mi.Spectrum) -> mi.Spectrum:
    """Return the weight of a sample with the derivatives of the BSDF f, at a constant density."""
    # The ratio weight / f is one over the density. Channels with f = 0 use the ratio of the
    # brightest channel
    f_0 = dr.detach(intensity(f))
    weight_0 = dr.detach(intensity(weight))
    highest = dr.max(f_0)
    usual = dr.select(highest > 0, dr.max(weight_0) / highest, 0)
    ratio = dr.select(f_0 > 0, weight_0 / f_0, usual)

    # Add the change of f to the detached weight
    return dr.detach(weight) + multiply_throughput(f - dr.detach(f), ratio)
