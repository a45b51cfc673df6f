"""Films that stream to disk, tile by tile, by this process or by workers."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..films.recording import tell_not_finite
from ..integrators.running import stopped
from ..runtime import atomic, memory
from ..runtime.checkpoints import Checkpoint
from ..runtime.progress import EVERY_S, deferred_stop, progress_bar
from .dataset import channel_coordinates
from .films_on_disk import load_zarr
from .pieces import TILE_BYTES, Piece, tile_size, tiles, whole
from .store import Receipt, Store, check_film, under_way
from .window import warn_of_losses
from .workers import check_client, pieces_by_workers

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

    from .job import Job


def stream(
    job: Job,
    out: str | os.PathLike[str],
    *,
    client: Client | None = None,
    seconds: float = EVERY_S,
    tell: Any = print,
    again: str = "",
    progress: bool = True,
) -> xr.Dataset:
    """Render a job to disk, tile by tile.

    Args:
        job: The render.
        out: Name of the folder, which appears when all is done. A call for the same job goes on
            with the tiles of one that was stopped or killed.
        client: Workers, which see the folder too; this process alone by default.
        seconds: Time between savings of a tile under way, where no worker renders it [s].
        tell: Is called with a line that says what is gone on with.
        again: How to go on, for the message of a render that was stopped.
        progress: Whether to show a bar for work that takes more than two seconds.

    Returns:
        The film, read from disk when its values are used.

    Raises:
        KeyboardInterrupt: The render was stopped; one line that says how to go on.
        ConnectionError: The scheduler of the workers was lost; likewise.
        OSError: The disk is full; finished tiles stay.
    """
    if client is not None and job.plan.splats:
        raise ValueError("client: must be left out, light lands on all tiles; see `render`")
    target, folder = check_film(out), under_way(out)
    shape = job.film.shape
    workers = 1 if client is None else check_client(client)
    with atomic.locked(target, "out"):
        _require_room(folder, shape, 2 if job.asked.errors else 1)
        store = _begun(job, folder, workers)
        planned = [whole(job)] if job.plan.splats else tiles(job, store.tile)
        receipts = {piece: store.receipt(piece) for piece in planned}
        left = [piece for piece in planned if receipts[piece] is None]
        rows, columns = store.tile
        plan = f"{len(planned)} tiles of {rows} x {columns} pixels"
        if len(planned) > 1 or client is not None:
            by = "" if client is None else f", {workers} workers"
            tell(
                f"{plan}, {atomic.readable(memory.film_bytes(rows, columns, *shape[2:]))} each{by}"
            )
        if len(left) < len(planned):
            tell(f"resuming from {len(planned) - len(left)} of {len(planned)} tiles")
        done = (
            _here(job, store, left, seconds)
            if client is None
            else pieces_by_workers(client, job, left, folder)
        )
        with progress_bar("Rendering", len(planned), unit="tile", enabled=progress) as bar:
            bar.update(len(planned) - len(left))
            try:
                for piece, receipt in done:
                    receipts[piece] = receipt
                    bar.update()
            except (KeyboardInterrupt, ConnectionError) as error:
                count = sum(receipt is not None for receipt in receipts.values())
                on = again or f"the same call goes on with {folder}"
                raise stopped(error, count, len(planned), "tiles", on) from None
        attrs = _attributes(job, [receipt for receipt in receipts.values() if receipt])
        store.finish(channel_coordinates(job.film), attrs, target)
    tell_not_finite(attrs["contributions_not_finite"])
    if job.arrivals is not None:
        warn_of_losses(job.film, attrs["energy_outside_window"], job.arrivals, job.profile)
    return load_zarr(target)


def _begun(job: Job, folder: Path, workers: int) -> Store:
    """The film under way, or a new one."""
    count = whole(job).count
    plan = {"spp": count, **job.all_of_it}
    tile = Store.planned(folder).get("tile")
    rows, columns = tile or tile_size(job.film.shape, TILE_BYTES, workers)
    return Store.begin(folder, plan, job.film.shape, (rows, columns), job.asked.errors)


def _require_room(folder: Path, shape: tuple[int, int, int, int], films: int) -> None:
    """Refuse a disk that a film does not fit on."""
    height, width, bins, channels = shape
    needed = 4 * films * height * width * (bins + 1) * channels
    there = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    if shutil.disk_usage(atomic.existing_parent(folder)).free < needed - there:
        raise atomic.disk_full(folder, needed)


def _here(
    job: Job, store: Store, pieces: list[Piece], seconds: float
) -> Iterator[tuple[Piece, Receipt]]:
    """Render pieces in this process."""
    with deferred_stop() as stop:
        for piece in pieces:
            checkpoint = None
            if seconds:
                path = store.checkpoint_path(piece)
                checkpoint = Checkpoint(path, seconds, tell=lambda line: None)
            taken = job.take(piece, checkpoint=checkpoint, progress=False)
            if taken.done < piece.count:
                raise KeyboardInterrupt
            yield piece, store.put(piece, taken)
            if checkpoint is not None:
                checkpoint.remove()
            if stop.requested and piece != pieces[-1]:
                raise KeyboardInterrupt


def _attributes(job: Job, receipts: list[Receipt]) -> dict[str, Any]:
    """Attributes of a finished film."""
    steady = sum(receipt.steady for receipt in receipts)
    outside = 1 - sum(receipt.transient for receipt in receipts) / steady if steady else 0.0
    return job.recipe | {
        "scene": job.asked.name,
        "spp": whole(job).count,
        "energy_outside_window": min(max(outside, 0.0), 1.0),
        "complete": 1,
        "contributions_not_finite": sum(receipt.not_finite for receipt in receipts),
        "render_seconds": sum(receipt.seconds for receipt in receipts),
        "film_width": int(job.film.size().x),
        "film_height": int(job.film.size().y),
    }
