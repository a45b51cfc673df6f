"""The cases of light tracing: error at equal time of paths from the camera, lights, and both."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

import tofrender

from .timing import Row, in_turn, noise, trace

TRACERS = ("transient_path", "transient_light_tracer", "transient_bdpt")
SCENES = ("cornell_box", "caustic", "mirror_and_glass", "lamp_in_fixture", "light_through_hole")
DEPTH = 6
OWN = "4,1"
"""Strategy that finds a caustic: lamp, two vertices of the glass, floor; then the camera."""


def lights(runs: int, quick: bool) -> list[Row]:
    """Compare squared error times CPU time with `transient_path`, for pictures and bins.

    The reference is the mean of many bidirectional renders with other seeds. Pixels with a lamp, a
    mirror or glass in their neighborhood are excluded. A pixel belongs to a caustic if most of its
    light comes from the caustic.
    """
    size, spp, reference = (16, 16, 4) if quick else (64, 256, 32)
    rows: list[Row] = []
    for name in SCENES:
        # Render the reference
        scene = _scene(name, size)
        truth = _mean(scene, _tracer("transient_bdpt"), spp, range(1000, 1000 + reference))

        # Choose the pixels
        masks = {"": plain_pixels(scene)}
        if name == "caustic":
            own = _mean(scene, _tracer("transient_bdpt", strategy=OWN), spp, range(4))[0]
            found = own.sum(axis=2) > 0.5 * truth[0].sum(axis=2)
            masks = {", caustic": masks[""] & found, ", elsewhere": masks[""] & ~found}

        # Measure the errors
        figures = _figures(scene, truth, masks, spp, runs)
        for tracer in TRACERS[1:]:
            for what, value in figures[tracer].items():
                ratio = figures[TRACERS[0]][what] / value
                target = 20.0 if "caustic" in what and "bdpt" in tracer else None
                label = f"{name}, {size}x{size}, {spp} spp: transient_path's error x cpu time over "
                rows.append((f"{label}{tracer}'s, {what}", ratio, target))
    return rows


def light_samples(runs: int, quick: bool) -> list[Row]:
    """Compare one emitter sample with several, by variance of the bins times CPU time.

    The pixels are the same as in `lights`.
    """
    size, spp = (16, 16) if quick else (64, 256)
    scene = _scene("cornell_box", size)
    plain = plain_pixels(scene)

    def draw(points: str | int) -> Callable[[int], np.ndarray]:
        tracer = _tracer(TRACERS[0], light_samples=points)
        return lambda seed: _render(scene, tracer, spp, seed)[1][plain]

    variance, times = noise({str(n): draw(n) for n in (1, 4, 8, 16, "auto")}, max(runs, 8))
    rows: list[Row] = []
    for name in list(times)[1:]:
        gain = variance["1"] / variance[name] * times["1"].ratio(times[name])[1]
        target = 2.0 if name == "auto" else None
        what = f"cornell_box, {size}x{size}, {spp} spp: one light point's variance x cpu time"
        rows.append((f"{what} over that of light_samples = {name}", gain, target))
    return rows


def camera_connections(runs: int, quick: bool) -> list[Row]:
    """Measure the fraction of CPU time that connections to the camera need."""
    size, spp = (32, 16) if quick else (64, 64)
    scene = _scene("cornell_box", size)
    functions = {
        str(on): trace(scene, spp, integrator=_tracer("transient_bdpt", camera_connections=on))
        for on in (True, False)
    }
    times = in_turn(functions, runs)
    part = 1 - times["False"].ratio(times["True"])[1]
    what = f"cornell_box, {size}x{size}, {spp} spp: part of transient_bdpt's cpu time"
    return [(f"{what} that camera_connections take", part, 0.2)]


def _scene(name: str, size: int) -> mi.Scene:
    """Load a built-in scene."""
    return tofrender.load_scene(name, width=size, height=size)


def _tracer(kind: str, **more: Any) -> Any:
    """Load an integrator."""
    return mi.load_dict({"type": f"tofrender_{kind}", "max_depth": DEPTH, **more})


def _render(scene: mi.Scene, tracer: Any, spp: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Render the steady picture and the bins."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Light outside of the window is only in the picture
        found = tofrender.render(scene, integrator=tracer, spp=spp, seed=seed, progress=False)
    return found["steady"].values, found["transient"].values


def _mean(scene: mi.Scene, tracer: Any, spp: int, seeds: range) -> list[np.ndarray]:
    """Return the mean picture and the mean bins over seeds."""
    total = [np.zeros(1), np.zeros(1)]
    for seed in seeds:
        found = _render(scene, tracer, spp, seed)
        total = [a + b.astype(np.float64) for a, b in zip(total, found, strict=True)]
    return [a / len(seeds) for a in total]


def plain_pixels(scene: mi.Scene, lamps_alone: bool = False) -> np.ndarray:
    """Return a mask of pixels without lamps, mirrors and glass in their neighborhood.

    With `lamps_alone`, only lamps are excluded.
    """
    # Trace 8 x 8 rays per pixel
    sensor = scene.sensors()[0]
    width, height = (int(n) for n in sensor.film().size())
    n = 8
    y, x = np.mgrid[: height * n, : width * n]
    across = (x.ravel() + 0.5) / (width * n), (y.ravel() + 0.5) / (height * n)
    place = mi.Point2f(*(mi.Float(a.astype(np.float32)) for a in across))
    ray, _ = sensor.sample_ray(0, 0.5, place, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)

    # Which rays hit neither a lamp nor a mirror or glass?
    usual = ~si.shape.is_emitter()
    if not lamps_alone:
        usual &= mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
    odd = ~np.array(usual, dtype=bool).reshape(height, n, width, n).all(axis=(1, 3))

    # Exclude the neighbors, too
    around = np.pad(odd, 1)
    near = [around[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return ~np.any(near, axis=0)


def _figures(scene, truth, masks, spp: int, runs: int) -> dict[str, dict[str, float]]:
    """Return error times CPU time of each tracer, for pictures and bins in each mask."""
    errors: dict[str, list[dict[str, float]]] = {tracer: [] for tracer in TRACERS}

    def draw(kind: str) -> None:
        found = _render(scene, tracers[kind], spp, len(errors[kind]))
        off = {"picture": found[0] - truth[0], "bins": found[1] - truth[1]}
        errors[kind].append(
            {
                f"{what}{where}": float(np.mean(values[mask] ** 2))
                for what, values in off.items()
                for where, mask in masks.items()
            }
        )

    tracers = {kind: _tracer(kind) for kind in TRACERS}
    times = in_turn({kind: lambda kind=kind: draw(kind) for kind in TRACERS}, runs)
    return {
        kind: {
            what: float(np.mean([e[what] for e in errors[kind]]) * np.median(times[kind].cpu))
            for what in errors[kind][0]
        }
        for kind in TRACERS
    }
