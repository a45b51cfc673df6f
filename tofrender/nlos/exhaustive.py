"""Exhaustive captures: a render for each laser spot of the grid."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.image import time_bins, transient_film
from ..films.recording import warn_not_finite
from ..integrators.passes import Part, best_sampler, steps
from ..integrators.running import interrupted, made_with, run
from ..rendering.work_items import ArrayStore
from ..rendering.workers import check_client, render_by_workers
from ..runtime import checks
from ..runtime.backend import versions
from ..runtime.checkpoints import Checkpoint, SavedState, SubCheckpoint
from ..runtime.progress import ProgressBar, Stop, deferred_stop
from .device.focus import focus_laser
from .setup import CaptureSetup, prepare_capture

if TYPE_CHECKING:
    from distributed import Client

POINTS = "laser points"


class ExhaustiveCapture:
    """An exhaustive capture, rendered in this process or by workers.

    Attributes:
        film: An empty film of one render.
        spots: Rows and columns of the grid's points that are on the wall.
        recipe: All that the result depends on, for checkpoints.
        origin: Function and arguments that make the capture again in a worker.
    """

    def __init__(self, setup: CaptureSetup) -> None:
        self.setup = setup
        film = setup.camera.film()
        window = time_bins(film)
        if not window:
            kind = film.class_name()
            raise ValueError(f"film = {kind}: has no time bins; must be transient_hdr_film")
        self.window, self.film = window, transient_film(film, *window)
        self.points, _, on_wall = setup.points
        self.spots = [(int(row), int(column)) for row, column in np.argwhere(on_wall)]
        made = {"seed": setup.seed, "spp": setup.spp, "variant": mi.variant(), **setup.more}
        made |= {"film": str(self.film), "versions": versions()}
        self.recipe = made_with(setup.scene, setup.camera, setup.integrator, made)
        self.origin = _in_worker, setup.arguments
        self.arrays: dict[str, np.ndarray] = {}

    def render(
        self,
        point: tuple[int, int],
        kept: SavedState | None = None,
        checkpoint: SubCheckpoint | None = None,
        stop: Stop | None = None,
        progress: bool = False,
    ) -> tuple[float, np.ndarray] | None:
        """Render with the laser on one point: all energy, and bins (rows, columns, bins, C).

        None if the render was stopped.
        """
        setup = self.setup
        focus_laser(setup.scene, point=self.points[point])
        film = transient_film(setup.camera.film(), *self.window)
        record = setup.integrator.recording(film)
        seed = (setup.seed + point[0] * self.points.shape[1] + point[1]) % checks.MAX_SEED
        part, sampler = Part(kept=kept), best_sampler(setup.spp)
        done = run(
            steps(setup.plan(), record, setup.camera, sampler, seed, part),
            *(record, setup.spp),
            done=part.done,
            checkpoint=checkpoint,
            progress=progress,
            stop=stop,
        )
        if done < setup.spp:
            return None
        warn_not_finite(record.not_finite)
        steady, bins = film.take()
        return float(np.sum(steady, dtype=np.float64)), bins

    def add(
        self, arrays: dict[str, np.ndarray], point: tuple[int, int], found: tuple[float, np.ndarray]
    ) -> None:
        """Add energy and bins of a laser point to the arrays of all."""
        arrays["energy"][point], arrays["values"][point] = found

    def render_all(
        self, client: Client | None, checkpoint: Checkpoint | None, progress: bool
    ) -> tuple[np.ndarray, float]:
        """Render with the laser on each point, by workers if there is a client.

        Returns:
            Bins (laser rows, laser columns, rows, columns, bins, C), and the fraction of the energy
            that none of them holds.
        """
        lasers = self.points.shape[:2]
        self.arrays["values"] = np.zeros((*lasers, *self.film.shape), np.float32)
        self.arrays["energy"] = np.zeros(lasers)
        if client is None:
            self._render_here(checkpoint, progress)
        else:
            check_client(client)
            store = ArrayStore(self, self.spots, self.arrays, self.recipe, POINTS, checkpoint)
            store.collect(render_by_workers(client, self, store.left), progress)
        values, energy = self.arrays["values"], self.arrays["energy"]
        inside, total = (float(np.sum(a, dtype=np.float64)) for a in (values[energy > 0], energy))
        return values, min(max(1 - inside / total, 0.0), 1.0) if total else 0.0

    def _render_here(self, checkpoint: Checkpoint | None, progress: bool) -> None:
        """Render point by point; a checkpoint also holds the film of the point under way."""
        spp, kept, done, arrays = self.setup.spp, None, 0, self.arrays
        whole = len(self.spots) * spp
        if checkpoint is not None:
            kept = checkpoint.begin(self.recipe, whole, "samples per pixel")
        if kept is not None:
            done = kept.done
            arrays |= {name: kept.arrays.pop(name) for name in arrays if name in kept.arrays}
        bar = ProgressBar(POINTS, len(self.spots), unit="point", enabled=progress)
        with bar, deferred_stop() as stop:
            for number, point in enumerate(self.spots):
                bar.update()
                if done > (number + 1) * spp:  # Where equal, the film of this point was kept
                    continue
                begun = max(0, done - number * spp)
                state = SavedState(begun, spp, 0.0, kept.arrays) if kept and begun else None
                within = checkpoint and SubCheckpoint(checkpoint, number * spp, whole, arrays)
                found = self.render(point, state, within, stop)
                if found is None or (stop.requested and number + 1 < len(self.spots)):
                    again = checkpoint.again if checkpoint else ""
                    raise KeyboardInterrupt(interrupted(number, len(self.spots), POINTS, again))
                self.add(arrays, point, found)
                done = (number + 1) * spp


def _in_worker(axis: Any, **arguments: Any) -> ExhaustiveCapture:
    """Prepare the same capture in a worker."""
    return ExhaustiveCapture(prepare_capture(**arguments))
