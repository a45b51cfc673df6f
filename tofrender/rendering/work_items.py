"""Work items of a render: tiles of pixels and ranges of samples, each rendered by itself.

With the sampler `padded_sobol`, a work item has the points that the whole has there, so that they
add up to the whole but for rounding, however it is cut. Other samplers give each its own points.
"""

from __future__ import annotations

import itertools
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import mitsuba as mi
import numpy as np

from ..films.image import pixels_of, transient_film
from ..integrators.passes import Part, steps
from ..integrators.running import UNIT, interrupted, run, stopped
from ..paths.camera import Tile
from ..runtime import memory
from ..runtime.checkpoints import Checkpoint, SavedState, SubCheckpoint
from ..runtime.progress import ProgressBar, deferred_stop
from .errors import Scatter, parts_of, seed_of

if TYPE_CHECKING:
    from ..films.transient import TransientHDRFilm
    from .job import Job

Item = TypeVar("Item", bound=Hashable)
Result = TypeVar("Result")
ItemT = TypeVar("ItemT", bound=Hashable, contravariant=True)
ResultT = TypeVar("ResultT", contravariant=True)

TILE_BYTES = 256 << 20
"""Memory of the bins of a tile, if the whole film does not fit [bytes]."""

TILES_PER_WORKER = 4
"""Least tiles for each worker, so that none waits long for the last one."""


@dataclass(frozen=True, order=True)
class WorkItem:
    """Some samples of some pixels.

    Attributes:
        y, x: First row and column of the pixels in the film's crop window.
        height, width: Rows and columns.
        first: Samples per pixel before the first of these.
        count: Samples per pixel.
    """

    y: int
    x: int
    height: int
    width: int
    first: int
    count: int

    def pixels(self, array: np.ndarray) -> np.ndarray:
        """The item's pixels of an array of the whole film, (height, width, ...), as a view."""
        return array[self.y : self.y + self.height, self.x : self.x + self.width]


@dataclass
class WorkResult:
    """Result of a work item.

    Attributes:
        arrays: `transient` (height, width, temporal_bins, channels), `steady` (height, width,
            channels), and their standard errors, `transient_error` and `steady_error`, if wanted.
        done: Samples per pixel that were taken: fewer than the item's if it was stopped.
        not_finite: Contributions that were left out.
        seconds: Time that it took [s].
    """

    arrays: dict[str, np.ndarray]
    done: int
    not_finite: int = 0
    seconds: float = 0.0


def whole(job: Job, first: int = 0) -> WorkItem:
    """All pixels, and all samples after the `first` ones."""
    height, width, _, _ = job.film.shape
    return WorkItem(0, 0, height, width, first, job.points(first).sample_count())


def tiles(job: Job, size: tuple[int, int]) -> list[WorkItem]:
    """Tiles of so many rows and columns, the last ones smaller, that cover the film."""
    height, width, _, _ = job.film.shape
    rows, columns = size
    count = job.points().sample_count()
    return [
        WorkItem(y, x, min(rows, height - y), min(columns, width - x), 0, count)
        for y in range(0, height, rows)
        for x in range(0, width, columns)
    ]


