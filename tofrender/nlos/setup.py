"""Loading and checking of a capture: scene, sensor, relay wall, and the points of the wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from ..films.exposure import profile as seen_pulse
from ..integrators.user_defined import is_user_defined
from ..rendering.time_window import windowed_film
from ..runtime import checks, memory
from ..scenes.checking import check_scene
from ..scenes.fingerprint import shape_digest
from ..scenes.loading import load_scene, require_sensor
from .device.laser import apply_meters
from .device.relay_wall import APART, DEFAULT_ID, find_shapes, ids, seen_shapes, wall_points

# Number of copies of a capture's light that are in memory at the end
COPIES = 2


@dataclass
class CaptureSetup:
    """A loaded and checked capture."""

    # The scene, its sensor, and the index of the sensor
    scene: mi.Scene
    camera: Any
    sensor: int

    # The integrator, and the shapes of the relay wall
    integrator: Any
    wall: list[mi.Shape]

    # "single", "confocal" or "exhaustive"
    mode: str

    # Points, normals and mask, as `wall_points` returns them
    points: tuple[np.ndarray, np.ndarray, np.ndarray]

    # Samples per pixel, and seed of the random numbers
    spp: int
    seed: int

    # Arguments of `prepare_capture`, for workers
    arguments: dict[str, Any]

    @property
    def fingerprint_entries(self) -> dict[str, Any]:
        """Return the values that determine a capture, next to scene, sensor and integrator."""
        wall = [f"{shape.id()} {shape_digest(shape)[:8]}" for shape in self.wall]
        return {"mode": self.mode, "relay_wall": wall}

    def plan(self) -> Any:
        """Return the plan of the render, without light of the laser spot before the window."""
        plan = self.integrator.capture_plan(self.scene, self.camera, self.wall, self.mode)
        film = windowed_film(self.camera.film())
        profile = seen_pulse(film, self.integrator.exposure())
        latest = 0.0 if profile is None else profile.support[1]
        return plan.counting_from(film.start_opl - latest)


def prepare_capture(
    scene: Any, *, mode: str | None, grid: Any, spp: int | None, seed: int, sensor: Any, wall: Any
) -> CaptureSetup:
    """Load and check everything that a capture needs; the arguments are as for `capture`."""
    arguments: dict[str, Any] = {
        "scene": scene,
        "mode": mode,
        "grid": grid,
        "spp": spp,
        "seed": seed,
        "sensor": sensor,
        "wall": wall,
    }

    # Load the scene
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, optimize=False, **_film_size(grid))
    else:
        allowed = "None for a loaded scene, whose film has its size already"
        checks.require("grid", grid, grid is None, allowed)

    # Find sensor, mode and integrator
    camera: Any = require_sensor(scene, sensor)
    check_scene(scene, camera, media=True)
    mode = capture_mode(scene, camera, mode)
    integrator: Any = scene.integrator()
    if is_user_defined(integrator):
        raise TypeError(
            f"integrator = {type(integrator).__name__}: it overrides sample(), which does not "
            "report path lengths. Use an integrator without its own sample() for a capture"
        )

    # Check the size
    samples = camera.sampler().sample_count() if spp is None else spp
    samples = checks.integer("spp", samples, 1, checks.MAX_SPP)
    _require_memory(mode, camera.film())

    # Find the relay wall and its points
    apply_meters(scene, camera)
    shapes = _find_wall(scene, integrator, camera, wall)
    return CaptureSetup(
        scene=scene,
        camera=camera,
        sensor=int(sensor),
        integrator=integrator,
        wall=shapes,
        mode=mode,
        points=wall_points(scene, camera, shapes),
        spp=samples,
        seed=seed,
        arguments=arguments,
    )


def capture_mode(scene: mi.Scene, camera: Any, mode: str | None) -> str:
    """Return the mode of a capture: the given one, or the scene's if `mode` is None.

    Raises:
        ValueError: The scene determines another mode, or its integrator makes no captures.
    """
    integrator: Any = scene.integrator()
    if not hasattr(integrator, "capture_plan"):
        kind = type(integrator).__name__.replace("NoneType", "none")
        allowed = "transient_nlos_path or confocal_transient_path"
        raise ValueError(f"integrator = {kind}: must be {allowed}")

    modes = integrator.capture_modes(camera)
    if mode is None:
        return modes[0]
    if mode not in modes:
        scene_modes = " or ".join(f"'{each}'" for each in modes)
        raise ValueError(
            f"mode = {mode!r}: the scene determines {scene_modes}, by its integrator or by "
            "`confocal` of its sensor. Omit mode, or change the scene"
        )
    return mode


def _film_size(grid: Any) -> dict[str, Any]:
    """Return settings for a film with the grid's width and height."""
    if grid is None:
        return {}
    sides = checks.items("grid", grid, 2, "a width and a height, for example (64, 64)")
    named = zip(("width", "height"), sides, strict=True)
    return {name: checks.integer(f"grid {name}", n, 1, checks.MAX_SIZE) for name, n in named}


def _require_memory(mode: str, film: mi.Film) -> None:
    """Raise a MemoryError that names a smaller size if a capture does not fit into memory."""
    # Films of other kinds are refused later
    shape = getattr(film, "shape", None)
    if shape is None:
        return

    # Compare the size with free memory
    rows, columns, bins, channels = shape
    lasers = rows * columns if mode == "exhaustive" else 1
    size = COPIES * 4 * lasers * math.prod(shape)
    free = memory.free_on_host()
    if size <= free:
        return

    # Side of a square of points that fits, or of a square of pairs of laser and pixel
    fits = math.isqrt(free // (COPIES * 4 * bins * channels))
    side = math.isqrt(fits) if mode == "exhaustive" else fits
    raise MemoryError(
        f"grid of {columns} x {rows} points x {bins} bins: the {mode} capture needs "
        f"{size / 2**30:.1f} GiB, must be at most {free / 2**30:.1f} GiB; {side} x {side} points "
        f"or {int(bins * free / size)} bins would fit"
    )


def _find_wall(scene: mi.Scene, integrator: Any, camera: Any, given: Any) -> list[mi.Shape]:
    """Find the relay wall by argument, integrator, id or view, as `capture` documents."""
    shapes = scene.shapes()
    wall = (
        integrator.wall(scene, camera) if given is None else find_shapes(scene, given, DEFAULT_ID)
    )

    # Otherwise, use the only shape that the sensor sees
    if not wall:
        wall = seen_shapes(scene, camera)
        if len(wall) != 1:
            raise ValueError(
                f"relay_wall: the wall is unknown, because the sensor sees {ids(wall)}. Set "
                f"relay_wall to one of {ids(shapes)}"
            )
    if all(shape in wall or shape.is_emitter() for shape in shapes):
        raise ValueError(
            f"scene: hidden geometry is missing, its shapes are {ids(shapes)}. Add a shape "
            f"that is not the relay wall ({APART})"
        )
    return wall
