"""Rendering from start to end, with progress, checkpoints, and a stop between two steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from inspect import isfunction
from os import PathLike
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.exposure import PICTURE, Exposure
from ..films.image import image_film
from ..films.recording import Recording, recording, warn_not_finite
from ..runtime import checks
from ..runtime.checkpoints import Checkpoint, SubCheckpoint
from ..runtime.progress import ProgressBar, Stop, deferred_stop
from ..scenes.checking import check_view
from ..scenes.fingerprint import fingerprint
from .passes import SampleRange, best_sampler, steps
from .user_defined import Tracer, UserDefinedTracer, follows, is_user_defined

UNIT = "samples per pixel"


def run(
    rendering: Iterator[int],
    record: Recording,
    spp: int,
    *,
    done: int = 0,
    before: int = 0,
    checkpoint: Checkpoint | SubCheckpoint | None = None,
    progress: bool = True,
    stop: Stop | None = None,
) -> int:
    """Render all steps of `passes.steps`, with a progress bar, until a signal stops it.

    The film has `done` samples per pixel from the start; an earlier render took `before`, for the
    bar. The checkpoint has begun already. `stop` is given if the caller handles signals.

    Returns:
        Samples per pixel that the film has: fewer than `spp` after Ctrl-C, SIGTERM or SIGHUP,
        which finish the current step and save the checkpoint.
    """
    with (
        ProgressBar("Rendering", before + spp, unit="spp", enabled=progress) as bar,
        deferred_stop() if stop is None else nullcontext(stop) as stop,
    ):
        bar.update(before + done)
        for done in rendering:
            bar.update(before + done - bar.n)
            if checkpoint is not None and (checkpoint.due or stop.requested):
                checkpoint.save(done, spp, record.state())
            if stop.requested:
                break
    return done


def render_image(
    scene: mi.Scene,
    integrator: Any,
    sensor: mi.Sensor,
    method: str,
    refusal: str,
    call: str,
    targets: tuple[float, ...],
    *settings: Any,
    **identity: Any,
) -> np.ndarray:
    """Render one picture by an integrator, or by the `sample` of a user-defined one.

    An integrator without a `method` is refused; else light counts as its `exposure(*targets)` says.
    A user-defined one is called as `call` says, with `targets` after the ray. `settings` and
    `identity` are those of `render_all`.
    """
    check_view(scene, sensor, **follows(integrator))
    film = image_film(sensor.film())
    if is_user_defined(integrator):
        if not isfunction(getattr(type(integrator), "sample", None)):  # Mitsuba's know no time
            kind = type(integrator).__name__
            raise TypeError(f"integrator = {kind}: has no sample of its own; must have {call}")
        record = recording(film, Exposure(supported_films=(PICTURE,)))
        arguments = [dr.opaque(mi.Float, target) for target in targets]
        tracer: Tracer = UserDefinedTracer(integrator, scene, record, *arguments)
    else:
        require_method(integrator, method, refusal)
        record = recording(film, integrator.exposure(*targets))
        tracer = integrator.plan(scene, sensor, record.weight)
    render_all(scene, integrator, sensor, tracer, record, *settings, stacklevel=5, **identity)
    return np.array(film.develop())


def require_method(integrator: Any, method: str, refusal: str) -> None:
    """Raise a `TypeError` if an integrator lacks a method."""
    if not hasattr(integrator, method):
        raise TypeError(f"integrator = {type(integrator).__name__}: {refusal}")


def render_all(
    scene: mi.Scene,
    integrator: Any,
    sensor: mi.Sensor,
    tracer: Tracer,
    record: Recording,
    spp: int,
    seed: int,
    checkpoint: Checkpoint | str | PathLike[str] | None,
    progress: bool,
    stacklevel: int = 4,
    **identity: Any,
) -> None:
    """Render all samples; stopping is an error, since the result would look complete.

    `identity` is what else the result depends on, for checkpoints. Raises a `ValueError` for wrong
    settings or a checkpoint of another render, a `KeyboardInterrupt` if the render was stopped.
    """
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    checks.boolean("progress", progress)
    sampler, checkpoint = best_sampler(spp), Checkpoint.of(checkpoint)
    saved = None
    if checkpoint is not None:
        more = {**identity, "film": str(record.film)}
        made = made_with(scene, sensor, integrator, more)
        saved = checkpoint.begin({"seed": seed, "variant": mi.variant(), **made}, spp, UNIT)
    samples = SampleRange(saved=saved)
    rendering = steps(tracer, record, sensor, sampler, seed, samples)
    done = run(rendering, record, spp, done=samples.done, checkpoint=checkpoint, progress=progress)
    if done < spp:
        again = checkpoint.again if checkpoint else ""
        raise KeyboardInterrupt(interrupted(done, spp, UNIT, again))
    warn_not_finite(record.not_finite, stacklevel)


def made_with(
    scene: mi.Scene, sensor: mi.Sensor, integrator: Any, more: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what identifies a render: fingerprint of scene, sensor and integrator, and more."""
    return {**more, "fingerprint": fingerprint(scene, sensor, integrator)}


def interrupted(done: int, of: int, unit: str, again: str = "") -> str:
    """Return the message of work that was stopped, and how to go on."""
    return f"interrupted after {done} of {of} {unit}" + (f"; {again}" if again else "")


def stopped(error: BaseException, done: int, of: int, unit: str, again: str = "") -> BaseException:
    """Return the error of work that was stopped, or whose workers are lost, see `interrupted`."""
    if isinstance(error, KeyboardInterrupt):
        return KeyboardInterrupt(interrupted(done, of, unit, again))
    if isinstance(error, ConnectionError):
        return ConnectionError(f"{error}: {interrupted(done, of, unit, again)}")
    return error
