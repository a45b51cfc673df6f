# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Time of flight
#
# **Overview.** You extend a path tracer by the *arrival time* of light: as a camera with a time
# gate, as a correlation camera that measures depth, with a film of time bins, and for a scene
# around a corner. The [handout](README.md) explains the theory and specifies each problem.
#
# **What you will learn**
# - what pulses, gates and time bins measure, in which units, and how they sum to a steady image
# - how a correlation camera maps path lengths to phases, and how phase wrapping and multi-path
#   interference change depth
# - how to trace paths into time bins, and which errors a conversion to phasors has
# - how light from a hidden scene is computed, if the laser spot is treated as a light source
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

import drjit as dr
import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

import tofrender
from tofrender.paths.camera import sample_camera
from tofrender.signals.units import SPEED_OF_LIGHT, opl_to_ns

SMALL = os.environ.get("TOFRENDER_NOTEBOOK_SIZE") == "small"  # for automatic tests
SIZE, SPP = (16, 512) if SMALL else (64, 256)  # pixels, samples per pixel
FREQUENCIES = [20e6, 50e6, 100e6]  # Hz
UNIT = "[W m$^{-2}$ sr$^{-1}$]"
OUT = Path("deliverables")
OUT.mkdir(exist_ok=True)


def save(name, **arrays):
    """Write arrays to deliverables/, numbers of pictures in single precision."""
    single = {k: np.asarray(v, np.float32) if np.ndim(v) > 1 else v for k, v in arrays.items()}
    np.savez_compressed(OUT / name, **single)
    print(f"wrote {OUT / name}: {', '.join(arrays)}")


def show(ax, image, title="", **options):
    """A picture without axes."""
    shown = ax.imshow(image, **options)
    ax.set_title(title)
    ax.set_axis_off()
    return shown


# %% [markdown]
# # Part 1: gates and waves
# ## 1. Gaussian pulse
# Problem `a2.gaussian_pulse`. Its `eval`, `cdf` and `sample` must be consistent.

# %% [solution] gaussian_pulse.py

# %%
from gaussian_pulse import GaussianPulse

pulse = GaussianPulse(width_opl=0.03)
n = 2001
t = dr.linspace(mi.Float, -0.2, 0.2, n)
dt = 0.4 / (n - 1)  # both ends belong to the n points
print(f"integral of the density: {np.array(pulse.eval(t)).sum() * dt:.5f}")

xi = mi.Float(np.random.default_rng(0).random(100_000))
offsets, weight = pulse.sample(xi)
offsets = np.array(offsets)
print(f"samples: mean {offsets.mean():+.5f} m, standard deviation {offsets.std():.5f} m")
print("offsets at ξ = 0, 1/2, 1:", np.array(pulse.sample(mi.Float([0, 0.5, 1]))[0]), "m")

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.2), layout="constrained")
left.hist(offsets, bins=100, density=True, color="0.8", label="samples")
left.plot(np.array(t), np.array(pulse.eval(t)), label="eval")
left.set(xlabel="offset [m]", ylabel="density [1/m]")
left.legend(frameon=False)
right.plot(np.sort(offsets), np.linspace(0, 1, offsets.size), color="0.7", lw=4, label="samples")
right.plot(np.array(t), np.array(pulse.cdf(t)), label="cdf")
right.set(xlabel="offset [m]", ylabel="fraction of the energy")
right.legend(frameon=False)
plt.show()

# %% [markdown]
# Problem `a2.pulse_checks`. Your pulse should pass your test, and a pulse with twice the energy
# should fail.

# %% [solution] pulse_checks.py

# %%
from pulse_checks import check_pulse


class TwiceTheEnergy(GaussianPulse):
    """Wrong on purpose."""

    def eval(self, t):
        """Twice the density."""
        return 2 * super().eval(t)


check_pulse(pulse)
try:
    check_pulse(TwiceTheEnergy(width_opl=0.03))
