"""Photons: light paths that reach a surface after reflections and refractions by delta lobes."""

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

MAX_LOBES = 16  # Largest number of reflections and refractions of a photon


@dataclass
class Photons:
    """Photons at the first surface with a smooth lobe. Each array has one row per photon."""

    # Positions [m], shape (n, 3)
    p: np.ndarray

    # Geometric normals, shape (n, 3)
    n: np.ndarray

    # Unit vectors towards the previous vertex, shape (n, 3)
    d: np.ndarray

    # Power of each photon [W], shape (n,)
    power: np.ndarray

    # Power of all sampled emitters [W]
    emitted: float


def trace_photons(scene: mi.Scene, sensor: mi.Sensor, count: int, seed: int = 0) -> Photons:
    """Trace photons through delta lobes.

    Photons start at emitters that paths can hit. Only photons that pass at least one delta lobe
    before a surface with a smooth lobe are returned.

    Args:
        scene: The scene.
        sensor: The sensor, for wavelengths and time.
        count: Number of photons that start.
        seed: Seed of the random numbers.
    """
    # Sample the emission of one photon per lane
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    ray = mi.Ray3f(sensor.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))[0])
    ray.o += dr.zeros(mi.Float, count)  # One ray per photon
    emitted = Emission(scene, sensor).sample(sampler, ray)

    # Trace the photons, and store their first vertex with a smooth lobe
    photons = _Recorder(emitted, count)
    path = Path.start(emitted.ray, emitted.origin, emitted.active & ~emitted.delta)
    delta_lobes = Materials(scene, importance=True, lobes=mi.BSDFFlags.Delta)
    parts = Parts(Vacuum(scene), photons, delta_lobes, Limits(MAX_LOBES, MAX_LOBES))
    walk(sampler, path, parts, Radiance.zero())

    # Collect the stored vertices
    weight = dr.select(emitted.active & ~emitted.delta, dr.mean(emitted.weight), 0)
    dr.eval(photons.records, weight)
    rows = np.array([np.array(each) for each in photons.records])
    p, n, d, power = np.split(rows[:, rows[9] > 0], (3, 6, 9))
    return Photons(p.T, n.T, d.T, power[0] / count, float(dr.mean(weight)[0]))


class _Recorder(Endpoint):
    """Endpoint that stores the first vertex with a smooth lobe of each lane."""

    importance = True
    finds_all = False

    def __init__(self, emitted: Emitted, count: int) -> None:
        self.emitted = emitted

        # Position, normal, direction and power
        self.records = [dr.zeros(mi.Float, count) for _ in range(10)]

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Store the vertex, and return an inactive connection."""
        p = vertex.si.p
        n = vertex.si.n
        d = -path.ray.d
        power = dr.mean(self.emitted.weight * mi.unpolarized_spectrum(path.β))
        lane = dr.arange(mi.UInt32, dr.width(self.records))
        for record, value in zip(self.records, [*p, *n, *d, power], strict=True):
            dr.scatter(record, value, lane, active & (path.depth > 0))
        return Connection.to_point(p, d, mi.Float(0), False)
