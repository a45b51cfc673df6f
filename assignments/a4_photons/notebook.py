# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Photons
#
# **Overview.** A render is expected radiance; a depth camera counts photons. You simulate a SPAD
# with pile-up, dead time and jitter, correct what can be corrected, and estimate depth as well as
# the Cramér-Rao bound allows. Then you do the same for a correlation camera (iToF). The
# [handout](README.md) explains the theory and specifies each problem.
#
# **What you will learn**
# - how pile-up distorts a histogram of photons, and how to undo it
# - what dead time and jitter do to counts
# - how exact a depth from photons can be, and which estimator reaches that
# - what noise and multi-path light do to a correlation camera
#
# **How to work.** A cell that begins with `%%solution` contains a file of your solution; running it
# writes the file. Below it are a cell that runs its tests (`%%test`), and one that uses it and
# draws pictures. Some cells also write files to `deliverables/`, which you hand in. Replace
# `raise NotImplementedError(...)`, run the cell, look at the pictures, and run the tests.

# %% [markdown]
# ## Set-up

# %%
# %load_ext tofrender.course.student

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tofrender
from tofrender.sensors import Response, expected_photons
from tofrender.sensors.response import distribution

SMALL = os.environ.get("TOFRENDER_NOTEBOOK_SIZE") == "small"  # for automatic tests
SIZE, SPP = (20, 128) if SMALL else (40, 512)  # pixels, samples per pixel
SPEED_OF_LIGHT = 299792458.0
OUT = Path("deliverables")
OUT.mkdir(exist_ok=True)


def save(name, **arrays):
    """Write arrays to deliverables/."""
    np.savez_compressed(OUT / name, **arrays)
    print(f"wrote {OUT / name}: {', '.join(arrays)}")


# %% [markdown]
# ## 1. From radiance to photons
# The Cornell box, with a flash at the camera. `expected_photons` gives the **rates**: expected
# photons per bin and laser cycle, here 2 in all bins of an average pixel, and some ambient light.

# %%
# Time bins: start and width [m], and number
START = 5.0
WIDTH = 0.04
BINS = 325
PULSE = 0.06  # standard deviation of the laser pulse [m of path], 200 ps
scene = tofrender.load_scene("cornell_box_flash", width=SIZE, height=SIZE)
film = tofrender.render(
    "cornell_box_flash",
    size=(SIZE, SIZE),
    spp=SPP,
    window=(START, START + WIDTH * BINS),
    bins=BINS,
    pulse_width=PULSE,
    progress=False,
)
light = expected_photons(film, photons_per_cycle=2.0, background_per_cycle=0.2)
rates = light["rate"].values.astype(float)  # (y, x, bin)
truth = tofrender.true_depth(scene)
opl = START + (np.arange(BINS) + 0.5) * WIDTH
# A pixel on the back wall
ROW = SIZE // 4
COLUMN = SIZE // 2

figure, axes = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained", width_ratios=(1, 2))
picture = axes[0].imshow(rates.sum(-1), cmap="inferno")
axes[0].plot(COLUMN, ROW, "wo", mfc="none")
axes[0].set(title="photons per cycle", xticks=[], yticks=[])
figure.colorbar(picture, ax=axes[0])
axes[1].semilogy(opl, rates[ROW, COLUMN])
axes[1].set(xlabel="optical path length [m]", ylabel="photons per bin and cycle")
plt.show()

# %% [markdown]
# ## 2. Pile-up
# Problem `a4.pile_up`. A SPAD that detects the first photon of each cycle misses the others. The
# histogram leans toward early times; Coates' correction undoes that.

# %% [solution] pile_up.py

# %%
from pile_up import coates, coates_variance, first_photon

CYCLES = 4000
rng = np.random.default_rng(1)
own = rates[ROW, COLUMN]
p = first_photon(own)
one = rng.multinomial(CYCLES, np.append(p, 1 - p.sum()))[:-1]
figure, ax = plt.subplots(figsize=(9, 3.4), layout="constrained")
ax.plot(opl, own, color="black", label="rates")
ax.plot(opl, one / CYCLES, color="tab:orange", label="counts / cycles")
ax.errorbar(
    opl,
    coates(one, CYCLES),
    np.sqrt(coates_variance(own, CYCLES)),
    fmt=".",
    ms=3,
    lw=0.7,
    label="corrected",
)
ax.set(xlabel="optical path length [m]", xlim=(5, 12), ylabel="photons per bin and cycle")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# Problem `a4.pile_up_checks`. A right solution passes your test:

# %% [solution] pile_up_checks.py

# %%
import pile_up
from pile_up_checks import check_pile_up

check_pile_up(pile_up)

# %% [markdown]
# ## 3. Dead time
# Problem `a4.dead_time`. The rate of detections under constant light, and a film of counts: with a
# dead time as long as the window, only the first photon of a cycle is detected.

# %% [solution] dead_time.py

# %%
from dead_time import armed_detections, sample_counts

flux = np.geomspace(0.05, 10, 30)  # photons per dead time
steps = 100
dead = 50
figure, ax = plt.subplots(figsize=(6, 3.6), layout="constrained")
for paralysable in (False, True):
    constant = np.repeat(flux[:, None] / dead, steps, axis=1)
    found = armed_detections(constant, dead, paralysable, True).mean(axis=1) * dead
    ax.loglog(flux, found, label="paralysable" if paralysable else "non-paralysable")
ax.set(xlabel="photons per dead time", ylabel="detections per dead time", ylim=(0.02, 2))
ax.legend(frameon=False)
plt.show()

# %%
flat = rates.reshape(-1, BINS)
counts = sample_counts(np.random.default_rng(2), flat, CYCLES, BINS).reshape(rates.shape)
save("counts.npz", counts=counts, rates=rates, cycles=CYCLES, start_opl=START, bin_width_opl=WIDTH)

# %% [markdown]
# ## 4. Jitter
# Problem `a4.jitter`. Time stamps are late, by a Gaussian and an exponential tail.

# %% [solution] jitter.py

# %%
from jitter import add_jitter, kernel, sample_jitter

delays = distribution("jitter", Response(200e-12, tail_s=300e-12))
masses = kernel(delays, WIDTH)
stamps = np.repeat(np.arange(BINS), counts[ROW, COLUMN])
moved = stamps + sample_jitter(np.random.default_rng(3), masses, stamps.size)
late = np.bincount(moved[(moved >= 0) & (moved < BINS)], minlength=BINS)
figure, ax = plt.subplots(figsize=(9, 3.4), layout="constrained")
ax.plot(opl, counts[ROW, COLUMN], label="detections")
ax.plot(opl, late, ".", label="stamps")
expected = CYCLES * add_jitter(first_photon(own), masses, periodic=False)
ax.plot(opl, expected, label="expected stamps")
ax.set(xlabel="optical path length [m]", xlim=(7, 11), ylabel="counts")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# ## 5. How exact a depth can be
# Problem `a4.bound`: no unbiased estimator has less variance than the Cramér-Rao bound. Does yours
# (`a4.depth_map`) reach it?

# %% [solution] bound.py

# %%
from bound import depth_bound

pulse = Response(PULSE / SPEED_OF_LIGHT)
signals = np.array([10.0, 30.0, 100.0, 300.0, 1000.0])
bound = depth_bound(signals, 0.2, pulse, WIDTH)

# %% [solution] depth_map.py

# %%
from depth_map import estimate_depth

rng = np.random.default_rng(4)
edges = np.arange(101) * WIDTH
place = rng.uniform(45, 55, (20, 40)) * WIDTH
part = np.diff(distribution("pulse", pulse).cdf(edges - place[..., None]))
errors = {}
for method in ("matched", "ml"):
    errors[method] = []
    for signal in signals:
        noisy = rng.poisson(signal * part + 0.2)
        found = estimate_depth(noisy, pulse, method, start_opl=0.0, bin_width_opl=WIDTH)["depth"]
        errors[method].append(np.sqrt(np.mean((found - place / 2) ** 2)))
figure, ax = plt.subplots(figsize=(6, 3.6), layout="constrained")
for method, error in errors.items():
    ax.loglog(signals, error, "o-", label=method)
ax.loglog(signals, bound, "--", color="tab:gray", label="Cramér-Rao bound")
ax.set(xlabel="signal [counts]", ylabel="error of depth [m]")
ax.legend(frameon=False)
plt.show()
save("bound.npz", signal=signals, error=np.array(errors["ml"]), bound=bound, background=0.2)

