"""Films on the disk while `tofrender render` makes them, and what becomes of them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import options as opt
from .keeping import AGAIN

if TYPE_CHECKING:
    import xarray as xr

    from ..rendering.job import Job


def fits(job: Job) -> bool:
    """Whether a job's film fits into memory; if not, says so."""
    from tofrender.rendering.pieces import whole

    try:
        job.require_memory(whole(job).count)
    except MemoryError as error:
        opt.note(f"note: {error}; it is rendered tile by tile on the disk")
        return False
    return True


def streamed(job: Job, film: Path, client: Any, seconds: float, resume: bool) -> xr.Dataset:
    """Render a job on the disk, or take what a killed run had finished there."""
    from tofrender.rendering.dataset import in_channels
    from tofrender.rendering.films_on_disk import is_film, load_zarr
    from tofrender.rendering.pieces import whole
    from tofrender.rendering.streaming import stream, under_way
    from tofrender.runtime import atomic

    if not resume:
        for left in (film, under_way(film)):
            atomic.remove(left)
    if is_film(film):
        dataset = load_zarr(film)
        wanted = job.recipe | {"spp": whole(job).count, "errors": job.asked.errors}
        found = dataset.attrs | {"errors": "transient_error" in dataset}
        wanted["shape"], found["shape"] = job.film.shape, in_channels(dataset)["transient"].shape
        for name, value in wanted.items():
            its = found.get(name)
            if its != value:
                raise ValueError(f"--resume: was rendered with {name} = {its!r}; must be {value!r}")
        return dataset
    return stream(job, film, client=client, seconds=seconds, tell=opt.note, again=AGAIN)


def placed(dataset: xr.Dataset, place: Path) -> None:
    """Put a film on the disk: move one that is there, write one that is not."""
    from tofrender.rendering.store import save_zarr

    source = dataset.encoding.get("source")
    if source is None:
        save_zarr(dataset, place)
    else:
        os.rename(source, place)