except AssertionError as error:
    print(f"found: {error}")
else:
    print("a density that integrates to 2 passes: look again")

# %% [markdown]
# ## 2. Time gates
# Problem `a2.time_gated`. Start from `PathTracer` in `path_tracer.py`: keep track of the path
# length, and weight each contribution with the pulse.

# %% [solution] time_gated.py

# %%
from time_gated import TimeGatedTransientPath, render_at_time, render_transient

STEADY = {"integrator": {"type": "path", "max_depth": 8}}
box = tofrender.cornell_box(width=SIZE, height=SIZE)
scene = mi.load_dict(box | STEADY)
sensor = scene.sensors()[0]
integrator = TimeGatedTransientPath(mi.Properties())

instants = (4.9, 5.6, 6.2, 6.8)
figure, axes = plt.subplots(1, 4, figsize=(12, 3.3), layout="constrained")
for ax, target in zip(axes, instants, strict=True):
    image = render_at_time(scene, integrator, sensor, target, spp=SPP)
    title = f"{target:.1f} m = {opl_to_ns(target):.1f} ns"
    show(ax, tofrender.tonemap(image, exposure=1.2), title)
plt.show()

# %% [markdown]
# Now all gates of the film's window, computed from the same paths. A gated value is a density, so
# the sum over gates times their spacing is compared with the steady image of Mitsuba's path tracer.
# Some light is missing: it arrives later than 9.5 m, after the last gate.

# %%
film_config = {"temporal_bins": 300, "start_opl": 3.5, "bin_width_opl": 0.02}
start = film_config["start_opl"]
width = film_config["bin_width_opl"]
opl = start + (np.arange(300) + 0.5) * width  # m, centers of the bins
gated = render_transient(scene, integrator, sensor, film_config, spp=SPP)
steady_sum = gated.sum(axis=2) * width
steady_scene = mi.load_dict(tofrender.cornell_box_steady_state(width=SIZE, height=SIZE))
steady = np.array(mi.render(steady_scene, spp=SPP))
kept = steady_sum.sum() / steady.sum()
print(f"shape {gated.shape}; the sum holds {100 * kept:.1f} % of the light (96 % is right)")

exposure = 1 / np.percentile(steady, 98)
figure, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
show(axes[0], tofrender.tonemap(steady, exposure=exposure), "Mitsuba's path")
show(axes[1], tofrender.tonemap(steady_sum, exposure=exposure), "sum over gates x spacing")
missing = 5 * np.maximum(steady - steady_sum, 0)
show(axes[2], tofrender.tonemap(missing, exposure=exposure), "difference x 5")
plt.show()

# %% [markdown]
# The responses of single pixels. The left side of the tall box is in shadow: where does its light
# come from?

# %%
places = {"back wall": (0.7, 0.35), "red wall": (0.08, 0.5), "box, in shadow": (0.29, 0.65)}
pixels = {name: (int(u * SIZE), int(v * SIZE)) for name, (u, v) in places.items()}

figure, axes = plt.subplots(1, 2, figsize=(12, 3.8), width_ratios=(1, 2.2), layout="constrained")
show(axes[0], tofrender.tonemap(steady_sum, exposure=exposure), "sum over gates")
for name, (x, y) in pixels.items():
    (line,) = axes[1].plot(opl_to_ns(opl), gated[y, x, :, 0], label=f"{name} ({x}, {y})")
    axes[0].plot(x, y, "o", color=line.get_color(), markeredgecolor="white", markersize=9)
axes[1].set(xlabel="time [ns]", ylabel="red radiance per meter [W m$^{-2}$ sr$^{-1}$ m$^{-1}$]")
axes[1].legend(frameon=False)
figure.savefig(OUT / "pixel_responses.png", dpi=110)
plt.show()

# %% [markdown]
# An animation of light in flight, with three gates per frame.

