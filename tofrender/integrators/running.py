"""Rendering from start to end: shown, kept in a checkpoint, and stopped between two steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from os import PathLike
from typing import Any

import mitsuba as mi

from ..films.recording import Recording, tell_not_finite
from ..runtime import checks
from ..runtime.checkpoints import Checkpoint, SubCheckpoint
from ..runtime.progress import Stop, deferred_stop, progress_bar
from ..scenes.fingerprint import fingerprint
from .passes import Part, best_sampler

UNIT = "samples per pixel"


def run(
    taking: Iterator[int],
    record: Recording,
    spp: int,
    *,
    done: int = 0,
    before: int = 0,
    checkpoint: Checkpoint | SubCheckpoint | None = None,
    progress: bool = True,
    stop: Stop | None = None,
) -> int:
    """Take the steps of a render.

    Args:
        taking: The steps, as `passes.steps` gives them.
        record: What they are recorded on.
        spp: Samples per pixel in all steps.
        done: Those that the record has from the start.
        before: Those that an earlier render took, for the bar.
        checkpoint: What is kept up to date; it was begun.
        progress: Whether to show a bar for work that takes more than two seconds.
        stop: Whether to stop, if who calls listens to signals.

    Returns:
        Samples per pixel that the record has: fewer than `spp` after Ctrl-C, SIGTERM or SIGHUP,
        which let the step under way finish and the checkpoint be saved.
    """
    with (
        progress_bar("Rendering", before + spp, unit="spp", enabled=progress) as bar,
        deferred_stop() if stop is None else nullcontext(stop) as stop,
    ):
        bar.update(before + done)
        for done in taking:
            bar.update(before + done - bar.n)
            if checkpoint is not None and (checkpoint.due or stop.requested):
                checkpoint.save(done, spp, record.state())
            if stop.requested:
                break
    return done


def run_whole(
    taking: Callable[[mi.Sampler, int, Part], Iterator[int]],
    record: Recording,
    spp: Any,
    seed: Any,
    recipe: Callable[[], Mapping[str, Any]],
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> None:
    """Render all samples; what is stopped is an error, since nobody would see that it is not whole.

    Args:
        taking: `passes.steps` or `expose` for a sampler, a seed and a part.
        record: What they are recorded on.
        spp: Samples per pixel.
        seed: Seed of the random numbers.
        recipe: All that the result depends on, but for `spp` and `seed`.
        checkpoint: What is kept up to date.
        progress: Whether to show a bar for work that takes more than two seconds.

    Raises:
        ValueError: `spp` or `seed` is out of range, or the checkpoint is of another render.
        KeyboardInterrupt: The render was stopped; one line that says where it can go on.
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
        *(taking(sampler, seed, part), record, spp),
        done=part.done,
        checkpoint=checkpoint,
        progress=progress,
    )
    if done < spp:
        raise KeyboardInterrupt(
            interrupted(done, spp, UNIT, checkpoint.again if checkpoint else "")
        )
    tell_not_finite(record.not_finite)


def made_with(
    scene: mi.Scene, sensor: mi.Sensor, integrator: Any, more: Mapping[str, Any]
) -> dict[str, Any]:
    """What a checkpoint compares: scene, sensor and integrator, and what else there is."""
    return {**more, "fingerprint": fingerprint(scene, sensor, integrator)}


def interrupted(done: int, of: int, unit: str, again: str = "") -> str:
    """One line on work that was stopped, and on how to go on."""
    return f"interrupted after {done} of {of} {unit}" + (f"; {again}" if again else "")


def stopped(error: BaseException, done: int, of: int, unit: str, again: str = "") -> BaseException:
    """The error of work that was stopped, or whose workers are lost, with one line as above."""
    if isinstance(error, KeyboardInterrupt):
        return KeyboardInterrupt(interrupted(done, of, unit, again))
    if isinstance(error, ConnectionError):
        return ConnectionError(f"{error}: {interrupted(done, of, unit, again)}")
    return error
