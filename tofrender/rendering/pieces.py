"""Pieces of a render: tiles of pixels, and ranges of samples, each rendered by itself.

With the sampler `padded_sobol`, a piece has the points that the whole has there, so that pieces add
up to the whole but for rounding, however they are cut. Other samplers give each piece its own.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.image import pixels_of, transient_film
from ..integrators.passes import Part, steps
from ..integrators.running import UNIT, interrupted, run, stopped
from ..paths.camera import Tile
from ..runtime import memory
from ..runtime.checkpoints import Checkpoint, SavedState, SubCheckpoint
from ..runtime.progress import deferred_stop, progress_bar
from .errors import Scatter, parts_of, seed_of

if TYPE_CHECKING:
    from .job import Job

TILE_BYTES = 256 << 20
"""Memory of the bins of a tile, if the whole film does not fit [bytes]."""

LEAST_PIECES = 4
"""Pieces for each worker, so that none waits long for the last one."""


@dataclass(frozen=True, order=True)
class Piece:
    """A part of the samples of a render.

    Attributes:
        y: First row of its pixels in the film's crop window.
        x: First column there.
        height: Rows.
        width: Columns.
        first: Samples per pixel that come before its own.
        count: Samples per pixel.
    """

    y: int
    x: int
    height: int
    width: int
    first: int
    count: int

    def of(self, array: np.ndarray) -> np.ndarray:
        """The piece's pixels of an array of the whole film, (height, width, ...)."""
        return array[self.y : self.y + self.height, self.x : self.x + self.width]


@dataclass
class Taken:
    """What became of a piece.

    Attributes:
        steady: Picture, shape (height, width, channels).
        transient: Bins, shape (height, width, temporal_bins, channels).
        done: Samples per pixel that were taken.
        not_finite: Contributions that were left out.
        seconds: Time that it took [s].
        errors: Standard errors of `transient` and `steady`, if these were asked for.
    """

    steady: np.ndarray
    transient: np.ndarray
    done: int
    not_finite: int
    seconds: float
    errors: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays, by the name of the Dataset's variable."""
        errors = {f"{name}_error": array for name, array in self.errors.items()}
        return {"transient": self.transient, "steady": self.steady} | errors


def whole(job: Job, first: int = 0) -> Piece:
    """All pixels, and all samples after the `first` ones."""
    height, width, _, _ = job.film.shape
    return Piece(0, 0, height, width, first, job.points(first).sample_count())


def tiles(job: Job, size: tuple[int, int]) -> list[Piece]:
    """Tiles of so many rows and columns, the last ones smaller, that cover the film."""
    height, width, _, _ = job.film.shape
    rows, columns = size
    count = job.points().sample_count()
    return [
        Piece(y, x, min(rows, height - y), min(columns, width - x), 0, count)
        for y in range(0, height, rows)
        for x in range(0, width, columns)
    ]


