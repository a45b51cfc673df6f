"""Rendering captures: a scene in, a Dataset of the relay wall out."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import backend, checks
from ..films.image import transient_film
from ..integrators.passes import take
from ..loading import load_scene, require_sensor
from ..progress import progress_bar
from ..relay_wall import is_on_relay_wall
from ..rendering import render
from .captures import MODES, make_capture

if TYPE_CHECKING:
    import xarray as xr


def capture(
    scene: mi.Scene | Mapping[str, Any] | str | os.PathLike[str],
    *,
    mode: str = "confocal",
    grid: tuple[int, int] | None = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    progress: bool = True,
) -> xr.Dataset:
    """Capture a hidden scene by its relay wall.

    The sensor's pixels are the points of the wall that are looked at: the centres of the cells of
    an `nlos_capture_meter`, or what a camera's pixels see.

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
        progress: Whether long work shows a bar.

    Returns:
        A capture, see `tofrender.nlos.make_capture`.

    Raises:
        ValueError: An argument is wrong, the scene has no laser or relay wall, the laser misses it,
            or a pixel does not look at it; one line.

    Example:
        >>> z = capture("nlos_z", grid=(4, 4), spp=16)
        >>> z["transient"].dims, z.attrs["mode"]
        (('y', 'x', 'opl', 'channel'), 'confocal')
    """
    backend.require_vectorised()
    checks.one_of("mode", mode, MODES)
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    name = os.fspath(scene) if isinstance(scene, str | os.PathLike) else "scene"
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, optimize=False, **_size(grid))
    elif grid is not None:
        raise ValueError("grid: must be None for a loaded scene, whose film has its size already")
    require_sensor(scene)
    number = checks.integer("sensor", sensor, 0, len(scene.sensors()) - 1)
    camera, integrator = scene.sensors()[number], _integrator(scene, mode)
    samples = camera.sampler().sample_count() if spp is None else spp
    samples = checks.integer("spp", samples, 1, checks.MAX_SPP)
    wall = integrator.wall(scene, camera)
    points, normals = wall_points(scene, camera, wall)
    geometry: dict[str, Any] = {"sensor_grid": points, "sensor_normals": normals}
    geometry["sensor_origin"] = _origin(camera)
    geometry["laser_origin"] = _laser_origin(scene, integrator, camera)
    attrs = {"scene": name, "spp": samples, "seed": seed, "variant": mi.variant()}
    if mode == "exhaustive":
        values = _exhaustive(scene, integrator, camera, points, samples, seed, progress)
        film: Any = camera.film()
        start, width = film.start_opl, film.bin_width_opl
        geometry |= {"laser_grid": points, "laser_normals": normals}
    else:
        with warnings.catch_warnings():  # The lit point itself is meant to arrive too early
            warnings.filterwarnings("ignore", ".*of the energy arrives outside the window")
            dataset = render(
                scene,
                integrator=integrator,
                sensor=number,
                spp=samples,
                seed=seed,
                progress=progress,
            )
        values = dataset["transient"].values
        start, width = dataset.attrs["start_opl"], dataset.attrs["bin_width_opl"]
        attrs |= {k: dataset.attrs[k] for k in ("pulse", "energy_outside_window", "complete")}
        if mode == "single":
            geometry |= _laser_point(scene, wall)
    return make_capture(
        values,
        mode=mode,
        start_opl=start,
        bin_width_opl=width,
        counts_first_and_last_legs=integrator.counts_legs,
        attrs=attrs,
        **geometry,
    )


def wall_points(
    scene: mi.Scene, sensor: mi.Sensor, wall: list[mi.Shape]
) -> tuple[np.ndarray, np.ndarray]:
    """Points of the wall that the centres of a sensor's pixels look at, and normals.

    Args:
        scene: The scene.
        sensor: The sensor; its film's crop window counts.
        wall: Shapes of the relay wall.

    Returns:
        Points [m] and unit normals on the side that the sensor sees, both (height, width, 3).

    Raises:
        ValueError: A pixel does not look at the wall; one line.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    centre = mi.Point2f(mi.Float(x.ravel()) + 0.5, mi.Float(y.ravel()) + 0.5)
    centre /= mi.ScalarPoint2f(width, height)
    ray, _ = sensor.sample_ray(0.0, 0.5, centre, mi.Point2f(0.5), mi.Bool(True))
    si = scene.ray_intersect(mi.Ray3f(ray))
    missing = int(np.sum(~np.array(is_on_relay_wall(si, wall))))
    if missing:
        raise ValueError(
            f"sensor: {missing} of {width * height} pixels do not look at the relay wall; all must"
        )
    normal = si.n * dr.sign(-dr.dot(si.n, ray.d))
    points, normals = (np.array(v, dtype=np.float64).T for v in (si.p, normal))
    return points.reshape(height, width, 3), normals.reshape(height, width, 3)