# %%
three = gated.reshape(*gated.shape[:2], 100, 3, 3).mean(axis=3)
frames = three[:, :, ::5] if SMALL else three
animation = tofrender.visualize_transient(frames, start, 6.0 / frames.shape[2])
animation.save(OUT / "animation.gif", writer="pillow", fps=20, dpi=60)
animation

# %%
save("gated.npz", transient=gated, pulse_width_opl=0.03, start_opl=start, bin_width_opl=width)

# %% [markdown]
# ## 3. AMCW modulation
# Problem `a2.amcw_pulse`. Which `phase_offset` turns the cosine into a sine?

# %% [solution] amcw_pulse.py

# %%
from amcw_pulse import AMCWPulse

x = np.linspace(0, 12, 1200)
figure, ax = plt.subplots(figsize=(9, 2.8), layout="constrained")
for offset, name in ((0.0, "offset 0"), (-np.pi / 2, "offset -π/2"), (np.pi / 2, "offset +π/2")):
    wave = AMCWPulse(20e6, offset)
    ax.plot(x, np.array(wave.eval(mi.Float(x))), label=name)
ax.plot(x, np.sin(2 * np.pi * 20e6 * x / SPEED_OF_LIGHT), ":", color="black", label="sine")
ax.set(xlabel="optical path length [m]", ylabel="weight", title="20 MHz")
figure.legend(loc="outside right center", frameon=False)
plt.show()
for frequency in FREQUENCIES:
    reach = AMCWPulse(frequency).get_unambiguous_range()
    print(f"{frequency / 1e6:3.0f} MHz: unambiguous range {reach:.2f} m")

# %% [markdown]
# ## 4. Correlation images and phasors
# Problem `a2.amcw_path`.

# %% [solution] amcw_path.py

# %% [markdown]
# First a scene in which half the path length *is* a depth: the box is lit by a flash at the camera.
# At 20 MHz all depths are within the unambiguous range, at 50 MHz none is.

# %%
from amcw_path import render_amcw_phasor

flash = mi.load_dict(tofrender.cornell_box_flash(width=SIZE, height=SIZE) | STEADY)


def all_phasors(scene, spp=SPP, seed=0):
    """I, Q, amplitude, phase and depth at all frequencies, the frequencies in front."""
    each = [render_amcw_phasor(scene, scene.sensors()[0], f, spp, seed) for f in FREQUENCIES]
    return [np.array(part) for part in zip(*each, strict=True)]


flash_phasors = all_phasors(flash)
tofrender.phasor_panel(FREQUENCIES, *flash_phasors, title="with a flash at the camera")

# %% [markdown]
# The error of the depth, compared with the distance of the first surface. Depths that are too small
# by whole unambiguous ranges have wrapped. The remaining error is due to indirect light (multi-path
# interference). The phasors of the color channels are added; their phases are not averaged.


# %%
def first_surface(scene):
    """Distance from the camera to what each pixel sees [m]."""
    sensor = scene.sensors()[0]
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, SIZE * SIZE)
    camera = sample_camera(sensor, sensor.film(), sampler, dr.arange(mi.UInt32, SIZE * SIZE))
    si = scene.ray_intersect(camera.ray)
    distance = dr.select(si.is_valid(), dr.norm(si.p - camera.origin), dr.nan)
    return np.array(distance).reshape(SIZE, SIZE)


truth = first_surface(flash)
for j, frequency in enumerate(FREQUENCIES):
    phasor = (flash_phasors[0][j] + 1j * flash_phasors[1][j]).sum(axis=-1)
    reach = SPEED_OF_LIGHT / (2 * frequency)
    depth = np.mod(np.angle(phasor), 2 * np.pi) / (2 * np.pi) * reach
    error = depth - truth
    left = (error + reach / 2) % reach - reach / 2
    print(
        f"{frequency / 1e6:3.0f} MHz: median error {np.nanmedian(error):+.3f} m, "
        f"without whole ranges {1000 * np.nanmedian(left):+.0f} mm"
    )

