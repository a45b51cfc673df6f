"""Photons: where light lands after reflection and refraction by delta lobes alone."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.sums import Radiance
from ..paths.protocols import Endpoint, Parts
from ..paths.records import Connection, Limits, Path, Vertex
from ..paths.scattering import Materials
from ..paths.space import Vacuum
from ..paths.walk import walk
from .emission import Emission, Emitted

MAX_LOBES = 16  # Reflections and refractions of a photon at most


@dataclass
class Photons:
    """Photons where their first smooth lobe would scatter them; arrays have a row for each."""

    p: np.ndarray  # positions [m], shape (n, 3)
    n: np.ndarray  # normals, shape (n, 3)
    d: np.ndarray  # unit vectors to where they have come from, shape (n, 3)
    power: np.ndarray  # power over the number of photons that were sent [W], shape (n,)
    emitted: float  # power of all emitters that were sampled [W]


def trace_photons(scene: mi.Scene, sensor: mi.Sensor, count: int, seed: int = 0) -> Photons:
    """Trace `count` photons from emitters that paths can hit, by one or more delta lobes."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    ray = mi.Ray3f(sensor.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))[0])
    ray.o += dr.zeros(mi.Float, count)  # As many rays as photons
    emitted = Emission(scene, sensor).sample(sampler, ray)
    photons = _Recorder(emitted, count)
    path = Path.start(emitted.ray, emitted.origin, emitted.active & ~emitted.delta)
    delta_lobes = Materials(scene, importance=True, lobes=mi.BSDFFlags.Delta)
    parts = Parts(Vacuum(scene), photons, delta_lobes, Limits(MAX_LOBES, MAX_LOBES))
    walk(sampler, path, parts, Radiance.zero())
    weight = dr.select(emitted.active & ~emitted.delta, dr.mean(emitted.weight), 0)
    dr.eval(photons.records, weight)
    rows = np.array([np.array(each) for each in photons.records])
    p, n, d, power = np.split(rows[:, rows[9] > 0], (3, 6, 9))
    return Photons(p.T, n.T, d.T, power[0] / count, float(dr.mean(weight)[0]))


class _Recorder(Endpoint):
    """Stores the first vertex with a smooth lobe, in one row for each lane."""

    importance, finds_all = True, False

    def __init__(self, emitted: Emitted, count: int) -> None:
        self.emitted = emitted
        self.records = [dr.zeros(mi.Float, count) for _ in range(10)]

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Store the vertex, and connect it to nothing."""
        p, n, d = vertex.si.p, vertex.si.n, -path.ray.d
        power = dr.mean(self.emitted.weight * mi.unpolarized_spectrum(path.β))
        lane = dr.arange(mi.UInt32, dr.width(self.records))
        for record, value in zip(self.records, [*p, *n, *d, power], strict=True):
            dr.scatter(record, value, lane, active & (path.depth > 0))
        return Connection.to_point(p, d, mi.Float(0), False)
