"""When light arrives: the energy of a whole picture over path length, from a quick test render."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .camera import sample_camera, sampled_size
from .pulses import Pulse

PATHS = 1 << 16
BINS = 1 << 13
FIRST_OPL, LAST_OPL = 1e-3, 1e5


@dataclass
class ArrivalHistogram:
    """A measurement: energy in logarithmic bins of path length, for all pixels together.

    Attributes:
        energy: Array of `BINS` values; light before 1 mm is in the first, after 100 km in the last.
    """

    energy: Any

    def add(self, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
        """Add a contribution of all channels."""
        position = dr.log(dr.maximum(opl, FIRST_OPL) / FIRST_OPL) / np.log(LAST_OPL / FIRST_OPL)
        k = mi.UInt32(dr.clip(position * BINS, 0, BINS - 1))
        dr.scatter_add(self.energy, dr.sum(spectrum), k, active & dr.isfinite(opl))


@dataclass
class Arrivals:
    """Energy over path length.

    Attributes:
        edges: Edges of the bins [m], shape (n + 1,), in powers of a common ratio.
        energy: Energy in each bin, in arbitrary units, shape (n,).
        support: By how much the light's pulse reaches to both sides of an arrival [m].
    """

    edges: np.ndarray
    energy: np.ndarray
    support: tuple[float, float]

    @property
    def any(self) -> bool:
        """Whether any light was found at all."""
        return bool(self.energy.sum() > 0)

    def window(self, fraction: float = 0.999) -> tuple[float, float]:
        """From the first arrival to where `fraction` of the energy has arrived [m]."""
        cumulative = np.cumsum(self.energy)
        first = np.flatnonzero(self.energy)[0]
        last = np.searchsorted(cumulative, fraction * cumulative[-1])
        start, stop = self.edges[first] + self.support[0], self.edges[last + 1] + self.support[1]
        return float(start), float(stop)

    def between(self, start_opl: float, stop_opl: float) -> bool:
        """Whether any light was found in a window [m]."""
        low, high = self.support
        overlaps = (self.edges[1:] + high > start_opl) & (self.edges[:-1] + low < stop_opl)
        return bool(self.energy[overlaps].sum() > 0)


def find_arrivals(
    integrator: Any, scene: mi.Scene, sensor: mi.Sensor, film: Any, pulse: Pulse | None, seed: int
) -> Arrivals:
    """Trace 65536 paths through random pixels and note when their light arrives.

    Args:
        integrator: A transient integrator.
        scene: The scene.
        sensor: The camera.
        film: Its size and crop say which pixels are sampled.
        pulse: Temporal profile of the light, None for an instant.
        seed: Seed of the random numbers.
    """
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, PATHS)
    width, height = sampled_size(film)
    pixel = mi.UInt32(sampler.next_1d() * (width * height))
    with dr.suspend_grad():
        camera = sample_camera(sensor, film, sampler, dr.minimum(pixel, width * height - 1))
        histogram = ArrivalHistogram(dr.zeros(mi.Float, BINS))
        lights = integrator.lights(scene, sensor)
        integrator.trace(scene, sampler, camera.ray, camera.origin, histogram, lights)
    edges = FIRST_OPL * (LAST_OPL / FIRST_OPL) ** (np.arange(BINS + 1) / BINS)
    edges[0] = 0.0
    energy = np.array(histogram.energy, dtype=np.float64)
    return Arrivals(edges, energy, (0.0, 0.0) if pulse is None else pulse.support)
