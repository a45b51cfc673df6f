"""Films that stream to disk, tile by tile, by this process or by workers."""

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
from .store import StoredFilm, TileReceipt, check_film, under_way
from .tiling import tile_size, tiles
from .work_items import render_item
from .workers import check_client, render_by_workers

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

    from .job import Job


class FilmStore(ResultStore[WorkItem, TileReceipt]):
    """Keeps the receipts of work items whose results are in a film on disk."""

    def __init__(self, items: list[WorkItem], film: StoredFilm, again: str) -> None:
        super().__init__(items, "tiles", again)
        found = {item: film.receipt(item) for item in items}
        self.receipts = {item: receipt for item, receipt in found.items() if receipt is not None}
        self.finished.update(self.receipts)

    def put(self, item: WorkItem, result: TileReceipt) -> None:
        """Keep the receipt of an item that is on disk."""
        self.receipts[item] = result

    def save(self, force: bool = False) -> None:
        """Do nothing: the film and its receipts are on disk."""


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
    """Render a job to disk, tile by tile; the same call goes on with those that are finished.

    A tile under way is saved every `seconds`. `tell` is called with lines on what is done.
    """
    if client is not None and job.plan.splats:
        raise ValueError("client: must be left out, light lands on all tiles; see `render`")
    target, folder = check_film(out), under_way(out)
    shape = job.film.shape
    workers = 1 if client is None else check_client(client)
    with atomic.locked(target, "out"):
        _require_disk_space(folder, shape, 2 if job.settings.errors else 1)
        film = _open_store(job, folder, workers)
        rows, columns = film.tile
        items = [whole(job)] if job.plan.splats else tiles(job, film.tile)
        results = FilmStore(items, film, again or f"the same call goes on with {folder}")
        if len(items) > 1 or client is not None:
            size = atomic.readable(memory.film_bytes(rows, columns, *shape[2:]))
            by = "" if client is None else f", {workers} workers"
            tell(f"{len(items)} tiles of {rows} x {columns} pixels, {size} each{by}")
        if results.finished:
            tell(f"resuming from {len(results.finished)} of {len(items)} tiles")
        if client is None:
            done = _render_here(job, film, results.left, seconds)
        else:
            take = partial(render_item, progress=False)
            done = render_by_workers(client, job, results.left, take, folder)
        results.collect(done, progress)
        attrs = _attributes(job, list(results.receipts.values()))
        film.finish(channel_coordinates(job.film), attrs, target)
    warn_of_missing(job, attrs, stacklevel=4)
    return load_zarr(target)


def _open_store(job: Job, folder: Path, workers: int) -> StoredFilm:
    """The film under way, or a new one."""
    recipe = {"spp": whole(job).count, **job.full_recipe}
    rows, columns = StoredFilm.planned(folder).get("tile") or tile_size(job.film.shape, workers)
    return StoredFilm.begin(folder, recipe, job.film.shape, (rows, columns), job.settings.errors)


def _require_disk_space(folder: Path, shape: tuple[int, int, int, int], films: int) -> None:
    """Refuse a disk that a film does not fit on."""
    height, width, bins, channels = shape
    needed = 4 * films * height * width * (bins + 1) * channels
    there = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    if shutil.disk_usage(atomic.existing_parent(folder)).free < needed - there:
        raise atomic.disk_full(folder, needed)


def _render_here(
    job: Job, film: StoredFilm, items: list[WorkItem], seconds: float
) -> Iterator[tuple[WorkItem, TileReceipt]]:
    """Render work items in this process, each with a checkpoint of its own."""
    with deferred_stop() as stop:
        for item in items:
            checkpoint = None
            if seconds:
                path = film.checkpoint_path(item)
                checkpoint = Checkpoint(path, seconds, tell=lambda line: None)
            result = render_item(job, item, checkpoint=checkpoint, progress=False)
            if result.done < item.count:
                raise KeyboardInterrupt
            yield item, film.write(item, result)
            if checkpoint is not None:
                checkpoint.remove()
            if stop.requested and item != items[-1]:
                raise KeyboardInterrupt


def _attributes(job: Job, receipts: list[TileReceipt]) -> dict[str, Any]:
    """Attributes of a finished film."""
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
