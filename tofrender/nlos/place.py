"""What a capture needs, loaded and checked: scene, sensor, wall and its points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from ..films.exposure import profile as seen_pulse
from ..films.image import developed_shape
from ..integrators.own_sample import brings_sample
from ..rendering.window import windowed_film
from ..runtime import checks, memory
from ..scenes.checking import check_scene
from ..scenes.fingerprint import shape_digest
from ..scenes.loading import load_scene, require_sensor
from .device.laser import follow_meters
from .device.relay_wall import DEFAULT_ID as WALL, find_shapes, ids, seen_shapes
from .device.wall_points import wall_points

COPIES = 2
"""Times that a capture's light is in memory at the end."""


@dataclass
class Place:
    """A capture, decided.

    Attributes:
        scene: The scene.
        camera: The sensor, `sensor` its number.
        integrator: The scene's.
        wall: The relay wall.
        mode: What is lit.
        points: Points of the wall, normals there, and which pixels look at it.
        spp: Samples per pixel.
        seed: Seed of the random numbers.
        arguments: What it was made of, for workers.
    """

    scene: mi.Scene
    camera: Any
    sensor: int
    integrator: Any
    wall: list[mi.Shape]
    mode: str
    points: tuple[np.ndarray, np.ndarray, np.ndarray]
    spp: int
    seed: int
    arguments: dict[str, Any]

    @property
    def more(self) -> dict[str, Any]:
        """What a result depends on besides scene, sensor and integrator."""
        wall = [f"{shape.id()} {shape_digest(shape)[:8]}" for shape in self.wall]
        return {"mode": self.mode, "relay_wall": wall}

    def plan(self) -> Any:
        """What is done with the rays of the sensor; the lit point may arrive before the window."""
        parts = self.scene, self.camera, self.wall, self.mode
        plan, film = self.integrator.capture_plan(*parts), windowed_film(self.camera.film())
        profile = seen_pulse(film, self.integrator.exposure())
        late = 0.0 if profile is None else profile.support[1]
        return plan.counting_from(film.start_opl - late)


def place_of_capture(
    scene: Any, *, mode: str, grid: Any, spp: int | None, seed: int, sensor: Any, wall: Any
) -> Place:
    """Load and check all that a capture needs."""
    arguments = {
        "scene": scene,
        "mode": mode,
        "grid": grid,
        "spp": spp,
        "seed": seed,
        "sensor": sensor,
        "wall": wall,
    }
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, optimize=False, **_size(grid))
    elif grid is not None:
        raise ValueError(
            f"grid = {checks.quote(grid)}: must be None for a loaded scene, whose film has its "
            "size already"
        )
    require_sensor(scene)
    number = checks.integer("sensor", sensor, 0, len(scene.sensors()) - 1)
    camera: Any = scene.sensors()[number]
    check_scene(scene, camera, media=True)
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
    shapes = _wall(scene, integrator, camera, wall)
    points = wall_points(scene, camera, shapes)
    found = scene, camera, number, integrator, shapes
    return Place(*found, mode, points, samples, seed, arguments)


def _size(grid: Any) -> dict[str, Any]:
    """Settings for a film of this size."""
    if grid is None:
        return {}
    try:
        width, height = grid
    except (TypeError, ValueError):
        raise ValueError(
            f"grid = {checks.quote(grid)}: must be a width and a height, for example (64, 64)"
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
