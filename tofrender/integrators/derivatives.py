"""Derivatives of renders, forwards and in reverse, in passes of many samples."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.derivatives import Changes, changes
from ..films.histogram import MAX_ADDED
from ..films.recording import Recording
from ..paths.attached import Detached
from ..paths.camera import CameraSample, sample_camera, sampled_size
from ..paths.derivatives import MOST_KEPT, move, pull
from ..paths.protocols import Endpoint, Parts
from ..paths.records import packed
from ..paths.surfaces import has_lobes
from ..paths.walk import accumulate
from ..runtime import backend, checks
from ..runtime.progress import progress_bar
from .differentiable import tracked
from .passes import best_sampler
from .plan import Plan

PASS_SAMPLES = 1 << 20
"""Camera rays of one kernel launch."""


@contextmanager
def replaced(params: Any) -> Iterator[dict[str, Any]]:
    """Replace parameters by variables of the same rates, which is undone at the end.

    Dr.Jit may ask a render for its change before it has come to, say, the radius that a sphere has
    computed from its `to_world`. Of variables of our own, all consequences are computed at once.
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
    """Say in one line why Dr.Jit cannot propagate rates beside other scenes that have some.

    It asks all shapes and materials that there are, those of other scenes too, and must not go back
    to what their parameters were made of.
    """
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
    """The derivative of a render.

    Args:
        plan: What is done with camera rays.
        scene: The scene.
        record: The film and how light counts on it.
        sensor: The camera.
        spp: Samples per pixel.
        detached: Whether the places of vertices are detached from random numbers.
    """

    def __init__(
        self,
        plan: Plan,
        scene: mi.Scene,
        record: Recording,
        sensor: mi.Sensor,
        spp: Any,
        detached: bool = True,
    ) -> None:
        backend.require_vectorised()
        self.spp = checks.integer("spp_grad", spp, 1, checks.MAX_SPP)
        self.plan, self.record, self.sensor = plan.attached(), record, sensor
        self.scattering = self.plan.scattering
        if detached:
            single = has_lobes(scene, mi.BSDFFlags.Delta) or self.plan.space.scatters
            self.scattering = Detached(self.scattering, scene, single)

    @backend.uncollected()
    def forward(self, seed: Any, fresh: Any) -> Any:
        """The change of what the film develops, where `fresh` parameters change at their rates."""
        gc.collect()  # Scenes that nobody has any more would be asked, too: see `of_one_scene`
        dr.enqueue(dr.ADMode.Forward, fresh)
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
        with dr.suspend_grad(), progress_bar("Changes", self.spp, unit="spp") as bar:
            added = 0
            for shot in self._shots(seed):
                if added + shot.spp > MAX_ADDED:
                    self.record.flush()
                    added = 0
                with of_one_scene():
                    self._add_changes(shot)
                added += shot.spp
                bar.update(shot.spp)
            self.record.reach(self.spp, self.spp)
            return self.record.film.develop()

    def _add_changes(self, shot: Shot) -> None:
        film = changes(self.record, shot.camera, self.spp)
        with dr.resume_grad():
            start, beside = shot.again(film)
            rates = film.move(beside, film.zero(), start)
            rate = dr.grad(start)
        rates, _ = move(shot.sampler, shot.path, rate, shot.parts, film, rates)
        before, behind = film.channels(rates)
        image = self.record.image
        block = image.create_block()
        block.put(shot.camera.position, [*before, mi.Float(1), *behind])
        image.put_block(block)
        image.schedule_storage()
        dr.eval()

    @backend.uncollected()
    def reverse(self, seed: Any, gradients: Sequence[Any]) -> None:
        """Propagate the gradient of a loss by what the film develops to parameters.

        Raises:
            ValueError: Paths have no longest one, or may be too long; one line.
        """
        depth = self.plan.limits.max_depth
        if not 0 < depth <= MOST_KEPT:
            raise ValueError(
                f"max_depth = {depth}: must be from 1 to {MOST_KEPT} for derivatives in reverse"
            )
        with dr.suspend_grad(), progress_bar("Gradients", self.spp, unit="spp") as bar:
            for shot in self._shots(seed):
                film = changes(self.record, shot.camera, self.spp, gradients)
                gradient = pull(shot.sampler, shot.path, shot.parts, film)
                with dr.resume_grad():
                    start, beside = shot.again(film)
                    film.pull(beside, start, gradient)
                dr.eval()
                bar.update(shot.spp)

    def _shots(self, seed: Any) -> Iterator[Shot]:
        """Clear the film, and yield all samples of its pixels in passes of one point set."""
        record, spp, done = self.record, self.spp, 0
        sampler: Any = best_sampler(spp)
        width, height = sampled_size(record.film)
        lanes = max(1, min(spp, PASS_SAMPLES // (width * height), MAX_ADDED))
        record.prepare()
        record.begin(spp, False)
        while done < spp:
            count = min(lanes, spp - done)
            sampler.set_samples_per_wavefront(count)
            sampler.seed(seed, width * height * count)
            sampler.skip(done)
            lane = dr.arange(mi.UInt32, width * height * count)
            yield Shot(self, sampler, lane // dr.opaque(mi.UInt32, count), count)
            done += count


class Shot:
    """Some camera rays, what they see, and what their paths go along.

    Args:
        of: The render.
        sampler: Random numbers.
        pixel: Pixels of the rays.
        spp: Rays of each pixel.

    Attributes:
        camera: The rays.
        parts: What their paths go along.
        path: Where these start.
    """

    def __init__(self, of: Derivative, sampler: Any, pixel: mi.UInt32, spp: int) -> None:
        self.of, self.sampler, self.pixel, self.spp = of, sampler, pixel, spp
        self._first = sampler.dimension
        self.camera, endpoint, _ = self._begin()
        self.parts = Parts(of.plan.space, endpoint, of.scattering, of.plan.limits)
        self.path = self._start(self.camera, endpoint)

    def _begin(self) -> tuple[CameraSample, Endpoint, list[Any]]:
        camera = sample_camera(self.of.sensor, self.of.record.film, self.sampler, self.pixel)
        lit = self.of.plan.illuminate(camera.ray, camera.origin, self.sampler, mi.Bool(True))
        return camera, *lit

    def _start(self, camera: CameraSample, endpoint: Endpoint) -> Any:
        return self.of.plan.start(endpoint, camera.ray, camera.origin, True, camera.frame)

    def again(self, film: Changes) -> tuple[Any, Any]:
        """The first state of the paths, packed, and light beside them: both with derivatives."""
        last, self.sampler.dimension = self.sampler.dimension, self._first
        camera, endpoint, beside = self._begin()
        self.sampler.dimension = last
        collected = film.step()
        for light in beside:
            accumulate(collected, light)
        return packed(self._start(camera, endpoint)), collected