# %% [markdown]
# Now the scene of your other results, with a lamp in the ceiling. There, "depth" is half the length
# of the path from lamp to camera, not the distance of a surface.

# %%
phasors = all_phasors(scene)
amplitude = np.hypot(phasors[0], phasors[1])
dark = amplitude.max(axis=(0, -1)) < 2  # without the lamp, which outshines all else
panel = [np.where(dark[..., None], part, np.nan) for part in phasors]
tofrender.phasor_panel(FREQUENCIES, *panel, title="lit from the ceiling")

# %%
save("phasors.npz", frequencies_hz=FREQUENCIES, I=phasors[0], Q=phasors[1])

# %% [markdown]
# **Questions, part 1.** Answer in this cell.
# 1. Which surface is the first to be lit at 4.9 m, and why is it not the ceiling?
# 2. Which fraction of the light is in your sum over gates? Where and when does the rest arrive?
# 3. In the flash scene, in which pixels is the depth wrong although it has not wrapped? Is it too
#    large or too small, and why?

# %% [markdown]
# # Part 2: bins
# ## 5. Transient path tracer
# Problem `a2.transient_path`. The film and `render` are given. You write the path tracer, and the
# method that spreads a contribution over bins with a pulse.

# %% [solution] transient_path.py

# %% [markdown]
# **Task 1: a Gaussian pulse.** The scene's film has the time window of the gates above. The value
# of a bin is a radiance, not a density, so the sum over bins needs no factor.

# %%
from transient_path import TransientPath

film_scene = mi.load_dict(box)
tracer = TransientPath(mi.Properties())
tracer.pulse = GaussianPulse(width_opl=0.03)
film_steady, pulsed = (np.array(part) for part in tracer.render(film_scene, spp=SPP, seed=1))
print(f"shape {pulsed.shape}; sum over bins / steady: {pulsed.sum() / film_steady.sum():.3f}")

tracer.pulse = None
_, instant = (np.array(part) for part in tracer.render(film_scene, spp=SPP, seed=1))

figure, axes = plt.subplots(1, 2, figsize=(12, 3.6), layout="constrained")
x, y = pixels["back wall"]
axes[0].step(opl, instant[y, x].sum(axis=-1), where="mid", color="0.75", label="bins, an instant")
axes[0].plot(opl, pulsed[y, x].sum(axis=-1), label="bins, a pulse")
axes[0].plot(opl, gated[y, x].sum(axis=-1) * width, "--", label="gates x bin width")
axes[0].set(xlim=(5.5, 8), title="back wall", xlabel="optical path length [m]")
axes[0].set_ylabel(f"radiance per bin {UNIT}")
axes[1].semilogy(opl, pulsed.mean(axis=(0, 1, 3)), label="bins, a pulse")
axes[1].semilogy(opl, gated.mean(axis=(0, 1, 3)) * width, "--", label="gates x bin width")
axes[1].set(ylim=(1e-6, 1e-1), title="mean of all pixels", xlabel="optical path length [m]")
for ax in axes:
    ax.legend(frameon=False)
plt.show()

# %%
tofrender.light_in_flight(pulsed, start, width, style="rainbow")

# %%
save(
    "transient.npz",
    transient=pulsed,
    steady=film_steady,
    start_opl=start,
    bin_width_opl=width,
    pulse_width_opl=0.03,
)

# %% [markdown]
# ## 6. Phasors from time bins
# Problem `a2.transient_to_phasor`.

# %% [solution] phasors.py

# %% [markdown]
# **Task 2: phasors from a transient.** Bins contain how much light has which path length, and a
# phasor depends on nothing else.

# %%
from phasors import sum_channels, transient_to_phasor