def tile_size(
    shape: tuple[int, int, int, int], tile_bytes: float, workers: int = 1
) -> tuple[int, int]:
    """Rows and columns of tiles that cover a film.

    Args:
        shape: (height, width, temporal_bins, channels).
        tile_bytes: Memory that the bins of a tile may take [bytes].
        workers: How many will share the tiles.
    """
    height, width, bins, channels = shape
    wanted = LEAST_PIECES * workers if workers > 1 else 1
    row_bytes = memory.film_bytes(1, width, bins, channels)
    rows = max(1, min(int(tile_bytes // row_bytes), height // wanted))
    rows = math.ceil(height / math.ceil(height / rows))
    if row_bytes <= tile_bytes and height >= workers:
        return rows, width
    fit = int(tile_bytes // memory.film_bytes(1, 1, bins, channels))
    columns = max(1, min(fit, width // math.ceil(wanted / height)))
    return 1, math.ceil(width / math.ceil(width / columns))


def ranges(job: Job, workers: int) -> list[Piece]:
    """Ranges of samples of the whole film, for light that lands anywhere on it."""
    all_of_it = whole(job)
    count = min(workers, all_of_it.count)
    edges = [all_of_it.count * k // count for k in range(count + 1)]
    return [
        Piece(0, 0, all_of_it.height, all_of_it.width, low, high - low)
        for low, high in itertools.pairwise(edges)
    ]


def take(
    job: Job,
    piece: Piece,
    *,
    checkpoint: Checkpoint | None = None,
    resumed: int = 0,
    progress: bool = True,
) -> Taken:
    """Render a piece.

    Args:
        job: The render.
        piece: What of it.
        checkpoint: What is kept up to date.
        resumed: Samples per pixel that an earlier render has, for the checkpoint and the bar.
        progress: Whether to show a bar for work that takes more than two seconds.

    Returns:
        What was taken: less than all if it was stopped.
    """
    kept = None
    if checkpoint is not None:
        parts = piece.count if job.asked.errors else 0  # Of parts none may change
        made = {"resume": resumed, "errors": parts, **job.all_of_it}
        if piece != whole(job, resumed):
            made |= {"piece": str(asdict(piece))}
        kept = checkpoint.begin(made, piece.count, UNIT, resumed)
    start = time.perf_counter()
    taking = _in_parts if job.asked.errors else _at_once
    taken = taking(job, piece, checkpoint, kept, resumed, progress)
    taken.seconds = time.perf_counter() - start + (kept.seconds if kept else 0.0)
    return taken


def collect_pieces(
    found: Callable[[list[Any]], Iterator[tuple[Any, Any]]],
    pieces: Sequence[Any],
    place: Callable[[Any, Any], None],
    arrays: dict[str, np.ndarray],
    *,
    recipe: Mapping[str, Any],
    unit: str,
    checkpoint: Checkpoint | None = None,
    progress: bool = True,
) -> None:
    """Put pieces into arrays as they are done, and keep these in a checkpoint.

    Args:
        found: Gives pieces and what they came to, of those that are left.
        pieces: All pieces.
        place: Puts what a piece came to into the arrays.
        arrays: The arrays; those of a checkpoint are copied into them.
        recipe: All that the result depends on, for the checkpoint.
        unit: What pieces are called.
        checkpoint: What is kept up to date.
        progress: Whether to show a bar for work that takes more than two seconds.

    Raises:
        KeyboardInterrupt: The work was stopped; one line that says how to go on.
        ConnectionError: The scheduler was lost; likewise.
    """
    done = np.zeros(len(pieces), dtype=bool)
    kept = None if checkpoint is None else checkpoint.begin(recipe, len(pieces), unit)
    if kept is not None:
        done = kept.arrays.pop("done")
        for name, array in kept.arrays.items():
            arrays[name][...] = array
    numbers = {piece: number for number, piece in enumerate(pieces)}
    left = [piece for piece, number in numbers.items() if not done[number]]

    def keep() -> None:
        if checkpoint is not None:
            checkpoint.save(int(done.sum()), len(pieces), {**arrays, "done": done})

    with progress_bar("Rendering", len(pieces), unit="piece", enabled=progress) as bar:
        bar.update(int(done.sum()))
        try:
            for piece, result in found(left):
                with deferred_stop() as stop:  # A piece is there whole or not at all
                    place(piece, result)
                    done[numbers[piece]] = True
                bar.update()
                if checkpoint is not None and checkpoint.due:
                    keep()
                if stop.requested:
                    raise KeyboardInterrupt
        except (KeyboardInterrupt, Exception) as error:
            keep()
            again = checkpoint.again if checkpoint else ""
            raise stopped(error, int(done.sum()), len(pieces), unit, again) from None


def _at_once(
    job: Job,
    piece: Piece,
    checkpoint: Checkpoint | SubCheckpoint | None,
    kept: SavedState | None,
    before: int,
    progress: bool,
    seed: Any = None,
) -> Taken:
    """Render a piece from one point set."""
    film, tile, (y, x) = _film_of(job, piece)
    record, points = job.recording(film), job.points()
    points.set_sample_count(piece.count)
    part = Part(first=piece.first, tile=tile, kept=kept)
    done = run(
        steps(job.plan, record, job.camera, points, job.asked.seed if seed is None else seed, part),
        *(record, piece.count),
        done=part.done,
        before=before,
        checkpoint=checkpoint,
        progress=progress,
    )
    inside = np.s_[y : y + piece.height, x : x + piece.width]
    steady, transient = (array[inside] for array in film.take())
    return Taken(steady, transient, done, record.not_finite, 0.0)


def _in_parts(
    job: Job,
    piece: Piece,
    checkpoint: Checkpoint | None,
    kept: SavedState | None,
    before: int,
    progress: bool,
) -> Taken:
    """Render a piece in parts with points of their own, and tell by their scatter what is noise."""
    parts = parts_of(piece.count)
    count = piece.count // parts
    scatter = Scatter.restored(kept.arrays) if kept else None
    done = kept.done if kept else 0
    not_finite = int(kept.arrays["not_finite_before"]) if kept else 0
    first = scatter.count if scatter else 0
    with deferred_stop() as stop:
        for part in range(first, parts):
            within = None
            if checkpoint is not None:
                state = scatter.state() if scatter else {}
                state["not_finite_before"] = np.array(not_finite)
                within = SubCheckpoint(checkpoint, part * count, piece.count, state)
            if stop.requested:
                if within is not None:
                    within.save(0, count, {})
                break
            own = replace(piece, first=0, count=count)
            begun = None
            if kept and part * count < done:
                begun = SavedState(done - part * count, count, 0.0, kept.arrays)
            seed = seed_of(job.asked.seed, piece.first, part)
            taken = _at_once(
                *(job, own, within, begun if part == first else None),
                *(before + part * count, progress, seed),
            )
            if taken.done < count:
                break
            not_finite += taken.not_finite
            arrays = {"transient": taken.transient, "steady": taken.steady}
            if scatter is None:
                scatter = Scatter(arrays)
            else:
                scatter.add(arrays)
    if scatter is None or scatter.count < 2:
        again = checkpoint.again if checkpoint else ""
        taken_parts = scatter.count if scatter else 0
        raise KeyboardInterrupt(interrupted(taken_parts, parts, "parts", again))
    means = scatter.means
    done = scatter.count * count
    return Taken(means["steady"], means["transient"], done, not_finite, 0.0, scatter.errors())


def _film_of(job: Job, piece: Piece) -> tuple[Any, Tile | None, tuple[int, int]]:
    """A film for a piece, where it is in the job's, and rows and columns to leave out before it.

    A filter reaches over the edges of a tile: what it takes from pixels there is rendered as well.
    """
    film = job.film
    height, width, bins, _ = film.shape
    if (piece.height, piece.width) == (height, width):
        return film, None, (0, 0)
    rfilter = film.rfilter()
    reach = 0 if rfilter.is_box_filter() or film.sample_border() else rfilter.border_size()
    y, x = max(0, piece.y - reach), max(0, piece.x - reach)
    own: Any = pixels_of(film) | {
        "height": min(height, piece.y + piece.height + reach) - y,
        "width": min(width, piece.x + piece.width + reach) - x,
    }
    for name in ("crop_width", "crop_height", "crop_offset_x", "crop_offset_y"):
        del own[name]
    small = mi.load_dict({"type": "hdrfilm"} | own)
    tile_film = transient_film(small, bins, film.start_opl, film.bin_width_opl)
    return tile_film, Tile(x, y, film), (piece.y - y, piece.x - x)