def focus_laser(
    scene: mi.Scene,
    *,
    point: Any = None,
    uv: Any = None,
    pixel: Any = None,
    sensor: int = 0,
) -> np.ndarray:
    """Turn the scene's laser to a point of the relay wall.

    Args:
        scene: A scene with one emitter, a projector or spot.
        point: The point [m], or
        uv: its place in the uv square of the shape that the sensor is a child of, or
        pixel: (x, y) of the sensor's film; its centre is meant.
        sensor: Number of the sensor.

    Returns:
        The point [m], shape (3,).

    Raises:
        ValueError: Not exactly one of the three is given, or it is out of range; one line.

    Example:
        >>> from tofrender import load_scene
        >>> scene = load_scene("nlos_z", width=4, height=4, optimize=False)
        >>> focus_laser(scene, pixel=(3, 0)).round(2).tolist()
        [0.75, -0.75, 0.0]
    """
    given = {"point": point, "uv": uv, "pixel": pixel}
    named = [name for name, value in given.items() if value is not None]
    if len(named) != 1:
        raise ValueError(f"focus_laser: got {named or 'nothing'}; must be one of point, uv, pixel")
    sensors = scene.sensors()
    camera = sensors[checks.integer("sensor", sensor, 0, len(sensors) - 1)]
    if pixel is not None:
        size = camera.film().size()
        place = [
            (checks.integer(f"pixel {axis}", k, 0, n - 1) + 0.5) / n
            for axis, k, n in zip("xy", pixel, size, strict=True)
        ]
        if camera.get_shape() is None:
            ray, _ = camera.sample_ray(0.0, 0.5, mi.Point2f(*place), mi.Point2f(0.5))
            target = scene.ray_intersect(mi.Ray3f(ray)).p
        else:
            target = _at_uv(camera, place)
    elif uv is not None:
        u, v = (float(x) for x in uv)
        if not (0 <= u <= 1 and 0 <= v <= 1):
            raise ValueError(f"uv = {uv!r}: must be two numbers from 0 to 1")
        target = _at_uv(camera, (u, v))
    else:
        target = mi.Point3f(*_three("point", point))
    emitter = _laser(scene)
    parameters = mi.traverse(emitter)
    origin = emitter.world_transform() @ mi.Point3f(0)
    if not dr.norm(target - origin)[0] > 0:
        raise ValueError(
            f"point = {np.array(target).ravel().tolist()}: must not be the laser's own"
        )
    axis = dr.normalize(target - origin)
    up = mi.Vector3f(0, 1, 0) if abs(axis.y[0]) < 0.99 else mi.Vector3f(1, 0, 0)
    parameters["to_world"] = mi.Transform4f().look_at(origin, target, up)
    parameters.update()
    return np.array(target).ravel()


def _three(name: str, value: Any) -> list[float]:
    """Three lengths [m]."""
    if np.shape(value) != (3,):
        raise ValueError(f"{name} = {value!r}: must be three numbers, in metres")
    return [checks.metres(name, float(x)) for x in value]