each = [transient_to_phasor(pulsed, f, start, width) for f in FREQUENCIES]
converted = [np.array(part) for part in zip(*each, strict=True)]
panel = [np.where(dark[..., None], part, np.nan) for part in converted]
tofrender.phasor_panel(FREQUENCIES, *panel, title="converted from bins")

# %% [markdown]
# **Task 3: comparison.** A mean squared error alone does not show whether it is only noise. So we
# also print the error between two direct renders with different seeds, which differ by noise only.
# (The error of the comparison may be smaller, because bins and direct renders need not be equally
# noisy.)

# %%
again = all_phasors(scene, seed=7)
mse = {}
noise = {}
for part, name in enumerate("IQ"):
    mse[name] = np.mean((phasors[part] - converted[part]) ** 2, axis=(1, 2, 3))
    noise[name] = np.mean((phasors[part] - again[part]) ** 2, axis=(1, 2, 3))
    for j, frequency in enumerate(FREQUENCIES):
        print(
            f"{name} at {frequency / 1e6:3.0f} MHz: MSE {mse[name][j]:.2e}, "
            f"two direct renders {noise[name][j]:.2e}"
        )
save(
    "comparison.npz",
    frequencies_hz=FREQUENCIES,
    I_direct=phasors[0],
    Q_direct=phasors[1],
    I_converted=converted[0],
    Q_converted=converted[1],
    mse_I=mse["I"],
    mse_Q=mse["Q"],
)

# %% [markdown]
# Noise in single pixels hides an error that is common to all. Half the path length, computed from
# the sum of all pixels except the lamp, shows it: the time window ends at 9.5 m, and the conversion
# lacks later light. With a window that contains all paths, converted and direct phasors agree.

# %%
long_box = tofrender.cornell_box(
    width=SIZE, height=SIZE, start_opl=3.0, temporal_bins=600, bin_width_opl=0.04
)
_, whole = (np.array(part) for part in tracer.render(mi.load_dict(long_box), spp=SPP, seed=2))


def half_path(I, Q, frequency):
    """Half the path length of all light together but the lamp's [m]."""
    parts = (np.where(dark[..., None], part, 0).sum(axis=(0, 1), keepdims=True) for part in (I, Q))
    return sum_channels(*parts, frequency)[4].item()


for j, frequency in enumerate(FREQUENCIES):
    direct = half_path(phasors[0][j], phasors[1][j], frequency)
    short = half_path(converted[0][j], converted[1][j], frequency)
    long = half_path(*transient_to_phasor(whole, frequency, 3.0, 0.04)[:2], frequency)
    errors = 1000 * (np.array([short, long]) - direct)
    print(
        f"{frequency / 1e6:3.0f} MHz: direct {direct:.3f} m; "
        f"window to 9.5 m {errors[0]:+.0f} mm, to 27 m {errors[1]:+.0f} mm"
    )

# %% [markdown]
# **Questions, part 2.** Answer in this cell.
# 1. Is the mean squared error of the comparison explained by noise? What do the lines after it show
#    that the mean squared error hides?
# 2. Why does truncation make the path length too short at 20 MHz, but perhaps too long at 100 MHz?
# 3. By which factor does the pulse of 30 mm change the amplitude at 100 MHz? Must it be corrected?

# %% [markdown]
# # Part 3: around the corner
# ## 7. The relay wall
# Problem `a2.relay_wall`.

# %% [solution] relay_wall.py

# %% [markdown]
# ## 8. The laser spot as a light source
# Problem `a2.confocal` (and the bonus `a2.area_spot`, in the same file).

# %% [solution] confocal.py

# %% [markdown]
# The scene: laser and camera scan a wall, a floor adjoins it, and a letter Z faces it. All are on
# the same side of the wall; an occluder hides the letter from the camera. Wall and floor both count as
# relay wall, so that light between them can be distinguished from light of the letter.

# %%
import confocal  # noqa: F401 (this registers the integrator)
from nlos_scene import corner_scene
from relay_wall import is_on_relay_wall

