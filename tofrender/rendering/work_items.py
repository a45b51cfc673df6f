"""Work items of a render: tiles of pixels and ranges of samples, each rendered by itself.

With the sampler `padded_sobol`, a work item has the points that the whole has there, so that they
add up to the whole but for rounding, however it is cut. Other samplers give each its own points.
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
from ..integrators.running import UNIT, interrupted, run
from ..media.space import Media
from ..paths.camera import Tile
from ..runtime.checkpoints import Checkpoint, SavedState, SubCheckpoint
from ..runtime.progress import deferred_stop
from .errors import Halves, Scatter, batches_of, seed_of
from .job import Job, WorkItem, WorkResult, whole

if TYPE_CHECKING:
    from ..films.transient import TransientHDRFilm

DIRECT, DIRECT_SAMPLES = 2, 4
"""Segments of paths that a render with `denoise` renders apart, and with how many times `spp`."""


def render_item(
    job: Job, item: WorkItem, *, checkpoint: Checkpoint | None = None, progress: bool = True
) -> WorkResult:
    """Render a work item, all of it unless it is stopped."""
    saved = None
    if checkpoint is not None:
        total = item.count if job.settings.errors else 0  # More samples would be other batches
        recipe = {"resume": item.first, "errors": total, **job.full_recipe}
        if job.settings.denoise:
            recipe["denoise"] = item.count
        if item != whole(job, item.first):
            recipe |= {"piece": str(asdict(item))}
        saved = checkpoint.begin(recipe, item.count, UNIT, item.first)
    start = time.perf_counter()
    if job.settings.errors or job.settings.denoise:
        result = _render_in_batches(job, item, checkpoint, saved, progress)
    else:
        samples = _Samples(job, item, job.settings.seed, saved)
        done = run(
            *(samples.steps, samples.record, item.count),
            done=samples.done,
            before=item.first,
            checkpoint=checkpoint,
            progress=progress,
        )
        result = samples.result(done)
    result.seconds = time.perf_counter() - start + (saved.seconds if saved else 0.0)
    return result


class _Samples:
    """Samples of a work item from one point set: `steps` records them on a film of its own."""

    def __init__(
        self, job: Job, item: WorkItem, seed: int | mi.UInt32, saved: SavedState | None
    ) -> None:
        film, tile = _film_of(job.film, item)
        self.record, self._item, self._tile = job.recording(film), item, tile
        points = job.points()
        points.set_sample_count(item.count)
        samples = SampleRange(first=item.first, tile=tile, saved=saved)
        self.done = samples.done
        self.steps = steps(job.plan, self.record, job.camera, points, seed, samples)

    def result(self, done: int) -> WorkResult:
        """The item's pixels of the film, without those that its filter needs around them."""
        y, x = (0, 0) if self._tile is None else (self._tile.y, self._tile.x)
        inside = replace(self._item, y=self._item.y - y, x=self._item.x - x)
        film: Any = self.record.film
        steady, transient = (inside.pixels(array) for array in film.take())
        return WorkResult({"transient": transient, "steady": steady}, done, self.record.not_finite)


def _render_in_batches(
    job: Job,
    item: WorkItem,
    checkpoint: Checkpoint | None,
    saved: SavedState | None,
    progress: bool,
) -> WorkResult:
    """Render in batches, whose scatter gives the standard errors, or in halves of one point set.

    Batches have points of their own. The mean of the halves is what a render without halves gives,
    but for direct light, which is rendered apart, with more samples.
    """
    halves, direct = job.settings.denoise, None
    again = checkpoint.again if checkpoint else ""
    plans = _by_depth(job.plan) if halves and isinstance(job.plan, Plan) else None
    if plans is not None:  # Direct light is soon rendered, so checkpoints leave it out
        many = replace(item, count=DIRECT_SAMPLES * item.count)
        samples = _Samples(replace(job, plan=plans[0]), many, job.settings.seed, None)
        direct = samples.result(run(samples.steps, samples.record, many.count, progress=progress))
        if direct.done < many.count:
            raise KeyboardInterrupt(interrupted(0, 2, "halves", again))
        job = replace(job, plan=plans[1])
    kind, batches = (Halves, 2) if halves else (Scatter, batches_of(item.count))
    count = item.count // batches
    scatter = kind.restored(saved.arrays) if saved else None
    not_finite = int(saved.arrays["not_finite_before"]) if saved else 0
    first = scatter.count if scatter else 0
    with deferred_stop() as stop:
        for batch in range(first, batches):
            before = batch * count
            within = None
            if checkpoint is not None:
                state = scatter.state() if scatter else {}
                state["not_finite_before"] = np.array(not_finite)
                within = SubCheckpoint(checkpoint, before, item.count, state)
            if stop.requested:
                if within is not None:
                    within.save(0, count, {})
                break
            begun = None
            if saved and batch == first and before < saved.done:
                begun = SavedState(saved.done - before, count, 0.0, saved.arrays)
            seed = job.settings.seed if halves else seed_of(job.settings.seed, item.first, batch)
            part = replace(item, first=item.first + before if halves else 0, count=count)
            samples = _Samples(job, part, seed, begun)
            done = run(
                *(samples.steps, samples.record, count),
                done=samples.done,
                before=item.first + before,
                checkpoint=within,
                progress=progress,
            )
            if done < count:
                break
            result = samples.result(done)
            not_finite += result.not_finite
            if scatter is None:
                scatter = kind(result.arrays)
            else:
                scatter.add(result.arrays)
    if scatter is None or scatter.count < 2:
        finished = scatter.count if scatter else 0
        unit = "halves" if halves else "batches"
        raise KeyboardInterrupt(interrupted(finished, batches, unit, again))
    arrays = scatter.means | scatter.errors()
    if halves:
        arrays["direct"] = np.zeros_like(arrays["transient"])
    if direct is not None:
        arrays["direct"], not_finite = direct.arrays["transient"], not_finite + direct.not_finite
        for name, array in direct.arrays.items():
            arrays[name] += array
    return WorkResult(arrays, scatter.count * count, not_finite)


def _by_depth(plan: Plan) -> tuple[Plan, Plan] | None:
    """Split a plan into direct light and longer paths, if noise of the former stays in a filter.

    It does where light arrives in one or two bins of a pixel, from points, and in media.
    """
    at_points = mi.EmitterFlags.DeltaPosition
    flags = [emitter.flags() for emitter in plan.scene.emitters()]
    if isinstance(plan.space, Media) or all(mi.has_flag(each, at_points) for each in flags):
        return plan.by_depth(DIRECT)
    return None


def _film_of(film: TransientHDRFilm, item: WorkItem) -> tuple[TransientHDRFilm, Tile | None]:
    """A film for a work item, and where it is in the whole, if it is smaller.

    A filter reaches over the edges of a tile: pixels from there that count in it are rendered, too.
    """
    height, width, bins, _ = film.shape
    if (item.height, item.width) == (height, width):
        return film, None
    rfilter = film.rfilter()
    reach = 0 if rfilter.is_box_filter() or film.sample_border() else rfilter.border_size()
    y, x = max(0, item.y - reach), max(0, item.x - reach)
    rows = min(height, item.y + item.height + reach) - y
    columns = min(width, item.x + item.width + reach) - x
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
