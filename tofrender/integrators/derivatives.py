"""Derivatives of renders, forwards and in reverse, in passes of many samples."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.contribution import Contribution
from ..films.histogram import MAX_ADDED
from ..films.recording import BinRecording, Recording
from ..gradients.detached import Detached
from ..gradients.films import BinChanges, Changes, Collected
from ..gradients.steps import MOST_KEPT, jvp, vjp
from ..paths.camera import CameraSample, sample_camera, sampled_size
from ..paths.protocols import Endpoint, Parts
from ..paths.records import Path
from ..paths.surfaces import has_lobes
from ..paths.walk import accumulate
from ..runtime import backend, checks, variants
from ..runtime.lane_memory import packed
from ..runtime.progress import ProgressBar
from .differentiable import tracked
from .passes import best_sampler, step_samples
from .plan import Plan

PASS_SAMPLES = 1 << 20  # Camera rays of one kernel launch on a CPU


@contextmanager
def replaced(params: Any) -> Iterator[dict[str, Any]]:
    """Replace parameters by variables of the same rates, which is undone at the end.

    Dr.Jit may ask a render for its rates before it has come to, say, the radius that a sphere has
    computed from its `to_world`. All consequences of new variables are computed at once.
    """
    names = tracked(params)
    with dr.resume_grad():  # Else those lose track that no rate comes from
        before = {name: dr.copy(params[name]) for name in names}
    fresh = {name: dr.detach(value) for name, value in before.items()}
    dr.enable_grad(fresh)
    try:
        for name, value in fresh.items():
            dr.set_grad(value, dr.grad(before[name]))
            params[name] = value
        params.update()
        yield fresh
    finally:
        with dr.resume_grad():
            for name, value in before.items():
                params[name] = value
            params.update()


@contextmanager
def of_one_scene() -> Iterator[None]:
    """Refuse in one line other scenes that have rates, whose shapes and materials Dr.Jit visits."""
    try:
        yield
    except RuntimeError as error:
        cause: BaseException | None = error
        while cause is not None and "isolate_grad" not in str(cause):
            cause = cause.__cause__
        if cause is None:
            raise
        raise RuntimeError(
            "params: another loaded scene has parameters that track gradients, too, which forward "
            "mode cannot tell apart; must be deleted, or dr.disable_grad(its parameters)"
        ) from None


class Derivative:
    """The derivative of a render, by detached or attached sampling."""

    def __init__(
        self, plan: Plan, record: Recording, sensor: mi.Sensor, spp: int, detached: bool
    ) -> None:
        variants.require_vectorized()
        self.spp = checks.integer("spp_grad", spp, 1, checks.MAX_SPP)
        self.plan, self.record, self.sensor = plan.attached(), record, sensor
        self.changes = BinChanges if isinstance(record, BinRecording) else Changes
        self.scattering = self.plan.scattering
        if detached:
            single = has_lobes(plan.scene, mi.BSDFFlags.Delta) or self.plan.space.scatters
            self.scattering = Detached(self.scattering, plan.scene, single)

    @backend.tracing_lock()
    def forward(self, seed: int, fresh: dict[str, Any]) -> Any:
        """Return rates of what the film develops, where `fresh` parameters change at theirs."""
        gc.collect()  # Scenes that nobody has any more would be asked, too: see `of_one_scene`
        dr.enqueue(dr.ADMode.Forward, fresh)
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
        with dr.suspend_grad(), ProgressBar("Changes", self.spp, unit="spp") as bar:
            added = 0
            for rays in self._passes(seed):
                if added + rays.spp > MAX_ADDED:
                    self.record.flush()
                    added = 0
                with of_one_scene():
                    self._add_rates(rays)
                added += rays.spp
                bar.update(rays.spp)
            self.record.update_image(self.spp, self.spp)
            return self.record.film.develop()

    def _add_rates(self, rays: Rays) -> None:
        film = self.changes(self.record, rays.camera, self.spp)
        with dr.resume_grad():
            start, collected = rays.attached_start(film)
            rates = film.jvp(collected, film.zero(), start)
            rate = dr.grad(start)
        rates, _ = jvp(rays.sampler, rays.path, rate, rays.parts, film, rates)
        before, behind = film.channels(rates)
        image = self.record.image
        block = image.create_block()
        block.put(rays.camera.position, [*before, mi.Float(1), *behind])
        image.put_block(block)
        image.schedule_storage()
        dr.eval()

    @backend.tracing_lock()
    def reverse(self, seed: int, gradients: Sequence[mi.TensorXf]) -> None:
        """Propagate the gradient of a loss by what the film develops to parameters."""
        depth = self.plan.limits.max_depth
        allowed = f"from 1 to {MOST_KEPT} for derivatives in reverse"
        checks.require("max_depth", depth, 0 < depth <= MOST_KEPT, allowed)
        with dr.suspend_grad(), ProgressBar("Gradients", self.spp, unit="spp") as bar:
            for rays in self._passes(seed):
                film = self.changes(self.record, rays.camera, self.spp, gradients)
                gradient = vjp(rays.sampler, rays.path, rays.parts, film)
                with dr.resume_grad():
                    start, collected = rays.attached_start(film)
                    film.vjp(collected, start, gradient)
                dr.eval()
                bar.update(rays.spp)

    def _passes(self, seed: int) -> Iterator[Rays]:
        """Clear the film, and yield all samples of its pixels in passes of one point set."""
        record, spp, done = self.record, self.spp, 0
        sampler = best_sampler(spp)
        width, height = sampled_size(record.film)
        lanes = max(1, min(spp, step_samples(PASS_SAMPLES) // (width * height), MAX_ADDED))
        record.prepare()
        record.begin(spp)
        while done < spp:
            count = min(lanes, spp - done)
            sampler.set_samples_per_wavefront(count)
            sampler.seed(seed, width * height * count)
            sampler.skip(done)
            lane = dr.arange(mi.UInt32, width * height * count)
            yield Rays(self, sampler, lane // dr.opaque(mi.UInt32, count), count)
            done += count


class Rays:
    """Camera rays of one pass, `spp` for each pixel, and the start and the parts of their paths."""

    def __init__(self, of: Derivative, sampler: mi.Sampler, pixel: mi.UInt32, spp: int) -> None:
        self.of, self.sampler, self.pixel, self.spp = of, sampler, pixel, spp
        self._first_dimension = sampler.dimension
        self.camera, self.path, endpoint, _ = self._sample()
        self.parts = Parts(of.plan.space, endpoint, of.scattering, of.plan.limits)

    def _sample(self) -> tuple[CameraSample, Path, Endpoint, list[Contribution]]:
        plan, sampler = self.of.plan, self.sampler
        film = self.of.record.film
        camera = sample_camera(self.of.sensor, film, sampler, self.pixel, scene=plan.scene)
        lit = plan.illuminate(camera.ray, camera.origin, sampler, mi.Bool(True))
        path = plan.start(lit[0], camera.ray, camera.origin, True, camera.frame)
        return camera, path, *lit

    def attached_start(self, film: Changes) -> tuple[Any, Collected]:
        """Return the paths' first state, packed, and light without paths, with derivatives."""
        last, self.sampler.dimension = self.sampler.dimension, self._first_dimension
        _, path, _, contributions = self._sample()
        self.sampler.dimension = last
        collected = film.step()
        for contribution in contributions:
            accumulate(collected, contribution)
        return packed(path), collected
