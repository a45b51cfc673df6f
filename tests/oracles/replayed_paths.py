"""Complete paths from the lens to an emitter, and the share that each strategy has of each of them.

A path has a point x_0 on the lens, k surface points x_1 to x_k, and an end x_k+1 on an emitter or
infinitely far away. They are found from the camera, and then walked again from both ends by the
plan of the integrator: its walk, connections and weights are what a render has, only each choice
is the recorded one. Nothing is asked about what is in the way.
"""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from tofrender.bidirectional.emission import Emitted
from tofrender.bidirectional.lens_connections import LightPath
from tofrender.bidirectional.mis import BidirectionalMIS
from tofrender.integrators.bidirectional import BidirectionalPlan
from tofrender.paths.camera import ray_origin
from tofrender.paths.protocols import Space
from tofrender.paths.records import BSDFSample, Limits, Transmittance, Vertex
from tofrender.paths.scattering import Materials

LONGEST = 5  # Segments
WIDE = LONGEST + 1  # Records of a path: x_0 to x_k+1, and room for no more


class Paths:
    """Recorded paths, entry j of lane i at the index WIDE i + j.

    Attributes:
        scene: The scene.
        count: k of each lane.
        complete: Lanes whose path ends at an emitter and carries light.
        lens: Points on the lens [m].
        si: The points.
        d: Directions from each to the next.
        specular: 1 where that direction was the only one.
        end: The end as a connection from x_k finds it, its density too.
        far: Whether it is infinitely far away.
        delta: Whether no path runs into it.
    """

    def __init__(self, scene: mi.Scene, lanes: int, seed: int = 0) -> None:
        self.scene, self.lanes = scene, lanes
        self.lane = dr.arange(mi.UInt32, lanes)
        self.count = self.lane % LONGEST
        self.si = dr.zeros(mi.SurfaceInteraction3f, lanes * WIDE)
        self.d = dr.zeros(mi.Vector3f, lanes * WIDE)
        self.specular = dr.zeros(mi.UInt32, lanes * WIDE)
        self._trace(seed)
        kept = self.si, self.d, self.specular, self.lens, self.end, self.far, self.delta
        dr.eval(self.lane, self.count, self.complete, *kept)

    def _trace(self, seed: int) -> None:
        sampler = mi.load_dict({"type": "independent", "sample_count": 1})
        sampler.seed(seed, self.lanes)
        scene, sensor = self.scene, self.scene.sensors()[0]
        inside = 0.01 + 0.98 * sampler.next_2d()  # A path at the film's rim may round out of it
        ray, _ = sensor.sample_ray(0.0, 0.5, inside, sampler.next_2d())
        materials = Materials(scene)
        here = dr.zeros(mi.Interaction3f, self.lanes)
        here.p = self.lens = ray_origin(sensor, ray)
        self.complete, active = mi.Bool(False), mi.Bool(True)
        self.end = dr.zeros(mi.DirectionSample3f, self.lanes)
        connects = mi.Bool(False)
        for j in range(LONGEST):
            last = active & (self.count == j)
            to_end, light = scene.sample_emitter_direction(here, sampler.next_2d(), True, connects)
            if j > 0:
                bsdf_eval = materials.eval_pdf(
                    Vertex(here, mi.Float(0), connects), to_end.d, connects
                )
                dark = dr.all(bsdf_eval.f == 0) | dr.all(light == 0)
                last &= ~(connects & dark)
                ray = dr.select(connects, here.spawn_ray(to_end.d), ray)
            si = scene.ray_intersect(ray, active)
            seen = mi.DirectionSample3f(scene, si, here)
            seen.pdf = scene.pdf_emitter_direction(here, seen, last)
            lit = dr.any(si.emitter(scene).eval(si, last) > 0) & (seen.pdf > 0)
            delta = connects & to_end.delta
            end = dr.select(delta, to_end, seen)
            self.end = dr.select(last, end, self.end)
            self.complete |= last & (delta | lit)
            ends = dr.select(last, end.d, dr.normalize(si.p - here.p))
            dr.scatter(self.d, mi.Vector3f(ends), self.lane * WIDE + j, active)
            if j + 1 == LONGEST:
                dr.scatter(self.si, si, self.lane * WIDE + j + 1, last)
                break
            dr.scatter(self.si, si, self.lane * WIDE + j + 1, active)
            active &= (self.count > j) & si.is_valid()
            vertex = Vertex(si, mi.Float(0), active)
            _, bsdf_sample = materials.sample(vertex, None, sampler, active)
            connects = active & (self.count == j + 1) & materials.smooth(vertex)
            connects &= sampler.next_1d() < 0.5
            active &= connects | dr.any(bsdf_sample.weight > 0)
            only = dr.select(bsdf_sample.specular & ~connects, mi.UInt32(1), 0)
            dr.scatter(self.specular, only, self.lane * WIDE + j + 1, active)
            ray, here = bsdf_sample.ray, si
            dr.eval(ray, here, active, connects, self.end, self.complete)
        flags = self.end.emitter.flags()
        self.far = mi.has_flag(flags, mi.EmitterFlags.Infinite)
        first, last = self.count == 0, self.at(self.si, self.count, self.count > 0).p
        beyond = dr.select(first, self.lens, last) + 1000 * self.end.d
        self.end.p = dr.select(self.far, beyond, self.end.p)
        self.delta = mi.Bool(self.end.delta)

    def at(self, record: Any, j: mi.UInt32, active: Any = True) -> Any:
        """Entries j of a record; nothing where not active."""
        active = mi.Bool(active) & (j < WIDE)
        return dr.gather(type(record), record, self.lane * WIDE + dr.select(active, j, 0), active)

    def emitted(self, density: mi.Float) -> Emitted:
        """The light that the paths start with, if light starts there with a density."""
        end, d = self.end, self.at(self.d, self.count)
        surface = mi.has_flag(end.emitter.flags(), mi.EmitterFlags.Surface)
        return Emitted(
            ray=mi.Ray3f(end.p, -d),
            origin=end.p,
            normal=dr.select(surface, end.n, 0),
            uv=end.uv,
            emitter=end.emitter,
            weight=mi.UnpolarizedSpectrum(1),
            cos=dr.select(surface, dr.abs(dr.dot(end.n, d)), 1),
            density=density,
            delta=self.delta,
            active=self.complete & (self.count > 0),
        )


