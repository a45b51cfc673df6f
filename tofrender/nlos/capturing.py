"""Rendering of captures."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.image import time_bins
from ..films.recording import warn_not_finite
from ..films.windowed import transient_film
from ..integrators.passes import SampleRange, best_sampler, steps
from ..integrators.render_loop import interrupted, made_with, run
from ..labels import bins_of
from ..rendering.collecting import ArrayStore, collect
from ..rendering.job import Job, dataset_of, decide, remaining
from ..rendering.settings import RenderSettings
from ..rendering.time_window import warn_of_losses
from ..rendering.work_items import render_item
from ..rendering.workers import check_client, render_by_workers, require_client
from ..runtime import checks, variants
from ..runtime.checkpoints import Checkpoint, SavedState, SubCheckpoint
from ..runtime.progress import ProgressBar, Stop, deferred_stop, status, without_bars
from ..runtime.versions import versions
from ..scenes.fingerprint import fingerprint
from ..scenes.packing import packed
from .captures import first_and_last_legs, make_capture, subtract_legs
from .device.laser import find_laser, focus_laser, position_of, restored_pose
from .device.relay_wall import trace_laser_spot
from .modes import MODES
from .setup import CaptureSetup, prepare_capture

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

POINTS = "laser points"
WINDOW_SETTINGS = "`temporal_bins`, `start_opl` and `bin_width_opl` of its film"
RENDER_ATTRIBUTES = ("pulse", "spp", "energy_outside_window", "complete")


def capture(
    scene: mi.Scene | Mapping[str, Any] | str | os.PathLike[str],
    *,
    mode: str | None = None,
    grid: tuple[int, int] | None = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    relay_wall: Any = None,
    checkpoint: Checkpoint | str | os.PathLike[str] | None = None,
    client: Client | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Capture a hidden scene by way of its relay wall.

    The pixels of the sensor sample the wall. With an `nlos_capture_meter`, the samples are the
    centers of its cells; with a camera, they are the points at which the pixel centers look. Pixels
    that miss the wall are dark. The variable `on_wall` marks them, and a warning reports their
    number. On a flat wall, their points continue the plane of the wall; otherwise, they repeat the
    point of the nearest pixel.

    The attribute `energy_outside_window` is the fraction of the energy outside all bins. It does
    not count light of a single bounce (the laser spot itself) that arrives before the window.

    If the integrator excludes the leg to the camera (`camera_unwarp`) but counts legs otherwise,
    the leg from the laser is subtracted as well. Then lengths are from wall to wall.
    See also `reconstruct`, `save_capture`.

    Args:
        scene: As for `render`. Its integrator must be a `transient_nlos_path` or, for confocal
            captures, a `confocal_transient_path`. A file, name or dict is loaded without merging
            its shapes (`optimize=False`).
        mode: "confocal": the laser follows the pixel's point. "single": the laser remains where it
            is aimed. "exhaustive": the laser scans the points of the grid, and all pixels observe
            each laser spot. By default the scene decides: first `capture_type` of the integrator,
            then `confocal` of an `nlos_capture_meter`. Without both, the mode is "confocal".
        grid: Width and height of the grid [points]; by default the film's.
        spp: Samples per pixel (and laser spot); by default the sampler's.
        seed: Seed of the random numbers.
        sensor: Index of the sensor.
        relay_wall: The wall: a shape, its id, or a list of shapes or ids. By default, the shape to
            which the sensor is attached, then the shape with the id "relay_wall", then the only
            shape that the pixels see.
        checkpoint: As for `render`.
        client: A `distributed.Client`. Its workers render tiles of the grid, or laser spots of an
            exhaustive capture. The scene must be a name, a file or a dict.
        progress: Whether to show a progress bar.

    Returns:
        A capture, see `tofrender.nlos.make_capture`. Ctrl-C, SIGTERM and SIGHUP stop a single or
        confocal capture and return the finished samples, with `complete` = 0 and the number of
        these samples as `spp`.

    Raises:
        ValueError: An argument is invalid, `mode` contradicts the scene, the laser or the relay
            wall is missing, the laser misses the wall, or no pixel looks at the wall.
        KeyboardInterrupt: An exhaustive capture was stopped. The message describes how to resume.
        MemoryError: The capture does not fit into memory. The message names a size that fits.

    Warns:
        UserWarning: More than 1 % of the energy is outside the window, or pixels miss the wall.

    Example:
        >>> z = capture("nlos_z", grid=(4, 4), spp=16)
        >>> z["transient"].dims, z.attrs["capture_mode"]
        (('y', 'x', 'opl', 'channel'), 'confocal')
    """
    # Check the arguments
    variants.require_vectorized()
    if mode is not None:
        checks.one_of("mode", mode, MODES)
    checks.boolean("progress", progress)
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    name = os.fspath(scene) if isinstance(scene, str | os.PathLike) else "scene"
    if client is not None:
        require_client(client)
        # Refuse scenes that cannot be sent to workers
        packed("scene", scene)

    # Load the scene
    with without_bars(not progress), status("Tracing the relay wall"):
        setup = prepare_capture(
            scene, mode=mode, grid=grid, spp=spp, seed=seed, sensor=sensor, wall=relay_wall
        )
    scene = setup.scene
    camera = setup.camera
    integrator = setup.integrator
    mode = setup.mode

    # Report dark pixels
    points, normals, on_wall = setup.points
    missing = on_wall.size - int(on_wall.sum())
    if missing:
        warnings.warn(
            f"sensor: {missing} of {on_wall.size} pixels do not look at the relay wall. They are "
            "dark, and on_wall is false there",
            stacklevel=2,
        )

    # Describe the geometry
    geometry: dict[str, Any] = {
        "sensor_grid": points,
        "sensor_normals": normals,
        "sensor_origin": position_of(camera),
        "laser_origin": integrator.laser_origin(scene, camera),
    }
    attrs = {"scene": name, "spp": setup.spp, "seed": seed, "variant": mi.variant()}
    attrs["fingerprint"] = fingerprint(scene, camera, integrator)

    # Exhaustive capture: render the light of each laser spot
    if mode == "exhaustive":
        with restored_pose(find_laser(scene)):
            job = ExhaustiveCapture(setup)
            values, outside = job.render_all(client, Checkpoint.of(checkpoint), progress)
        start = job.film.start_opl
        width = job.film.bin_width_opl
        attrs["energy_outside_window"] = outside
        warn_of_losses(job.film, outside, window_option=WINDOW_SETTINGS, stacklevel=3)
        geometry["laser_grid"] = points
        geometry["laser_normals"] = normals

    # Other captures: a single render
    else:
        job = _job(setup, name)
        if client is None:
            checkpoint = Checkpoint.of(checkpoint)
            result = render_item(job, remaining(job), checkpoint=checkpoint, progress=progress)
        else:
            result = collect(job, client, checkpoint, progress)
        dataset = dataset_of(job, result)
        values = dataset["transient"].values
        bins = bins_of(dataset, "the render")
        start = bins.start_opl
        width = bins.bin_width_opl
        attrs |= {k: dataset.attrs[k] for k in RENDER_ATTRIBUTES}
        if mode == "single":
            geometry["laser_grid"], geometry["laser_normals"] = trace_laser_spot(scene, setup.wall)

    # Combine light and geometry
    data = make_capture(
        np.where(on_wall[..., None, None], values, np.float32(0)),
        mode=mode,
        start_opl=start,
        bin_width_opl=width,
        counts_first_and_last_legs=integrator.counts_legs,
        on_wall=on_wall,
        attrs=attrs,
        **geometry,
    )

    # If one leg does not count, subtract the other leg
    one_leg = integrator.counts_legs and integrator.camera_unwarp
    return subtract_legs(data, first_and_last_legs(data, ["laser"])) if one_leg else data


