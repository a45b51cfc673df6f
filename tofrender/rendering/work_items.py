"""Rendering of single work items: tiles of pixels and ranges of samples.

With the sampler `padded_sobol`, a work item uses the same sample points as a render of the whole
film. Together, the work items therefore give the same result up to rounding. With other samplers,
each work item has different sample points.
"""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.windowed import transient_film
from ..integrators.passes import SampleRange, steps
from ..integrators.plan import Plan
from ..integrators.render_loop import UNIT, interrupted, run
from ..media.participating import Media
from ..paths.camera import Tile
from ..runtime.checkpoints import Checkpoint, SavedState, SubCheckpoint
from ..runtime.progress import deferred_stop
from .errors import Halves, Scatter, batches_of, seed_of
from .job import Job, WorkItem, WorkResult, whole

if TYPE_CHECKING:
    from ..films.transient import TransientHDRFilm

# Longest path of direct light, in segments. A render with `denoise` renders it separately
DIRECT = 2

# Factor of the samples per pixel of direct light
DIRECT_SAMPLES = 4


def render_item(
    job: Job, item: WorkItem, *, checkpoint: Checkpoint | None = None, progress: bool = True
) -> WorkResult:
    """Render a work item until it is finished or interrupted.

    Args:
        job: The job.
        item: The work item.
        checkpoint: Checkpoint to continue from and to save to.
        progress: Show a progress bar.
    """
    # Open the checkpoint
    saved = None
    if checkpoint is not None:
        # The batches of error estimates depend on the number of samples
        total = item.count if job.settings.errors else 0
        recipe = {"resume": item.first, "errors": total, **job.full_recipe}
        if job.settings.denoise:
            recipe["denoise"] = item.count
        if item != whole(job, item.first):
            recipe |= {"piece": str(asdict(item))}
        saved = checkpoint.begin(recipe, item.count, UNIT, item.first)

    # Render the samples, in batches or from one point set
    start = time.perf_counter()
    if job.settings.errors or job.settings.denoise:
        result = _render_in_batches(job, item, checkpoint, saved, progress)
    else:
        samples = _Samples(job, item, job.settings.seed, saved)
        done = run(
            samples.steps,
            samples.record,
            item.count,
            done=samples.done,
            before=item.first,
            checkpoint=checkpoint,
            progress=progress,
        )
        result = samples.result(done)

    # Add the time before an interruption
    result.seconds = time.perf_counter() - start + (saved.seconds if saved else 0.0)
    return result


class _Samples:
    """Samples of a work item from one point set, recorded on a separate film.

    Attributes:
        record: Measurement that records the samples.
        done: Samples per pixel that a checkpoint contains already.
        steps: Iterator that renders some samples in each step.
    """

    def __init__(
        self, job: Job, item: WorkItem, seed: int | mi.UInt32, saved: SavedState | None
    ) -> None:
        # Prepare a film for the item
        film, tile = _film_of(job.film, item)
        self.record = job.recording(film)
        self._item = item
        self._tile = tile

        # Prepare the samples, after the samples of a checkpoint
        points = job.points()
        points.set_sample_count(item.count)
        samples = SampleRange(first=item.first, tile=tile, saved=saved)
        self.done = samples.done
        self.steps = steps(job.plan, self.record, job.camera, points, seed, samples)

    def result(self, done: int) -> WorkResult:
        """Return the result of the item, without the margin that the film's filter needs."""
        # Convert the item's position to the pixels of the small film
        y, x = (0, 0) if self._tile is None else (self._tile.y, self._tile.x)
        inside = replace(self._item, y=self._item.y - y, x=self._item.x - x)
        film: Any = self.record.film
        steady, transient = (inside.pixels(array) for array in film.take())
        arrays = {"transient": transient, "steady": steady}
        return WorkResult(arrays, done, self.record.accumulation.not_finite)


