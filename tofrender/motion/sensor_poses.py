"""Renders of a scene from many poses of the sensor, with the scene loaded once."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np
import xarray as xr

from ..integrators.render_loop import interrupted
from ..rendering.dataset import LOST_ENERGY
from ..rendering.job import Job, dataset_of, decide, whole
from ..rendering.renderer import make_job
from ..rendering.settings import RenderSettings, is_auto
from ..rendering.work_items import render_item
from ..runtime import checks, memory
from ..runtime.interface import pose
from ..runtime.parameters import require_names
from ..runtime.progress import ProgressBar
from ..scenes.motion import motions_of, movable_parts, placed, require_movable

NOT_OF_POSES = ("scene", "errors", "denoise")  # Settings of a render that are not supported
RIGID = 1e-3  # Largest error of the rotation of a pose


def render_poses(
    scene: mi.Scene | Mapping[str, object] | str | PathLike[str],
    poses: Sequence[Any] | np.ndarray,
    *,
    attached: Sequence[str] = (),
    progress: bool = True,
    **settings: Any,
) -> xr.Dataset:
    """Render a scene from many poses of the sensor.

    The scene is loaded once, and all poses share the compiled kernels and the random numbers.

    Args:
        scene: As for `render`, without moving parts.
        poses: Poses of the sensor in the world, shape (poses, 4, 4): a rotation and a translation
            [m]. A sensor looks along its axis z. Its axis x is to the left in the picture, and its
            axis y is up.
        attached: Ids of lights and shapes that move with the sensor, for example a laser.
        progress: Show a progress bar.
        **settings: `spp`, `seed`, `size`, `bins`, `start_opl`, `bin_width`, `window`,
            `pulse_width`, `max_depth`, `integrator`, `sampler`, `sensor`, `define` and `settings`,
            as for `render`. All poses have the same window; "auto" is not supported.

    Returns:
        A Dataset as of `render` with an axis `pose` before the others, and the poses as the
        variable `to_world (pose, row, column)`. With a perspective camera, the coordinates `tan_x`
        and `tan_y` are the tangents x / z and y / z of the pixels' centers in the sensor's frame.
        Ctrl-C, SIGTERM and SIGHUP return the poses that are finished, with `complete` = 0.

    Raises:
        ValueError: An argument or the scene is wrong, or a pose is not rigid.
        MemoryError: The poses do not fit.
        KeyboardInterrupt: The render was stopped in the first pose.

    Warns:
        UserWarning: More than 1 % of the energy is outside the window, or the render was stopped.

    Example:
        >>> import numpy as np, tofrender
        >>> scene = tofrender.cornell_box(width=6, height=4, max_depth=2)
        >>> pose = np.diag([-1.0, 1.0, -1.0, 1.0])  # Looks along -z
        >>> pose[:3, 3] = [0, 0, 4]
        >>> found = render_poses(scene, [pose, pose], spp=4, window=(3.5, 15.0), progress=False)
        >>> found["transient"].dims, found["to_world"].shape
        (('pose', 'y', 'x', 'opl', 'channel'), (2, 4, 4))
    """
    known = [each.name for each in fields(RenderSettings) if each.name not in NOT_OF_POSES]
    require_names("render_poses", settings, known)
    matrices = require_poses("poses", poses)
    checks.boolean("progress", progress)
    if is_auto(settings.get("window")):
        raise ValueError("window = 'auto' is not supported for poses. Pass (start, stop) in meters")

    # Load the scene once, and find which parts move
    job = make_job(RenderSettings(scene, **settings), may_be_dark=True)
    if is_auto(job.settings.window):
        raise ValueError("the scene's film has no time bins. Pass bins and window = (start, stop)")
    parts = _moving_parts(job, attached)
    memory.require_film(*job.film.shape, copies=len(matrices) + 2.0)
    back = np.linalg.inv(pose(job.camera))

    # Render each pose
    renders: list[xr.Dataset] = []
    with ProgressBar("Rendering", len(matrices), enabled=progress) as bar:
        for matrix in matrices:
            change = matrix @ back
            with placed(job.scene, dict.fromkeys(parts, np.asarray(change))):
                posed_job = _posed_job(job)
                result = render_item(posed_job, whole(job), progress=False)
                finished = result.done == whole(job).count
                if finished:
                    renders.append(dataset_of(posed_job, result))
            if not finished:
                message = interrupted(len(renders), len(matrices), "poses")
                if not renders:
                    raise KeyboardInterrupt(message)
                warnings.warn(f"{message}, which are returned", stacklevel=2)
                break
            bar.update()

    found = _joined(renders, matrices, parts).assign_coords(_tangents(job.camera))
    outside = found.attrs["energy_outside_window"]
    if outside > LOST_ENERGY:
        warnings.warn(
            f"{outside:.1%} of the energy of a pose is outside the window; see `window`",
            stacklevel=2,
        )
    return found


def require_poses(name: str, poses: Any) -> np.ndarray:
    """Check poses of a sensor, and return them as float64 (poses, 4, 4)."""
    found = checks.finite(name, checks.real_array(name, poses, np.float64))
    valid = found.ndim == 3 and found.shape[1:] == (4, 4) and len(found) > 0
    checks.shape(name, found, valid, "(poses, 4, 4), with one pose or more")
    rotation = found[:, :3, :3]
    skew = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    turned = np.linalg.det(rotation) > 0
    last = np.abs(found[:, 3] - [0, 0, 0, 1]).max(axis=1)
    bad = np.flatnonzero((skew > RIGID) | ~turned | (last > 0))
    if bad.size:
        raise ValueError(
            f"{name}[{bad[0]}] is not a rotation and a translation with the last row 0, 0, 0, 1. "
            "Pass a rigid pose without scale or mirror"
        )
    return found


def _moving_parts(job: Job, attached: Sequence[str]) -> list[str]:
    """Return the ids of the parts that move with the sensor: the sensor and the attached parts.

    Raises:
        ValueError: The scene has moving parts, or an attached id does not name a movable part.
    """
    if motions_of(job.scene):
        raise ValueError("the scene has moving parts; render_poses supports scenes at rest")
    if isinstance(attached, str):
        raise ValueError(f"attached = {attached!r}: must be a list of ids")
    known = movable_parts(job.scene)
    for name in attached:
        require_movable("attached", name, known)
    return [job.camera.id(), *attached]


def _posed_job(job: Job) -> Job:
    """Return the job of the scene's present pose, since a plan may depend on the pose."""
    film = job.film
    axis = (film.temporal_bins, film.start_opl, film.bin_width_opl)
    plan = job.integrator.plan(job.scene, job.camera)
    return decide(plan, job.integrator, job.scene, job.settings, job.origin, axis)


