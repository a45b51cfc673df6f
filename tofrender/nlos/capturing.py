"""Rendering of captures."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.image import time_bins, transient_film
from ..films.recording import warn_not_finite
from ..integrators.passes import SampleRange, best_sampler, steps
from ..integrators.running import interrupted, made_with, run
from ..rendering.collecting import ArrayStore, collect
from ..rendering.job import Job, dataset_of, decide, remaining
from ..rendering.settings import RenderSettings
from ..rendering.window import warn_of_losses
from ..rendering.work_items import render_item
from ..rendering.workers import check_client, render_by_workers, require_client
from ..runtime import backend, checks
from ..runtime.backend import versions
from ..runtime.checkpoints import Checkpoint, SavedState, SubCheckpoint
from ..runtime.progress import ProgressBar, Stop, deferred_stop, status, without_bars
from ..scenes.fingerprint import fingerprint
from ..scenes.packing import packed
from .captures import MODES, first_and_last_legs, make_capture, subtract_legs
from .device.laser import find_laser, focus_laser, position_of, restored_pose
from .device.relay_wall import trace_laser_spot
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
    """Capture a hidden scene by its relay wall.

    The sensor's pixels sample the wall: at the centres of the cells of an `nlos_capture_meter`, or
    where the centres of a camera's pixels look. Pixels that miss the wall are dark, and the
    variable `on_wall` says which (a warning says how many). Their points continue the plane of the
    wall; on a wall that is not flat they are the nearest pixel's.

    The attribute `energy_outside_window` is the fraction of the energy that no bin holds, without
    light of a single bounce that arrives before the window: the laser spot itself.

    Where the integrator leaves out the leg to the camera (`camera_unwarp`) and counts the legs
    otherwise, the laser's is subtracted as well: lengths are then from wall to wall.
    See also `reconstruct`, `save_capture`.

    Args:
        scene: As for `render`. Its integrator must be a `transient_nlos_path` or, for confocal
            captures, a `confocal_transient_path`. A file, name or dict is loaded with its shapes
            apart (`optimize=False`).
        mode: "confocal": the laser follows the pixel's point. "single": the laser stays where it is
            aimed. "exhaustive": the laser scans the points of the grid, and all pixels observe each
            of its spots. By default the scene decides: `capture_type` of the integrator, then
            `confocal` of an `nlos_capture_meter`. A scene with neither gives "confocal".
        grid: Width and height of the grid [points]; by default the film's.
        spp: Samples per pixel (and laser spot); by default the sampler's.
        seed: Seed of the random numbers.
        sensor: Number of the sensor.
        relay_wall: The wall: a shape, its id, or a list of either. By default the shape that the
            sensor is a child of, or that is called "relay_wall", or the only one that the pixels
            look at.
        checkpoint: As for `render`.
        client: A `distributed.Client`, whose workers render tiles of the grid or, of an exhaustive
            capture, laser spots. The scene must be a name, a file or a dict.
        progress: Whether long work shows a bar.

    Returns:
        A capture, see `tofrender.nlos.make_capture`. Ctrl-C, SIGTERM and SIGHUP return what is
        finished of a single or confocal one, with `complete` = 0 and `spp` as far as it got.

    Raises:
        ValueError: An argument is wrong, `mode` contradicts the scene, the scene has no laser or
            relay wall, the laser misses it, or no pixel looks at it; one line.
        KeyboardInterrupt: An exhaustive capture was stopped; one line that says how to go on.
        MemoryError: It does not fit; the message says what would.

    Warns:
        UserWarning: More than 1 % of the energy is outside the window, or pixels miss the wall.

    Example:
        >>> z = capture("nlos_z", grid=(4, 4), spp=16)
        >>> z["transient"].dims, z.attrs["mode"]
        (('y', 'x', 'opl', 'channel'), 'confocal')
    """
    backend.require_vectorised()
    if mode is not None:
        checks.one_of("mode", mode, MODES)
    checks.boolean("progress", progress)
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    name = os.fspath(scene) if isinstance(scene, str | os.PathLike) else "scene"
    if client is not None:
        require_client(client)
        packed("scene", scene)  # Refuses what cannot be sent
    with without_bars(not progress), status("Tracing the relay wall"):
        setup = prepare_capture(
            scene, mode=mode, grid=grid, spp=spp, seed=seed, sensor=sensor, wall=relay_wall
        )
    scene, camera, integrator, mode = setup.scene, setup.camera, setup.integrator, setup.mode
    points, normals, on_wall = setup.points
    missing = on_wall.size - int(on_wall.sum())
    if missing:
        warnings.warn(
            f"sensor: {missing} of {on_wall.size} pixels do not look at the relay wall; they are "
            "dark, and on_wall is false there",
            stacklevel=2,
        )
    geometry: dict[str, Any] = {
        "sensor_grid": points,
        "sensor_normals": normals,
        "sensor_origin": position_of(camera),
        "laser_origin": integrator.laser_origin(scene, camera),
    }
    attrs = {"scene": name, "spp": setup.spp, "seed": seed, "variant": mi.variant()}
    attrs["fingerprint"] = fingerprint(scene, camera, integrator)
    if mode == "exhaustive":
        with restored_pose(find_laser(scene)):
            job = ExhaustiveCapture(setup)
            values, outside = job.render_all(client, Checkpoint.of(checkpoint), progress)
        start, width = job.film.start_opl, job.film.bin_width_opl
        attrs["energy_outside_window"] = outside
        warn_of_losses(job.film, outside, window_option=WINDOW_SETTINGS, stacklevel=3)
        geometry |= {"laser_grid": points, "laser_normals": normals}
    else:
        job = _job(setup, name)
        if client is None:
            checkpoint = Checkpoint.of(checkpoint)
            result = render_item(job, remaining(job), checkpoint=checkpoint, progress=progress)
        else:
            result = collect(job, client, checkpoint, progress)
        dataset = dataset_of(job, result)
        values = dataset["transient"].values
        start, width = dataset.attrs["start_opl"], dataset.attrs["bin_width_opl"]
        attrs |= {k: dataset.attrs[k] for k in RENDER_ATTRIBUTES}
        if mode == "single":
            geometry["laser_grid"], geometry["laser_normals"] = trace_laser_spot(scene, setup.wall)
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
    one_leg = integrator.counts_legs and integrator.camera_unwarp
    return subtract_legs(data, first_and_last_legs(data, ["laser"])) if one_leg else data


def require_same_capture(found: xr.Dataset, scene: Any, **options: Any) -> None:
    """Refuse a capture that `capture` would not make again with these arguments.

    `options` are all that decide it, with the relay wall as `wall`.
    """
    setup = prepare_capture(scene, **options)
    wanted = {"mode": setup.mode, "spp": setup.spp, "seed": setup.seed, "variant": mi.variant()}
    if "fingerprint" in found.attrs:  # Those of earlier versions have none
        wanted["fingerprint"] = fingerprint(setup.scene, setup.camera, setup.integrator)
    for name, value in wanted.items():
        own = found.attrs.get(name)
        if own != value:
            raise ValueError(f"resume: was captured with {name} = {own!r}; must be {value!r}")
    points = found["sensor_grid"].values
    if points.shape != setup.points[0].shape or not np.allclose(points, setup.points[0]):
        raise ValueError("resume: was captured at other points of the wall; must be at these")


def _job(setup: CaptureSetup, name: str = "scene", axis: Any = None) -> Job:
    """Make a single or confocal capture a render."""
    settings = RenderSettings(name, spp=setup.spp, seed=setup.seed, sensor=setup.sensor)
    origin = _job_in_worker, setup.arguments
    job = decide(setup.plan(), setup.integrator, setup.scene, settings, origin, axis)
    job.more, job.window_option = setup.more, WINDOW_SETTINGS
    return job


def _job_in_worker(axis: Any, **arguments: Any) -> Job:
    """Prepare the same capture in a worker."""
    return _job(prepare_capture(**arguments), axis=axis)


class ExhaustiveCapture:
    """Exhaustive capture, a render for each laser spot of the grid, by this process or workers."""

    def __init__(self, setup: CaptureSetup) -> None:
        self.setup = setup
        film = setup.camera.film()
        window = time_bins(film)
        if not window:
            kind = film.class_name()
            raise ValueError(f"film = {kind}: has no time bins; must be transient_hdr_film")
        self.window, self.film = window, transient_film(film, *window)  # An empty film
        self.points, _, on_wall = setup.points
        self.spots = [(int(row), int(column)) for row, column in np.argwhere(on_wall)]
        made = {"seed": setup.seed, "spp": setup.spp, "variant": mi.variant(), **setup.more}
        made |= {"film": str(self.film), "versions": versions()}
        self.recipe = made_with(setup.scene, setup.camera, setup.integrator, made)
        self.origin = _exhaustive_in_worker, setup.arguments  # Makes the capture in a worker
        self.arrays: dict[str, np.ndarray] = {}

    def render(
        self,
        point: tuple[int, int],
        kept: SavedState | None = None,
        checkpoint: SubCheckpoint | None = None,
        stop: Stop | None = None,
        progress: bool = False,
    ) -> tuple[float, np.ndarray] | None:
        """Render one laser spot: all energy, and bins (rows, columns, bins, C); None if stopped."""
        setup = self.setup
        focus_laser(setup.scene, point=self.points[point])
        film = transient_film(setup.camera.film(), *self.window)
        record = setup.integrator.recording(film)
        seed = (setup.seed + point[0] * self.points.shape[1] + point[1]) % checks.MAX_SEED
        samples, sampler = SampleRange(saved=kept), best_sampler(setup.spp)
        done = run(
            steps(setup.plan(), record, setup.camera, sampler, seed, samples),
            *(record, setup.spp),
            done=samples.done,
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
        """Bins (laser rows, laser columns, rows, columns, bins, C), and energy outside of them."""
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
        spp, saved, done, arrays = self.setup.spp, None, 0, self.arrays
        whole = len(self.spots) * spp
        if checkpoint is not None:
            saved = checkpoint.begin(self.recipe, whole, "samples per pixel")
        if saved is not None:
            done = saved.done
            arrays |= {name: saved.arrays.pop(name) for name in arrays if name in saved.arrays}
        bar = ProgressBar(POINTS, len(self.spots), unit="point", enabled=progress)
        with bar, deferred_stop() as stop:
            for number, point in enumerate(self.spots):
                bar.update()
                if done > (number + 1) * spp:  # Where equal, the film of this point was kept
                    continue
                begun = max(0, done - number * spp)
                state = SavedState(begun, spp, 0.0, saved.arrays) if saved and begun else None
                within = checkpoint and SubCheckpoint(checkpoint, number * spp, whole, arrays)
                found = self.render(point, state, within, stop)
                if found is None or (stop.requested and number + 1 < len(self.spots)):
                    again = checkpoint.again if checkpoint else ""
                    raise KeyboardInterrupt(interrupted(number, len(self.spots), POINTS, again))
                self.add(arrays, point, found)
                done = (number + 1) * spp


def _exhaustive_in_worker(axis: Any, **arguments: Any) -> ExhaustiveCapture:
    """Prepare the same capture in a worker."""
    return ExhaustiveCapture(prepare_capture(**arguments))
