"""Lists of the paths along which light reaches a pixel, with all vertices."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.channels import kept, to_rgb
from ..films.contribution import CameraSample, Contribution
from ..integrators.base import TransientIntegrator
from ..integrators.bidirectional import BidirectionalPlan
from ..integrators.passes import best_sampler
from ..integrators.plan import Plan
from ..integrators.user_defined import follows
from ..paths.camera import sample_camera, sampled_size
from ..paths.sensor_window import KINDS, Window
from ..paths.walk import step
from ..runtime import backend, checks, variants
from ..scenes.checking import check_view
from ..scenes.loading import load_plugin, load_scene, require_sensor
from ..signals.polarization import components, scaled

# Largest number of paths in a list
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
    """List the paths along which light reaches a pixel.

    Camera rays are uniform in the pixel. The function chooses `count` paths with a length in range,
    with probabilities proportional to their radiance, without repetition.

    Args:
        scene: As for `render`. The limits of its integrator apply, for example `max_depth`.
        pixel: Column and row on the film, including the crop offset.
        opl: Smallest and largest optical path length [m]. The length includes the camera segment
            unless the integrator excludes it. None includes all lengths.
        count: Largest number of paths that are returned, 1 to 10 000.
        spp: Number of camera rays, 1 to 2^20.
        seed: Seed of all random numbers.
        sensor: Index of the sensor.

    Returns:
        A Dataset of paths, the brightest path first. The vertices of a path begin at the sensor and
        end at the emitter. `position (path, vertex, xyz)` contains their positions [m]. `shape
        (path, vertex)` is the identifier of the shape or of an emitter without a shape, or "sensor"
        or "medium".
        `vertex_opl (path, vertex)` and `opl (path)` are optical path lengths [m]. `radiance (path,
        channel)` is the contribution of the path to the pixel's radiance [W m^-2 sr^-1]. `on_film
        (path, vertex, xy)` is the projection of the vertices onto the film of a camera with a lens
        [pixels]. The projection is NaN behind the camera and for other sensors. Shorter paths are
        padded with NaN and "". `total (channel)` is the radiance of all paths in range. The
        attribute `found` is the number of these paths. In polarized variants, radiance is S0.

    Raises:
        ValueError: An argument or the scene is wrong.
        BackendError: The active variant does not support transient rendering.

    Example:
        >>> paths = paths_of("cornell_box", (128, 200), opl=(0, 8), count=4, spp=256)
        >>> paths["shape"].values[0, 0].item(), bool((paths["opl"] < 8).all())
        ('sensor', True)
    """
    # Check the arguments
    variants.require_vectorized()
    count = checks.integer("count", count, 1, MOST_PATHS)
    spp = checks.integer("spp", spp, 1, 1 << 20)
    checks.integer("seed", seed, 0, checks.MAX_SEED)
    low = 0.0
    high = np.inf
    if opl is not None:
        low, high = (checks.meters("opl", each) for each in checks.items("opl", opl, 2, "lengths"))
        checks.require("opl", (low, high), low < high, "(least, greatest), least below greatest")

    # Load the scene, and plan camera paths
    loaded = scene if isinstance(scene, mi.Scene) else load_scene(scene, optimize=False)
    camera = require_sensor(loaded, sensor)
    index = _index_of(pixel, camera.film())
    plan = _plan(loaded, camera)
    with backend.tracing_lock(), dr.suspend_grad():
        # Sample camera rays in the pixel
        sampler: Any = best_sampler(spp)
        sampler.set_samples_per_wavefront(spp)
        sampler.seed(seed, spp)
        pixels = dr.full(mi.UInt32, index, spp)
        rays = sample_camera(camera, camera.film(), sampler, pixels, scene=loaded)

        # Trace the paths, and choose some of them
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
    """Return the index of a pixel in the sampled area of the film.

    Args:
        pixel: Column and row, including the crop offset.
        film: The film.
    """
    # Convert the pixel to the crop window
    names = ("column", "row")
    offset = film.crop_offset()
    size = film.crop_size()
    numbers = checks.items("pixel", pixel, 2, "its column and row")
    x, y = (
        checks.integer(f"pixel {name}", k, int(first), int(first + n) - 1) - int(first)
        for name, k, first, n in zip(names, numbers, offset, size, strict=True)
    )

    # The sampled area may have a border around the crop window
    width = sampled_size(film)[0]
    border = film.rfilter().border_size() * film.sample_border()
    return (y + border) * width + x + border


def _plan(scene: mi.Scene, camera: mi.Sensor) -> Plan:
    """Return the scene's plan of camera paths with one emitter sample per vertex.

    Raises:
        ValueError: The integrator is not supported.
    """
    # Is the integrator supported?
    integrator: Any = scene.integrator()
    valid = isinstance(integrator, TransientIntegrator)
    name = type(integrator).__name__
    checks.require("integrator", name, valid, "one of this package, as `load_scene` sets it")
    check_view(scene, camera, **follows(integrator))

    # Replace a bidirectional plan: camera paths find the same light
    plan = integrator.plan(scene, camera)
    if isinstance(plan, BidirectionalPlan):
        plan = load_plugin("integrator", {"type": "transient_path"} | integrator.traits).plan(
            scene, camera
        )
    checks.require("integrator", name, type(plan) is Plan, "one whose paths begin at a camera")

    # Use one emitter sample per vertex
    endpoint = copy(plan.endpoint)
    endpoint.further = None
    return plan.with_endpoint(endpoint)


@dataclass
class _Step:
    """Measurement that lists the contributions of one step of the path loop.

    The emission that the ray hits comes first, then the contribution of the connection.
    """

    found: list[Contribution] = field(default_factory=list)

    def add(self, contribution: Contribution) -> None:
        """Store a contribution."""
        self.found.append(contribution)


class _Found:
    """Paths of some camera rays with an optical path length in range.

    Args:
        camera: The camera rays.
        low: Smallest optical path length [m].
        high: Upper bound of the optical path length, exclusive [m].

    Attributes:
        points: For each vertex index, the positions on all rays, shape (ray, xyz) [m].
        lengths: For each vertex index, the optical path lengths of all rays [m].
        vertices: For each path, the index of its last vertex.
        lanes: For each path, the index of its ray.
        opl: For each path, the optical path length [m].
        radiance: For each path, the radiance, shape (path, channel).
        ends: For each path, the position of its last vertex, shape (path, xyz) [m].
    """

    def __init__(self, camera: CameraSample, low: float, high: float) -> None:
        self.camera = camera
        self.low = low
        self.high = high

        # The first vertex is the sensor
        self.points = [np.array(camera.origin).T + np.zeros((dr.width(camera.ray), 1))]
        self.lengths = [np.zeros(dr.width(camera.ray))]
        self._rows: list[tuple[np.ndarray, ...]] = []

    def trace(self, plan: Plan, sampler: mi.Sampler) -> None:
        """Trace the rays, and store vertices and contributions of each step."""
        camera = self.camera
        self.index = plan.space.index
        path = plan.start(plan.endpoint, camera.ray, camera.origin, True, camera.frame)
        while dr.any(path.active):
            # Extend all paths by one vertex
            measured = _Step()
            path = step(sampler, path, plan, measured)
            sampler.schedule_state()
            dr.eval(path, *(vars(each) for each in measured.found))

            # Emission ends at the new vertex, so add it before the vertex
            emission, *connections = measured.found
            self._add(emission)

            # Add the vertex. It may be a boundary that the ray has passed, so that emitters on
            # boundaries are listed
            point = path.prev.p
            length = path.opl
            if path.passed is not None:
                passes = path.passed > 0
                point = dr.select(passes, path.ray.o, point)
                length = dr.select(passes, dr.fma(path.η, path.passed, length), length)
            self.points.append(np.array(point).T)
            self.lengths.append(np.array(length))

            # Connections end one vertex later
            for connection in connections:
                self._add(connection)

        # Join the contributions of all steps
        vertices, lanes, opl, radiance, ends = zip(*self._rows, strict=True)
        self.vertices, self.lanes, self.opl = map(np.concatenate, (vertices, lanes, opl))
        self.radiance = np.concatenate(radiance)
        self.ends = np.concatenate(ends)

    def _add(self, contribution: Contribution) -> None:
        """Add the paths of a contribution. They end one vertex after the current vertices."""
        # Convert the light to channels
        lanes = len(self.points[0])
        wavelengths = self.camera.ray.wavelengths
        light = components(scaled(contribution.spectrum, self.camera.weight / lanes))[0]
        channels = [np.broadcast_to(np.array(c), lanes) for c in kept(to_rgb(light, wavelengths))]
        radiance = np.nan_to_num(np.stack(channels, axis=-1))

        # Choose paths with a length in range that contain light
        opl = np.broadcast_to(np.array(contribution.opl), lanes)
        inside = (opl >= self.low) & (opl < self.high) & np.array(contribution.active)
        chosen = np.flatnonzero(inside & (radiance.sum(axis=1) > 0))
        vertices = np.full(chosen.size, len(self.points))
        ends = np.broadcast_to(np.array(contribution.end).T, (lanes, 3))
        self._rows.append((vertices, chosen, opl[chosen], radiance[chosen], ends[chosen]))

    def chosen(self, scene: mi.Scene, count: int, seed: int) -> xr.Dataset:
        """Return a Dataset of random paths, with probabilities proportional to their radiance.

        Args:
            scene: The scene.
            count: Largest number of paths.
            seed: Seed of the choice.
        """
        # Choose paths, and sort them by radiance
        light = self.radiance.sum(axis=1)
        rows = np.arange(light.size)
        if light.size > count:
            rows = np.random.default_rng(seed).choice(rows, count, False, light / light.sum())
        rows = rows[np.argsort(-light[rows], kind="stable")]

        # Collect the vertices of each path, with NaN after the last vertex
        lanes = self.lanes[rows]
        vertices = self.vertices[rows]
        longest = int(vertices.max(initial=0)) + 1
        position = np.full((rows.size, longest, 3), np.nan)
        vertex_opl = np.full((rows.size, longest), np.nan)
        for k in range(longest):
            before = vertices > k
            last = vertices == k
            if before.any():
                position[before, k] = self.points[k][lanes[before]]
                vertex_opl[before, k] = self.lengths[k][lanes[before]]
            position[last, k] = self.ends[rows[last]]
            vertex_opl[last, k] = self.opl[rows[last]]

        # Name the shapes, and move emitters from infinity to a finite distance
        names = _shapes(scene, position, vertices)
        self._shorten(scene, position, vertex_opl, vertices, names)

        # Make the Dataset
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
        """Move the ends at infinitely distant emitters to the point where the path length starts.

        Args:
            scene: The scene.
            position: Positions (path, vertex, xyz) [m], which are changed.
            vertex_opl: Optical path lengths (path, vertex) [m].
            last: Index of the last vertex of each path.
            names: Identifiers of the shapes (path, vertex).
        """
        # Find the paths that end at such an emitter
        infinite = mi.EmitterFlags.Infinite
        distant = [e.id() for e in scene.emitters() if mi.has_flag(e.flags(), infinite)]
        row = np.arange(len(last))
        far = np.isin(names[row, last], distant)
        row = row[far]
        last = last[far]

        # Move the last vertex along its segment
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
    """Return the identifiers of the shapes at vertices, as an array (path, vertex) of text.

    Args:
        scene: The scene.
        position: Positions (path, vertex, xyz) [m].
        last: Index of the last vertex of each path.
    """
    names = np.full(position.shape[:2], "", dtype=object)
    names[:, 0] = "sensor"
    shapes = scene.shapes()
    pointers = mi.ShapePtr(shapes)
    for k in range(1, position.shape[1]):
        rows = np.flatnonzero(last >= k)
        start, stop = (mi.Point3f(*position[rows, j].T) for j in (k - 1, k))

        # Intersect the end of the segment, because null surfaces may be in between
        distance = dr.norm(stop - start)
        gap = dr.minimum(1e-3 * (1 + dr.max(dr.abs(stop))), 0.5 * distance)
        ray = mi.Ray3f(start, mi.Vector3f(stop - start) / distance)
        ray.o = ray(distance - gap)
        si = scene.ray_intersect(ray)

        # Name the shapes at the intersections
        there = si.is_valid() & (si.t < 2 * gap)
        for shape, pointer in zip(shapes, pointers, strict=False):
            name = shape.id() or type(shape).__name__
            names[rows[np.array(there & (si.shape == pointer))], k] = name

        # The other vertices are in media, or at emitters without a shape
        for row in rows[~np.array(there)]:
            names[row, k] = _emitter(scene, position[row, k]) if last[row] == k else "medium"
    return names.astype(str)


def _emitter(scene: mi.Scene, p: np.ndarray) -> str:
    """Return the identifier of the emitter at a point that is on no shape.

    If no point light is at the point, the function returns the identifier of the infinitely distant
    emitter. The result is "emitter" unless the scene has exactly one infinitely distant emitter.
    """
    # Is a point light at the point?
    emitters = scene.emitters()
    origin = dr.zeros(mi.Interaction3f)
    for emitter in emitters:
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaPosition):
            own = emitter.sample_direction(origin, mi.Point2f(0.5))[0].p
            if np.allclose(np.array(own).ravel(), p, atol=1e-3):
                return str(emitter.id())

    # Is the light infinitely distant?
    distant = [e.id() for e in emitters if mi.has_flag(e.flags(), mi.EmitterFlags.Infinite)]
    return distant[0] if len(distant) == 1 else "emitter"