@dataclass
class Recorded(Vertex):
    """A vertex, with the direction that its path went on in; 0 at the end."""

    onward: Any = None
    specular: Any = None


class Track(Space):
    """Vertices as they were, from either end."""

    def __init__(self, paths: Paths) -> None:
        self.paths, self.index = paths, 1.0

    def next_vertex(self, path, sampler):
        """The next one of a path from the camera, or from a light."""
        paths, k = self.paths, self.paths.count
        if isinstance(path.history, LightPath):
            j, there = k - path.depth, path.active & (path.depth < k)
            onward = dr.select(j > 1, -paths.at(paths.d, j - 1, there), 0)
        else:
            j = path.depth + 1
            there = path.active & (j <= k + 1)
            onward = dr.select(j <= k, paths.at(paths.d, j, there), 0)
        si = paths.at(paths.si, j, there)
        valid = there & si.is_valid()
        si.wi = dr.select(valid, si.to_local(-path.ray.d), -path.ray.d)
        specular = paths.at(paths.specular, j, there) == 1
        length = dr.norm(si.p - path.prev.p)
        return path, Recorded(si, length, valid, onward=onward, specular=specular)

    def transmittance(self, path, vertex, connection, sampler):
        """All: what is in the way was asked when the paths were found."""
        return Transmittance(mi.Float(1))


class Retraced(Materials):
    """Materials that send paths where they went; densities are those of their choice."""

    def sample(self, vertex, connection, sampler, active):
        bsdf_eval = self.eval_connection(vertex, connection)
        taken = self.eval_pdf(vertex, vertex.onward, active & ~vertex.specular)
        weight = dr.select(dr.any(vertex.onward != 0), mi.UnpolarizedSpectrum(1), 0)
        ray = vertex.si.spawn_ray(vertex.onward)
        return bsdf_eval, BSDFSample(
            ray, weight, taken.pdf, mi.Float(1), vertex.specular, None, taken.pdf_reverse
        )


