"""Detached sampling: where paths go does not depend on parameters, what they carry does.

A vertex that a path has found by a random direction is a point of a surface. If the scene changes,
it stays at its place on that surface, and the direction to it turns. The integral over directions
is one over surface points then, whose domain no surface leaves by moving:

    f(x, ω) dω = f(x, y) G(x, y) dA(y),     G = |cos θ_y| / |y - x|²

The density is that of the unchanged scene; f, G and dA change. Along single directions (camera
rays, mirrors, glass) there is no choice: the next vertex slides along the ray. Shares of multiple
importance sampling belong to the changed scene, so that they add up to 1 in it.

This is the material form of T. Zeltner et al., "Monte Carlo Estimators for Differential Light
Transport", SIGGRAPH 2021 (detached sampling), and of C. Zhang et al., "Path-Space Differentiable
Rendering", SIGGRAPH 2020 (points that keep their places). What becomes visible or hidden, and
hard edges of gates, it does not see.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import intensity
from .protocols import Scattering
from .records import BSDFEval, BSDFSample, Connection, Path, Vertex, extend
from .surfaces import changing, element, spawn_ray


class Detached:
    """Scattering with detached sampling: sampled directions lead to the same surface points.

    Args:
        inner: The scattering that samples.
        scene: The scene.
        single: Whether it may choose single directions, which are followed as they bsdf_eval.
    """

    def __init__(self, inner: Scattering, scene: mi.Scene, single: bool) -> None:
        self.inner, self.scene, self.single = inner, scene, single

    @property
    def refracts(self) -> bool:
        """Delegate to the inner scattering."""
        return self.inner.refracts

    def guide(self) -> Any:
        """Delegate to the inner scattering."""
        return self.inner.guide()

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Delegate to the inner scattering."""
        return self.inner.smooth(vertex)

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Delegate to the inner scattering."""
        return self.inner.eval_pdf(vertex, direction, active)

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Complete the inner sample; its density is detached."""
        one = copy(path)
        one.β = mi.UnpolarizedSpectrum(1)
        arrived = self.inner.complete_sample(one, vertex)
        factor = dr.detach(intensity(arrived.β))
        arrived.β = extend(path.β, factor)
        return arrived

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, BSDFSample]:
        """Evaluate a connection, and sample a direction to a detached point."""
        bsdf_eval = (
            None
            if connection is None
            else self.inner.eval_pdf(vertex, connection.direction, connection.active)
        )
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


def _reweighted(weight: Any, f: Any) -> Any:
    """A weight with the changes of the BSDF that it is made of; its density stays."""
    before, was = dr.detach(intensity(f)), dr.detach(intensity(weight))
    highest = dr.max(before)
    usual = dr.select(highest > 0, dr.max(was) / highest, 0)
    ratio = dr.select(before > 0, was / before, usual)
    return dr.detach(weight) + extend(f - dr.detach(f), ratio)