def tile_size(
    shape: tuple[int, int, int, int], workers: int = 1, tile_bytes: float | None = None
) -> tuple[int, int]:
    """Rows and columns of the tiles of a film (height, width, temporal_bins, channels).

    The bins of a tile take `tile_bytes` at most, by default `TILE_BYTES`.
    """
    height, width, bins, channels = shape
    tile_bytes = TILE_BYTES if tile_bytes is None else tile_bytes
    wanted = TILES_PER_WORKER * workers if workers > 1 else 1
    row_bytes = memory.film_bytes(1, width, bins, channels)
    rows = max(1, min(int(tile_bytes // row_bytes), height // wanted))
    rows = math.ceil(height / math.ceil(height / rows))
    if row_bytes <= tile_bytes and height >= workers:
        return rows, width
    fit = int(tile_bytes // memory.film_bytes(1, 1, bins, channels))
    columns = max(1, min(fit, width // math.ceil(wanted / height)))
    return 1, math.ceil(width / math.ceil(width / columns))


def sample_ranges(job: Job, workers: int) -> list[WorkItem]:
    """Ranges of samples of the whole film, for light that lands anywhere on it."""
    item = whole(job)
    count = min(workers, item.count)
    edges = [item.count * k // count for k in range(count + 1)]
    return [replace(item, first=low, count=high - low) for low, high in itertools.pairwise(edges)]


def render_item(
    job: Job,
    item: WorkItem,
    *,
    checkpoint: Checkpoint | None = None,
    resumed: int = 0,
    progress: bool = True,
) -> WorkResult:
    """Render a work item, all of it unless it is stopped.

    `resumed` is the number of samples per pixel that an earlier render has, for the checkpoint and
    the progress bar.
    """
    saved = None
    if checkpoint is not None:
        parts = item.count if job.settings.errors else 0  # Of parts none may change
        recipe = {"resume": resumed, "errors": parts, **job.all_of_it}
        if item != whole(job, resumed):
            recipe |= {"piece": str(asdict(item))}
        saved = checkpoint.begin(recipe, item.count, UNIT, resumed)
    start = time.perf_counter()
    if job.settings.errors:
        result = _render_in_parts(job, item, checkpoint, saved, resumed, progress)
    else:
        samples = _Samples(job, item, job.settings.seed, saved)
        done = run(
            *(samples.steps, samples.record, item.count),
            done=samples.done,
            before=resumed,
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
        part = Part(first=item.first, tile=tile, kept=saved)
        self.done = part.done
        self.steps = steps(job.plan, self.record, job.camera, points, seed, part)

    def result(self, done: int) -> WorkResult:
        """The item's pixels of the film, without those that its filter needs around them."""
        y, x = (0, 0) if self._tile is None else (self._tile.y, self._tile.x)
        inside = replace(self._item, y=self._item.y - y, x=self._item.x - x)
        film: Any = self.record.film
        steady, transient = (inside.pixels(array) for array in film.take())
        return WorkResult({"transient": transient, "steady": steady}, done, self.record.not_finite)


def _render_in_parts(
    job: Job,
    item: WorkItem,
    checkpoint: Checkpoint | None,
    saved: SavedState | None,
    resumed: int,
    progress: bool,
) -> WorkResult:
    """Render in parts with points of their own, whose scatter tells the standard errors."""
    parts = parts_of(item.count)
    count = item.count // parts
    scatter = Scatter.restored(saved.arrays) if saved else None
    not_finite = int(saved.arrays["not_finite_before"]) if saved else 0
    first = scatter.count if scatter else 0
    with deferred_stop() as stop:
        for part in range(first, parts):
            before = part * count
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
            if saved and part == first and before < saved.done:
                begun = SavedState(saved.done - before, count, 0.0, saved.arrays)
            seed = seed_of(job.settings.seed, item.first, part)
            samples = _Samples(job, replace(item, first=0, count=count), seed, begun)
            done = run(
                *(samples.steps, samples.record, count),
                done=samples.done,
                before=resumed + before,
                checkpoint=within,
                progress=progress,
            )
            if done < count:
                break
            result = samples.result(done)
            not_finite += result.not_finite
            if scatter is None:
                scatter = Scatter(result.arrays)
            else:
                scatter.add(result.arrays)
    if scatter is None or scatter.count < 2:
        again = checkpoint.again if checkpoint else ""
        finished = scatter.count if scatter else 0
        raise KeyboardInterrupt(interrupted(finished, parts, "parts", again))
    errors = {f"{name}_error": array for name, array in scatter.errors().items()}
    return WorkResult(scatter.means | errors, scatter.count * count, not_finite)


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
    own: Any = pixels_of(film) | {
        "height": min(height, item.y + item.height + reach) - y,
        "width": min(width, item.x + item.width + reach) - x,
    }
    for name in ("crop_width", "crop_height", "crop_offset_x", "crop_offset_y"):
        del own[name]
    small = mi.load_dict({"type": "hdrfilm"} | own)
    return transient_film(small, bins, film.start_opl, film.bin_width_opl), Tile(x, y, film)


# ------------------------------------------------------------------------------ collecting many


class ResultStore(ABC, Generic[Item, Result]):
    """Keeps the results of work items as they are finished, in memory or on disk.

    Messages call the items by `unit`, and say by `again` how stopped work goes on.
    """

    def __init__(self, items: Sequence[Item], unit: str, again: str = "") -> None:
        self.items, self.unit, self.again = items, unit, again
        self.finished: set[Item] = set()

    @property
    def left(self) -> list[Item]:
        """Items that are not finished."""
        return [item for item in self.items if item not in self.finished]

    @abstractmethod
    def put(self, item: Item, result: Result) -> None:
        """Keep the result of an item."""

    @abstractmethod
    def save(self, force: bool = False) -> None:
        """Write a checkpoint, where results are not on disk, if it is time to or if forced."""

    def collect(self, results: Iterator[tuple[Item, Result]], progress: bool = True) -> None:
        """Keep the results of the items that are left, and show how many there are."""
        total, unit = len(self.items), self.unit.removesuffix("s")
        with ProgressBar("Rendering", total, unit=unit, enabled=progress) as bar:
            bar.update(len(self.finished))
            try:
                for item, result in results:
                    with deferred_stop() as stop:  # A result is kept whole or not at all
                        self.put(item, result)
                        self.finished.add(item)
                    bar.update()
                    self.save()
                    if stop.requested and len(self.finished) < total:
                        raise KeyboardInterrupt
            except (KeyboardInterrupt, Exception) as error:
                self.save(force=True)
                done = len(self.finished)
                raise stopped(error, done, total, self.unit, self.again) from None


class Work(Protocol[ItemT, ResultT]):
    """Work whose items are rendered apart, and whose results add up in arrays."""

    def add(self, arrays: dict[str, np.ndarray], item: ItemT, result: ResultT, /) -> None:
        """Add the result of an item to the arrays of the whole."""
        ...


class ArrayStore(ResultStore[Item, Result]):
    """Keeps results in arrays, and these in a checkpoint."""

    def __init__(
        self,
        work: Work[Item, Result],
        items: Sequence[Item],
        arrays: dict[str, np.ndarray],
        recipe: Mapping[str, object],
        unit: str,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        super().__init__(items, unit, checkpoint.again if checkpoint else "")
        self._work, self._arrays, self._checkpoint = work, arrays, checkpoint
        saved = None if checkpoint is None else checkpoint.begin(recipe, len(items), unit)
        if saved is not None:
            done = saved.arrays.pop("done")
            self.finished.update(item for item, is_done in zip(items, done, strict=True) if is_done)
            for name, array in saved.arrays.items():
                arrays[name][...] = array

    def put(self, item: Item, result: Result) -> None:
        """Add the result of an item."""
        self._work.add(self._arrays, item, result)

    def save(self, force: bool = False) -> None:
        """Write the checkpoint, with a flag for each item."""
        if self._checkpoint is not None and (force or self._checkpoint.due):
            done = np.array([item in self.finished for item in self.items], bool)
            arrays = {**self._arrays, "done": done}
            self._checkpoint.save(len(self.finished), len(self.items), arrays)
