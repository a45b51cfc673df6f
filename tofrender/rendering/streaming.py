"""Renders to disk, tile by tile, in this process or with workers."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..runtime import atomic, memory
from ..runtime.checkpoints import Checkpoint
from ..runtime.progress import EVERY_S, deferred_stop
from .collecting import ResultStore
from .dataset import channel_coordinates
from .films_on_disk import load_zarr
from .job import WorkItem, render_attributes, warn_of_missing, whole
from .stored_film import StoredFilm, TileReceipt, check_film, under_way
from .tiling import tile_size, tiles
from .work_items import render_item
from .workers import check_client, render_by_workers

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

    from .job import Job


class FilmStore(ResultStore[WorkItem, TileReceipt]):
    """Store of receipts. The results of the work items are in a film on disk."""

    def __init__(self, items: list[WorkItem], film: StoredFilm, again: str) -> None:
        super().__init__(items, "tiles", again)
        found = {item: film.receipt(item) for item in items}
        self.receipts = {item: receipt for item, receipt in found.items() if receipt is not None}
        self.finished.update(self.receipts)

    def put(self, item: WorkItem, result: TileReceipt) -> None:
        """Store the receipt of an item that was written to disk."""
        self.receipts[item] = result

    def save(self, force: bool = False) -> None:
        """Do nothing, because the film and its receipts are already on disk."""


def stream(
    job: Job,
    out: str | os.PathLike[str],
    *,
    client: Client | None = None,
    seconds: float = EVERY_S,
    tell: Callable[[str], None] = print,
    again: str = "",
    progress: bool = True,
) -> xr.Dataset:
    """Render a job to disk, tile by tile. The same call continues after an interruption.

    Args:
        job: The job.
        out: Folder of the film.
        client: Client of workers. If it is missing, this process renders.
        seconds: Time between two checkpoints of an unfinished tile [s].
        tell: Function that prints a line about the progress.
        again: Text for messages that describes how to resume. By default, it names the folder.
        progress: Show a progress bar.
    """
    if client is not None and job.plan.splats:
        raise ValueError(
            "client: must be left out with `out` for light tracing, whose light lands on all tiles"
        )
    target = check_film(out)
    folder = under_way(out)
    shape = job.film.shape
    workers = 1 if client is None else check_client(client)
    with atomic.locked(target, "out"):
        # Open the film and divide the job into work items
        _require_disk_space(folder, shape, 2 if job.settings.errors else 1)
        film = _open_store(job, folder, workers)
        rows, columns = film.tile
        items = [whole(job)] if job.plan.splats else tiles(job, film.tile)
        results = FilmStore(items, film, again or f"the same call goes on with {folder}")

        # Report the tiles
        if len(items) > 1 or client is not None:
            size = atomic.readable(memory.film_bytes(rows, columns, *shape[2:]))
            by = "" if client is None else f", {workers} workers"
            tell(f"{len(items)} tiles of {rows} x {columns} pixels, {size} each{by}")
        if results.finished:
            tell(f"resuming from {len(results.finished)} of {len(items)} tiles")

        # Render the tiles that are not finished
        if client is None:
            done = _render_here(job, film, results.left, seconds)
        else:
            take = partial(render_item, progress=False)
            done = render_by_workers(client, job, results.left, take, folder)
        results.collect(done, progress)

        # Complete the film
        attrs = _attributes(job, list(results.receipts.values()))
        film.finish(channel_coordinates(job.film), attrs, target)
    warn_of_missing(job, attrs, stacklevel=4)
    return load_zarr(target)


def _open_store(job: Job, folder: Path, workers: int) -> StoredFilm:
    """Open the unfinished film of a job, or create a film."""
    # An unfinished film keeps the size of its tiles
    recipe = {"spp": whole(job).count, **job.full_recipe}
    rows, columns = StoredFilm.planned(folder).get("tile") or tile_size(job.film.shape, workers)
    return StoredFilm.begin(folder, recipe, job.film.shape, (rows, columns), job.settings.errors)


def _require_disk_space(folder: Path, shape: tuple[int, int, int, int], films: int) -> None:
    """Raise an OSError if the disk has too little space for a film.

    Args:
        folder: Folder of the film.
        shape: Shape of the film, (height, width, temporal_bins, channels).
        films: Number of films, two with standard errors.
    """
    # Find the bytes of all bins and of the steady pictures, without the files that exist
    height, width, bins, channels = shape
    needed = 4 * films * height * width * (bins + 1) * channels
    there = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    if shutil.disk_usage(atomic.existing_parent(folder)).free < needed - there:
        raise atomic.disk_full(folder, needed)


def _render_here(
    job: Job, film: StoredFilm, items: list[WorkItem], seconds: float
) -> Iterator[tuple[WorkItem, TileReceipt]]:
    """Render work items in this process, with a separate checkpoint for each item."""
    with deferred_stop() as stop:
        for item in items:
            # Render the item, and continue from its checkpoint
            checkpoint = None
            if seconds:
                path = film.checkpoint_path(item)
                checkpoint = Checkpoint(path, seconds, tell=lambda line: None)
            result = render_item(job, item, checkpoint=checkpoint, progress=False)
            if result.done < item.count:
                raise KeyboardInterrupt

            # Write the item, and remove its checkpoint afterwards
            yield item, film.write(item, result)
            if checkpoint is not None:
                checkpoint.remove()

            # Was the render stopped?
            if stop.requested and item != items[-1]:
                raise KeyboardInterrupt


def _attributes(job: Job, receipts: list[TileReceipt]) -> dict[str, Any]:
    """Return the attributes of a finished film from the receipts of its tiles."""
    steady, transient = (
        sum(getattr(r, name) for r in receipts) for name in ("steady", "transient")
    )
    return render_attributes(job, steady, transient) | {
        "spp": whole(job).count,
        "complete": 1,
        "contributions_not_finite": sum(receipt.not_finite for receipt in receipts),
        "render_seconds": sum(receipt.seconds for receipt in receipts),
        "film_width": int(job.film.size().x),
        "film_height": int(job.film.size().y),
    }