class Noted(BidirectionalMIS):
    """Shares that are written down, for strategies of whole paths."""

    def __init__(self, paths: Paths, exponent: int, camera_connections: bool) -> None:
        super().__init__(exponent, camera_connections)
        self.paths = paths
        self.shares = dr.full(mi.Float, dr.nan, paths.lanes * (LONGEST + 1))
        dr.make_opaque(self.shares)

    def weight(self, x, s, t):
        share = super().weight(x, s, t)
        s, t = mi.UInt32(s), mi.UInt32(t)
        whole = s + t == self.paths.count + 2
        dr.scatter(self.shares, share, self.paths.lane * (LONGEST + 1) + s, whole)
        return share


class Nowhere:
    """A measurement of nothing."""

    def add(self, contribution):
        pass


def shares(
    paths: Paths, density: np.ndarray, exponent: int = 2, camera_connections: bool = True
) -> np.ndarray:
    """Shares of the strategies s = 0 ... of each path, NaN where none was asked for.

    Args:
        paths: The paths.
        density: Density of the point and the direction in which light starts, for each path.
        exponent, camera_connections: As in `BidirectionalMIS`.
    """
    scene, sensor = paths.scene, paths.scene.sensors()[0]
    sharing = Noted(paths, exponent, camera_connections)
    limits = Limits(LONGEST, rr_depth=1000)
    parts = scene, sensor, Track(paths), limits, sharing
    plan = BidirectionalPlan(*parts, False, False, True)
    plan.scattering = Retraced(scene, both_ways=True)
    plan.adjoint = plan.light_paths.adjoint = Retraced(scene, importance=True)
    light, lit = mi.Float(density.astype(np.float32)), mi.UnpolarizedSpectrum(1)
    plan.emission.sample = lambda sampler, ray: paths.emitted(light)
    emitters = plan.light_paths
    emitters.sample_direction = lambda *_: (paths.end, lit)
    connection = emitters.connection
    emitters.connection = lambda *light: connection(*light[:3], light[3] & paths.complete)
    plan.lens.sample = lambda sampler: paths.lens
    plan.emission.samples = SimpleNamespace(
        sample_direction=lambda *_: (paths.end, lit),
        pdf_direction=plan.emission.samples.pdf_direction,
    )
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(0, paths.lanes)
    ray = mi.Ray3f(paths.lens, paths.at(paths.d, mi.UInt32(0)))
    with dr.suspend_grad():  # As in renders: calls trace materials of other tests' scenes, too
        plan.trace(sampler, ray, paths.lens, Nowhere(), paths.complete)
    return np.array(sharing.shares, float).reshape(paths.lanes, LONGEST + 1)


def started(scene: mi.Scene, emitter: Any, cos: np.ndarray, cross_section: float) -> np.ndarray:
    """Density of the point and the direction in which light starts.

    Surfaces shine by the cosine, lights at a point evenly in their cone, and light from afar comes
    through a disk, whose area is the cross-section.
    """
    pick = 1 / len(scene.emitters())
    density = np.full(cos.size, np.nan)
    for each in scene.emitters():
        kind = each.class_name()
        if kind == "AreaLight":
            value = pick / float(each.get_shape().surface_area()[0]) * cos / np.pi
        elif kind == "SpotLight":
            cutoff = np.radians(mi.traverse(each)["cutoff_angle"][0])
            value = pick / (2 * np.pi * (1 - np.cos(cutoff)))
        elif kind == "DirectionalEmitter":
            value = pick / cross_section
        else:
            at_a_point = kind == "PointLight"
            assert at_a_point or kind == "ConstantBackgroundEmitter"
            value = pick / (4 * np.pi) / (1 if at_a_point else cross_section)
        density = np.where(np.array(emitter == mi.EmitterPtr(each)), value, density)
    return density


