"""Derivatives with detached sampling: of what paths carry, not of the samples that they follow.

A vertex that a path has found by a random direction is a point of a surface. If the scene changes,
it is fixed on that surface, and the direction to it changes. The integral over directions is one
over surface points then, whose domain no surface leaves by moving:

    f(x, ω) dω = f(x, y) G(x, y) dA(y),     G = |cos θ_y| / |y - x|²

The density is that of the unchanged scene; f, G and dA change. Along single directions (camera
rays, mirrors, glass) there is no choice: the next vertex slides along the ray. MIS weights are
those of the changed scene, so that they add up to 1 in it.

This is the material form of T. Zeltner et al., "Monte Carlo Estimators for Differential Light
Transport", SIGGRAPH 2021 (detached sampling), and of C. Zhang et al., "Path-Space Differentiable
Rendering", SIGGRAPH 2020 (material points). It leaves out what becomes visible or hidden, and hard
edges of gates. For free flights through media see `media.attached`.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..paths.protocols import Scattering, ScatteringWrapper
from ..paths.records import BSDFEval, BSDFSample, Connection, Path, Vertex
from ..paths.surfaces import changing, element, spawn_ray
from ..signals.polarisation import intensity, multiply_throughput


class Detached(ScatteringWrapper):
    """Scattering with detached sampling: sampled directions lead to the same surface points.

    `single` says whether it may sample delta lobes, whose directions have derivatives.
    """

    def __init__(self, inner: Scattering, scene: mi.Scene, single: bool) -> None:
        super().__init__(inner)
        self.scene, self.single = scene, single

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Complete the inner sample; its density is detached."""
        completed = self.inner.complete_sample(replace(path, β=mi.UnpolarizedSpectrum(1)), vertex)
        return replace(completed, β=multiply_throughput(path.β, dr.detach(intensity(completed.β))))

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Evaluate a connection, and sample a direction to a detached point."""
        bsdf_eval = self.inner.eval_connection(vertex, connection)

        # Sample a direction, and find the detached point y that it leads to
        with dr.suspend_grad(when=not self.single):
            _, bsdf_sample = self.inner.sample(vertex, None, sampler, active)
        chosen = active & ~bsdf_sample.specular
        with dr.suspend_grad():
            ray = dr.detach(bsdf_sample.ray)
            ahead = self.scene.ray_intersect_preliminary(ray, active=chosen)
        flags = mi.RayFlags.All | mi.RayFlags.FollowShape
        y = ahead.compute_surface_interaction(ray, flags, chosen)
        found = chosen & y.is_valid()
        onto = dr.select(found, y.p - vertex.si.p, ray.d)
        d = dr.normalize(onto)

        # Evaluate the BSDF, and the area that the solid angle covers at y, in the changed scene
        again = self.inner.eval_pdf(vertex, d, chosen)
        seen = dr.abs(dr.dot(y.n, d)) / dr.squared_norm(onto) * element(y)
        change = changing(seen, found)

        bsdf_sample.weight = dr.select(
            chosen, _reweighted(bsdf_sample.weight, again.f) * change, bsdf_sample.weight
        )
        same = dr.detach(again.pdf)
        pdf = dr.detach(bsdf_sample.pdf) * dr.select(same > 0, again.pdf / same, 1)
        bsdf_sample.pdf = dr.select(chosen, pdf, bsdf_sample.pdf)
        bsdf_sample.η = dr.select(chosen, again.η, bsdf_sample.η)
        onwards = spawn_ray(vertex.si, d, mi.Bool(False))
        bsdf_sample.ray.o = dr.select(chosen, dr.replace_grad(ray.o, onwards.o), bsdf_sample.ray.o)
        bsdf_sample.ray.d = dr.select(chosen, dr.replace_grad(ray.d, d), bsdf_sample.ray.d)
        return bsdf_eval, bsdf_sample


def _reweighted(weight: mi.Spectrum, f: mi.Spectrum) -> mi.Spectrum:
    """Return a sample weight with the derivatives of the BSDF f; its density stays."""
    f_0, weight_0 = dr.detach(intensity(f)), dr.detach(intensity(weight))
    highest = dr.max(f_0)
    usual = dr.select(highest > 0, dr.max(weight_0) / highest, 0)
    ratio = dr.select(f_0 > 0, weight_0 / f_0, usual)
    return dr.detach(weight) + multiply_throughput(f - dr.detach(f), ratio)
