"""Collection of the results of work items that several workers render."""

import time
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import numpy as np

from ..integrators.render_loop import stopped
from ..runtime.checkpoints import Checkpoint
from ..runtime.progress import ProgressBar, deferred_stop
from .job import Job, WorkResult, whole
from .tiling import sample_ranges, tile_size, tiles
from .work_items import render_item
from .workers import check_client, render_by_workers

if TYPE_CHECKING:
    from distributed import Client

# Types of a work item and of its result
Item = TypeVar("Item", bound=Hashable)
Result = TypeVar("Result")
ItemT = TypeVar("ItemT", bound=Hashable, contravariant=True)
ResultT = TypeVar("ResultT", contravariant=True)


class ResultStore(ABC, Generic[Item, Result]):
    """Store of the results of finished work items, in memory or on disk.

    Args:
        items: All work items.
        unit: Plural noun for the items, for messages.
        again: Text for messages that describes how to resume interrupted work.
    """

    def __init__(self, items: Sequence[Item], unit: str, again: str = "") -> None:
        self.items = items
        self.unit = unit
        self.again = again
        self.finished: set[Item] = set()

    @property
    def left(self) -> list[Item]:
        """Work items that are not finished."""
        return [item for item in self.items if item not in self.finished]

    @abstractmethod
    def put(self, item: Item, result: Result) -> None:
        """Store the result of a work item."""

    @abstractmethod
    def save(self, force: bool = False) -> None:
        """Write a checkpoint if it is due or if `force` is True.

        Stores on disk do not need a checkpoint.
        """

    def collect(self, results: Iterator[tuple[Item, Result]], progress: bool = True) -> None:
        """Store the results of the unfinished items.

        Args:
            results: Pairs of item and result, as the items are finished.
            progress: Show a progress bar.

        Raises:
            KeyboardInterrupt: The work was stopped. Finished items are saved.
        """
        total = len(self.items)
        unit = self.unit.removesuffix("s")
        with ProgressBar("Rendering", total, unit=unit, enabled=progress) as bar:
            bar.update(len(self.finished))
            try:
                for item, result in results:
                    # Delay signals, so that a result is stored completely or not at all
                    with deferred_stop() as stop:
                        self.put(item, result)
                        self.finished.add(item)

                    # Save a checkpoint, and stop after a signal
                    bar.update()
                    self.save()
                    if stop.requested and len(self.finished) < total:
                        raise KeyboardInterrupt
            except (KeyboardInterrupt, Exception) as error:
                # Save the finished items before the error is reported
                self.save(force=True)
                done = len(self.finished)
                raise stopped(error, done, total, self.unit, self.again) from None


class Work(Protocol[ItemT, ResultT]):
    """Work of independent items. The results are added to arrays."""

    def add(self, arrays: dict[str, np.ndarray], item: ItemT, result: ResultT, /) -> None:
        """Add the result of an item to the arrays of the whole result."""
        ...


class ArrayStore(ResultStore[Item, Result]):
    """Store of results in arrays, which are saved in a checkpoint.

    Args:
        work: Object that adds the result of an item to the arrays.
        items: All work items.
        arrays: Arrays of zeros, by name. The store changes the arrays.
        recipe: Values that determine the result. A checkpoint must have the same recipe.
        unit: Plural noun for the items, for messages.
        checkpoint: Checkpoint to continue from and to save to.
    """

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
        self._work = work
        self._arrays = arrays
        self._checkpoint = checkpoint

        # Restore the finished items of an earlier call
        saved = None if checkpoint is None else checkpoint.begin(recipe, len(items), unit)
        if saved is not None:
            done = saved.arrays.pop("done")
            self.finished.update(item for item, is_done in zip(items, done, strict=True) if is_done)
            for name, array in saved.arrays.items():
                arrays[name][...] = array

    def put(self, item: Item, result: Result) -> None:
        """Add the result of an item to the arrays."""
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
    """Render a job with workers, and add the results of the work items.

    Args:
        job: The job.
        client: The client of the workers.
        checkpoint: Checkpoint to continue from and to save to.
        progress: Show a progress bar.
    """
    # Are the workers, the settings and the memory suitable?
    workers = check_client(client)
    if job.plan.splats and job.settings.errors:
        raise ValueError("errors = True: must be False for light tracing with a client")
    count = whole(job).count
    checkpoint = Checkpoint.of(checkpoint)
    job.require_memory(count)

    # Divide the job into work items. A checkpoint must continue with the same work items
    if checkpoint is not None:
        workers = int(checkpoint.recipe().get("workers", workers))
    if job.plan.splats:
        items = sample_ranges(job, workers)
    else:
        items = tiles(job, tile_size(job.film.shape, workers))

    # Allocate the arrays of the whole film
    height, width, _, channels = job.film.shape
    arrays = {}
    for suffix in ("", "_error") if job.settings.errors else ("",):
        arrays[f"transient{suffix}"] = np.zeros(job.film.shape, np.float32)
        arrays[f"steady{suffix}"] = np.zeros((height, width, channels), np.float32)
    arrays["not_finite"] = np.zeros(1, int)

    # Render the work items that are not finished
    recipe = job.full_recipe | {"spp": count, "workers": workers}
    start = time.perf_counter()
    store = ArrayStore(job, items, arrays, recipe, "pieces", checkpoint)
    results = render_by_workers(client, job, store.left, partial(render_item, progress=False))
    store.collect(results, progress)
    seconds = time.perf_counter() - start

    # Separate the number of ignored contributions from the film
    not_finite = int(arrays.pop("not_finite")[0])
    return WorkResult(arrays=arrays, done=count, not_finite=not_finite, seconds=seconds)
