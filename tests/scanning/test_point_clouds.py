"""Echoes of shots: false alarms, weak echoes, and memory."""

import tracemalloc

import numpy as np
import pytest
import xarray as xr
from helpers.support import ALPHA, COMPARISONS, smallest_allowed
from scipy.stats import binom, norm

from tofrender.scanning import point_cloud
from tofrender.sensors import Spad

WIDTH = 0.03
SIGMA = 0.06
START = 1.5  # Start of the bins [m]


def waveforms(signal, background, shots=20_000, bins=200):
    """Waveforms of shots in different directions, with an echo of the same range in each."""
    opl = START + 0.4 * bins * WIDTH + 0.01
    edges = START + np.arange(bins + 1) * WIDTH
    rate = np.broadcast_to(
        signal * np.diff(norm.cdf(edges, opl, SIGMA)) + background, (shots, bins)
    )
    azimuth = np.linspace(-0.3, 0.3, shots)
    direction = np.stack([np.sin(azimuth), 0 * azimuth, np.cos(azimuth)], axis=1)
    arrays = {
        "rate": (("shot", "bin"), rate),
        "background": ("shot", np.full(shots, background)),
        "true_range": ("shot", np.full(shots, opl / 2)),
        "time": ("shot", np.arange(shots) * 1e-5),
        "direction": (("shot", "axis"), direction),
        "origin": ("axis", np.array([1.0, 2.0, 3.0])),
    }
    attrs = {"start_opl": START, "bin_width_opl": WIDTH, "pulse_width_opl": SIGMA}
    places = {"opl": ("bin", edges[:-1] + WIDTH / 2), "axis": [*"xyz"]}
    return xr.Dataset(arrays, places, attrs)


DEAD = Spad(mode="multi_hit", dead_time_s=2e-10)


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("background", "asked", "detector", "count"),
    [
        *[(2e-5, asked, None, 20_000) for asked in (0.1, 0.01, 0.001)],
        *[(2e-3, asked, None, 20_000) for asked in (0.1, 0.01, 0.001)],
        (2e-3, 0.1, DEAD, 1000),
    ],
)
def test_false_alarms_of_shots(background, asked, detector, count):
    """Shots into the sky have echoes at the requested rate within a factor of 1.5."""
    shots = waveforms(0.0, background, count)
    cloud = point_cloud(shots, pulses=50, false_alarm=asked, detector=detector, seed=4)
    found = np.unique(cloud["shot"].values).size
    unlikely = smallest_allowed(ALPHA, COMPARISONS)
    assert binom.sf(found - 1, count, 1.5 * asked) > unlikely
    assert binom.cdf(found, count, asked / 1.5) > unlikely


@pytest.mark.statistical
@pytest.mark.parametrize("signal", [1.5, 5.1])
def test_two_photons_are_an_echo(signal):
    """With a faint known background, two photons of an echo are enough: 1 - (1 + S) exp(-S)."""
    shots = waveforms(signal, 1e-4, 5000)
    cloud = point_cloud(shots, false_alarm=1e-3, seed=5)
    near = abs(cloud["range"] - cloud["true_range"]) < 2 * SIGMA
    found = np.unique(cloud["shot"].values[near]).size / 5000
    assert found == pytest.approx(1 - (1 + signal) * np.exp(-signal), abs=0.03)


def test_memory_does_not_grow_with_the_number_of_shots():
    peaks = []
    for shots in (2500, 10_000):
        given = waveforms(0.0, 1e-4, shots, bins=500)
        tracemalloc.start()
        point_cloud(given, seed=2)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]
