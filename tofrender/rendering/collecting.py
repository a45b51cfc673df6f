"""Collecting the results of work items that are rendered by many workers."""

import time
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import numpy as np

from ..integrators.running import stopped
from ..runtime.checkpoints import Checkpoint
from ..runtime.progress import ProgressBar, deferred_stop
from .job import Job, WorkResult, whole
from .tiling import sample_ranges, tile_size, tiles
from .work_items import render_item
from .workers import check_client, render_by_workers

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item", bound=Hashable)
Result = TypeVar("Result")
ItemT = TypeVar("ItemT", bound=Hashable, contravariant=True)
ResultT = TypeVar("ResultT", contravariant=True)


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


def collect(
    job: Job,
    client: "Client",
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> WorkResult:
    """Render a job by workers, and add up their results."""
    workers = check_client(client)
    if job.plan.splats and job.settings.errors:
        raise ValueError("errors = True: must be False with a client for light that lands anywhere")
    count, checkpoint = whole(job).count, Checkpoint.of(checkpoint)
    job.require_memory(count)
    if checkpoint is not None:  # The work items are those that were begun with
        workers = int(checkpoint.recipe().get("workers", workers))
    if job.plan.splats:
        items = sample_ranges(job, workers)
    else:
        items = tiles(job, tile_size(job.film.shape, workers))
    height, width, _, channels = job.film.shape
    arrays = {}
    for suffix in ("", "_error") if job.settings.errors else ("",):
        arrays[f"transient{suffix}"] = np.zeros(job.film.shape, np.float32)
        arrays[f"steady{suffix}"] = np.zeros((height, width, channels), np.float32)
    arrays["not_finite"] = np.zeros(1, int)
    recipe = job.full_recipe | {"spp": count, "workers": workers}
    start = time.perf_counter()
    store = ArrayStore(job, items, arrays, recipe, "pieces", checkpoint)
    results = render_by_workers(client, job, store.left, partial(render_item, progress=False))
    store.collect(results, progress)
    seconds = time.perf_counter() - start
    not_finite = int(arrays.pop("not_finite")[0])
    return WorkResult(arrays, count, not_finite, seconds)
