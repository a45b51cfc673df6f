"""Lists of paths: how light reaches a pixel, vertex by vertex."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.colors import kept, to_rgb
from ..films.contribution import Contribution
from ..integrators.base import TransientIntegrator
from ..integrators.bidirectional import BidirectionalPlan
from ..integrators.passes import best_sampler
from ..integrators.plan import Plan
from ..integrators.user_defined import follows
from ..paths.camera import CameraSample, sample_camera, sampled_size
from ..paths.walk import step
from ..paths.window import KINDS, Window
from ..runtime import backend, checks, variants
from ..scenes.checking import check_view
from ..scenes.loading import load_plugin, load_scene, require_sensor
from ..signals.polarisation import components, scaled

MOST_PATHS = 10_000


def paths_of(
    scene: mi.Scene | dict[str, Any] | str | PathLike[str],
    pixel: tuple[int, int],
    *,
    opl: tuple[float, float] | None = None,
    count: int = 32,
    spp: int = 4096,
    seed: int = 0,
    sensor: int = 0,
) -> xr.Dataset:
    """List paths by which light reaches a pixel.

    Camera rays are uniform in the pixel. Of all paths whose length is in range, `count` are chosen
    with probabilities proportional to their radiance, without repetition.

    Args:
        scene: As for `render`; its integrator's `max_depth` and other limits hold.
        pixel: Column and row on the film, crop offset included.
        opl: Least and greatest optical path length [m], with the camera segment unless the
            integrator leaves that out; None for all.
        count: Largest number of paths that are returned, 1 to 10 000.
        spp: Number of camera rays, 1 to 2^20.
        seed: Seed of all random numbers.
        sensor: Number of the sensor.

    Returns:
        A Dataset of paths, the brightest first, whose vertices begin at the sensor and end at the
        emitter: `position (path, vertex, xyz)` [m], `shape (path, vertex)`, the identifier of the
        shape, or "sensor", "medium" or that of an emitter without a shape; `vertex_opl (path,
        vertex)` and `opl (path)`, optical path lengths [m]; `radiance (path, channel)`, what the
        path adds to the pixel's radiance [W m^-2 sr^-1]; `on_film (path, vertex, xy)`, where a
        camera with a lens projects vertices [pixels], NaN behind it and for other sensors. Paths
        that are shorter than others end with NaN and "". `total (channel)` is the radiance of all
        paths in range, of which `found` (an attribute) were found. In polarised variants, radiance
        is S0.

    Raises:
        ValueError: An argument or the scene is wrong; one line.
        BackendError: The active variant cannot render in time.

    Example:
        >>> paths = paths_of("cornell_box", (128, 200), opl=(0, 8), count=4, spp=256)
        >>> paths["shape"].values[0, 0].item(), bool((paths["opl"] < 8).all())
        ('sensor', True)
    """
    variants.require_vectorized()
    count = checks.integer("count", count, 1, MOST_PATHS)
    spp = checks.integer("spp", spp, 1, 1 << 20)
    checks.integer("seed", seed, 0, checks.MAX_SEED)
    low, high = 0.0, np.inf
    if opl is not None:
        low, high = (checks.metres("opl", each) for each in checks.items("opl", opl, 2, "lengths"))
        checks.require("opl", (low, high), low < high, "(least, greatest), least below greatest")
    loaded = scene if isinstance(scene, mi.Scene) else load_scene(scene, optimize=False)
    camera = require_sensor(loaded, sensor)
    index = _index_of(pixel, camera.film())
    plan = _plan(loaded, camera)
    with backend.tracing_lock(), dr.suspend_grad():
        sampler: Any = best_sampler(spp)
        sampler.set_samples_per_wavefront(spp)
        sampler.seed(seed, spp)
        pixels = dr.full(mi.UInt32, index, spp)
        rays = sample_camera(camera, camera.film(), sampler, pixels, scene=loaded)
        found = _Found(rays, low, high)
        found.trace(plan, sampler)
        chosen = found.chosen(loaded, count, seed)
        on_film = _on_film(camera, chosen["position"].values)
        return chosen.assign(on_film=(("path", "vertex", "xy"), on_film)).assign_attrs(
            pixel=list(map(int, pixel)),
            range=None if opl is None else [low, high],
            **{"spp": spp, "seed": seed, "found": len(found.opl)},
        )


def _index_of(pixel: Any, film: mi.Film) -> int:
    """Number of a pixel of the film in its sampled area."""
    names, offset, size = ("column", "row"), film.crop_offset(), film.crop_size()
    numbers = checks.items("pixel", pixel, 2, "its column and row")
    x, y = (
        checks.integer(f"pixel {name}", k, int(first), int(first + n) - 1) - int(first)
        for name, k, first, n in zip(names, numbers, offset, size, strict=True)
    )
    width, border = sampled_size(film)[0], film.rfilter().border_size() * film.sample_border()
    return (y + border) * width + x + border


def _plan(scene: mi.Scene, camera: mi.Sensor) -> Plan:
    """Plan of camera paths with one emitter sample per vertex, by the scene's integrator."""
    integrator: Any = scene.integrator()
    valid = isinstance(integrator, TransientIntegrator)
    name = type(integrator).__name__
    checks.require("integrator", name, valid, "one of this package, as `load_scene` sets it")
    check_view(scene, camera, **follows(integrator))
    plan = integrator.plan(scene, camera)
    if isinstance(plan, BidirectionalPlan):  # Any light that it finds, camera paths find, too
        plan = load_plugin("integrator", {"type": "transient_path"} | integrator.traits).plan(
            scene, camera
        )
    checks.require("integrator", name, type(plan) is Plan, "one whose paths begin at a camera")
    endpoint = copy(plan.endpoint)
    endpoint.further = None
    return plan.with_endpoint(endpoint)


