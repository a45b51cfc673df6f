"""Waveforms of a scanning lidar, and the scene's true distances beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from os import PathLike
from typing import Annotated, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.recording import warn_not_finite
from ..integrators.passes import best_sampler, steps
from ..integrators.running import UNIT, interrupted, run
from ..labels import PATTERN
from ..paths.surfaces import first_surface
from ..rendering.window import warn_of_losses
from ..runtime import backend, checks, variants
from ..runtime.interface import pose
from ..scenes.checking import check_scene
from ..scenes.loading import load_plugin, load_scene, require_sensor
from ..scenes.motion import motions_of, posed
from ..signals.units import SPEED_OF_LIGHT
from .beam import LidarPlan, require_followed
from .patterns import directions, read_pattern, scan_pattern
from .scanner import Scanner

COLUMNS = 4096  # Of the film, whose pixels are the shots


def lidar(
    scene: mi.Scene | Mapping[str, object] | str | PathLike[str],
    pattern: Annotated[xr.Dataset | str | PathLike[str], PATTERN] = "raster",
    *,
    sensor: int = 0,
    divergence_rad: float = 1e-3,
    max_range: float | None = None,
    pulse_width_opl: float = 0.06,
    bin_width_opl: float = 0.03,
    photons: float = 5e8,
    aperture_m: float = 0.025,
    background_hz: float = 0.0,
    max_depth: int = 6,
    pose_time_s: float = 1e-3,
    spp: int = 64,
    seed: int = 0,
    progress: bool = True,
) -> xr.Dataset:
    """Render the waveform that a scanning lidar receives from each shot.

    Laser and receiver are at one point and share a cone; the scene's lights are off. A diffuse
    surface that fills the cone returns, of N photons to an aperture of the area A,

        N A rho cos / (pi r^2)

    Light also returns after several scatterings, and by mirrors and clear glass, there and back on
    the same way: as from the mirrored distance. Left out are the mirror image of the lidar itself,
    and light that passes a mirror or glass there only, back only, or on different ways.

    Args:
        scene: As for `render`.
        pattern: A Dataset of `scan_pattern`, a kind of it, or a result of `lidar`, whose shots are
            fired again.
        sensor: Number of the sensor in whose place the lidar is.
        divergence_rad: Half angle of the cone [rad], from 0 to 0.5.
        max_range: End of the waveform [m]; None for beyond the scene, where mirror images are.
        pulse_width_opl: Standard deviation of the Gaussian pulse [m].
        bin_width_opl: Width of the bins [m].
        photons: Photons of a pulse, times all efficiencies, N.
        aperture_m: Diameter of the aperture [m].
        background_hz: Counts per second without the pulse.
        max_depth: Longest path in segments, that from the laser to its spot included; -1 for any.
        pose_time_s: Longest time between shots that see one pose of a moving scene, that of their
            mean time [s]; other scenes have one pose.
        spp: Samples per shot.
        seed: Seed of the random numbers.
        progress: Show a bar for work that takes long.

    Returns:
        The pattern with `rate` (shot, bin), the expected counts per pulse with the `background` in
        each bin; `true_range` [m] along the axis to the first surface, glass and mirrors included,
        NaN for none; world `direction` (shot, axis), `origin` (axis; of a sensor that moves,
        shot, axis); coordinate `opl` [m].

    Raises:
        ValueError: A wrong scene, pattern or value, or materials that `require_followed` refuses.

    Example:
        >>> shots = lidar("cornell_box", scan_pattern(shots=(4, 4), fov_deg=(20, 20)), spp=4)
        >>> shots["rate"].dims, round(shots["true_range"].min().item(), 1)
        (('shot', 'bin'), 3.2)
    """
    variants.require_vectorised()
    variants.require_unpolarised()
    photons = checks.number("photons", photons, positive=True)
    area = math.pi / 4 * checks.number("aperture_m", aperture_m, positive=True) ** 2
    half_angle = checks.number("divergence_rad", divergence_rad, low=0, high=0.5)
    width = checks.width("bin_width_opl", bin_width_opl)
    background = checks.number("background_hz", background_hz, low=0) * width / SPEED_OF_LIGHT
    pulse = checks.width("pulse_width_opl", pulse_width_opl)
    max_depth = checks.depth("max_depth", max_depth)
    kind = {"type": "transient_path", "max_depth": max_depth, "pulse_width_opl": pulse}
    integrator, sampler = load_plugin("integrator", kind), best_sampler(spp)
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    progress = checks.boolean("progress", progress)
    given = pattern if isinstance(pattern, xr.Dataset) else scan_pattern(pattern)
    shots = read_pattern(given)
    pose_time_s = checks.number("pose_time_s", pose_time_s, positive=True, unit="seconds")
    local, attrs = directions(shots), {"scene": scene if isinstance(scene, str) else "scene"}

    # Place the lidar, and find how far it sees
    scene = scene if isinstance(scene, mi.Scene) else load_scene(scene)
    camera = require_sensor(scene, sensor)
    check_scene(scene, camera, media=True)
    require_followed(scene, integrator.space(scene, camera))
    groups = _poses(shots, pose_time_s if motions_of(scene) else math.inf)
    if max_range is None:
        max_range = 0.0
        for time in {min(groups), max(groups)}:
            with posed(scene, time):
                sphere, middle = scene.bbox().bounding_sphere(), _place(camera)[0]
                middle -= np.ravel(sphere.center)
                max_range = max(max_range, float(np.linalg.norm(middle)) + 3 * sphere.radius)
    end_opl = 2 * checks.number("max_range", max_range, positive=True, unit="metres")
    checks.resolved("bin_width_opl", width, end_opl)
    bins = checks.integer("bins to max_range", math.ceil(end_opl / width), 1, checks.MAX_BINS)

    # Find the true distances, and render each shot as a pixel; shots of a pose together
    count, not_finite = len(local), 0
    axes, origins, transient = (np.zeros((count, n)) for n in (3, 3, bins))
    distance, steady = np.zeros(count), np.zeros(count)
    film = {"type": "transient_hdr_film", "rfilter": {"type": "box"}, "temporal_bins": bins}
    film |= {"start_opl": 0.0, "bin_width_opl": width}
    for time, group in groups.items():
        columns, rows = min(len(group), COLUMNS), math.ceil(len(group) / COLUMNS)
        size = {"width": columns, "height": rows}
        record = integrator.recording(load_plugin("film", film | size))
        record.require_memory(spp)
        with posed(scene, time):
            origins[group], rotation = _place(camera)
            axes[group] = local[group] @ rotation.T
            start, directed = mi.Point3f(*origins[group[0]].tolist()), axes[group]
            dr.make_opaque(start)  # One kernel for all poses
            with backend.tracing_lock():
                si = first_surface(scene, mi.Ray3f(start, mi.Vector3f(directed.T.copy())))
                hit = dr.select(si.is_valid(), dr.norm(si.p - start), dr.nan)
                distance[group] = np.array(hit, np.float64)
            scanner: Any = Scanner(start, directed, half_angle, (columns, rows))  # No plugin
            plan = LidarPlan(scene, integrator.space(scene, camera), half_angle, max_depth)
            done = run(steps(plan, record, scanner, sampler, seed), record, spp, progress=progress)
        if done < spp:
            raise KeyboardInterrupt(interrupted(done, spp, UNIT))
        not_finite += record.not_finite
        steady[group], transient[group] = (
            each.reshape(-1, *each.shape[2:])[: len(group)].mean(axis=-1, dtype=np.float64)
            for each in record.film.take()
        )
    warn_not_finite(not_finite)
    outside = max(0.0, 1 - transient.sum() / steady.sum()) if steady.any() else 0.0
    warn_of_losses(record.film, outside, window_option="`max_range`", stacklevel=3)

    arrays: dict[str, Any] = {}
    arrays["rate"] = ("shot", "bin"), transient * (photons * area) + background
    arrays |= {"background": ("shot", np.full(count, background))}
    arrays |= {"true_range": ("shot", distance, {"units": "m"})}
    rests = bool((origins == origins[0]).all())
    origin = ("axis", origins[0]) if rests else (("shot", "axis"), origins)
    arrays |= {"direction": (("shot", "axis"), axes), "origin": (*origin, {"units": "m"})}
    opl = "bin", (np.arange(bins) + 0.5) * width, {"units": "m"}
    attrs |= {"quantity": "rate", "units": "1", "divergence_rad": half_angle, "photons": photons}
    attrs |= {"aperture_m": aperture_m, "start_opl": 0.0, "bin_width_opl": width, "spp": spp}
    attrs |= {"pulse_width_opl": pulse, "seed": seed, "energy_outside_window": outside}
    return shots.assign(arrays).assign_coords(opl=opl, axis=[*"xyz"]).assign_attrs(attrs)


def _poses(shots: xr.Dataset, pose_time_s: float) -> dict[float, np.ndarray]:
    """Return the shots of each pose by the pose's time [s]; all in that of 0 if it is infinite."""
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
