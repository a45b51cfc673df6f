"""Division of a render into work items: tiles of pixels, or ranges of samples."""

import itertools
import math
from dataclasses import replace
from typing import TYPE_CHECKING

from ..runtime import memory
from .job import WorkItem, whole

if TYPE_CHECKING:
    from .job import Job

# Memory of the bins of a tile, if the whole film is larger [bytes]
TILE_BYTES = 256 << 20

# Smallest number of tiles per worker. With several tiles, all workers finish at about the same time
TILES_PER_WORKER = 4


def tiles(job: "Job", size: tuple[int, int]) -> list[WorkItem]:
    """Return tiles of `size` (rows, columns) that cover the film; the last tiles may be smaller."""
    height, width, _, _ = job.film.shape
    rows, columns = size
    count = job.points().sample_count()
    return [
        WorkItem(
            y=y,
            x=x,
            height=min(rows, height - y),
            width=min(columns, width - x),
            first=0,
            count=count,
        )
        for y in range(0, height, rows)
        for x in range(0, width, columns)
    ]


def tile_size(
    shape: tuple[int, int, int, int], workers: int = 1, tile_bytes: float | None = None
) -> tuple[int, int]:
    """Return the rows and columns of the tiles of a film.

    Args:
        shape: Shape of the film, (height, width, temporal_bins, channels).
        workers: Number of workers.
        tile_bytes: Largest memory of a tile's bins [bytes], by default `TILE_BYTES`.
    """
    height, width, bins, channels = shape
    tile_bytes = TILE_BYTES if tile_bytes is None else tile_bytes
    wanted = TILES_PER_WORKER * workers if workers > 1 else 1

    # Use tiles of whole rows, of similar height
    row_bytes = memory.film_bytes(1, width, bins, channels)
    rows = max(1, min(int(tile_bytes // row_bytes), height // wanted))
    rows = math.ceil(height / math.ceil(height / rows))
    if row_bytes <= tile_bytes and height >= workers:
        return rows, width

    # If a row is too large, or if the film has few rows, divide the rows
    fit = int(tile_bytes // memory.film_bytes(1, 1, bins, channels))
    columns = max(1, min(fit, width // math.ceil(wanted / height)))
    return 1, math.ceil(width / math.ceil(width / columns))


def sample_ranges(job: "Job", workers: int) -> list[WorkItem]:
    """Return work items with different samples of the whole film, for light tracing."""
    item = whole(job)
    count = min(workers, item.count)
    edges = [item.count * k // count for k in range(count + 1)]
    return [replace(item, first=low, count=high - low) for low, high in itertools.pairwise(edges)]