class Products:
    """Full products of densities in double precision, by NumPy and Mitsuba's densities.

    Densities are by area; of what is infinitely far away, by direction. Directions that are the
    only ones have the density 1, both ways.

    Args:
        paths: The paths.
        window: Area of the film's window, at distance 1 before the lens.
        axis: The camera's.
        cross_section: Area of the disk that light from afar comes through [m^2].

    Attributes:
        started: Density of the point and the direction in which light starts.
    """

    def __init__(self, paths: Paths, window: float, axis: Any, cross_section: float) -> None:
        self.paths, self.k = paths, np.array(paths.count, int)[:, None]
        self.j = np.arange(WIDE)
        self.specular = np.array(paths.specular).reshape(-1, WIDE) == 1
        p, n, d = (self._rows(each) for each in (paths.si.p, paths.si.n, paths.d))
        p[:, 0], end = np.array(paths.lens).T, self.j == self.k + 1
        p[end] = np.array(paths.end.p).T
        arriving, leaving = np.abs((n[:, 1:] * d[:, :-1]).sum(2)), np.abs((n * d).sum(2))
        arriving[end[:, 1:] & ~self._on_surface()] = 1
        per_area = 1 / np.maximum(((p[:, 1:] - p[:, :-1]) ** 2).sum(2), 1e-12)
        per_area[(self.j == self.k)[:, :-1] & self._each(paths.far)] = 1

        to_camera, to_light = self._turns()
        to_light[:, 0] = 1 / (window * (d[:, 0] @ axis) ** 3)
        self.from_lens, self.from_light = np.ones(p.shape[:2]), np.ones(p.shape[:2])
        self.from_lens[:, 1:] = to_light[:, :-1] * arriving * per_area
        self.from_light[:, :-1] = to_camera[:, 1:] * leaving[:, :-1] * per_area

        lane, k = np.arange(paths.lanes), self.k[:, 0]
        cos = arriving[lane, k]
        self.started = started(paths.scene, paths.end.emitter, cos, cross_section)
        self.from_light[lane, k] = leaving[lane, k] * per_area[lane, k]
        self.from_light[lane, k + 1] = self.started
        by_area = np.where(self._on_surface()[:, 0], cos * per_area[lane, k], 1)
        self.connected = np.array(paths.end.pdf, float) * by_area

    def _rows(self, record: Any) -> np.ndarray:
        return np.array(record, float).T.reshape(-1, WIDE, 3)

    def _each(self, mask: mi.Bool) -> np.ndarray:
        return np.array(mask)[:, None]

    def _on_surface(self) -> np.ndarray:
        flags = self.paths.end.emitter.flags()
        return self._each(mi.has_flag(flags, mi.EmitterFlags.Surface))

    def _turns(self) -> tuple[np.ndarray, np.ndarray]:
        """Densities at each point of the direction to the camera, and of that to the light."""
        paths, ctx = self.paths, mi.BSDFContext()
        index = dr.arange(mi.UInt32, paths.lanes * WIDE)
        j, k = index % WIDE, dr.repeat(paths.count, WIDE)
        rough = dr.repeat(paths.complete, WIDE) & (j >= 1) & (j <= k) & (paths.specular == 0)
        si = mi.SurfaceInteraction3f(paths.si)
        before = si.to_local(-dr.gather(mi.Vector3f, paths.d, index - 1, rough))
        after = si.to_local(paths.d)

        def density(wi: mi.Vector3f, wo: mi.Vector3f) -> np.ndarray:
            si.wi = wi
            pdf = dr.select(rough, si.bsdf().pdf(ctx, si, wo, rough), 1)
            return np.array(pdf, float).reshape(-1, WIDE)

        return density(after, before), density(before, after)

    def possible(self, camera_connections: bool = True) -> np.ndarray:
        """Which strategies find each path, shape (lanes, LONGEST + 1).

        None joins where there is only one direction, or where a path has no such points.
        """
        complete, delta = self._each(self.paths.complete), self._each(self.paths.delta)
        s, found = self.j, complete & (self.j <= self.k + 1)
        for j in (self.k + 1 - s, self.k + 2 - s):
            smooth = np.take_along_axis(self.specular, np.clip(j, 0, WIDE - 1), axis=1)
            found &= ~(smooth & (s > 0) & (j >= 1) & (j <= self.k))
        found &= ~(delta & ((s == 0) | (self.k == 0)))
        return found & (camera_connections | (s <= self.k))

    def shares(self, exponent: int = 2, camera_connections: bool = True) -> np.ndarray:
        """Density to the power over the sum, 0 for what is not possible."""
        products = []
        for s in range(LONGEST + 1):
            lit = self.j > self.k + 1 - s
            from_lens = np.where(lit, 1, self.from_lens).prod(axis=1)
            from_light = np.where(lit & (self.j <= self.k + 1), self.from_light, 1).prod(axis=1)
            products.append(from_lens * (self.connected if s == 1 else from_light))
        powers = np.stack(products, axis=1) ** exponent * self.possible(camera_connections)
        return powers / np.maximum(powers.sum(axis=1, keepdims=True), 1e-300)
