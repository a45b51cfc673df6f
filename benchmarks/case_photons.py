"""The case `photons`: histograms and photon lists of a SPAD, compared with a loop over photons."""

from __future__ import annotations

import resource

import numpy as np

from tofrender.sensors import Response, Spad

from .timing import Row, in_turn

WIDTH = 0.02  # Width of a time bin [m]


def naive(rates: np.ndarray, cycles: int, dead: int, seed: int) -> np.ndarray:
    """Simulate the histogram (bin,) of a free-running detector photon by photon."""
    rng = np.random.default_rng(seed)
    bins = rates.size
    armed = 0
    counts = np.zeros(bins, np.int64)
    for cycle in range(cycles):
        for k in np.repeat(np.arange(bins), rng.poisson(rates)):
            if cycle * bins + k >= armed:
                counts[k] += 1
                armed = cycle * bins + k + dead + 1
    return counts


def film(size: int, bins: int) -> np.ndarray:
    """Return rates with a background of 0.2 photons and a return of 0.2 photons per cycle."""
    rates = np.full((size, size, bins), 0.2 / bins, np.float32)
    first = bins // 3
    rates[:, :, first : first + 10] += 0.02
    return rates


def photons(runs: int, quick: bool) -> list[Row]:
    """Measure the time of a histogram with 1e5 cycles, and photons per second of photon lists."""
    # Prepare rates and sensors
    size, side = (32, 16) if quick else (256, 64)
    rates = film(size, 1000)
    cycles = 100_000
    few = 200 if quick else 6000
    part = rates[:side, :side]
    total = float(part.sum()) * few
    chain = Spad(mode="free_running", dead_time_s=20e-9, jitter=Response(50e-12, 80e-12))

    # Measure the times
    functions = {
        "histogram": lambda: Spad().histogram(rates, cycles, bin_width_opl=WIDTH),
        "list": lambda: Spad(mode="multi_hit").photons(part, few, bin_width_opl=WIDTH),
        "chain": lambda: chain.photons(part, few, bin_width_opl=WIDTH),
        "naive": lambda: naive(rates[0, 0].astype(np.float64), 2000, 300, 1),
    }
    times = in_turn(functions, runs)
    wall, cpu = (
        {name: float(np.median(getattr(each, kind))) for name, each in times.items()}
        for kind in ("wall", "cpu")
    )

    # Compute memory, and photons per second
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    what = f"{size}x{size} x 1000 bins, 1e5 cycles"
    plain = float(rates[0, 0].sum()) * 2000 / cpu["naive"]
    rows: list[Row] = [
        (f"histogram, {what}: wall [s]", wall["histogram"], None if quick else 10.0),
        (f"histogram, {what}: cpu [s]", cpu["histogram"], None if quick else 20.0),
        (f"peak of the process, {what} [GiB]", peak, 2.0),
    ]
    for name in ("list", "chain"):
        rows.append((f"{name}: million photons a second, wall", total / wall[name] / 1e6, None))
        rows.append((f"{name}: million photons a second, cpu", total / cpu[name] / 1e6, None))
    rows.append(("chain over a loop over photons: cpu", total / cpu["chain"] / plain, None))
    return rows