# %% [markdown]
# ## 6. A depth map from counts
# The counts of section 3, unchanged and corrected. The first bin starts at `START`.

# %%
raw = estimate_depth(counts, pulse, start_opl=START, bin_width_opl=WIDTH)
corrected = coates(counts, CYCLES) * CYCLES
corrected[~np.isfinite(corrected)] = 0
better = estimate_depth(corrected, pulse, start_opl=START, bin_width_opl=WIDTH)
maps = {"counts": raw["depth"], "corrected": better["depth"]}
figure, axes = plt.subplots(1, 3, figsize=(13, 3.8), layout="constrained")
shown = axes[0].imshow(maps["corrected"], cmap="viridis", vmin=3, vmax=5.1)
axes[0].set(title="depth, corrected [m]", xticks=[], yticks=[])
figure.colorbar(shown, ax=axes[0])
for ax, (name, depth) in zip(axes[1:], maps.items(), strict=True):
    shown = ax.imshow(1000 * (depth - truth), cmap="RdBu", vmin=-100, vmax=100)
    median = 1000 * np.nanmedian(depth - truth)
    ax.set(title=f"{name}: median error {median:.1f} mm", xticks=[], yticks=[])
figure.colorbar(shown, ax=axes[2], label="error of depth [mm]")
figure.savefig(OUT / "depth_map.png", dpi=100)
plt.show()
save("depth.npz", counted=maps["counts"], corrected=maps["corrected"], depth_std=raw["depth_std"])

# %% [markdown]
# ## 7. A correlation camera
# Problem `a4.itof`. Each tap sums the light of all bins: a pixel has one phase, and all returns
# contribute to it.

# %% [solution] itof.py

# %%
from itof import demodulate, expected_taps, multipath_phase_error, phase_deviation, sample_taps

# Modulation, and cycles of the exposure
FREQUENCY = 20e6
CONTRAST = 0.6
FRAMES = 20_000
phase_of_bin = 2 * np.pi * FREQUENCY * opl / SPEED_OF_LIGHT
ambient = light["background"].values.astype(float)  # photons per bin and cycle
modulated = rates - ambient[..., None]
means = expected_taps(modulated, 0.0, phase_of_bin, CONTRAST).sum(axis=-1)
means = FRAMES * (means + ambient * BINS / 4)
taps = sample_taps(np.random.default_rng(5), means, read_noise=20.0)
amplitude, phase = demodulate(taps, CONTRAST)
depth = SPEED_OF_LIGHT * phase / (4 * np.pi * FREQUENCY)
noise = phase_deviation(amplitude, FRAMES * ambient * BINS, CONTRAST, read_noise=20.0)
noise = SPEED_OF_LIGHT * noise / (4 * np.pi * FREQUENCY)
print(f"error by noise {1000 * np.median(noise):.2f} mm (median of the pixels)")
print(f"median error {1000 * np.nanmedian(depth - truth):.0f} mm: multi-path light")
turn = np.linspace(0, 2 * np.pi, 200)
figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
for ratio in (0.1, 0.35, 0.8):
    axes[0].plot(turn, multipath_phase_error(ratio + 0 * turn, turn), label=f"ratio {ratio}")
axes[0].set(xlabel="phase of the second return [rad]", ylabel="error of the phase [rad]")
axes[0].legend(frameon=False)
shown = axes[1].imshow(1000 * (depth - truth), cmap="RdBu", vmin=-600, vmax=600)
axes[1].set(title="error of depth [mm]", xticks=[], yticks=[])
figure.colorbar(shown, ax=axes[1])
plt.show()
save("itof.npz", taps=taps, phase=phase, depth=depth, frequency_hz=FREQUENCY, contrast=CONTRAST)

# %% [markdown]
# **Questions.** Answer in this cell.
# 1. Which pixels have the largest error in the map of the uncorrected counts, and why is it
#    negative?
# 2. `depth_std` of the uncorrected counts is about 1 mm. Is that their error? What does the bound
#    not include?
# 3. At which signal does the error in section 5 leave the bound, and what happens there?
# 4. Why is the depth of the correlation camera too great nearly everywhere? Would more light, or
#    another frequency, change that?
#
# ## See also
# - `README.md`, `exercises.md`
# - `pytest` for all problems, and `tofrender submit a4 .` to pack what you hand in
