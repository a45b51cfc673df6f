"""Rendering from start to end, with progress, checkpoints, and a stop between two steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from os import PathLike
from typing import Any

import mitsuba as mi

from ..films.recording import Recording, warn_not_finite
from ..runtime import checks
from ..runtime.checkpoints import Checkpoint, SubCheckpoint
from ..runtime.progress import Stop, deferred_stop, progress_bar
from ..scenes.fingerprint import fingerprint
from .passes import Part, best_sampler, steps
from .plan import Tracer

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
    """Render all steps, with a progress bar, until a signal stops it.

    Args:
        rendering: The steps, see `passes.steps`.
        record: The film and how light counts on it.
        spp: Samples per pixel in all steps.
        done: Samples per pixel that the film has from the start.
        before: Samples per pixel of an earlier render, for the bar.
        checkpoint: Checkpoint that is saved, already begun.
        progress: Whether to show a bar for work that takes more than two seconds.
        stop: Request to stop, if the caller handles signals.

    Returns:
        Samples per pixel that the film has: fewer than `spp` after Ctrl-C, SIGTERM or SIGHUP,
        which finish the current step and save the checkpoint.
    """
    with (
        progress_bar("Rendering", before + spp, unit="spp", enabled=progress) as bar,
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


def render_all(
    plan: Tracer,
    record: Recording,
    sensor: mi.Sensor,
    spp: Any,
    seed: Any,
    recipe: Callable[[], Mapping[str, Any]],
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> None:
    """Render all samples; stopping is an error, since the result would look complete.

    Args:
        plan: Traces camera rays.
        record: The film and how light counts on it.
        sensor: The camera.
        spp: Samples per pixel.
        seed: Seed of the random numbers.
        recipe: All that the result depends on, but for `spp` and `seed`; for a checkpoint.
        checkpoint: Checkpoint that is saved.
        progress: Whether to show a bar for work that takes more than two seconds.

    Raises:
        ValueError: `spp` or `seed` is out of range, or the checkpoint is of another render.
        KeyboardInterrupt: The render was stopped; one line that says how to go on.
    """
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    checks.boolean("progress", progress)
    sampler, checkpoint = best_sampler(spp), Checkpoint.of(checkpoint)
    kept = None
    if checkpoint is not None:
        made = {"seed": seed, "variant": mi.variant(), **recipe()}
        kept = checkpoint.begin(made, spp, UNIT)
    part = Part(kept=kept)
    done = run(
        *(steps(plan, record, sensor, sampler, seed, part), record, spp),
        done=part.done,
        checkpoint=checkpoint,
        progress=progress,
    )
    if done < spp:
        raise KeyboardInterrupt(
            interrupted(done, spp, UNIT, checkpoint.again if checkpoint else "")
        )
    warn_not_finite(record.not_finite)


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
