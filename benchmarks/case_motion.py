"""The case `motion`: heterodyne light compared with a naive method, and the cost of range rates."""

from __future__ import annotations

import time
from collections.abc import Callable

import mitsuba as mi
import numpy as np

import tofrender

from .timing import Row, in_turn

FREQUENCY_HZ = 30e6
EXPOSURE_S = 1.5e-3
TIMES = 16  # Number of poses of the naive method
MOTIONS = {"small-box": tofrender.Motion(velocity=(5.0, 0.0, 10.0))}


def box(size: int, moves: bool) -> mi.Scene:
    """Load a Cornell box with a small box that moves or is at rest."""
    described = tofrender.cornell_box(width=size, height=size, temporal_bins=64)
    scene = tofrender.load_scene(described, optimize=False)
    return tofrender.moving(scene, MOTIONS) if moves else scene


def naive(scene: mi.Scene, spp: int, seed: int) -> np.ndarray:
    """Render heterodyne light at random times of the exposure, with independent samples."""
    total = 0.0
    sensor = scene.sensors()[0]
    for k, t in enumerate(np.random.default_rng(seed).random(TIMES)):
        with tofrender.posed(scene, t * EXPOSURE_S):
            i, q, *_ = tofrender.render_amcw_phasor(
                scene, sensor, FREQUENCY_HZ, spp // TIMES, seed * TIMES + k, progress=False
            )
        total = total + (i + 1j * q) * np.exp(2j * np.pi * t) / TIMES
    return np.asarray(total)


def ours(scene: mi.Scene, spp: int, seed: int) -> np.ndarray:
    """Render heterodyne light by `doppler`, with half of the samples in each pose."""
    found = tofrender.doppler(
        scene,
        frequency_hz=FREQUENCY_HZ,
        exposure_s=EXPOSURE_S,
        spp=spp // 2,
        seed=seed,
        progress=False,
    )["heterodyne"].values
    return found[:, :, 0] + 1j * found[:, :, 1]


def variance_by_time(function: Callable[[int], np.ndarray], runs: int) -> float:
    """Return the mean variance of a picture over seeds, times the CPU time of one picture [s]."""
    function(0)
    start = time.process_time()
    pictures = [function(seed) for seed in range(1, runs + 1)]
    seconds = (time.process_time() - start) / runs
    return float(np.var(pictures, axis=0, ddof=1).mean()) * seconds


def motion(runs: int, quick: bool) -> list[Row]:
    """Compare the naive method with `doppler`, and a moving scene with a scene at rest."""
    # Measure variance times CPU time
    size, spp = (16, 32) if quick else (64, 256)
    moves = box(size, True)
    rest = box(size, False)
    seeds = max(runs, 4)
    by_naive, by_poses = (
        variance_by_time(lambda seed, each=each: each(moves, spp, seed), seeds)
        for each in (naive, ours)
    )

    # Measure the cost of range rates
    settings = {"spp": spp, "rates": (-60.0, 60.0), "rate_bins": 5, "progress": False}
    settings |= {"window": (3.5, 60.0)}
    times = in_turn(
        {
            "moves": lambda: tofrender.range_rate(moves, **settings),
            "rest": lambda: tofrender.range_rate(rest, **settings),
        },
        runs,
    )
    rows: list[Row] = [("heterodyne, variance x time, naive over ours", by_naive / by_poses, 100)]
    return rows + times["moves"].rows(times["rest"], "range_rate, moving over rest", None, 1.25)