def require_same_capture(found: xr.Dataset, scene: Any, **options: Any) -> None:
    """Raise a ValueError if `capture` would not reproduce a stored capture with these arguments.

    Args:
        found: The stored capture.
        scene: As for `capture`.
        options: All arguments of `prepare_capture`, with the relay wall as `wall`.

    Raises:
        ValueError: The capture was made with other arguments.
    """
    # Compare the settings
    setup = prepare_capture(scene, **options)
    wanted = {
        "capture_mode": setup.mode,
        "spp": setup.spp,
        "seed": setup.seed,
        "variant": mi.variant(),
        "fingerprint": fingerprint(setup.scene, setup.camera, setup.integrator),
    }
    for name, value in wanted.items():
        stored = found.attrs.get(name)
        if stored != value:
            raise ValueError(
                f"resume: the stored capture has {name} = {stored!r}, not {value!r}. Restore the "
                "settings, or remove the file"
            )

    # Compare the points of the wall
    points = found["sensor_grid"].values
    if points.shape != setup.points[0].shape or not np.allclose(points, setup.points[0]):
        raise ValueError(
            "resume: the stored capture has other points of the relay wall. Restore the scene, or "
            "remove the file"
        )


def _job(setup: CaptureSetup, name: str = "scene", axis: Any = None) -> Job:
    """Return the render job of a single or confocal capture."""
    settings = RenderSettings(name, spp=setup.spp, seed=setup.seed, sensor=setup.sensor)
    origin = _job_in_worker, setup.arguments
    job = decide(setup.plan(), setup.integrator, setup.scene, settings, origin, axis)
    job.more = setup.fingerprint_entries
    job.window_option = WINDOW_SETTINGS
    return job


