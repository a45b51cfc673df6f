"""When light arrives: the energy of a whole picture over path length, from a quick test render."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.contribution import Contribution
from ..integrators.plan import Plan
from ..paths.camera import sample_camera, sampled_size
from ..runtime import checks
from ..runtime.backend import tracing_lock
from ..runtime.progress import status
from ..signals.polarisation import intensity

if TYPE_CHECKING:
    from ..films.transient import TransientHDRFilm
    from ..signals.pulses import Pulse

PATHS = 1 << 14
FIRST_OPL, LAST_OPL = 1e-6, checks.MAX_OPL
BINS = 18 << 10  # 1024 for each power of ten


class ArrivalHistogram:
    """A measurement: energy in logarithmic bins of path length, for all pixels together.

    No dataclass, so that loops do not carry the bins as their state.

    Attributes:
        energy: Array of `BINS` values; the first and the last have all before and after.
        hits: Number of contributions in each bin.
    """

    def __init__(self) -> None:
        self.energy, self.hits = dr.zeros(mi.Float, BINS), dr.zeros(mi.Float, BINS)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution of all channels."""
        beyond = dr.maximum(contribution.opl, FIRST_OPL) / FIRST_OPL
        position = dr.log(beyond) / np.log(LAST_OPL / FIRST_OPL)
        k = mi.UInt32(dr.clip(position * BINS, 0, BINS - 1))
        dr.scatter_add(
            self.energy, dr.sum(intensity(contribution.spectrum)), k, contribution.active
        )
        dr.scatter_add(self.hits, 1.0, k, contribution.active)


@dataclass
class Arrivals:
    """Energy over path length."""

    edges: np.ndarray  # edges of the bins [m], shape (n + 1,), in powers of a common ratio
    energy: np.ndarray  # energy in each bin, in arbitrary units, shape (n,)
    hits: np.ndarray  # number of contributions in each bin, shape (n,)

    @property
    def any(self) -> bool:
        """Whether any light was found at all."""
        return bool(self.energy.sum() > 0)

    def window(self, profile: Pulse | None = None, fraction: float = 0.999) -> tuple[float, float]:
        """From the first arrival to where `fraction` of the energy, in (0, 1], has arrived [m].

        A profile that arrivals are seen through widens the window. Start and stop are rounded
        outwards to a thousandth of the window or so.
        """
        low, high = (0.0, 0.0) if profile is None else profile.support
        cumulative = np.cumsum(self.energy)
        first = int(np.flatnonzero(self.energy)[0])
        last = int(np.searchsorted(cumulative, fraction * cumulative[-1]))
        # A bin more on both sides: single precision may have put an arrival beside its own
        start = float(self.edges[max(first - 1, 0)]) + low
        stop = float(self.edges[min(last + 2, self.energy.size)]) + high
        digit = 10.0 ** (math.floor(math.log10(stop - start)) - 2)
        return math.floor(start / digit) * digit, math.ceil(stop / digit) * digit

    def outside(self, start_opl: float, stop_opl: float, profile: Pulse | None = None) -> float:
        """Fraction of the energy that arrives outside a window [m], seen through `profile`."""
        low, high = (0.0, 0.0) if profile is None else profile.support
        inside = (self.edges[1:] + low > start_opl) & (self.edges[:-1] + high < stop_opl)
        total = float(self.energy.sum())
        return float(self.energy[~inside].sum()) / total if total else 0.0

    def joined(self, other: Arrivals) -> Arrivals:
        """Return the arrivals of both test renders."""
        return Arrivals(self.edges, self.energy + other.energy, self.hits + other.hits)

    def between(self, start_opl: float, stop_opl: float, profile: Pulse | None = None) -> int:
        """Number of contributions in a window [m], seen through `profile`."""
        low, high = (0.0, 0.0) if profile is None else profile.support
        overlaps = (self.edges[1:] + high > start_opl) & (self.edges[:-1] + low < stop_opl)
        return int(self.hits[overlaps].sum())


Look = Callable[[int], Arrivals]
"""Test render with a seed."""


def looking_once(plan: Plan, sensor: mi.Sensor, film: TransientHDRFilm) -> Look:
    """Return a function for test renders that makes the test render of each seed once."""
    return cache(partial(find_arrivals, plan, sensor, film))


@status("Looking for light")
@tracing_lock()
def find_arrivals(plan: Plan, sensor: mi.Sensor, film: TransientHDRFilm, seed: int) -> Arrivals:
    """Trace 16384 paths through random pixels of a film's crop and note when light arrives."""
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, PATHS)
    width, height = sampled_size(film)
    pixel = mi.UInt32(sampler.next_1d() * (width * height))
    with dr.suspend_grad():
        pixel = dr.minimum(pixel, width * height - 1)
        camera = sample_camera(sensor, film, sampler, pixel, scene=plan.scene)
        histogram = ArrivalHistogram()
        plan.trace(sampler, camera.ray, camera.origin, histogram)
    edges = FIRST_OPL * (LAST_OPL / FIRST_OPL) ** (np.arange(BINS + 1) / BINS)
    edges[0] = 0.0
    energy, hits = (np.array(a, dtype=np.float64) for a in (histogram.energy, histogram.hits))
    return Arrivals(edges, energy, hits)