def _render_in_batches(
    job: Job,
    item: WorkItem,
    checkpoint: Checkpoint | None,
    saved: SavedState | None,
    progress: bool,
) -> WorkResult:
    """Render in batches for standard errors, or in two halves for denoising.

    Each batch has a separate point set. The standard errors follow from the scatter of the batches.
    The two halves share one point set, so their mean equals a render without halves. Direct light
    can be an exception: it is rendered separately, with more samples.

    Raises:
        KeyboardInterrupt: Fewer than two batches were finished.
    """
    halves = job.settings.denoise
    direct = None
    again = checkpoint.again if checkpoint else ""

    # The filter expects that the noise of neighboring pixels is independent
    if halves and isinstance(job.plan, Plan):
        job = replace(job, plan=job.plan.without_shared_paths())

    # Render direct light separately. This step is fast, so checkpoints do not contain its result
    plans = _by_depth(job.plan) if halves and isinstance(job.plan, Plan) else None
    if plans is not None:
        many = replace(item, count=DIRECT_SAMPLES * item.count)
        samples = _Samples(replace(job, plan=plans[0]), many, job.settings.seed, None)
        direct = samples.result(run(samples.steps, samples.record, many.count, progress=progress))
        if direct.done < many.count:
            raise KeyboardInterrupt(interrupted(0, 2, "halves", again))
        job = replace(job, plan=plans[1])

    # Choose the number of batches, and restore the finished batches
    kind, batches = (Halves, 2) if halves else (Scatter, batches_of(item.count))
    count = item.count // batches
    scatter = kind.restored(saved.arrays) if saved else None
    not_finite = int(saved.arrays["not_finite_before"]) if saved else 0
    first = scatter.count if scatter else 0
    with deferred_stop() as stop:
        for batch in range(first, batches):
            # Prepare a checkpoint that contains the finished batches and a part of this batch
            before = batch * count
            within = None
            if checkpoint is not None:
                state = scatter.state() if scatter else {}
                state["not_finite_before"] = np.array(not_finite)
                within = SubCheckpoint(checkpoint, before, item.count, state)

            # Was the render stopped?
            if stop.requested:
                if within is not None:
                    within.save(0, count, {})
                break

            # Continue with a batch that was interrupted
            begun = None
            if saved and batch == first and before < saved.done:
                begun = SavedState(
                    done=saved.done - before,
                    of=count,
                    seconds=0.0,
                    arrays=saved.arrays,
                )

            # Render the batch
            seed = job.settings.seed if halves else seed_of(job.settings.seed, item.first, batch)
            part = replace(item, first=item.first + before if halves else 0, count=count)
            samples = _Samples(job, part, seed, begun)
            done = run(
                samples.steps,
                samples.record,
                count,
                done=samples.done,
                before=item.first + before,
                checkpoint=within,
                progress=progress,
            )
            if done < count:
                break

            # Add the batch to the mean and the scatter
            result = samples.result(done)
            not_finite += result.not_finite
            if scatter is None:
                scatter = kind(result.arrays)
            else:
                scatter.add(result.arrays)

    # Are there enough batches for an estimate?
    if scatter is None or scatter.count < 2:
        finished = scatter.count if scatter else 0
        unit = "halves" if halves else "batches"
        raise KeyboardInterrupt(interrupted(finished, batches, unit, again))

    # Collect the arrays, and add the direct light
    arrays = scatter.means | scatter.errors()
    if halves:
        arrays["direct"] = np.zeros_like(arrays["transient"])
    if direct is not None:
        arrays["direct"] = direct.arrays["transient"]
        not_finite = not_finite + direct.not_finite
        for name, array in direct.arrays.items():
            arrays[name] += array
    return WorkResult(arrays, scatter.count * count, not_finite)


def _by_depth(plan: Plan) -> tuple[Plan, Plan] | None:
    """Split a plan into direct light and longer paths, if the filter cannot denoise direct light.

    Direct light of point lights reaches only one or two bins of a pixel, so its noise remains after
    the filter. Direct light in media remains noisy too. The result is None for scenes without media
    that have other emitters than point lights.
    """
    at_points = mi.EmitterFlags.DeltaPosition
    flags = [emitter.flags() for emitter in plan.scene.emitters()]
    if isinstance(plan.space, Media) or all(mi.has_flag(each, at_points) for each in flags):
        return plan.by_depth(DIRECT)
    return None


def _film_of(film: TransientHDRFilm, item: WorkItem) -> tuple[TransientHDRFilm, Tile | None]:
    """Return a film for a work item, and its position as a tile of the whole film.

    The film has a margin around the item's pixels, because the reconstruction filter uses samples
    of neighboring pixels. The position is None if the item covers the whole film.
    """
    # Does the item cover the whole film?
    height, width, bins, _ = film.shape
    if (item.height, item.width) == (height, width):
        return film, None

    # Add the margin, without pixels outside the whole film
    rfilter = film.rfilter()
    reach = 0 if rfilter.is_box_filter() or film.sample_border() else rfilter.border_size()
    y = max(0, item.y - reach)
    x = max(0, item.x - reach)
    rows = min(height, item.y + item.height + reach) - y
    columns = min(width, item.x + item.width + reach) - x

    # Make the film
    own = {
        "width": columns,
        "height": rows,
        "crop_width": columns,
        "crop_height": rows,
        "crop_offset_x": 0,
        "crop_offset_y": 0,
    }
    small = transient_film(film, bins, film.start_opl, film.bin_width_opl, **own)
    return small, Tile(x, y, film)
