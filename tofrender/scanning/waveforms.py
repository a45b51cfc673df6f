"""Waveforms of a scanning lidar, and the true distances in the scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Annotated, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.recording import warn_not_finite
from ..integrators.passes import best_sampler, steps
from ..integrators.render_loop import UNIT, interrupted, run
from ..labels import PATTERN
from ..paths.surfaces import first_surface
from ..rendering.time_window import warn_of_losses
from ..runtime import backend, checks, variants
from ..runtime.interface import pose
from ..runtime.parameters import filled, takes
from ..scenes.checking import check_scene
from ..scenes.loading import load_plugin, load_scene, require_sensor
from ..scenes.motion import motions_of, posed
from ..signals.units import SPEED_OF_LIGHT
from .beam import LidarPlan, require_followed
from .patterns import directions, read_pattern, scan_pattern
from .scanner import Scanner

# Number of columns of the film. Its pixels are the shots
COLUMNS = 4096


@dataclass(frozen=True, kw_only=True, eq=False)
class LidarArguments:
    """All parameters of `lidar`: the scene, the pattern, the device and the render."""

    scene: mi.Scene | Mapping[str, object] | str | PathLike[str] = field(kw_only=False)
    pattern: Annotated[xr.Dataset | str | PathLike[str], PATTERN] = field(
        default="raster", kw_only=False
    )
    sensor: int = 0
    divergence_rad: float = 1e-3
    max_range: float | None = None
    pulse_width_opl: float = 0.06
    bin_width_opl: float = 0.03
    photons: float = 5e8
    aperture_m: float = 0.025
    background_hz: float = 0.0
    max_depth: int = 6
    pose_time_s: float = 1e-3
    spp: int = 64
    seed: int = 0
    progress: bool = True


@takes(LidarArguments)
def lidar(*args: Any, **options: Any) -> xr.Dataset:  # noqa: D417, the record has them
    """Render the waveform that a scanning lidar receives from each shot.

    Laser and receiver are at the same point and share a cone. Lights of the scene are off. A
    diffuse surface that fills the cone returns

        N A rho cos / (pi r^2)

    of N photons to an aperture of the area A. Light also returns after several scattering events,
    and by way of mirrors and clear glass if it returns along its own way. Then it appears at the
    mirrored distance. Two kinds of light are omitted: the mirror image of the lidar itself, and
    light that passes a mirror or glass only once, or on different ways.

    Args:
        scene: As for `render`.
        pattern: A Dataset of `scan_pattern`, a name for `scan_pattern`, or a result of `lidar`, to
            repeat its shots.
        sensor: Index of the sensor that the lidar replaces.
        divergence_rad: Half angle of the cone [rad], from 0 to 0.5.
        max_range: End of the waveform [m]. None ends it beyond the scene and its mirror images.
        pulse_width_opl: Standard deviation of the Gaussian pulse [m].
        bin_width_opl: Width of the bins [m].
        photons: Number N of photons of a pulse, times all efficiencies.
        aperture_m: Diameter of the aperture [m].
        background_hz: Counts per second without the pulse.
        max_depth: Longest path in segments, including the segment from the laser to its spot; -1
            without a limit.
        pose_time_s: Time in seconds during which a moving scene stands still while it is scanned,
            in the pose of the mean time. Other scenes have one pose.
        spp: Samples per shot.
        seed: Seed of the random numbers.
        progress: Whether to show a progress bar.

    Returns:
        The pattern with the following variables. `rate` (shot, bin): expected counts per pulse,
        including the `background` in each bin. `true_range` [m]: distance along the axis to the
        first surface, also if it is a mirror or glass, NaN without a surface. `direction` (shot,
        axis) in world space. `origin` (axis), or (shot, axis) if the sensor moves. The coordinate
        `opl` [m].

    Raises:
        ValueError: Scene, pattern or a value are invalid, or the scene contains materials that the
            lidar does not support.

    Example:
        >>> shots = lidar("cornell_box", scan_pattern(shots=(4, 4), fov_deg=(20, 20)), spp=4)
        >>> shots["rate"].dims, round(shots["true_range"].min().item(), 1)
        (('shot', 'bin'), 3.2)
    """
    # Check the arguments
    variants.require_vectorized()
    variants.require_unpolarized()
    given = filled(LidarArguments, lidar, args, options)
    photons = checks.number("photons", given.photons, positive=True)
    area = math.pi / 4 * checks.number("aperture_m", given.aperture_m, positive=True) ** 2
    half_angle = checks.number("divergence_rad", given.divergence_rad, low=0, high=0.5)
    width = checks.width("bin_width_opl", given.bin_width_opl)
    background_hz = checks.number("background_hz", given.background_hz, low=0)
    background = background_hz * width / SPEED_OF_LIGHT
    pulse = checks.width("pulse_width_opl", given.pulse_width_opl)
    max_depth = checks.depth("max_depth", given.max_depth)
    kind = {"type": "transient_path", "max_depth": max_depth, "pulse_width_opl": pulse}
    integrator = load_plugin("integrator", kind)
    spp = given.spp
    sampler = best_sampler(spp)
    seed = checks.integer("seed", given.seed, 0, checks.MAX_SEED)
    progress = checks.boolean("progress", given.progress)
    pattern = given.pattern
    shots = read_pattern(pattern if isinstance(pattern, xr.Dataset) else scan_pattern(pattern))
    pose_time_s = checks.number("pose_time_s", given.pose_time_s, positive=True, unit="seconds")
    local = directions(shots)
    scene = given.scene
    attrs = {"scene": scene if isinstance(scene, str) else "scene"}

    # Place the lidar, and find its range
    scene = scene if isinstance(scene, mi.Scene) else load_scene(scene)
    camera = require_sensor(scene, given.sensor)
    check_scene(scene, camera, media=True)
    require_followed(scene, integrator.space(scene, camera))
    groups = _poses(shots, pose_time_s if motions_of(scene) else math.inf)
    max_range = given.max_range
    if max_range is None:
        max_range = 0.0
        for time in {min(groups), max(groups)}:
            with posed(scene, time):
                sphere = scene.bbox().bounding_sphere()
                middle = _place(camera)[0]
                middle -= np.ravel(sphere.center)
                max_range = max(max_range, float(np.linalg.norm(middle)) + 3 * sphere.radius)
    end_opl = 2 * checks.number("max_range", max_range, positive=True, unit="meters")
    checks.resolved("bin_width_opl", width, end_opl)
    bins = checks.integer("bins to max_range", math.ceil(end_opl / width), 1, checks.MAX_BINS)

    # Reserve the results of all shots
    count = len(local)
    not_finite = 0
    axes, origins, transient = (np.zeros((count, n)) for n in (3, 3, bins))
    distance = np.zeros(count)
    steady = np.zeros(count)
    film = {"type": "transient_hdr_film", "rfilter": {"type": "box"}, "temporal_bins": bins}
    film |= {"start_opl": 0.0, "bin_width_opl": width}

    # Render the shots of each pose, each as a pixel of a film
    for time, group in groups.items():
        columns = min(len(group), COLUMNS)
        rows = math.ceil(len(group) / COLUMNS)
        size = {"width": columns, "height": rows}
        record = integrator.recording(load_plugin("film", film | size))
        record.require_memory(spp)
        with posed(scene, time):
            # Place the lidar. Opaque coordinates allow one kernel for all poses
            origins[group], rotation = _place(camera)
            axes[group] = local[group] @ rotation.T
            start = mi.Point3f(*origins[group[0]].tolist())
            directed = axes[group]
            dr.make_opaque(start)

            # Trace the true distances
            with backend.tracing_lock():
                si = first_surface(scene, mi.Ray3f(start, mi.Vector3f(directed.T.copy())))
                hit = dr.select(si.is_valid(), dr.norm(si.p - start), dr.nan)
                distance[group] = np.array(hit, np.float64)
            # Render the shots. The scanner is not a plugin
            scanner: Any = Scanner(start, directed, half_angle, (columns, rows))
            plan = LidarPlan(scene, integrator.space(scene, camera), half_angle, max_depth)
            done = run(steps(plan, record, scanner, sampler, seed), record, spp, progress=progress)

        # Store the results of this pose
        if done < spp:
            raise KeyboardInterrupt(interrupted(done, spp, UNIT))
        not_finite += record.accumulation.not_finite
        steady[group], transient[group] = (
            each.reshape(-1, *each.shape[2:])[: len(group)].mean(axis=-1, dtype=np.float64)
            for each in record.film.take()
        )

    # Report lost energy
    warn_not_finite(not_finite)
    outside = max(0.0, 1 - transient.sum() / steady.sum()) if steady.any() else 0.0
    warn_of_losses(record.film, outside, window_option="`max_range`", stacklevel=3)

    # Describe the waveforms
    rests = bool((origins == origins[0]).all())
    origin = ("axis", origins[0]) if rests else (("shot", "axis"), origins)
    arrays: dict[str, Any] = {
        "rate": (("shot", "bin"), transient * (photons * area) + background),
        "background": ("shot", np.full(count, background)),
        "true_range": ("shot", distance, {"units": "m"}),
        "direction": (("shot", "axis"), axes),
        "origin": (*origin, {"units": "m"}),
    }
    opl = "bin", (np.arange(bins) + 0.5) * width, {"units": "m"}
    attrs |= {
        "quantity": "rate",
        "units": "1",
        "divergence_rad": half_angle,
        "photons": photons,
        "aperture_m": given.aperture_m,
        "start_opl": 0.0,
        "bin_width_opl": width,
        "spp": spp,
        "pulse_width_opl": pulse,
        "seed": seed,
        "energy_outside_window": outside,
    }
    return shots.assign(arrays).assign_coords(opl=opl, axis=[*"xyz"]).assign_attrs(attrs)


def _poses(shots: xr.Dataset, pose_time_s: float) -> dict[float, np.ndarray]:
    """Group the shots by pose, by the time of each pose [s]. Without motion, the time is 0."""
    time = np.asarray(shots["time"].values, np.float64)
    if not math.isfinite(pose_time_s):
        return {0.0: np.arange(time.size)}
    number = np.floor((time - time.min()) / pose_time_s)
    groups = [np.flatnonzero(number == each) for each in np.unique(number)]
    return {float(time[group].mean()): group for group in groups}


def _place(camera: mi.Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Return the origin and the rotation of a sensor."""
    to_world = pose(camera)
    return to_world[:3, 3], to_world[:3, :3] / np.linalg.norm(to_world[:3, :3], axis=0)
