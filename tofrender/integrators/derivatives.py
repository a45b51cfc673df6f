# pyright: reportArgumentType=false
"""Derivatives of renders, forwards and in reverse, in passes of many samples."""

from __future__ import annotations

import gc
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.cells import MAX_ADDED
from ..films.derivatives import Changes, changes
from ..films.recording import BinRecording, PhasorRecording, Recording
from ..paths.attached import Detached
from ..paths.camera import CameraSample, sample_camera, sampled_size
from ..paths.derivatives import Parts, move, pull
from ..paths.protocols import Endpoint
from ..paths.surfaces import Boundaries, has_mirrors
from ..paths.tape import packed
from ..paths.walk import deliver
from ..runtime import backend, checks
from ..runtime.progress import progress_bar
from ..scenes.media import media_of
from ..signals.pulses import BoxPulse, SampledPulse
from .passes import best_sampler
from .plan import Plan

PASS_SAMPLES = 1 << 20
"""Camera rays of one kernel launch."""

MOST_KEPT = 256
"""Vertices of a path whose states fit into the memory of a lane."""

MOVING = ("to_world", "vertex_positions", "position", "direction", "x_fov", "eta", "int_ior")
"""Ends of the names of parameters that light's way depends on."""


RENDERERS = ("tofrender", "mitsuba", "drjit")


class VisibilityWarning(UserWarning):
    """Derivatives leave out what becomes visible or hidden."""


def tracked(params: Any) -> list[str]:
    """Names of parameters that track gradients."""
    with dr.resume_grad():
        return [name for name, value in dict(params or {}).items() if dr.grad_enabled(value)]


def require_changes(params: Any) -> None:
    """Refuse parameters of which none has a derivative.

    Raises:
        ValueError: None tracks gradients; one line.
    """
    if not tracked(params):
        raise ValueError(
            "params: track no gradients; must be those of mi.traverse(scene), with "
            "dr.enable_grad(params[name]) for one at least"
        )


def require_still(scene: mi.Scene, names: Sequence[str]) -> None:
    """Refuse that things move where flights go through several media, or through grids.

    Raises:
        ValueError: They do; one line.
    """
    moving = [name for name in names if name.rpartition(".")[2] in MOVING]
    media = media_of(scene)
    if moving and media and (Boundaries(scene).exist or not all(m.is_homogeneous() for m in media)):
        raise ValueError(
            f"params = {checks.shown(', '.join(moving))}: have no derivatives in a scene with "
            "media that are grids or have boundaries of equal index; must be coefficients, "
            "materials or power"
        )


def warn_of_edges(names: Sequence[str]) -> None:
    """Tell who renders that derivatives by parameters that move things are not whole."""
    moving = [name for name in names if name.rpartition(".")[2] in MOVING]
    if moving:
        warnings.warn(
            f"params = {checks.shown(', '.join(moving))}: move what light meets; derivatives leave "
            "out what becomes visible or hidden at silhouettes and shadows",
            VisibilityWarning,
            _users_level(),
        )


def _users_level() -> int:
    """How many calls above its caller the first one is that no renderer makes."""
    frame, level = sys._getframe(1), 1
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in RENDERERS:
        frame, level = frame.f_back, level + 1
    return level


@contextmanager
def replaced(params: Any) -> Iterator[dict[str, Any]]:
    """Replace parameters by variables of the same rates, which is undone at the end.

    Dr.Jit may ask a render for its change before it has come to, say, the radius that a sphere has
    computed from its `to_world`. Of variables of our own, all consequences are computed at once.
    """
    names = tracked(params)
    before = {name: dr.copy(params[name]) for name in names}
    fresh = {name: dr.detach(value) for name, value in before.items()}
    dr.enable_grad(fresh)
    for name, value in fresh.items():
        dr.set_grad(value, dr.grad(before[name]))
        params[name] = value
    params.update()
    try:
        yield fresh
    finally:
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


def require_derivatives(record: Recording, names: Sequence[str]) -> None:
    """Refuse a recording that has no derivatives by the parameters of some names.

    Raises:
        ValueError: One line with what of it has none.
    """
    film = record.film
    if not film.rfilter().is_box_filter():
        raise ValueError(
            f"film.rfilter = {film.rfilter().class_name()}: has no derivatives; must be box"
        )
    if "xyz" in str(film):
        raise ValueError("film.pixel_format = xyz: has no derivatives; must be rgb or luminance")
    gate = record.exposure.pulse if record.exposure.at_centres else None
    gate = getattr(record.weight, "pulse", gate)
    if isinstance(gate, BoxPulse | SampledPulse):
        raise ValueError(
            f"pulse = {gate!r}: has hard edges, so that gates have no derivative by length; must "
            "be a GaussianPulse"
        )
    width = any(name.endswith("pulse_width_opl") for name in names)
    if isinstance(record, PhasorRecording) and width:
        raise ValueError(
            "pulse_width_opl: has no derivative on a phasor_hdr_film; must be on a film with bins"
        )
    if not isinstance(record, BinRecording):
        return
    if not record.in_time:
        kind = type(film)
        raise ValueError(
            f"film = {kind.__module__}.{kind.__name__}: has no derivatives; must be this package's"
        )
    if record.profile is None:
        raise ValueError(
            "pulse = None: leaves bins without a derivative by length; must be a pulse, e.g. by "
            "pulse_width_opl = 0.03"
        )
    if width and record.profile is not record.exposure.pulse:
        raise ValueError(
            "pulse_width_opl: has no derivative through a temporal_filter; must be 'box'"
        )


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
        self.spp = checks.integer("spp", spp, 1, checks.MAX_SPP)
        self.plan, self.record, self.sensor = plan.attached(), record, sensor
        self.scattering = self.plan.scattering
        if detached:
            single = has_mirrors(scene) or self.plan.space.scatters
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
                    self.record.fold()
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
        """All samples of the film's pixels, in passes of one point set; the film is emptied."""
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
        lit = self.of.plan.lit(camera.ray, camera.origin, self.sampler, mi.Bool(True))
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
            deliver(collected, light)
        return packed(self._start(camera, endpoint)), collected
