"""Exhaustive captures: each point of the grid is lit in turn."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NoReturn

import mitsuba as mi
import numpy as np

from ..films.image import time_bins, transient_film
from ..films.recording import tell_not_finite
from ..integrators.passes import Part, best_sampler, steps
from ..integrators.running import interrupted, made_with, run
from ..rendering.pieces import collect_pieces
from ..rendering.workers import check_client, pieces_by_workers
from ..runtime import checks
from ..runtime.backend import versions
from ..runtime.checkpoints import Checkpoint, SavedState, SubCheckpoint
from ..runtime.progress import Stop, deferred_stop, progress_bar
from .device.focus import focus_laser
from .place import Place

if TYPE_CHECKING:
    from distributed import Client

POINTS = "laser points"


class LaserPoints:
    """An exhaustive capture: a render for each laser point.

    Args:
        place: The capture.
        again: Makes the same in a worker.

    Attributes:
        film: A film of one render, empty.
        lit: Rows and columns of the points that are on the wall.
    """

    def __init__(self, place: Place, again: Callable[..., LaserPoints]) -> None:
        self.place = place
        self.window = time_bins(place.camera.film()) or _no_bins(place.camera.film())
        self.film = transient_film(place.camera.film(), *self.window)
        points, _, on_wall = place.points
        self.points = points
        self.lit = [(int(row), int(column)) for row, column in np.argwhere(on_wall)]
        made = {"seed": place.seed, "spp": place.spp, "variant": mi.variant(), **place.more}
        made |= {"film": str(self.film), "versions": versions()}
        self.recipe = made_with(place.scene, place.camera, place.integrator, made)
        self.origin = again, place.arguments

    def take(
        self,
        point: tuple[int, int],
        kept: SavedState | None = None,
        checkpoint: SubCheckpoint | None = None,
        stop: Stop | None = None,
        progress: bool = False,
    ) -> tuple[float, np.ndarray] | None:
        """Render with one point lit: all energy, and bins (rows, columns, bins, C).

        None if it was stopped.
        """
        place = self.place
        focus_laser(place.scene, point=self.points[point])
        film = transient_film(place.camera.film(), *self.window)
        record = place.integrator.recording(film)
        seed = (place.seed + point[0] * self.points.shape[1] + point[1]) % checks.MAX_SEED
        part, sampler = Part(kept=kept), best_sampler(place.spp)
        done = run(
            steps(place.plan(), record, place.camera, sampler, seed, part),
            *(record, place.spp),
            done=part.done,
            checkpoint=checkpoint,
            progress=progress,
            stop=stop,
        )
        if done < place.spp:
            return None
        tell_not_finite(record.not_finite)
        steady, bins = film.take()
        return float(np.sum(steady, dtype=np.float64)), bins

    def empty(self) -> dict[str, np.ndarray]:
        """Bins, (laser rows, laser columns, rows, columns, bins, C), and energy of each point."""
        lasers = self.points.shape[:2]
        values = np.zeros((*lasers, *self.film.shape), np.float32)
        return {"values": values, "energy": np.zeros(lasers)}

    def here(self, checkpoint: Checkpoint | None, progress: bool) -> tuple[np.ndarray, float]:
        """Render with each point lit, in this process; as `_whole` gives it."""
        spp, kept, done, arrays = self.place.spp, None, 0, self.empty()
        whole = len(self.lit) * spp
        if checkpoint is not None:
            kept = checkpoint.begin(self.recipe, whole, "samples per pixel")
        if kept is not None:
            done = kept.done
            arrays |= {name: kept.arrays.pop(name) for name in arrays if name in kept.arrays}
        with (
            progress_bar(POINTS, len(self.lit), unit="point", enabled=progress) as bar,
            deferred_stop() as stop,
        ):
            for number, point in enumerate(self.lit):
                bar.update()
                if done > (number + 1) * spp:  # Where equal, the film of this point was kept
                    continue
                begun = max(0, done - number * spp)
                state = SavedState(begun, spp, 0.0, kept.arrays) if kept and begun else None
                within = checkpoint and SubCheckpoint(checkpoint, number * spp, whole, arrays)
                found = self.take(point, state, within, stop)
                if found is None or (stop.requested and number + 1 < len(self.lit)):
                    again = checkpoint.again if checkpoint else ""
                    raise KeyboardInterrupt(interrupted(number, len(self.lit), POINTS, again))
                (arrays["energy"][point], arrays["values"][point]), done = found, (number + 1) * spp
        return _whole(arrays)

    def by_workers(
        self, client: Client, checkpoint: Checkpoint | None, progress: bool
    ) -> tuple[np.ndarray, float]:
        """Render with each point lit, by workers; as `_whole` gives it."""
        check_client(client)
        arrays = self.empty()

        def place(point: tuple[int, int], found: tuple[float, np.ndarray]) -> None:
            arrays["energy"][point], arrays["values"][point] = found

        collect_pieces(
            partial(pieces_by_workers, client, self),
            self.lit,
            place,
            arrays,
            recipe=self.recipe,
            unit=POINTS,
            checkpoint=checkpoint,
            progress=progress,
        )
        return _whole(arrays)


def _whole(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, float]:
    """All bins, and the fraction of the energy that none of them holds."""
    values, energy = arrays["values"], arrays["energy"]
    inside, total = (float(np.sum(a, dtype=np.float64)) for a in (values[energy > 0], energy))
    return values, min(max(1 - inside / total, 0.0), 1.0) if total else 0.0


def _no_bins(film: mi.Film) -> NoReturn:
    """Refuse a film without time bins."""
    raise ValueError(f"film = {film.class_name()}: has no time bins; must be transient_hdr_film")