def _joined(renders: list[xr.Dataset], matrices: np.ndarray, parts: list[str]) -> xr.Dataset:
    """Join the renders of poses along a first axis `pose`, and add the poses."""
    number = xr.DataArray(np.arange(len(renders)), dims="pose", name="pose")
    joined = xr.concat(renders, number, combine_attrs="drop")
    joined = joined.assign(to_world=(("pose", "row", "column"), matrices[: len(renders)]))

    # Describe how all poses were made; the poses are part of the identity of the renders
    attrs = dict(renders[0].attrs)
    digests = " ".join([*sorted(parts), *(each.attrs["fingerprint"] for each in renders)])
    digest = hashlib.sha256(digests.encode()).hexdigest()[:12]
    attrs["fingerprint"] = f"{attrs['fingerprint'][:2]}{digest}"
    attrs["complete"] = int(len(renders) == len(matrices))
    attrs["render_seconds"] = sum(each.attrs["render_seconds"] for each in renders)
    attrs["energy_outside_window"] = max(each.attrs["energy_outside_window"] for each in renders)
    return joined.assign_attrs(attrs)


def _tangents(camera: Any) -> dict[str, Any]:
    """Return the tangents of the pixels' centers, of a perspective camera only."""
    if camera.class_name() != "PerspectiveCamera":
        return {}
    width, height = (int(side) for side in camera.film().crop_size())
    to_local = np.linalg.inv(pose(camera))[:3, :3]

    def directions(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        position = mi.Point2f(np.float32(u), np.float32(v))
        ray, _ = camera.sample_ray(0.0, 0.5, position, mi.Point2f(0.5))
        local = to_local @ np.array(ray.d, dtype=np.float64).reshape(3, -1)
        return local[:2] / local[2]

    columns = (np.arange(width) + 0.5) / width
    rows = (np.arange(height) + 0.5) / height
    tan_x = directions(columns, np.full(width, 0.5))[0]
    tan_y = directions(np.full(height, 0.5), rows)[1]
    return {"tan_x": ("x", tan_x, {"units": "1"}), "tan_y": ("y", tan_y, {"units": "1"})}
