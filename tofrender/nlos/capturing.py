"""Rendering captures: a scene in, a Dataset of the relay wall out."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.image import developed_shape, time_bins, transient_film
from ..integrators.own_sample import brings_sample
from ..integrators.passes import run_plan
from ..rendering.renderer import carry_out
from ..runtime import backend, checks, memory
from ..runtime.progress import progress_bar
from ..scenes.checking import check_scene
from ..scenes.loading import load_scene, require_sensor
from .captures import MODES, make_capture, without_first_leg
from .device.laser import axis, find_laser, follow_meters, forget_meters, kept_aim, place_of, turn
from .device.relay_wall import DEFAULT_ID as WALL, find_shapes, ids, is_on_relay_wall, seen_shapes
from .device.wall_points import wall_points

if TYPE_CHECKING:
    import xarray as xr


COPIES = 2
"""Times that a capture's light is in memory at the end."""


def capture(
    scene: mi.Scene | Mapping[str, Any] | str | os.PathLike[str],
    *,
    mode: str = "confocal",
    grid: tuple[int, int] | None = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    relay_wall: Any = None,
    progress: bool = True,
) -> xr.Dataset:
    """Capture a hidden scene by its relay wall.

    The sensor's pixels are the points of the wall that are looked at: the centres of the cells of
    an `nlos_capture_meter`, or what the centres of a camera's pixels see. Pixels that look at
    something else, or at nothing, are dark, and the variable `on_wall` says which (a warning says
    how many). Their points continue the plane of the wall; on a wall that is not flat they are the
    nearest pixel's.

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
        progress: Whether long work shows a bar.

    Returns:
        A capture, see `tofrender.nlos.make_capture`.

    Raises:
        ValueError: An argument is wrong, the scene has no laser or relay wall, the laser misses it,
            or no pixel looks at it; one line.
        MemoryError: It does not fit; the message says what would.

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
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, optimize=False, **_size(grid))
    elif grid is not None:
        raise ValueError(
            f"grid = {checks.shown(grid)}: must be None for a loaded scene, whose film has "
            "its size already"
        )
    require_sensor(scene)
    number = checks.integer("sensor", sensor, 0, len(scene.sensors()) - 1)
    camera: Any = scene.sensors()[number]
    check_scene(scene, camera)
    integrator = _integrator(scene)
    integrator.require_mode(mode)
    if brings_sample(integrator):
        raise TypeError(
            f"integrator = {type(integrator).__name__}: has a sample of its own, which tells no "
            "path lengths; must have none for a capture"
        )
    samples = camera.sampler().sample_count() if spp is None else spp
    samples = checks.integer("spp", samples, 1, checks.MAX_SPP)
    _require_memory(mode, camera.film())
    follow_meters(scene, camera)
    wall = _wall(scene, integrator, camera, relay_wall)
    points, normals, on_wall = wall_points(scene, camera, wall)
    _tell_misses(on_wall)
    geometry: dict[str, Any] = {"sensor_grid": points, "sensor_normals": normals}
    geometry["sensor_origin"] = place_of(camera)
    geometry["laser_origin"] = integrator.laser_origin(scene, camera)
    attrs = {"scene": name, "spp": samples, "seed": seed, "variant": mi.variant()}
    if mode == "exhaustive":
        lit = np.where(on_wall[..., None], points, np.nan)
        with kept_aim(find_laser(scene)):
            values = _exhaustive(scene, integrator, camera, wall, lit, samples, seed, progress)
        _, start, width = time_bins(camera.film()) or _no_bins(camera.film())
        geometry |= {"laser_grid": points, "laser_normals": normals}
    else:
        with warnings.catch_warnings():  # The lit point itself is meant to arrive too early
            warnings.filterwarnings("ignore", ".*of the energy arrives outside the window")
            dataset = carry_out(
                integrator.capture_plan(scene, camera, wall, mode),
                integrator,
                scene,
                name=name,
                spp=samples,
                seed=seed,
                sensor=number,
                progress=progress,
            )
        values = dataset["transient"].values
        start, width = dataset.attrs["start_opl"], dataset.attrs["bin_width_opl"]
        attrs |= {k: dataset.attrs[k] for k in ("pulse", "energy_outside_window", "complete")}
        if mode == "single":
            geometry |= _laser_point(scene, wall)
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
        pixel: (x, y) of the sensor's whole film, whatever its crop window; its centre is meant.
        sensor: Number of the sensor.

    Returns:
        The point [m], shape (3,).

    Raises:
        ValueError: Not exactly one of the three is given, it is out of range, or the pixel sees
            nothing; one line.

    Example:
        >>> from tofrender import load_scene
        >>> scene = load_scene("nlos_z", width=4, height=4, optimize=False)
        >>> focus_laser(scene, pixel=(3, 0)).round(2).tolist()
        [0.75, -0.75, 0.0]
    """
    given = {"point": point, "uv": uv, "pixel": pixel}
    if not isinstance(scene, mi.Scene):
        raise ValueError(
            f"scene = {checks.shown(scene)}: must be a loaded scene; load_scene loads one"
        )
    named = [name for name, value in given.items() if value is not None]
    if len(named) != 1:
        raise ValueError(f"focus_laser: got {named or 'nothing'}; must be one of point, uv, pixel")
    if not isinstance(scene, mi.Scene):
        raise ValueError(
            f"scene = {checks.shown(scene)}: must be a loaded scene; load_scene loads one"
        )
    laser = find_laser(scene)
    follow_meters(scene)
    forget_meters(scene)
    sensors = scene.sensors()
    camera = sensors[checks.integer("sensor", sensor, 0, len(sensors) - 1)]
    if pixel is not None:
        _require_two("pixel", pixel, "its column and row")
        film = camera.film()
        size = film.size()
        x, y = (
            checks.integer(f"pixel {axis}", k, 0, n - 1) + 0.5
            for axis, k, n in zip("xy", pixel, size, strict=True)
        )
        if camera.get_shape() is None:
            # A camera's rays are asked for by their place in the crop window
            crop, offset = film.crop_size(), film.crop_offset()
            place = mi.Point2f((x - offset.x) / crop.x, (y - offset.y) / crop.y)
            ray, _ = camera.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
            si = scene.ray_intersect(mi.Ray3f(ray))
            if not dr.all(si.is_valid()):
                raise ValueError(f"pixel = {pixel}: sees nothing; must be one that sees a surface")
            target = si.p
        else:
            target = _at_uv(camera, (x / size.x, y / size.y))
    elif uv is not None:
        _require_two("uv", uv, "two numbers from 0 to 1")
        u, v = (checks.number("uv", x, unit="the side") for x in uv)
        if not (0 <= u <= 1 and 0 <= v <= 1):
            raise ValueError(f"uv = {checks.shown(uv)}: must be two numbers from 0 to 1")
        target = _at_uv(camera, (u, v))
    else:
        target = mi.Point3f(*checks.place("point", point))
    turn(laser, target)
    return np.array(target).ravel()


