"""Rendering captures: a scene in, a Dataset of the relay wall out."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..paths.surfaces import first_surface
from ..rendering.asked import Asked
from ..rendering.job import Job, carry_out, collect, decide
from ..rendering.window import warn_of_losses
from ..rendering.workers import require_client
from ..runtime import backend, checks
from ..runtime.backend import tracing_lock
from ..runtime.checkpoints import Checkpoint
from ..runtime.progress import status, without_bars
from ..scenes.fingerprint import fingerprint
from ..scenes.packing import packed
from .captures import MODES, make_capture, without_first_leg
from .device.laser import axis, find_laser, kept_aim, place_of
from .device.relay_wall import is_on_relay_wall
from .exhaustive import LaserPoints
from .place import Place, place_of_capture

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client


MEND = "temporal_bins, start_opl and bin_width_opl of its film"
"""Settings that decide where the window of a capture is, for warnings."""

KEPT = ("pulse", "spp", "energy_outside_window", "complete")
"""What of the attributes of a render a capture has."""


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

    The sensor's pixels are the points of the wall that are looked at: the centres of the cells of
    an `nlos_capture_meter`, or what the centres of a camera's pixels see. Pixels that look at
    something else, or at nothing, are dark, and the variable `on_wall` says which (a warning says
    how many). Their points continue the plane of the wall; on a wall that is not flat they are the
    nearest pixel's.

    The attribute `energy_outside_window` is the fraction of the energy that no bin holds, without
    light of a single bounce that arrives before the window: the lit point itself.

    Where the integrator leaves out the way to the camera (`camera_unwarp`) and counts the legs
    otherwise, the laser's is taken off as well: lengths are then from wall to wall.

    Args:
        scene: As for `render`. Its integrator must be a `transient_nlos_path` or, for confocal
            captures, a `confocal_transient_path`. A scene that is not loaded yet is loaded with
            its shapes apart (`optimize=False`).
        mode: "confocal": each point is lit while it is looked at; "single": the laser lights the
            point that it aims at; "exhaustive": it lights the points of the same grid one by one.
        grid: Width and height of the grid [points]; by default the film's.
        spp: Samples per pixel (and laser point); by default the sampler's.
        seed: Seed of the random numbers.
        sensor: Number of the sensor.
        relay_wall: The wall, if the scene does not say which shape that is: a shape, its id, or a
            list of either. By default the shape that the sensor is a child of, or the one that is
            called "relay_wall", or the only one that the sensor's pixels look at.
        checkpoint: As for `render`.
        client: A `distributed.Client`, whose workers take tiles of the grid or, of an exhaustive
            capture, laser points. The scene must be a name, a file or a dict.
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
    with without_bars(not progress), status("Looking at the wall"):
        place = place_of_capture(
            scene, mode=mode, grid=grid, spp=spp, seed=seed, sensor=sensor, wall=relay_wall
        )
    scene, camera, integrator = place.scene, place.camera, place.integrator
    points, normals, on_wall = place.points
    _tell_misses(on_wall)
    geometry: dict[str, Any] = {"sensor_grid": points, "sensor_normals": normals}
    geometry["sensor_origin"] = place_of(camera)
    geometry["laser_origin"] = integrator.laser_origin(scene, camera)
    attrs = {"scene": name, "spp": place.spp, "seed": seed, "variant": mi.variant()}
    attrs["fingerprint"] = fingerprint(scene, camera, integrator)
    if mode == "exhaustive":
        with kept_aim(find_laser(scene)):
            laser = LaserPoints(place, _laser_points_again)
            kept = Checkpoint.of(checkpoint)
            values, outside = (
                laser.here(kept, progress)
                if client is None
                else laser.by_workers(client, kept, progress)
            )
        start, width = laser.film.start_opl, laser.film.bin_width_opl
        attrs["energy_outside_window"] = outside
        warn_of_losses(laser.film, outside, mend=MEND, stacklevel=3)
        geometry |= {"laser_grid": points, "laser_normals": normals}
    else:
        job = _job(place, name)
        if client is None:
            dataset = carry_out(job, checkpoint=checkpoint, progress=progress)
        else:
            dataset = collect(job, client, checkpoint, progress)
        values = dataset["transient"].values
        start, width = dataset.attrs["start_opl"], dataset.attrs["bin_width_opl"]
        attrs |= {k: dataset.attrs[k] for k in KEPT}
        if mode == "single":
            geometry |= _laser_point(scene, place.wall)
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
    return without_first_leg(data) if one_leg else data


def require_same_capture(found: xr.Dataset, scene: Any, **options: Any) -> None:
    """Refuse a capture that is not the one that `capture` would make.

    Args:
        found: The capture.
        scene: As for `capture`.
        **options: All arguments that decide it, as for `capture`, with its relay wall as `wall`.

    Raises:
        ValueError: One line that names what differs.
    """
    place = place_of_capture(scene, **options)
    wanted = {"mode": place.mode, "spp": place.spp, "seed": place.seed, "variant": mi.variant()}
    if "fingerprint" in found.attrs:  # Those of earlier versions have none
        wanted["fingerprint"] = fingerprint(place.scene, place.camera, place.integrator)
    for name, value in wanted.items():
        if found.attrs.get(name) != value:
            its = found.attrs.get(name)
            raise ValueError(f"resume: was captured with {name} = {its!r}; must be {value!r}")
    points = found["sensor_grid"].values
    if points.shape != place.points[0].shape or not np.allclose(points, place.points[0]):
        raise ValueError("resume: was captured at other points of the wall; must be at these")


def _job(place: Place, name: str = "scene", axis: Any = None) -> Job:
    """A single or confocal capture as a render."""
    asked = Asked(name, spp=place.spp, seed=place.seed, sensor=place.sensor)
    origin = _job_again, place.arguments
    job = decide(place.plan(), place.integrator, place.scene, asked, origin, axis)
    job.more, job.mend = place.more, MEND
    return job


def _job_again(axis: Any, **arguments: Any) -> Job:
    """The same in a worker."""
    return _job(place_of_capture(**arguments), axis=axis)


def _tell_misses(on_wall: np.ndarray) -> None:
    """Warn of pixels that do not look at the wall."""
    missing = on_wall.size - int(on_wall.sum())
    if missing:
        warnings.warn(
            f"sensor: {missing} of {on_wall.size} pixels do not look at the relay wall; they are "
            "dark, and on_wall is false there",
            stacklevel=3,
        )


def _laser_points_again(axis: Any, **arguments: Any) -> LaserPoints:
    """The same in a worker."""
    return LaserPoints(place_of_capture(**arguments), _laser_points_again)


@tracing_lock()
def _laser_point(scene: mi.Scene, wall: list[mi.Shape]) -> dict[str, np.ndarray]:
    """The point that the laser of a single capture lights, and the wall's normal there."""
    ray = mi.Ray3f(*axis(find_laser(scene)))
    si: Any = first_surface(scene, ray)
    if not is_on_relay_wall(si, wall)[0]:
        raise ValueError("laser: does not light the relay wall; focus_laser turns it there")
    normal = si.n * dr.sign(-dr.dot(si.n, ray.d))
    grid, normals = (np.array(v, dtype=np.float64).reshape(1, 1, 3) for v in (si.p, normal))
    return {"laser_grid": grid, "laser_normals": normals}
