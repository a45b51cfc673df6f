"""Make all figures of the handout: `python figures/make.py [NAME ...]`, about a minute."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tofrender
from tofrender.sensors import (
    Itof,
    Response,
    coates,
    coates_variance,
    depth_bound,
    estimate_depth,
    expected_photons,
)
from tofrender.sensors.dead_time import sample_counts
from tofrender.sensors.response import distribution
from tofrender.sensors.taps import multipath_phase_error

HERE = Path(__file__).parent
SPEED_OF_LIGHT = 299792458.0
START = 5.0
WIDTH = 0.04
BINS = 325
PULSE = 0.06
CYCLES = 4000
RESPONSE = Response(PULSE / SPEED_OF_LIGHT)

plt.rcParams.update({"figure.dpi": 110, "font.size": 10, "axes.spines.top": False})
plt.rcParams.update({"axes.spines.right": False, "legend.frameon": False})


def film(size, spp):
    """Rates of the Cornell box with a flash at the camera, and its depth."""
    rendered = tofrender.render(
        "cornell_box_flash",
        size=(size, size),
        spp=spp,
        window=(START, START + WIDTH * BINS),
        bins=BINS,
        pulse_width=PULSE,
        progress=False,
    )
    rates = expected_photons(rendered, photons_per_cycle=2.0, background_per_cycle=0.2)
    scene = tofrender.load_scene("cornell_box_flash", width=size, height=size)
    return rates, tofrender.true_depth(scene)


def first_photons(rates, seed):
    """Counts of first photons (y, x, bin)."""
    flat = rates.reshape(-1, rates.shape[-1]).astype(float)
    rng = np.random.default_rng(seed)
    return sample_counts(rng, flat, CYCLES, flat.shape[1]).reshape(rates.shape)


def depth():
    """A depth map, and errors of three depths."""
    rates, truth = film(96, 1024)
    counts = first_photons(rates["rate"].values, 1)
    corrected = np.nan_to_num(coates(counts, CYCLES), posinf=0.0) * CYCLES
    maps = {}
    for name, found in (("first photons", counts), ("corrected", corrected)):
        axis = {"start_opl": START, "bin_width_opl": WIDTH}
        maps[name] = estimate_depth(found, RESPONSE, **axis)["depth"].values
    camera = Itof(frequencies_hz=20e6, contrast=0.6, read_noise=20.0)
    frames = camera.frames(rates, 20_000, seed=2)
    maps["correlation camera, 20 MHz"] = camera.depth(frames)["depth"].values
    figure, axes = plt.subplots(1, 4, figsize=(12, 3.1), layout="constrained")
    shown = axes[0].imshow(maps["corrected"], cmap="viridis", vmin=3, vmax=5.1)
    axes[0].set_title("depth, corrected [m]")
    figure.colorbar(shown, ax=axes[0])
    for ax, (name, depth), most in zip(axes[1:], maps.items(), (60, 60, 600), strict=True):
        shown = ax.imshow(1000 * (depth - truth), cmap="RdBu", vmin=-most, vmax=most)
        ax.set_title(f"{name}:\n{1000 * np.nanmedian(depth - truth):.0f} mm median error")
        figure.colorbar(shown, ax=ax, label="error [mm]")
    for ax in axes:
        ax.set(xticks=[], yticks=[])
    return figure


def pile_up():
    """Rates of a pixel, counts of first photons, corrected rates."""
    rates, _ = film(24, 1024)
    own = rates["rate"].values[6, 12]
    opl = START + (np.arange(BINS) + 0.5) * WIDTH
    counts = first_photons(own[None, None], 3)[0, 0]
    figure, ax = plt.subplots(figsize=(9, 3.2), layout="constrained")
    ax.plot(opl, own, color="black", lw=1, label="rates")
    ax.plot(opl, counts / CYCLES, color="tab:orange", lw=1.5, label="counts / cycles")
    deviation = np.sqrt(coates_variance(own, CYCLES))
    ax.errorbar(opl, coates(counts, CYCLES), deviation, fmt=".", ms=3, lw=0.6, label="corrected")
    ax.set(xlabel="optical path length [m]", xlim=(7.5, 12), ylabel="photons per bin and cycle")
    ax.set(yscale="log", ylim=(3e-4, 1))
    ax.legend()
    return figure


def dead_time():
    """Detections of constant light."""
    light = np.geomspace(0.02, 20, 200)
    figure, ax = plt.subplots(figsize=(5.5, 3.2), layout="constrained")
    ax.loglog(light, light / (1 + light), label=r"non-paralysable, $r/(1+r\tau)$")
    ax.loglog(light, light * np.exp(-light), label=r"paralysable, $re^{-r\tau}$")
    ax.loglog(light, light, ":", color="tab:gray", label="no dead time")
    ax.set(xlabel=r"photons per dead time, $r\tau$", ylabel="detections per dead time")
    ax.set(ylim=(0.01, 3))
    ax.legend()
    return figure


def bound():
    """Errors of matched filter and likeliest depth over the signal."""
    rng = np.random.default_rng(4)
    signals = np.array([3, 6, 12, 25, 50, 100, 200, 400, 800])
    place = rng.uniform(45, 55, (40, 50)) * WIDTH
    part = np.diff(
        distribution("response", RESPONSE).cdf(np.arange(101) * WIDTH - place[..., None])
    )
    figure, ax = plt.subplots(figsize=(5.5, 3.4), layout="constrained")
    noisy = [rng.poisson(signal * part + 0.05) for signal in signals]
    for method, label in (("matched", "matched filter"), ("ml", "likeliest")):
        errors = []
        for counts in noisy:
            axis = {"start_opl": 0.0, "bin_width_opl": WIDTH}
            found = estimate_depth(counts, RESPONSE, method, **axis)["depth"].values
            errors.append(1000 * np.sqrt(np.mean((found - place / 2) ** 2)))
        ax.loglog(signals, errors, "o-", ms=4, label=label)
    least = 1000 * depth_bound(signals.astype(float), 0.05, RESPONSE, WIDTH)
    ax.loglog(signals, least, "--", color="tab:gray", label="Cramér-Rao bound")
    ax.set(xlabel="signal [counts]", ylabel="RMS error of depth [mm]")
    ax.legend()
    return figure


def multipath():
    """Error of the phase by a second return."""
    turn = np.linspace(0, 2 * np.pi, 400)
    figure, ax = plt.subplots(figsize=(5.5, 3.2), layout="constrained")
    for ratio in (0.1, 0.35, 0.8):
        ax.plot(turn, multipath_phase_error(ratio, turn), label=f"r = {ratio}")
    ax.set(xlabel=r"phase of the second return, $\Delta$ [rad]", ylabel="error of the phase [rad]")
    ax.legend()
    return figure


FIGURES: dict[str, Callable] = {
    each.__name__: each for each in (depth, pile_up, dead_time, bound, multipath)
}

if __name__ == "__main__":
    for name in sys.argv[1:] or FIGURES:
        FIGURES[name]().savefig(HERE / f"{name}.png", metadata={"Software": None})
        plt.close("all")
        print(f"made {name}.png")
