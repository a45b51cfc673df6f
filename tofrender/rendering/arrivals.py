"""Energy of a whole picture over optical path length, from a quick test render."""

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
from ..signals.polarization import intensity

if TYPE_CHECKING:
    from ..films.transient import TransientHDRFilm
    from ..signals.pulses import Pulse

# Number of paths of a test render
PATHS = 1 << 14

# Range of the histogram, optical path length [m]
FIRST_OPL = 1e-6
LAST_OPL = checks.MAX_OPL

# Number of bins of the histogram, 1024 for each power of ten
BINS = 18 << 10


class ArrivalHistogram:
    """Measurement of the energy in logarithmic bins of path length, for all pixels together.

    The class is not a dataclass, because Dr.Jit loops would then include the bins in their state.

    Attributes:
        energy: Array of `BINS` values. The first and the last bin include the energy outside.
        hits: Number of contributions in each bin.
    """

    def __init__(self) -> None:
        self.energy = dr.zeros(mi.Float, BINS)
        self.hits = dr.zeros(mi.Float, BINS)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution, summed over its channels."""
        # Find the bin
        beyond = dr.maximum(contribution.opl, FIRST_OPL) / FIRST_OPL
        position = dr.log(beyond) / np.log(LAST_OPL / FIRST_OPL)
        k = mi.UInt32(dr.clip(position * BINS, 0, BINS - 1))

        # Add energy and count
        dr.scatter_add(
            self.energy, dr.sum(intensity(contribution.spectrum)), k, contribution.active
        )
        dr.scatter_add(self.hits, 1.0, k, contribution.active)


@dataclass
class Arrivals:
    """Energy over optical path length."""

    # Edges of the bins [m], shape (n + 1,), a geometric sequence
    edges: np.ndarray

    # Energy in each bin, in arbitrary units, shape (n,)
    energy: np.ndarray

    # Number of contributions in each bin, shape (n,)
    hits: np.ndarray

    @property
    def any(self) -> bool:
        """Whether the test render has found any light."""
        return bool(self.energy.sum() > 0)

    def window(self, profile: Pulse | None = None, fraction: float = 0.999) -> tuple[float, float]:
        """Return a window from the first arrival until most of the energy has arrived [m].

        Start and stop are rounded outwards to about a thousandth of the window.

        Args:
            profile: Temporal profile of a contribution. It widens the window by its support.
            fraction: Fraction of the energy that arrives before the stop, in (0, 1].
        """
        # Find the bins of the first and the last arrival
        low, high = (0.0, 0.0) if profile is None else profile.support
        cumulative = np.cumsum(self.energy)
        first = int(np.flatnonzero(self.energy)[0])
        last = int(np.searchsorted(cumulative, fraction * cumulative[-1]))

        # Add one bin on each side: rounding may have moved an arrival to a neighboring bin
        start = float(self.edges[max(first - 1, 0)]) + low
        stop = float(self.edges[min(last + 2, self.energy.size)]) + high

        # Round outwards
        digit = 10.0 ** (math.floor(math.log10(stop - start)) - 2)
        return math.floor(start / digit) * digit, math.ceil(stop / digit) * digit

    def outside(self, start_opl: float, stop_opl: float, profile: Pulse | None = None) -> float:
        """Return the fraction of the energy outside a window [m], widened by `profile`."""
        low, high = (0.0, 0.0) if profile is None else profile.support
        inside = (self.edges[1:] + low > start_opl) & (self.edges[:-1] + high < stop_opl)
        total = float(self.energy.sum())
        return float(self.energy[~inside].sum()) / total if total else 0.0

    def joined(self, other: Arrivals) -> Arrivals:
        """Return the sum of the arrivals of two test renders."""
        return Arrivals(self.edges, self.energy + other.energy, self.hits + other.hits)

    def between(self, start_opl: float, stop_opl: float, profile: Pulse | None = None) -> int:
        """Return the number of contributions in a window [m], widened by `profile`."""
        low, high = (0.0, 0.0) if profile is None else profile.support
        overlaps = (self.edges[1:] + high > start_opl) & (self.edges[:-1] + low < stop_opl)
        return int(self.hits[overlaps].sum())


# Function that makes a test render with a seed
Look = Callable[[int], Arrivals]


def looking_once(plan: Plan, sensor: mi.Sensor, film: TransientHDRFilm) -> Look:
    """Return a function for test renders. The result for each seed is cached."""
    return cache(partial(find_arrivals, plan, sensor, film))


@status("Looking for light")
@tracing_lock()
def find_arrivals(plan: Plan, sensor: mi.Sensor, film: TransientHDRFilm, seed: int) -> Arrivals:
    """Trace 16384 paths through random pixels of a film's crop and record their energy."""
    # Choose random pixels
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, PATHS)
    width, height = sampled_size(film)
    pixel = mi.UInt32(sampler.next_1d() * (width * height))

    # Trace the paths
    with dr.suspend_grad():
        pixel = dr.minimum(pixel, width * height - 1)
        camera = sample_camera(sensor, film, sampler, pixel, scene=plan.scene)
        histogram = ArrivalHistogram()
        plan.trace(sampler, camera.ray, camera.origin, histogram)

    # Copy the histogram to arrays. The first bin starts at 0
    edges = FIRST_OPL * (LAST_OPL / FIRST_OPL) ** (np.arange(BINS + 1) / BINS)
    edges[0] = 0.0
    energy, hits = (np.array(a, dtype=np.float64) for a in (histogram.energy, histogram.hits))
    return Arrivals(edges, energy, hits)