def _at_uv(camera: mi.Sensor, uv: Any) -> mi.Point3f:
    shape = camera.get_shape()
    if shape is None:
        raise ValueError("uv: the sensor is no child of a wall; must be a point or a pixel")
    return shape.sample_position(0.0, mi.Point2f(*uv), True).p


def _size(grid: Any) -> dict[str, int]:
    """Settings for a film of this size."""
    if grid is None:
        return {}
    try:
        width, height = grid
    except (TypeError, ValueError):
        raise ValueError(f"grid = {grid!r}: must be a width and a height") from None
    return {
        name: checks.integer(f"grid {name}", n, 1, checks.MAX_SIZE)
        for name, n in (("width", width), ("height", height))
    }


def _integrator(scene: mi.Scene, mode: str) -> Any:
    """The scene's integrator, set to a mode."""
    integrator: Any = scene.integrator()
    if isinstance(integrator, backend.plugin("ConfocalTransientIntegrator")):
        if mode != "confocal":
            raise ValueError(
                f"mode = {mode!r}: must be 'confocal' with a confocal_transient_path; "
                "the others need a transient_nlos_path"
            )
        return integrator
    if not isinstance(integrator, backend.plugin("TransientNLOSPath")):
        kind = "none" if integrator is None else type(integrator).__name__
        raise ValueError(
            f"integrator = {kind}: must be transient_nlos_path or confocal_transient_path"
        )
    integrator.capture_type = "confocal" if mode == "confocal" else "single"
    return integrator


def _exhaustive(
    scene: mi.Scene,
    integrator: Any,
    camera: mi.Sensor,
    points: np.ndarray,
    spp: int,
    seed: int,
    progress: bool,
) -> np.ndarray:
    """One render for each laser point: (laser rows, laser columns, rows, columns, bins, C)."""
    rows, columns = points.shape[:2]
    source: Any = camera.film()
    window = (source.temporal_bins, source.start_opl, source.bin_width_opl)
    values = None
    bar = progress_bar("laser points", rows * columns, unit="point", enabled=progress)
    with bar:
        for row in range(rows):
            for column in range(columns):
                focus_laser(scene, point=points[row, column])
                film = transient_film(camera.film(), *window)
                step = seed + row * columns + column
                take(scene, integrator, camera, film, spp, step % checks.MAX_SEED)
                part = film.take()[1]
                if values is None:
                    values = np.zeros((rows, columns, *part.shape), np.float32)
                values[row, column] = part
                bar.update()
    assert values is not None
    return values


def _laser(scene: mi.Scene) -> Any:
    emitters = scene.emitters()
    if len(emitters) != 1:
        raise ValueError(f"emitters: {len(emitters)}; must be one laser, a projector or a spot")
    return emitters[0]


def _origin(sensor: mi.Sensor) -> np.ndarray:
    return np.array(sensor.world_transform() @ mi.Point3f(0)).ravel()


def _laser_origin(scene: mi.Scene, integrator: Any, camera: mi.Sensor) -> np.ndarray:
    """Where the laser is: with the camera, if the integrator brings it."""
    if isinstance(integrator, backend.plugin("ConfocalTransientIntegrator")):
        return _origin(camera)
    return np.array(_laser(scene).world_transform() @ mi.Point3f(0)).ravel()


def _laser_point(scene: mi.Scene, wall: list[mi.Shape]) -> dict[str, np.ndarray]:
    """The point that the laser of a single capture lights, and the wall's normal there."""
    pose = _laser(scene).world_transform()
    ray = mi.Ray3f(pose @ mi.Point3f(0), dr.normalize(pose @ mi.Vector3f(0, 0, 1)))
    si = scene.ray_intersect(ray)
    if not is_on_relay_wall(si, wall)[0]:
        raise ValueError("laser: does not light the relay wall; focus_laser turns it there")
    normal = si.n * dr.sign(-dr.dot(si.n, ray.d))
    grid, normals = (np.array(v, dtype=np.float64).reshape(1, 1, 3) for v in (si.p, normal))
    return {"laser_grid": grid, "laser_normals": normals}
