"""Rendering of captures."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..paths.surfaces import first_surface
from ..rendering.collecting import collect
from ..rendering.job import Job, carry_out, decide
from ..rendering.settings import RenderSettings
from ..rendering.window import warn_of_losses
from ..rendering.workers import require_client
from ..runtime import backend, checks
from ..runtime.backend import tracing_lock
from ..runtime.checkpoints import Checkpoint
from ..runtime.progress import status, without_bars
from ..scenes.fingerprint import fingerprint
from ..scenes.packing import packed
from .captures import MODES, first_and_last_legs, make_capture, subtract_legs
from .device.laser import axis, find_laser, position_of, restored_pose
from .device.relay_wall import is_on_relay_wall
from .exhaustive import ExhaustiveCapture
from .setup import CaptureSetup, prepare_capture

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

WINDOW_SETTINGS = "temporal_bins, start_opl and bin_width_opl of its film"
RENDER_ATTRIBUTES = ("pulse", "spp", "energy_outside_window", "complete")


def capture(
    scene: mi.Scene | Mapping[str, Any] | str | os.PathLike[str],
    *,
    mode: str = "confocal",
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

    Args:
        scene: As for `render`. Its integrator must be a `transient_nlos_path` or, for confocal
            captures, a `confocal_transient_path`. A file, name or dict is loaded with its shapes
            apart (`optimize=False`).
        mode: "confocal": the laser follows the pixel's point; "single": it stays where it is aimed;
            "exhaustive": it scans the points of the same grid, for all pixels each.
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
        ValueError: An argument is wrong, the scene has no laser or relay wall, the laser misses it,
            or no pixel looks at it; one line.
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
    scene, camera, integrator = setup.scene, setup.camera, setup.integrator
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
            dataset = carry_out(job, checkpoint=checkpoint, progress=progress)
        else:
            dataset = collect(job, client, checkpoint, progress)
        values = dataset["transient"].values
        start, width = dataset.attrs["start_opl"], dataset.attrs["bin_width_opl"]
        attrs |= {k: dataset.attrs[k] for k in RENDER_ATTRIBUTES}
        if mode == "single":
            geometry |= _laser_spot(scene, setup.wall)
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
        if found.attrs.get(name) != value:
            own = found.attrs.get(name)
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


@tracing_lock()
def _laser_spot(scene: mi.Scene, wall: list[mi.Shape]) -> dict[str, np.ndarray]:
    """Trace the laser spot of a single capture, and the wall's normal there."""
    ray = mi.Ray3f(*axis(find_laser(scene)))
    si: Any = first_surface(scene, ray)
    if not is_on_relay_wall(si, wall)[0]:
        raise ValueError("laser: does not light the relay wall; focus_laser aims it there")
    normal = si.n * dr.sign(-dr.dot(si.n, ray.d))
    grid, normals = (np.array(v, dtype=np.float64).reshape(1, 1, 3) for v in (si.p, normal))
    return {"laser_grid": grid, "laser_normals": normals}