@dataclass
class _Step:
    """Measurement that keeps the contributions of a step: emission first, then a connection."""

    found: list[Contribution] = field(default_factory=list)

    def add(self, contribution: Contribution) -> None:
        self.found.append(contribution)


class _Found:
    """All contributions of some camera rays whose length is in range."""

    def __init__(self, camera: CameraSample, low: float, high: float) -> None:
        self.camera, self.low, self.high = camera, low, high
        self.points = [np.array(camera.origin).T + np.zeros((dr.width(camera.ray), 1))]
        self.lengths = [np.zeros(dr.width(camera.ray))]
        self._rows: list[tuple[np.ndarray, ...]] = []

    def trace(self, plan: Plan, sampler: mi.Sampler) -> None:
        """Trace the rays, and keep vertices and contributions of each step."""
        camera, self.index = self.camera, plan.space.index
        path = plan.start(plan.endpoint, camera.ray, camera.origin, True, camera.frame)
        while dr.any(path.active):
            measured = _Step()
            path = step(sampler, path, plan, measured)
            sampler.schedule_state()
            dr.eval(path, *(vars(each) for each in measured.found))
            emission, *connections = measured.found
            self._add(emission)
            point = path.prev.p
            length = path.opl
            if path.passed is not None:  # List emitters on boundaries that the ray has passed
                passes = path.passed > 0
                point = dr.select(passes, path.ray.o, point)
                length = dr.select(passes, dr.fma(path.η, path.passed, length), length)
            self.points.append(np.array(point).T)
            self.lengths.append(np.array(length))
            for connection in connections:
                self._add(connection)
        vertices, lanes, opl, radiance, ends = zip(*self._rows, strict=True)
        self.vertices, self.lanes, self.opl = map(np.concatenate, (vertices, lanes, opl))
        self.radiance, self.ends = np.concatenate(radiance), np.concatenate(ends)

    def _add(self, contribution: Contribution) -> None:
        """Add lanes of a contribution that ends after the vertices so far."""
        lanes = len(self.points[0])
        wavelengths = self.camera.ray.wavelengths
        light = components(scaled(contribution.spectrum, self.camera.weight / lanes))[0]
        channels = [np.broadcast_to(np.array(c), lanes) for c in kept(to_rgb(light, wavelengths))]
        radiance = np.nan_to_num(np.stack(channels, axis=-1))
        opl = np.broadcast_to(np.array(contribution.opl), lanes)
        inside = (opl >= self.low) & (opl < self.high) & np.array(contribution.active)
        chosen = np.flatnonzero(inside & (radiance.sum(axis=1) > 0))
        vertices = np.full(chosen.size, len(self.points))
        ends = np.broadcast_to(np.array(contribution.end).T, (lanes, 3))
        self._rows.append((vertices, chosen, opl[chosen], radiance[chosen], ends[chosen]))

    def chosen(self, scene: mi.Scene, count: int, seed: int) -> xr.Dataset:
        """Dataset of a random choice of the paths, in proportion to their radiance."""
        light = self.radiance.sum(axis=1)
        rows = np.arange(light.size)
        if light.size > count:
            rows = np.random.default_rng(seed).choice(rows, count, False, light / light.sum())
        rows = rows[np.argsort(-light[rows], kind="stable")]
        lanes, vertices = self.lanes[rows], self.vertices[rows]
        longest = int(vertices.max(initial=0)) + 1
        position = np.full((rows.size, longest, 3), np.nan)
        vertex_opl = np.full((rows.size, longest), np.nan)
        for k in range(longest):
            before, last = vertices > k, vertices == k
            if before.any():
                position[before, k] = self.points[k][lanes[before]]
                vertex_opl[before, k] = self.lengths[k][lanes[before]]
            position[last, k], vertex_opl[last, k] = self.ends[rows[last]], self.opl[rows[last]]
        names = _shapes(scene, position, vertices)
        self._shorten(scene, position, vertex_opl, vertices, names)
        channels = {1: ["Y"], 3: ["R", "G", "B"]}[self.radiance.shape[1]]
        return xr.Dataset(
            {
                "position": (("path", "vertex", "xyz"), position, {"units": "m"}),
                "shape": (("path", "vertex"), names),
                "vertex_opl": (("path", "vertex"), vertex_opl, {"units": "m"}),
                "opl": ("path", self.opl[rows], {"units": "m"}),
                "radiance": (("path", "channel"), self.radiance[rows]),
                "total": ("channel", self.radiance.sum(axis=0)),
            },
            coords={"xyz": ["x", "y", "z"], "channel": channels},
        )

    def _shorten(
        self,
        scene: mi.Scene,
        position: np.ndarray,
        vertex_opl: np.ndarray,
        last: np.ndarray,
        names: np.ndarray,
    ) -> None:
        """Move ends at emitters infinitely far away to where their light starts for lengths."""
        infinite = mi.EmitterFlags.Infinite
        distant = [e.id() for e in scene.emitters() if mi.has_flag(e.flags(), infinite)]
        row = np.arange(len(last))
        far = np.isin(names[row, last], distant)
        row, last = row[far], last[far]
        ahead = position[row, last] - position[row, last - 1]
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        length = (vertex_opl[row, last] - vertex_opl[row, last - 1]) / self.index
        position[row, last] = position[row, last - 1] + ahead * length[:, None]