points = 8 if SMALL else 16
described = corner_scene(width=points, height=points)
corner = mi.load_dict(described, optimize=False)
tofrender.plan_figure(corner, view="side", title="corner_scene, from the side")

# %% [markdown]
# A map of all directions around the device, which shows where it sees the relay wall.

# %%
rows = 90
columns = 180
polar, azimuth = dr.meshgrid(
    dr.linspace(mi.Float, 0.01, np.pi - 0.01, rows),
    dr.linspace(mi.Float, -np.pi, np.pi, columns),
    indexing="ij",
)
sin_p, cos_p = dr.sincos(polar)
sin_a, cos_a = dr.sincos(azimuth)
around = mi.Ray3f(mi.Point3f(-0.5, 0, 0.25), mi.Vector3f(-sin_p * sin_a, cos_p, -sin_p * cos_a))
si = corner.ray_intersect(around)
wall_shapes = [shape for shape in corner.shapes() if shape.id() in ("relay_wall", "floor")]
kind = np.array(si.is_valid()).astype(int) + np.array(is_on_relay_wall(si, wall_shapes))
figure, ax = plt.subplots(figsize=(8, 3.4), layout="constrained")
shown = ax.imshow(kind.reshape(rows, columns), extent=(-180, 180, -90, 90), vmin=0, vmax=2)
ax.set(xlabel="azimuth [degrees], 0 toward the wall", ylabel="elevation [degrees]")
bar = figure.colorbar(shown, ax=ax, ticks=[0, 1, 2])
bar.ax.set_yticklabels(["nothing", "something", "relay wall"])
plt.show()

# %% [markdown]
# A test with a closed form: the light that a tilted patch reflects back to the laser spot,
# $\Phi\rho_w^2\rho_h\cos^2\theta_w\cos^2\theta_h/(\pi^3r^4)$ per square meter of the patch. A
# missing cosine is visible at large tilts.

# %%
SIDE = 0.3
PLACE = np.array([0.3, 0.1, 1.0])
cells = SIDE * ((np.arange(30) + 0.5) / 30 - 0.5)
u, v = np.meshgrid(cells, cells)


def formula(tilt):
    """Radiance of all light of the patch, albedos 0.8 and 0.7, 1 W."""
    a = np.radians(tilt)
    across = np.array([np.cos(a), 0, -np.sin(a)])
    normal = np.array([-np.sin(a), 0, -np.cos(a)])
    p = PLACE + u[..., None] * across + v[..., None] * np.array([0, 1, 0])
    r = np.linalg.norm(p, axis=-1)
    cosines = np.maximum(p[..., 2] / r, 0) * np.maximum(-(p @ normal) / r, 0)
    return (0.8**2 * 0.7 * cosines**2 / (np.pi**3 * r**4)).mean() * SIDE**2


tilts = [-60, -30, 0, 30, 60]
found = []
for tilt in tilts:
    patch = tofrender.nlos_patch(
        side=SIDE, position=PLACE, tilt=tilt, width=1, height=1, temporal_bins=200
    )
    patch["integrator"] = {"type": "confocal_transient_path", "max_depth": 3}
    image, _ = mi.render(mi.load_dict(patch, optimize=False), spp=(1 << 14) if SMALL else (1 << 16))
    found.append(np.array(image).mean())
angles = np.linspace(-80, 80, 81)
figure, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
ax.plot(angles, [formula(a) for a in angles], label="formula")
ax.plot(tilts, found, "o", color="black", label="rendered")
ax.set(xlabel="tilt [degrees]", ylabel=f"radiance {UNIT}")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# Now the scene around the corner, with and without paths that only hit relay walls.

# %%
NLOS_SPP = 1024 if SMALL else 8192
captures = {}
for name, only in (("unfiltered", False), ("filtered", True)):
    described = corner_scene(width=points, height=points, use_nlos_only=only)
    _, bins = mi.render(mi.load_dict(described, optimize=False), spp=NLOS_SPP, seed=3)
    captures[name] = np.array(bins)
