"""Frames of an animation: a moving scene in time, at one time after the other."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.windowed import transient_film
from ..integrators.render_loop import interrupted
from ..rendering.dataset import LOST_ENERGY
from ..rendering.job import Job, WorkItem, WorkResult, dataset_of, decide, whole
from ..rendering.renderer import make_job
from ..rendering.settings import RenderSettings, is_auto
from ..rendering.work_items import render_item
from ..runtime import checks, memory
from ..runtime.parameters import require_names
from ..runtime.progress import ProgressBar, deferred_stop
from ..scenes.motion import posed

POSES = 8  # Default number of poses in an exposure
MAX_POSES = 4096
TOTALS = {"energy_outside_window": max, "render_seconds": sum}  # Attributes of all frames together

OF_ONE_FRAME = {"frame": "time_s", "fingerprint": "fingerprint"}
"""Coordinates along `frame`, and the attributes of a frame that they contain."""

NOT_OF_FRAMES = ("scene", "errors", "denoise")  # Settings of a render that frames do not have


@dataclass(frozen=True)
class Shutter:
    """When the rows of a frame are exposed.

    Args:
        exposure_s: Exposure of each row [s].
        poses: Poses of the scene in an exposure, at the middles of equal parts; by default 8, or as
            many as there are samples, and 1 without an exposure.
        row_time_s: Time from the start of a row to that of the next one below [s], 0 for all at
            once.
    """

    exposure_s: float = 0.0
    poses: int | None = None
    row_time_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("exposure_s", "row_time_s"):
            seconds = checks.number(name, getattr(self, name), low=0, unit="seconds")
            object.__setattr__(self, name, seconds)
        if self.poses is not None:
            poses = checks.integer("poses", self.poses, 1, MAX_POSES)
            alone = poses == 1 or self.exposure_s > 0
            checks.require("poses", poses, alone, "1 or left out without exposure_s")

    def of_samples(self, count: int) -> Shutter:
        """Return the shutter with a number of poses, for a number of samples per pixel."""
        if self.poses is None:
            return replace(self, poses=min(POSES, count) if self.exposure_s else 1)
        checks.require("poses", self.poses, self.poses <= count, f"at most spp, {count}")
        return self

    def parts(self, item: WorkItem, time_s: float, row: int) -> Iterator[tuple[float, WorkItem]]:
        """Yield the parts of a frame: the time of a pose [s], and the work item of this pose.

        With a row time, each row is exposed later than the row above. Without a row time, all rows
        are exposed together. Each pose is in the middle of an equal part of the exposure, and gets
        an equal part of the samples. The samples of all poses belong to one point set.

        Args:
            item: The pixels and samples of the whole frame.
            time_s: Time at which the first row of the film without a crop starts [s].
            row: Row of the film where the crop window, and therefore `item`, starts.
        """
        poses: Any = self.poses
        edges = [item.count * k // poses for k in range(poses + 1)]
        rows = [item]
        if self.row_time_s:
            rows = [replace(item, y=y, height=1) for y in range(item.height)]
        for each in rows:
            start = time_s + (row + each.y) * self.row_time_s
            for k in range(poses):
                part = replace(each, first=edges[k], count=edges[k + 1] - edges[k])
                yield start + (k + 0.5) / poses * self.exposure_s, part


def render_frames(
    scene: mi.Scene | Mapping[str, object] | str | PathLike[str],
    times_s: Sequence[float],
    *,
    exposure_s: float = 0.0,
    poses: int | None = None,
    row_time_s: float = 0.0,
    progress: bool = True,
    **settings: Any,
) -> xr.Dataset:
    """Render frames of a moving scene in time.

    All frames have the same random numbers, so that what rests looks the same in all. Light travels
    in no time compared with the motion: each path sees the scene in one pose.

    Args:
        scene: As for `render`; its parts move as the scene says, or `moving`.
        times_s: Times at which the frames start [s].
        exposure_s: Exposure of each row [s]; 0 shows the scene in one pose.
        poses: Poses of the scene in an exposure, 1 to 4096, which share the samples of a pixel; by
            default 8, at most `spp`. Too few show as separate pictures.
        row_time_s: Time from the start of a row to that of the next one below [s], of a rolling
            shutter; 0 starts all at once.
        progress: Show a bar for work that takes long.
        **settings: `spp`, `seed`, `size`, `bins`, `start_opl`, `bin_width`, `window`,
            `pulse_width`, `max_depth`, `integrator`, `sampler`, `sensor`, `define` and `settings`,
            as for `render`. The window "auto" contains the light of the first and last frame.

    Returns:
        A Dataset as of `render` with an axis `frame` before the others. The coordinates along it
        are `frame`, the times `times_s` [s], and `fingerprint`, which identifies the scene in its
        pose. Functions that take a render take one frame, `film.isel(frame=2)`. Ctrl-C, SIGTERM
        and SIGHUP return the frames that are finished, with `complete` = 0.

    Raises:
        ValueError: An argument or the scene is wrong.
        MemoryError: The frames do not fit.
        KeyboardInterrupt: The render was stopped in the first frame.

    Warns:
        UserWarning: More than 1 % of a frame's energy is outside the window, or the render was
            stopped.

    Example:
        >>> import tofrender
        >>> size = {"size": (8, 8), "bins": 350, "spp": 8, "progress": False}
        >>> film = render_frames("fan", [0, 0.01, 0.02], exposure_s=0.005, **size)
        >>> dict(film["transient"].sizes)
        {'frame': 3, 'y': 8, 'x': 8, 'opl': 350, 'channel': 3}
    """
    shutter = Shutter(exposure_s, poses, row_time_s)
    known = [each.name for each in fields(RenderSettings) if each.name not in NOT_OF_FRAMES]
    require_names("render_frames", settings, known)
    job, shutter = open_frames(RenderSettings(scene, **settings), times_s, shutter)
    times = np.asarray(times_s, dtype=float)
    copies = 2.0 * len(times) + 1
    memory.require_film(*job.film.shape, copies=copies, device_copies=2, host_copies=copies)
    done: list[xr.Dataset] = []
    with ProgressBar("Rendering", len(times), enabled=checks.boolean("progress", progress)) as bar:
        for time in times:
            try:
                done.append(render_frame(job, float(time), shutter))
            except KeyboardInterrupt:
                message = interrupted(len(done), len(times), "frames")
                if not done:
                    raise KeyboardInterrupt(message) from None
                warnings.warn(f"{message}, which are returned", stacklevel=2)
                break
            bar.update()
    return join_frames(done, complete=len(done) == len(times))


def join_frames(frames: list[xr.Dataset], *, complete: bool) -> xr.Dataset:
    """Join frames along a first axis `frame`, with their times [s] and fingerprints."""
    attrs = dict(frames[0].attrs)
    for name, total in TOTALS.items():
        attrs[name] = total(each.attrs[name] for each in frames)
    attrs["complete"] = int(complete)
    coordinates = {}
    for name, attribute in OF_ONE_FRAME.items():
        if attribute in attrs:
            coordinates[name] = "frame", [each.attrs[attribute] for each in frames]
            del attrs[attribute]
    joined = xr.concat(frames, "frame", combine_attrs="drop").assign_coords(coordinates)
    joined["frame"].attrs["units"] = "s"
    return joined.assign_attrs(attrs)


def open_frames(settings: RenderSettings, times_s: Any, shutter: Shutter) -> tuple[Job, Shutter]:
    """Check everything, load the scene, and find one window for all frames.

    A window in which both the first and the last frame are dark is refused.
    """
    times = checks.finite("times_s", checks.real_array("times_s", times_s, float))
    checks.require(
        "times_s", times_s, times.ndim == 1 and times.size, "times in seconds, 1 or more"
    )
    job = make_job(settings, may_be_dark=True)
    shutter = shutter.of_samples(whole(job).count)
    valid = not (shutter.row_time_s and job.plan.splats)
    allowed = f"0 with {type(job.integrator).__name__}, whose light lands on any row"
    checks.require("row_time_s", shutter.row_time_s, valid, allowed)
    films = []
    dark = []
    for time in (times[0], times[-1]):
        with posed(job.scene, float(time)):
            try:
                films.append(_posed_job(job, found=False).film)
            except ValueError as error:
                dark.append(error)
    if not films:
        raise dark[0]
    if not is_auto(job.settings.window):
        return job, shutter
    start = min(each.start_opl for each in films)
    stop = max(each.end_opl() for each in films)
    bins = job.film.temporal_bins
    film = transient_film(job.camera.film(), bins, start, (stop - start) / bins)
    return replace(job, film=film), shutter


def render_frame(job: Job, time_s: float, shutter: Shutter) -> xr.Dataset:
    """Render a frame that starts at a time [s]; raises KeyboardInterrupt if it is stopped."""
    height, width, _, channels = job.film.shape
    arrays = {"transient": np.zeros(job.film.shape, np.float32), "not_finite": np.zeros(1, int)}
    arrays["steady"] = np.zeros((height, width, channels), np.float32)
    row = int(np.array(job.film.crop_offset())[1])
    seconds = 0.0
    with posed(job.scene, time_s):
        frame = _posed_job(job)
        about = f"{shutter} {frame.recipe['fingerprint']}"  # Of the pose at the start
    with deferred_stop() as stop:
        for time, item in shutter.parts(whole(job), time_s, row):
            with posed(job.scene, time):
                result = render_item(_posed_job(job), item, progress=False)
            if result.done < item.count or stop.requested:
                raise KeyboardInterrupt("interrupted")
            job.add(arrays, item, result)
            seconds += result.seconds
    not_finite = int(arrays.pop("not_finite")[0])
    result = WorkResult(arrays, whole(job).count, not_finite, seconds)
    if shutter != Shutter(poses=1):
        digest = hashlib.sha256(about.encode()).hexdigest()[:12]
        frame.recipe["fingerprint"] = f"{frame.recipe['fingerprint'][:2]}{digest}"
    found = dataset_of(frame, result).assign_attrs(time_s=time_s, **vars(shutter))
    outside = found.attrs["energy_outside_window"]
    if outside > LOST_ENERGY:
        message = f"{outside:.1%} of the energy is outside the window at {time_s:g} s; see `window`"
        warnings.warn(message, stacklevel=3)
    return found


def _posed_job(job: Job, found: bool = True) -> Job:
    """Return the job of a scene's present pose, with its window if `found`, otherwise a new window.

    The data that a plan keeps of a scene may depend on the pose.
    """
    film = job.film
    axis = (film.temporal_bins, film.start_opl, film.bin_width_opl) if found else None
    plan = job.integrator.plan(job.scene, job.camera)
    return decide(plan, job.integrator, job.scene, job.settings, job.origin, axis)
