"""Derivatives of renders in forward and reverse mode (JVP and VJP), in passes of many samples."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.contribution import CameraSample, Contribution
from ..films.histogram import MAX_ADDED
from ..films.recording import BinRecording, Recording
from ..gradients.detached import Detached
from ..gradients.films import BinChanges, Changes, Collected
from ..gradients.steps import MOST_KEPT, jvp, vjp
from ..paths.camera import sample_camera, sampled_size
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

PASS_SAMPLES = 1 << 20  # Number of camera rays of one kernel launch on a CPU


@contextmanager
def replaced(params: Any) -> Iterator[dict[str, Any]]:
    """Replace tracked parameters by new variables with the same gradients.

    The parameters are restored at the end. Dr.Jit may request the derivative of a render before it
    has propagated gradients to dependent values, for example to the radius that a sphere computes
    from its `to_world`. For new variables, all dependent values are computed at once.

    Args:
        params: Parameters of a scene.

    Yields:
        The new variables by name.
    """
    names = tracked(params)

    # Copy the parameters. Parameters without gradients must also stay tracked
    with dr.resume_grad():
        before = {name: dr.copy(params[name]) for name in names}

    # Set new variables with the same gradients
    fresh = {name: dr.detach(value) for name, value in before.items()}
    dr.enable_grad(fresh)
    try:
        for name, value in fresh.items():
            dr.set_grad(value, dr.grad(before[name]))
            params[name] = value
        params.update()
        yield fresh
    finally:
        # Restore the parameters
        with dr.resume_grad():
            for name, value in before.items():
                params[name] = value
            params.update()


@contextmanager
def refuse_other_scenes() -> Iterator[None]:
    """Raise an error in one line if parameters of another loaded scene track gradients.

    Dr.Jit visits the shapes and materials of all loaded scenes.
    """
    try:
        yield
    except RuntimeError as error:
        # Find the error of Dr.Jit among the causes
        cause: BaseException | None = error
        while cause is not None and "isolate_grad" not in str(cause):
            cause = cause.__cause__
        if cause is None:
            raise
        raise RuntimeError(
            "params: parameters of another loaded scene also track gradients, which forward mode "
            "does not support. Delete the other scene, or call dr.disable_grad for its parameters"
        ) from None


class Derivative:
    """Derivative of a render.

    Args:
        plan: The plan of the render.
        record: Recording on the film.
        sensor: The sensor.
        spp: Samples per pixel.
        detached: Whether sampling is detached instead of attached.
    """

    def __init__(
        self, plan: Plan, record: Recording, sensor: mi.Sensor, spp: int, detached: bool
    ) -> None:
        variants.require_vectorized()
        self.spp = checks.integer("spp_grad", spp, 1, checks.MAX_SPP)
        self.plan = plan.attached()
        self.record = record
        self.sensor = sensor
        self.changes = BinChanges if isinstance(record, BinRecording) else Changes

        # Sampled directions of delta lobes and phase functions always have derivatives
        self.scattering = self.plan.scattering
        if detached:
            single = has_lobes(plan.scene, mi.BSDFFlags.Delta) or self.plan.space.scatters
            self.scattering = Detached(self.scattering, plan.scene, single)

    @backend.tracing_lock()
    def forward(self, seed: int, fresh: dict[str, Any]) -> Any:
        """Return the derivative of the developed film (JVP).

        Args:
            seed: Seed of the sampler.
            fresh: Differentiable scene parameters, by name. The caller has set their gradients to
                the direction of the derivative.
        """
        # Delete scenes without references, because Dr.Jit would also visit these scenes
        gc.collect()

        # Propagate the gradients of the parameters to the scene
        dr.enqueue(dr.ADMode.Forward, fresh)
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
        with dr.suspend_grad(), ProgressBar("Changes", self.spp, unit="spp") as bar:
            added = 0
            for rays in self._passes(seed):
                # Flush the film before single precision loses small addends
                if added + rays.spp > MAX_ADDED:
                    self.record.accumulation.flush()
                    added = 0

                # Add the derivatives of this pass
                with refuse_other_scenes():
                    self._add_rates(rays)
                added += rays.spp
                bar.update(rays.spp)
            self.record.accumulation.update_image(self.spp)
            return self.record.film.develop()

    def _add_rates(self, rays: Rays) -> None:
        """Add the derivatives of one pass to the film."""
        # Differentiate the start of the paths
        film = self.changes(self.record, rays.camera)
        with dr.resume_grad():
            start, collected = rays.attached_start(film)
            rates = film.jvp(collected, film.zero(), start)
            rate = dr.grad(start)

        # Differentiate the paths
        rates, _ = jvp(
            sampler=rays.sampler,
            path=rays.path,
            rate=rate,
            parts=rays.parts,
            changes=film,
            sums=rates,
        )

        # Add the derivatives of the picture
        before, behind = film.channels(rates)
        image = self.record.image
        block = image.create_block()
        block.put(rays.camera.position, [*before, mi.Float(1), *behind])
        image.put_block(block)
        image.schedule_storage()
        dr.eval()

    @backend.tracing_lock()
    def reverse(self, seed: int, gradients: Sequence[mi.TensorXf]) -> None:
        """Propagate a gradient from the developed film to the parameters (VJP).

        Args:
            seed: Seed of the sampler.
            gradients: Gradients of a loss by the developed tensors of the film.
        """
        depth = self.plan.limits.max_depth
        allowed = f"from 1 to {MOST_KEPT} for derivatives in reverse"
        checks.require("max_depth", depth, 0 < depth <= MOST_KEPT, allowed)
        with dr.suspend_grad(), ProgressBar("Gradients", self.spp, unit="spp") as bar:
            for rays in self._passes(seed):
                # Propagate the gradient of the film to the start of the paths
                film = self.changes(self.record, rays.camera, gradients)
                gradient = vjp(rays.sampler, rays.path, rays.parts, film)

                # Propagate this gradient to the parameters
                with dr.resume_grad():
                    start, collected = rays.attached_start(film)
                    film.vjp(collected, start, gradient)
                dr.eval()
                bar.update(rays.spp)

    def _passes(self, seed: int) -> Iterator[Rays]:
        """Clear the film, and yield all samples in passes, which use one point set."""
        record = self.record
        spp = self.spp
        done = 0
        sampler = best_sampler(spp)
        width, height = sampled_size(record.film)
        lanes = max(1, min(spp, step_samples(PASS_SAMPLES) // (width * height), MAX_ADDED))
        record.prepare(spp)
        while done < spp:
            # Seed the sampler, with `count` lanes per pixel
            count = min(lanes, spp - done)
            sampler.set_samples_per_wavefront(count)
            sampler.seed(seed, width * height * count)
            sampler.skip(done)
            lane = dr.arange(mi.UInt32, width * height * count)
            pixel = lane // dr.opaque(mi.UInt32, count)
            yield Rays(derivative=self, sampler=sampler, pixel=pixel, spp=count)
            done += count


class Rays:
    """Camera rays of one pass, and the start of their paths.

    Args:
        derivative: Derivative of the render.
        sampler: The seeded sampler.
        pixel: Pixel index of each lane.
        spp: Samples per pixel of the pass.
    """

    def __init__(
        self, derivative: Derivative, sampler: mi.Sampler, pixel: mi.UInt32, spp: int
    ) -> None:
        self.derivative = derivative
        self.sampler = sampler
        self.pixel = pixel
        self.spp = spp

        # Sample the camera rays, and store the sampler's dimension to repeat them
        self._first_dimension = sampler.dimension
        self.camera, self.path, endpoint, _ = self._sample()
        plan = derivative.plan
        self.parts = Parts(
            space=plan.space,
            endpoint=endpoint,
            scattering=derivative.scattering,
            limits=plan.limits,
        )

    def _sample(self) -> tuple[CameraSample, Path, Endpoint, list[Contribution]]:
        """Sample the camera rays.

        Returns:
            Camera rays, start of the paths, endpoint, and light that the paths do not find.
        """
        plan = self.derivative.plan
        sampler = self.sampler
        film = self.derivative.record.film
        camera = sample_camera(self.derivative.sensor, film, sampler, self.pixel, scene=plan.scene)
        endpoint, contributions = plan.illuminate(camera.ray, camera.origin, sampler, mi.Bool(True))
        path = plan.start(endpoint, camera.ray, camera.origin, True, camera.frame)
        return camera, path, endpoint, contributions

    def attached_start(self, film: Changes) -> tuple[Any, Collected]:
        """Sample the same camera rays again, with derivatives.

        Args:
            film: Derivatives of the film.

        Returns:
            Start of the paths, packed, and light that the paths do not find.
        """
        # Sample with the same random numbers
        last = self.sampler.dimension
        self.sampler.dimension = self._first_dimension
        _, path, _, contributions = self._sample()
        self.sampler.dimension = last

        # Collect the light that the paths do not find
        collected = film.step()
        for contribution in contributions:
            accumulate(collected, contribution)
        return packed(path), collected