film = described["relay_wall"]["sensor"]["film"]
nlos_start = film["start_opl"]
nlos_width = film["bin_width_opl"]
save("nlos.npz", **captures, start_opl=nlos_start, bin_width_opl=nlos_width)

# %% [markdown]
# Responses of the wall points on a line half a meter above the middle of the wall. The device is
# 0.25 m in front of the wall, and its distance d from each point is included in the length,
# 2d + 2r. The curves show the first arrival, from the nearest point of the letter and of the floor.

# %%
nlos_opl = nlos_start + nlos_width * (np.arange(captures["filtered"].shape[2]) + 0.5)
wall_x = 2 * (np.arange(points) + 0.5) / points - 1
row = 3 * points // 4
wall_y = wall_x[row]
d = np.sqrt((wall_x + 0.5) ** 2 + wall_y**2 + 0.25**2)
beside, above = (np.maximum(np.abs(each) - 0.4, 0) for each in (wall_x, wall_y))
nearest_letter = np.sqrt(1.0 + beside**2 + above**2)
arrivals = {"letter": 2 * d + 2 * nearest_letter, "floor": 2 * d + 2 * (wall_y + 1)}

figure, axes = plt.subplots(1, 3, figsize=(14, 4.2), layout="constrained")
top = captures["unfiltered"][row].mean(axis=-1).max()
for ax, (name, data) in zip(axes, captures.items(), strict=False):
    image = data[row].mean(axis=-1).T
    shown = ax.imshow(
        np.sqrt(image / top),
        origin="lower",
        aspect="auto",
        extent=(-1, 1, nlos_opl[0] - nlos_width / 2, nlos_opl[-1] + nlos_width / 2),
        vmax=1,
        cmap="magma",
    )
    for (what, when), style in zip(arrivals.items(), ("--", ":"), strict=True):
        ax.plot(wall_x, when, style, color="cyan", label=f"first light of the {what}")
    ax.set(ylim=(2, 7), title=name, xlabel="x of the wall's point [m]", xticks=(-1, 0, 1))
    ax.set_ylabel("optical path length [m]")
axes[1].legend(loc="lower right", labelcolor="white", frameon=False, fontsize=9)
figure.colorbar(shown, ax=axes[:2], label="square root of light, over the brightest")

column = points // 2
for name, style in (("unfiltered", "-"), ("filtered", "--")):
    response = captures[name][row, column].mean(axis=-1)
    axes[2].plot(nlos_opl, np.maximum(response, 1e-9), style, label=name)
for what, when in arrivals.items():
    axes[2].axvline(when[column], color="0.6", ls=":")
    axes[2].annotate(what, (when[column], 3e-8), rotation=90, ha="right", color="0.4")
axes[2].set(yscale="log", ylim=(1e-8, 1e-2), xlim=(2, 7), title="one point of the wall")
axes[2].set(xlabel="optical path length [m]", ylabel=f"radiance per bin {UNIT}")
axes[2].legend(frameon=False)
plt.show()

# %% [markdown]
# ## 9. Bonus: laser beam of finite width
# Problem `a2.area_spot`. How wide may a beam be before the capture blurs in time? (If `spot_sigma`
# is ignored, the curves coincide.)

# %%
figure, ax = plt.subplots(figsize=(8, 3.4), layout="constrained")
for sigma in (0.0, 0.01, 0.05, 0.15):
    patch = tofrender.nlos_patch(
        side=0.25, position=PLACE, tilt=40, width=1, height=1, temporal_bins=200
    )
    patch["integrator"] = {"type": "confocal_transient_path", "max_depth": 3}
    patch["integrator"] |= {"use_nlos_only": True, "spot_sigma": sigma}
    patch["relay_wall"]["sensor"]["film"] |= {"start_opl": 2.6, "bin_width_opl": 0.02}
    patch = mi.load_dict(patch, optimize=False)
    _, bins = mi.render(patch, spp=(1 << 14) if SMALL else (1 << 16))
    edges = 2.6 + 0.02 * np.arange(201)
    ax.stairs(np.array(bins)[0, 0, :, 0], edges, label=f"{sigma:g} rad")