def _job_in_worker(axis: Any, **arguments: Any) -> Job:
    """Prepare the same render job in a worker."""
    return _job(prepare_capture(**arguments), axis=axis)


class ExhaustiveCapture:
    """Exhaustive capture: one render for each laser spot of the grid.

    Args:
        setup: The capture, loaded and checked.
    """

    def __init__(self, setup: CaptureSetup) -> None:
        self.setup = setup
        # Create an empty film with the time bins of the scene's film
        film = setup.camera.film()
        window = time_bins(film)
        if not window:
            kind = film.class_name()
            raise ValueError(f"film = {kind}: has no time bins; must be transient_hdr_film")
        self.window = window
        self.film = transient_film(film, *window)

        # Laser spots: all points on the wall
        self.points, _, on_wall = setup.points
        self.spots = [(int(row), int(column)) for row, column in np.argwhere(on_wall)]

        # Everything that determines the result, for checkpoints
        made = {
            "seed": setup.seed,
            "spp": setup.spp,
            "variant": mi.variant(),
            **setup.fingerprint_entries,
            "film": str(self.film),
            "versions": versions(),
        }
        self.recipe = made_with(setup.scene, setup.camera, setup.integrator, made)

        # A function and its arguments that create the same capture in a worker
        self.origin = _exhaustive_in_worker, setup.arguments

        # Results: energy and bins of each laser spot
        self.arrays: dict[str, np.ndarray] = {}

    def render(
        self,
        point: tuple[int, int],
        kept: SavedState | None = None,
        checkpoint: SubCheckpoint | None = None,
        stop: Stop | None = None,
        progress: bool = False,
    ) -> tuple[float, np.ndarray] | None:
        """Render the light of one laser spot.

        Args:
            point: Row and column of the laser spot in the grid.
            kept: Finished samples of this laser spot, None to start anew.
            checkpoint: Checkpoint of this laser spot.
            stop: Request to stop.
            progress: Whether to show a progress bar.

        Returns:
            The energy inside and outside the window, and the bins (rows, columns, bins, channels).
            None if the render was stopped.
        """
        # Aim the laser, and create a film
        setup = self.setup
        focus_laser(setup.scene, point=self.points[point])
        film = transient_film(setup.camera.film(), *self.window)
        record = setup.integrator.recording(film)

        # Render with a seed of this laser spot
        seed = (setup.seed + point[0] * self.points.shape[1] + point[1]) % checks.MAX_SEED
        samples = SampleRange(saved=kept)
        sampler = best_sampler(setup.spp)
        done = run(
            steps(setup.plan(), record, setup.camera, sampler, seed, samples),
            record,
            setup.spp,
            done=samples.done,
            checkpoint=checkpoint,
            progress=progress,
            stop=stop,
        )
        if done < setup.spp:
            return None
        warn_not_finite(record.accumulation.not_finite)
        steady, bins = film.take()
        return float(np.sum(steady, dtype=np.float64)), bins

    def add(
        self, arrays: dict[str, np.ndarray], point: tuple[int, int], found: tuple[float, np.ndarray]
    ) -> None:
        """Store energy and bins of a laser spot in the arrays of all laser spots."""
        arrays["energy"][point], arrays["values"][point] = found

    def render_all(
        self, client: Client | None, checkpoint: Checkpoint | None, progress: bool
    ) -> tuple[np.ndarray, float]:
        """Render all laser spots.

        Returns:
            Bins (laser rows, laser columns, rows, columns, bins, channels), and the fraction of the
            energy outside the bins.
        """
        # Reserve memory
        lasers = self.points.shape[:2]
        self.arrays["values"] = np.zeros((*lasers, *self.film.shape), np.float32)
        self.arrays["energy"] = np.zeros(lasers)

        # Render in this process or in workers
        if client is None:
            self._render_here(checkpoint, progress)
        else:
            check_client(client)
            store = ArrayStore(self, self.spots, self.arrays, self.recipe, POINTS, checkpoint)
            results = render_by_workers(client, self, store.left, ExhaustiveCapture.render)
            store.collect(results, progress)

        # Compare the energy inside the bins with all energy
        values = self.arrays["values"]
        energy = self.arrays["energy"]
        inside = float(np.sum(values[energy > 0], dtype=np.float64))
        total = float(np.sum(energy, dtype=np.float64))
        return values, min(max(1 - inside / total, 0.0), 1.0) if total else 0.0

    def _render_here(self, checkpoint: Checkpoint | None, progress: bool) -> None:
        """Render the laser spots one after the other in this process.

        A checkpoint contains the finished laser spots, and the film of the current laser spot.
        """
        # Resume the checkpoint
        spp = self.setup.spp
        arrays = self.arrays
        whole = len(self.spots) * spp
        saved = None
        done = 0
        if checkpoint is not None:
            saved = checkpoint.begin(self.recipe, whole, "samples per pixel")
        if saved is not None:
            done = saved.done
            arrays |= {name: saved.arrays.pop(name) for name in arrays if name in saved.arrays}

        bar = ProgressBar(POINTS, len(self.spots), unit="point", enabled=progress)
        with bar, deferred_stop() as stop:
            for number, point in enumerate(self.spots):
                bar.update()

                # Skip finished laser spots. If both are equal, the film of this spot was stored
                if done > (number + 1) * spp:
                    continue

                # Render this laser spot, and resume the stored film
                begun = max(0, done - number * spp)
                state = SavedState(begun, spp, 0.0, saved.arrays) if saved and begun else None
                within = checkpoint and SubCheckpoint(checkpoint, number * spp, whole, arrays)
                found = self.render(point, state, within, stop)

                # Was the capture stopped?
                if found is None or (stop.requested and number + 1 < len(self.spots)):
                    again = checkpoint.again if checkpoint else ""
                    raise KeyboardInterrupt(interrupted(number, len(self.spots), POINTS, again))
                self.add(arrays, point, found)
                done = (number + 1) * spp


def _exhaustive_in_worker(axis: Any, **arguments: Any) -> ExhaustiveCapture:
    """Prepare the same exhaustive capture in a worker."""
    return ExhaustiveCapture(prepare_capture(**arguments))
