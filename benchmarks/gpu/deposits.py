"""Time and rounding of deposits in a film: three single numbers, or one packet of four.

Films add single numbers unless each pixel has one thread. On a CPU, packets are 8 % faster at
best, and lose digits. On a GPU, this part shows which kind and which mode is best.
"""

from __future__ import annotations

import time

import drjit as dr
import mitsuba as mi
import numpy as np

from .part import Part

MODES = ("Auto", "Local", "Direct")
LANES_PER_PIXEL = 16
DEPOSITS = 64  # Number of deposits of each lane
CHANNELS = 3
STRIDE = 4  # Numbers of a bin, with padding


def deposits(part: Part) -> None:
    """Measure each kind of deposit with each mode of `dr.scatter_reduce`."""
    width, height, bins = part.sizes.timed_film
    pixels = width * height
    lane = dr.arange(mi.UInt32, pixels * LANES_PER_PIXEL)
    value = 1 / mi.Float(1 + lane % 97)
    dr.eval(lane, value)
    exact = DEPOSITS * float(np.sum(np.asarray(value), dtype=np.float64))
    for name in part.each([f"{kind}, {mode}" for kind in ("single", "packets") for mode in MODES]):
        kind, _, mode = name.partition(", ")
        reduce_mode = getattr(dr.ReduceMode, mode)
        seconds = []
        for _ in range(part.sizes.runs + 1):  # The first one compiles
            film = dr.zeros(mi.Float, pixels * bins * STRIDE)
            left = dr.opaque(mi.UInt32, DEPOSITS) + dr.zeros(mi.UInt32, dr.width(lane))
            dr.eval(film, left)
            dr.sync_thread()
            start = time.perf_counter()
            film = _deposited(film, lane, value, left, bins, kind == "packets", reduce_mode)
            dr.eval(film)
            dr.sync_thread()
            seconds.append(time.perf_counter() - start)
        sums = np.asarray(film, np.float64).reshape(-1, STRIDE)[:, 0]
        error = abs(float(sums.sum()) / exact - 1)
        part.results[name] = {"median_s": float(np.median(seconds[1:])), "error": error}
        part.require(error < 1e-4, f"deposits, {name}: the sum is off by {error:.1e}")


@dr.syntax
def _deposited(
    film: mi.Float,
    lane: mi.UInt32,
    value: mi.Float,
    left: mi.UInt32,
    bins: int,
    packets: bool,
    mode: dr.ReduceMode,
) -> mi.Float:
    """Add to the bins of each lane's pixel. One bin gets half of the deposits, as from a lamp."""
    while left > 0:
        scattered = (lane * 2654435761 + left * 40503) % bins
        cell = lane // LANES_PER_PIXEL * bins + dr.select(left % 2 == 0, 0, scattered)
        if dr.hint(packets, mode="scalar"):
            packet = mi.Vector4f(value, value, value, 0)
            dr.scatter_reduce(dr.ReduceOp.Add, film, packet, cell, True, mode)
        else:
            for channel in range(CHANNELS):
                index = cell * STRIDE + channel
                dr.scatter_reduce(dr.ReduceOp.Add, film, value, index, True, mode)
        left -= 1
    return film