def _require_two(name: str, value: Any, what: str) -> None:
    """Refuse anything but two values."""
    try:
        count = len(value)
    except TypeError:
        count = 0
    if count != 2:
        raise ValueError(f"{name} = {checks.shown(value)}: must be {what}")


def _at_uv(camera: mi.Sensor, uv: Any) -> mi.Point3f:
    shape: Any = camera.get_shape()
    if shape is None:
        raise ValueError("uv: the sensor is no child of a wall; must be a point or a pixel")
    return shape.sample_position(0.0, mi.Point2f(*uv), True).p


def _size(grid: Any) -> dict[str, Any]:
    """Settings for a film of this size."""
    if grid is None:
        return {}
    try:
        width, height = grid
    except (TypeError, ValueError):
        raise ValueError(
            f"grid = {checks.shown(grid)}: must be a width and a height, for example (64, 64)"
        ) from None
    return {
        name: checks.integer(f"grid {name}", n, 1, checks.MAX_SIZE)
        for name, n in (("width", width), ("height", height))
    }


def _integrator(scene: mi.Scene) -> Any:
    """The scene's integrator, if it can capture."""
    integrator: Any = scene.integrator()
    if not hasattr(integrator, "capture_plan"):
        kind = "none" if integrator is None else type(integrator).__name__
        raise ValueError(
            f"integrator = {kind}: must be transient_nlos_path or confocal_transient_path"
        )
    return integrator