def _on_film(camera: mi.Sensor, position: np.ndarray) -> np.ndarray:
    """Project points (path, vertex, xyz) onto the film of a camera with a lens [pixels]."""
    pixels = np.full((*position.shape[:2], 2), np.nan)
    if pixels.size and camera.class_name() in KINDS:
        pixels[...] = Window(camera).project(position.reshape(-1, 3)).reshape(pixels.shape)
    return pixels


def _shapes(scene: mi.Scene, position: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Identifiers of the shapes at vertices (path, vertex, xyz), whose last numbers are given."""
    names = np.full(position.shape[:2], "", dtype=object)
    names[:, 0] = "sensor"
    shapes = scene.shapes()
    pointers = mi.ShapePtr(shapes)
    for k in range(1, position.shape[1]):
        rows = np.flatnonzero(last >= k)
        start, stop = (mi.Point3f(*position[rows, j].T) for j in (k - 1, k))
        # Intersect the end of the segment: null surfaces may be in between
        distance = dr.norm(stop - start)
        gap = dr.minimum(1e-3 * (1 + dr.max(dr.abs(stop))), 0.5 * distance)
        ray = mi.Ray3f(start, mi.Vector3f(stop - start) / distance)
        ray.o = ray(distance - gap)
        si = scene.ray_intersect(ray)
        there = si.is_valid() & (si.t < 2 * gap)
        for shape, pointer in zip(shapes, pointers, strict=False):
            name = shape.id() or type(shape).__name__
            names[rows[np.array(there & (si.shape == pointer))], k] = name
        for row in rows[~np.array(there)]:
            names[row, k] = _emitter(scene, position[row, k]) if last[row] == k else "medium"
    return names.astype(str)


def _emitter(scene: mi.Scene, p: np.ndarray) -> str:
    """Identifier of an emitter without a shape at a point, or else of one infinitely far away."""
    emitters, origin = scene.emitters(), dr.zeros(mi.Interaction3f)
    for emitter in emitters:
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaPosition):
            own = emitter.sample_direction(origin, mi.Point2f(0.5))[0].p
            if np.allclose(np.array(own).ravel(), p, atol=1e-3):
                return str(emitter.id())
    distant = [e.id() for e in emitters if mi.has_flag(e.flags(), mi.EmitterFlags.Infinite)]
    return distant[0] if len(distant) == 1 else "emitter"
