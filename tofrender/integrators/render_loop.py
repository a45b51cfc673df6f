"""Rendering of all samples, with a progress bar, checkpoints, and stops between two steps."""

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
    """Render all steps of `passes.steps`, until a signal stops the render.

    Ctrl-C, SIGTERM and SIGHUP stop the render. The current step is finished, and the checkpoint is
    saved.

    Args:
        rendering: The steps.
        record: Recording on the film.
        spp: Samples per pixel of the render.
        done: Samples per pixel that the film contains from the start.
        before: Samples per pixel of an earlier render, for the progress bar.
        checkpoint: The checkpoint, after `begin`. None for a render without checkpoints.
        progress: Whether to show a progress bar.
        stop: Requests to stop, None if signals are handled here.

    Returns:
        Samples per pixel that the film contains. The number is less than `spp` after a stop.
    """
    with (
        ProgressBar("Rendering", before + spp, unit="spp", enabled=progress) as bar,
        deferred_stop() if stop is None else nullcontext(stop) as stop,
    ):
        # Show the samples of earlier renders
        bar.update(before + done)
        for done in rendering:
            bar.update(before + done - bar.n)

            # Save the checkpoint regularly and before a stop
            if checkpoint is not None and (checkpoint.due or stop.requested):
                checkpoint.save(done, spp, record.accumulation.state())
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
    **settings: Any,
) -> np.ndarray:
    """Render one picture with an integrator, or with the `sample()` of a user-defined integrator.

    Args:
        scene: The scene.
        integrator: The integrator.
        sensor: The sensor.
        method: Name of a method that the integrator must have, unless it is user-defined.
        refusal: Error message for integrators without this method.
        call: Signature of a user-defined `sample()`, for an error message.
        targets: Arguments of `exposure()`. A user-defined `sample()` receives them after the ray.
        settings: Arguments of `render_all`: samples, seed, checkpoint, progress and identity.

    Returns:
        Array of shape (height, width, channels).
    """
    check_view(scene, sensor, **follows(integrator))
    film = image_film(sensor.film())
    if is_user_defined(integrator):
        # Trace with the `sample()` of the user. Integrators of Mitsuba do not support time
        if not isfunction(getattr(type(integrator), "sample", None)):
            kind = type(integrator).__name__
            raise TypeError(
                f"integrator = {kind}: the class does not define sample(). Define {call}"
            )
        record = recording(film, Exposure(supported_films=(PICTURE,)))
        arguments = [dr.opaque(mi.Float, target) for target in targets]
        tracer: Tracer = UserDefinedTracer(integrator, scene, record, *arguments)
    else:
        # Trace with a plan
        require_method(integrator, method, refusal)
        record = recording(film, integrator.exposure(*targets))
        tracer = integrator.plan(scene, sensor, record.exposure.weight)

    # Render all samples
    render_all(
        scene=scene,
        integrator=integrator,
        sensor=sensor,
        tracer=tracer,
        record=record,
        stacklevel=5,
        **settings,
    )
    return np.array(film.develop())


def require_method(integrator: Any, method: str, refusal: str) -> None:
    """Raise a `TypeError` if an integrator does not have a method."""
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
    """Render all samples.

    A stop is an error, because a stopped render would look complete.

    Args:
        scene: The scene.
        integrator: The integrator.
        sensor: The sensor.
        tracer: Tracer of the camera rays.
        record: Recording on the film.
        spp: Samples per pixel.
        seed: Seed of the sampler.
        checkpoint: Checkpoint or its file name, None for a render without checkpoints.
        progress: Whether to show a progress bar.
        stacklevel: Stack level of warnings.
        identity: Further values that the result depends on, for checkpoints.

    Raises:
        ValueError: A setting is wrong, or the checkpoint belongs to another render.
        KeyboardInterrupt: The render was stopped.
    """
    # Check the settings
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    checks.boolean("progress", progress)
    sampler = best_sampler(spp)
    checkpoint = Checkpoint.of(checkpoint)

    # Resume from the checkpoint, if its file belongs to this render
    saved = None
    if checkpoint is not None:
        described = {**identity, "film": str(record.film)}
        recipe = made_with(scene, sensor, integrator, described)
        saved = checkpoint.begin({"seed": seed, "variant": mi.variant(), **recipe}, spp, UNIT)

    # Render
    samples = SampleRange(saved=saved)
    rendering = steps(tracer, record, sensor, sampler, seed, samples)
    done = run(rendering, record, spp, done=samples.done, checkpoint=checkpoint, progress=progress)
    if done < spp:
        again = checkpoint.again if checkpoint else ""
        raise KeyboardInterrupt(interrupted(done, spp, UNIT, again))
    warn_not_finite(record.accumulation.not_finite, stacklevel)


def made_with(
    scene: mi.Scene, sensor: mi.Sensor, integrator: Any, values: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the values that identify a render, for checkpoints.

    Args:
        scene: The scene.
        sensor: The sensor.
        integrator: The integrator.
        values: Further values that the result depends on.

    Returns:
        The values, and a fingerprint of scene, sensor and integrator.
    """
    return {**values, "fingerprint": fingerprint(scene, sensor, integrator)}


def interrupted(done: int, of: int, unit: str, again: str = "") -> str:
    """Return the error message for interrupted work.

    Args:
        done: Number of finished units.
        of: Number of all units.
        unit: Name of the units.
        again: How to resume the work, "" if the work cannot be resumed.
    """
    return f"interrupted after {done} of {of} {unit}" + (f"; {again}" if again else "")


def stopped(error: BaseException, done: int, of: int, unit: str, again: str = "") -> BaseException:
    """Add the message of `interrupted` to the error of stopped work or of lost workers.

    Other errors are returned unchanged.
    """
    if isinstance(error, KeyboardInterrupt):
        return KeyboardInterrupt(interrupted(done, of, unit, again))
    if isinstance(error, ConnectionError):
        return ConnectionError(f"{error}: {interrupted(done, of, unit, again)}")
    return error