def _require_memory(mode: str, film: mi.Film) -> None:
    """Refuse a capture that does not fit into memory.

    Raises:
        MemoryError: One line that says what would fit.
    """
    shape = developed_shape(film)
    if shape is None:
        return
    rows, columns, bins, channels = shape
    lasers = rows * columns if mode == "exhaustive" else 1
    size, free = COPIES * 4 * lasers * math.prod(shape), memory.free_on_host()
    if size <= free:
        return
    fits = math.isqrt(free // (COPIES * 4 * bins * channels))  # Points of a square, or pairs
    side = math.isqrt(fits) if mode == "exhaustive" else fits
    raise MemoryError(
        f"grid of {columns} x {rows} points x {bins} bins: the {mode} capture takes "
        f"{size / 2**30:.1f} GiB, must be at most {free / 2**30:.1f} GiB; {side} x {side} points "
        f"or {int(bins * free / size)} bins would fit"
    )


def _no_bins(film: mi.Film) -> NoReturn:
    """Refuse a film without time bins."""
    raise ValueError(f"film = {film.class_name()}: has no time bins; must be transient_hdr_film")


def _wall(scene: mi.Scene, integrator: Any, camera: mi.Sensor, given: Any) -> list[mi.Shape]:
    """The relay wall, as `capture` describes it."""
    wall = integrator.wall(scene, camera) if given is None else find_shapes(scene, given, WALL)
    if not wall:
        wall = seen_shapes(scene, camera)
        if len(wall) != 1:
            seen = ", ".join(repr(shape.id()) for shape in wall) or "nothing"
            raise ValueError(
                f"relay_wall: is not known, and the sensor sees {seen}; must be one of {ids(scene)}"
            )
    if all(shape in wall or shape.is_emitter() for shape in scene.shapes()):
        raise ValueError(
            f"scene: has no hidden geometry, its shapes are {ids(scene)}; must have another than "
            "the relay wall (a load with optimize=False keeps meshes of equal material apart)"
        )
    return wall


def _tell_misses(on_wall: np.ndarray) -> None:
    """Warn of pixels that do not look at the wall."""
    missing = on_wall.size - int(on_wall.sum())
    if missing:
        warnings.warn(
            f"sensor: {missing} of {on_wall.size} pixels do not look at the relay wall; they are "
            "dark, and on_wall is false there",
            stacklevel=3,
        )


def _exhaustive(
    scene: mi.Scene,
    integrator: Any,
    camera: mi.Sensor,
    wall: list[mi.Shape],
    points: np.ndarray,
    spp: int,
    seed: int,
    progress: bool,
) -> np.ndarray:
    """One render for each laser point: (laser rows, laser columns, rows, columns, bins, C)."""
    rows, columns = points.shape[:2]
    window = time_bins(camera.film()) or _no_bins(camera.film())
    values = None
    bar = progress_bar("laser points", rows * columns, unit="point", enabled=progress)
    with bar:
        for row in range(rows):
            for column in range(columns):
                bar.update()
                if np.isnan(points[row, column]).any():
                    continue
                focus_laser(scene, point=points[row, column])
                film = transient_film(camera.film(), *window)
                step = seed + row * columns + column
                plan = integrator.capture_plan(scene, camera, wall, "exhaustive")
                run_plan(plan, integrator.recording(film), camera, spp, step % checks.MAX_SEED)
                part = film.take()[1]
                if values is None:
                    values = np.zeros((rows, columns, *part.shape), np.float32)
                values[row, column] = part
    assert values is not None
    return values


def _laser_point(scene: mi.Scene, wall: list[mi.Shape]) -> dict[str, np.ndarray]:
    """The point that the laser of a single capture lights, and the wall's normal there."""
    ray = mi.Ray3f(*axis(find_laser(scene)))
    si: Any = scene.ray_intersect(ray)
    if not is_on_relay_wall(si, wall)[0]:
        raise ValueError("laser: does not light the relay wall; focus_laser turns it there")
    normal = si.n * dr.sign(-dr.dot(si.n, ray.d))
    grid, normals = (np.array(v, dtype=np.float64).reshape(1, 1, 3) for v in (si.p, normal))
    return {"laser_grid": grid, "laser_normals": normals}