ax.set(xlim=(3.0, 3.6), xlabel="optical path length [m]", ylabel=f"radiance per bin {UNIT}")
ax.legend(frameon=False, title="spot_sigma")
plt.show()

# %% [markdown]
# ## 10. Bonus: fog and polarized light
# Problem `a2.fog`.

# %% [solution] fog.py

# %% [markdown]
# Positions of photons in fog after four path lengths. The dotted circle is the largest distance
# that light can reach. (Cells of this section show nothing until `fog.py` is written.)

# %%
from fog import absorb, through_polarizer, wander

try:
    ell = 1 / (2.0 * (1 - 0.7))
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.4), layout="constrained")
    for ax, turns in zip(axes, (0.5, 1, 3, 10), strict=True):
        s = turns * ell
        p = wander(np.random.default_rng(1), 2.0, 0.7, s, 5_000 if SMALL else 50_000)
        reach = min(1.05 * s, 12)
        ax.hist2d(p[:, 2], p[:, 0], bins=80, range=[(-reach, reach)] * 2, norm="symlog")
        ax.add_patch(plt.Circle((0, 0), s, fill=False, ec="white", ls=":"))
        mean = p[:, 2].mean()
        exact = ell * (1 - np.exp(-turns))
        title = f"s = {turns:g} l: mean of z {mean:.3f} m\nexact {exact:.3f} m"
        ax.set(title=title, aspect="equal", xlabel="z [m]")
    plt.show()
except NotImplementedError as error:
    print(error)

# %% [markdown]
# The response of the Cornell box filled with an absorbing gas, computed from the bins that you have
# rendered; and the fraction of light polarized at 30° that passes three polarizers, over the angle
# of the middle one. The outer two are crossed.

# %%
try:
    figure, axes = plt.subplots(1, 2, figsize=(12, 3.2), layout="constrained")
    opl = 3.0 + 0.04 * (np.arange(600) + 0.5)
    for mu_a in (0.0, 0.3, 1.0):
        axes[0].semilogy(
            opl, absorb(whole, mu_a, 3.0, 0.04).mean(axis=(0, 1, 3)), label=f"{mu_a:g}"
        )
    axes[0].set(xlabel="optical path length [m]", ylim=(1e-9, None), xlim=(3, 20))
    axes[0].legend(frameon=False, title="absorption [1/m]")
    light = np.array([1.0, 0.5, 0.866, 0.0])
    angles = np.linspace(0, np.pi, 91)
    passed = []
    for angle in angles:
        middle = through_polarizer(through_polarizer(light, 0.0), angle)
        passed.append(through_polarizer(middle, np.pi / 2)[0])
    axes[1].plot(np.degrees(angles), passed)
    axes[1].set(xlabel="angle of the middle polarizer [degrees]", ylabel="light")
    plt.show()
except NotImplementedError as error:
    print(error)

# %% [markdown]
# **Questions, part 3.** Answer in this cell.
# 1. Which bins of which wall points contain light of the path laser, wall, floor, wall, sensor, and
#    which contain light from the letter? Where are both in the same bin, and how does a filter by
#    time differ there from `use_nlos_only`?
# 2. Where would light of the path laser, wall, sensor be, and why is it in none of your captures?
# 3. How do the first arrivals along the wall determine the position of the letter? Which
#    information about the letter is in later light?
# 4. How would a capture look with four or five segments (`max_depth`) up to the laser spot?
#
# ## See also
# - `README.md`, `exercises.md`
# - `pytest` for all problems, and `tofrender submit a2 .` to pack what you hand in
