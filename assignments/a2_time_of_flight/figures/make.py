"""Make all figures of the handout: `python figures/make.py [NAME ...]`, about two minutes."""

# ruff: noqa: E741 (I and Q are what the field calls them)

from __future__ import annotations

import sys
from collections.abc import Callable
from math import erf
from pathlib import Path

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
from matplotlib.colors import PowerNorm

import tofrender
from tofrender.analysis import sum_channels, transient_to_phasor, unambiguous_range
from tofrender.signals.units import SPEED_OF_LIGHT

HERE = Path(__file__).parent
RADIANCE = "W m$^{-2}$ sr$^{-1}$"
SIZE = 128  # pixels of the pictures

plt.rcParams.update({"figure.dpi": 110, "font.size": 10, "axes.spines.top": False})
plt.rcParams.update({"axes.spines.right": False, "legend.frameon": False})


def picture(ax, image, title="", **options):
    """An image without axes."""
    shown = ax.imshow(image, interpolation="nearest", **options)
    ax.set_title(title)
    ax.set_axis_off()
    return shown


def pulse_and_bins():
    """What a gate reads and what a bin holds."""
    sigma = 0.03
    width = 0.02
    opl = 6.013
    edges = 5.88 + width * np.arange(14)
    cdf = np.vectorize(lambda t: 0.5 * (1 + erf((t - opl) / (sigma * np.sqrt(2)))))
    mass = np.diff(cdf(edges))
    t = np.linspace(edges[0], edges[-1], 500)
    density = np.exp(-0.5 * ((t - opl) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.3), layout="constrained")
    centers = edges[:-1] + width / 2
    left.bar(centers, mass / width, width * 0.94, color="0.85", label="mass of the bin / w")
    left.plot(t, density, color="tab:blue", label="p(t - opl)")
    read = np.exp(-0.5 * ((centers - opl) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    left.plot(centers, read, "o", color="tab:orange", label="gate at the center")
    left.set(xlabel="optical path length [m]", ylabel="density [1/m]", ylim=(0, 17))
    left.set_title("one path of 6.013 m, σ = 30 mm, w = 20 mm")
    left.legend(loc="upper left", fontsize=9)
    error = 100 * (read * width / mass - 1)
    right.bar(centers, error, width * 0.94, color="tab:orange")
    right.axhline(0, color="black", lw=0.8)
    right.set(xlabel="optical path length [m]", ylabel="error [%]")
    right.set_title("gate times w, compared with the bin's mass")
    return figure


def wavefronts():
    """The Cornell box at four instants, and what three pixels see."""
    scene = mi.load_dict(tofrender.cornell_box(width=SIZE, height=SIZE))
    integrator = tofrender.TimeGatedTransientPath(mi.Properties())
    gates = {"temporal_bins": 300, "start_opl": 3.5, "bin_width_opl": 0.02}
    cube = tofrender.render_transient(scene, integrator, scene.sensors()[0], gates, spp=256)
    opl = 3.5 + (np.arange(300) + 0.5) * 0.02
    figure = plt.figure(figsize=(10, 5.6), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=(1, 1))
    for ax, target in zip(top.subplots(1, 4), (4.9, 5.6, 6.2, 6.8), strict=True):
        k = int((target - 3.5) / 0.02)
        title = f"{target:.1f} m = {tofrender.opl_to_ns(target):.1f} ns"
        picture(ax, tofrender.tonemap(cube[:, :, k], exposure=1.2), title)
    left, right = bottom.subplots(1, 2, width_ratios=(1, 2.6))
    picture(left, tofrender.tonemap(cube.sum(axis=2) * 0.02, percentile=98), "sum over gates")
    places = {"back wall": (0.7, 0.35), "red wall": (0.08, 0.5), "box, in shadow": (0.29, 0.65)}
    for name, (u, v) in places.items():
        x = int(u * SIZE)
        y = int(v * SIZE)
        response = cube[y - 2 : y + 3, x - 2 : x + 3].mean(axis=(0, 1))
        (line,) = right.plot(tofrender.opl_to_ns(opl), response[:, 0], label=name)
        left.plot(x, y, "o", color=line.get_color(), markeredgecolor="white", markersize=8)
    right.set(xlabel="time [ns]", ylabel=f"red radiance per meter\n[{RADIANCE} m$^{{-1}}$]")
    right.set_xlim(14, 32)
    right.legend()
    return figure


def steady_and_sum():
    """The steady image, the sum over bins, and what is late, what is lost without emitter hits."""
    size = SIZE
    spp = 128
    dataset = tofrender.render(
        mi.load_dict(tofrender.cornell_box(width=size, height=size)), spp=spp, progress=False
    )
    steady = dataset["steady"].values
    kept = dataset["transient"].values.sum(axis=2)
    lamp_free = tofrender.cornell_box(width=size, height=size)
    lamp_free["integrator"]["discard_direct_light"] = True
    no_hits = tofrender.render(mi.load_dict(lamp_free), spp=spp, progress=False)["steady"].values
    exposure = 1 / np.percentile(steady, 98)
    shares = [image.sum() / steady.sum() for image in (kept, no_hits)]
    figure, axes = plt.subplots(1, 4, figsize=(11, 3.2), layout="constrained")
    panels = {
        "steady image": steady,
        f"sum over bins\n{100 * shares[0]:.1f} % of the light": kept,
        "later than 9.5 m, 5 x": 5 * np.maximum(steady - kept, 0),
        f"without emitter hits\n{100 * shares[1]:.0f} % of the light": no_hits,
    }
    for ax, (name, image) in zip(axes, panels.items(), strict=True):
        picture(ax, tofrender.tonemap(image, exposure=exposure), name)
    return figure


def wrapping():
    """A phase as a clock, and the depths that agree with it."""
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(11.5, 3.4), width_ratios=(1, 1.5, 1.5), layout="constrained"
    )
    f = 50e6
    depth = 4.0
    angle = 4 * np.pi * f * depth / SPEED_OF_LIGHT
    circle = np.linspace(0, 2 * np.pi, 200)
    left.plot(np.cos(circle), np.sin(circle), color="0.8")
    i = np.cos(angle)
    q = np.sin(angle)
    left.annotate("", (i, q), (0, 0), arrowprops={"arrowstyle": "-|>", "color": "tab:blue"})
    left.plot([i, i, 0], [0, q, q], ":", color="0.4")
    swept = np.linspace(0, angle % (2 * np.pi), 60)
    left.plot(0.35 * np.cos(swept), 0.35 * np.sin(swept), color="tab:blue", lw=1)
    left.text(0.3, 0.28, "phase", color="tab:blue")
    left.text(i, -0.06, "I", ha="center", va="top")
    left.text(0.06, q, "Q", va="center")
    left.set(
        aspect="equal", xlim=(-1.15, 1.15), ylim=(-1.15, 1.15), title="P = I + iQ, 4 m, 50 MHz"
    )
    left.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], xlabel="I", ylabel="Q")

    d = np.linspace(0, 9, 1801)
    for frequency in (20e6, 50e6):
        reach = unambiguous_range(frequency)
        found = d % reach
        found[1:][np.diff(found) < 0] = np.nan
        middle.plot(d, found, label=f"{frequency / 1e6:.0f} MHz, c/2f = {reach:.2f} m")
    middle.plot(d, d, ":", color="0.6", zorder=0)
    middle.set(xlabel="distance [m]", ylabel="depth from phase [m]", title="wrapping", ylim=(0, 9))
    middle.legend(fontsize=8.5, loc="upper left")

    truth = 5.0
    for row, (frequency, color) in enumerate(((20e6, "tab:blue"), (50e6, "tab:orange"))):
        reach = unambiguous_range(frequency)
        rungs = np.arange(truth % reach, 15.2, reach)
        right.plot(rungs, np.full(rungs.size, row), "|", ms=28, mew=3, color=color)
        right.plot(rungs[:1], [row], "o", color=color, ms=7)
    right.axvline(truth, color="0.5", ls=":")
    right.set(yticks=[0, 1], yticklabels=["20 MHz", "50 MHz"], ylim=(-0.7, 1.7), xlim=(0, 15))
    right.set(xlabel="depths that agree with the phase [m]", title="the ladders meet at 5 m only")
    return figure


def phasors():
    """Phase and depth of the Cornell box with a flash at three frequencies."""
    frequencies = [20e6, 50e6, 100e6]
    scene = mi.load_dict(tofrender.cornell_box_flash(width=80, height=80))
    I, Q, *_ = tofrender.render_amcw_phasor(scene, scene.sensors()[0], frequencies, spp=1024)
    seen = np.hypot(I[0], Q[0]).sum(axis=-1) > 0
    figure, axes = plt.subplots(3, 4, figsize=(10, 6.6), layout="constrained")
    for row, f, i, q in zip(axes, frequencies, I, Q, strict=True):
        parts = [each[..., 0] for each in sum_channels(i, q, f)]
        strongest = np.percentile(parts[2], 99)
        limits = ((-strongest, strongest), (-strongest, strongest), (-np.pi, np.pi))
        phase = np.where(seen, parts[3], np.nan)
        maps = (("I", parts[0], "RdBu_r"), ("Q", parts[1], "RdBu_r"), ("phase", phase, "twilight"))
        for ax, (name, image, cmap), (low, high) in zip(row, maps, limits, strict=False):
            shown = picture(ax, image, f"{name}, {f / 1e6:.0f} MHz", cmap=cmap, vmin=low, vmax=high)
            label = "[rad]" if name == "phase" else f"[{RADIANCE}]"
            figure.colorbar(shown, ax=ax, label=label, shrink=0.85)
        depth = np.where(seen, parts[4], np.nan)
        reach = unambiguous_range(f)
        shown = picture(row[3], depth, f"depth, c/2f = {reach:.2f} m", vmin=0, vmax=reach)
        figure.colorbar(shown, ax=row[3], label="[m]", shrink=0.85)
    return figure


def window():
    """What the end of the window does to phasors that are computed from bins."""
    size = 48
    frequencies = [20e6, 50e6, 100e6]
    scene = mi.load_dict(tofrender.cornell_box(width=size, height=size))
    whole = tofrender.render(scene, spp=256, window=(3.0, 27.0), bins=1200, progress=False)
    cube = whole["transient"].values
    reference = [sum_channels(*transient_to_phasor(cube, f, 3.0, 0.02)[:2], f) for f in frequencies]
    stops = np.arange(8.0, 18.01, 0.5)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.3), layout="constrained")
    total = cube.sum()
    walls = whole["steady"].values.max(axis=-1) < 2
    kept = [cube[:, :, : round((stop - 3.0) / 0.02)].sum() / total for stop in stops]
    left.plot(stops, 100 * (1 - np.array(kept)))
    left.set(xlabel="end of the window [m]", ylabel="light outside [%]", yscale="log")
    left.set(ylim=(1e-3, 20), title="what is lost")
    for f, wanted in zip(frequencies, reference, strict=True):
        shift = []
        for stop in stops:
            cut = cube[:, :, : round((stop - 3.0) / 0.02)]
            I, Q, *_ = transient_to_phasor(cut, f, 3.0, 0.02)
            change = np.angle((I + 1j * Q).sum(axis=-1) / (wanted[0] + 1j * wanted[1])[..., 0])
            shift.append(1000 * np.median(change[walls]) * SPEED_OF_LIGHT / (4 * np.pi * f))
        right.plot(stops, shift, label=f"{f / 1e6:.0f} MHz")
    right.axhline(0, color="0.6", lw=0.8)
    right.set(xlabel="end of the window [m]", ylabel="median change of\nhalf the path length [mm]")
    right.set_title("what it does to depth")
    right.legend()
    for ax in (left, right):
        ax.axvline(9.5, color="0.6", ls=":")
    left.text(9.65, 3e-3, "the scene's own\nwindow", color="0.4")
    return figure


def confocal(described, **options):
    """Laser and camera along the same ray."""
    chosen = {"type": "confocal_transient_path", "account_first_and_last_bounces": False}
    return described | {"integrator": chosen | options}


def confocal_setting():
    """The device, the wall, the hidden letter, and when which paths arrive."""
    described = tofrender.nlos_z(
        width=1, height=1, start_opl=0.0, temporal_bins=600, bin_width_opl=0.012
    )
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11, 4.0), width_ratios=(1, 1.35), layout="constrained"
    )
    left.plot([-1, 1], [0, 0], color="#1f6fb4", lw=4)
    left.plot([-0.4, 0.4], [1, 1], color="#d1495b", lw=4)
    left.plot([-0.5, -0.44], [0.34, 0.34], color="0.2", lw=4)
    left.plot(-0.5, 0.25, "^", color="#2a9d63", ms=10)
    hidden = np.array([0.15, 1.0])
    left.annotate(
        "", (0.0, 0.0), (-0.5, 0.25), arrowprops={"arrowstyle": "<|-|>", "color": "#e07b00"}
    )
    left.annotate("", hidden, (0, 0), arrowprops={"arrowstyle": "<|-|>", "color": "#d1495b"})
    left.text(-0.32, 0.05, "d", color="#e07b00")
    left.text(0.12, 0.5, "r", color="#d1495b")
    for x, z, text in (
        (-0.95, -0.1, "relay wall"),
        (-0.4, 1.06, "hidden scene"),
        (-0.4, 0.33, "occluder"),
        (-0.98, 0.3, "laser and\nsensor"),
        (0.05, -0.1, "lit point p"),
    ):
        left.text(x, z, text)
    left.set(xlim=(-1.05, 1.05), ylim=(-0.2, 1.25), aspect="equal", xlabel="x [m]", ylabel="z [m]")
    left.set_xticks([-1, -0.5, 0, 0.5, 1])
    left.set_title("all on the same side of the wall")

    settings = {
        "everything": ({}, "0.75", 5),
        "hidden bounce only": ({"use_nlos_only": True}, "tab:blue", 1.4),
        "five bounces": ({"filter_bounces": 5}, "tab:orange", 1.2),
    }
    for name, (options, color, line) in settings.items():
        spot = {"spot_sigma": 0.005, "account_first_and_last_bounces": True}
        captured = tofrender.capture(
            confocal(described, **spot | options), spp=1 << 16, progress=False
        )
        light = captured["transient"].values[0, 0, :, 0]
        opl = captured["opl"].values
        light = np.where(light > 0, light, 1e-12)
        right.step(opl, light, where="mid", color=color, lw=line, label=name)
    d = float(np.hypot(0.5, 0.25))
    for where, text in ((2 * d, "2d"), (2 * d + 2, "2d + 2r")):
        right.axvline(where, color="0.5", ls=":")
        right.text(where + 0.06, 3e4, text)
    right.set(yscale="log", xlim=(0, 7), ylim=(1e-10, 3e5), xlabel="optical path length [m]")
    right.set_ylabel(f"radiance per bin [{RADIANCE}]")
    right.legend(loc="upper right", bbox_to_anchor=(1, 0.9))
    return figure


def cones():
    """What a line of wall points sees of a small patch, and of a sphere."""
    film = {"width": 96, "height": 1, "temporal_bins": 120, "bin_width_opl": 0.012}
    patch = tofrender.nlos_patch(position=(0.3, 0.0, 1.0), tilt=0, side=0.03, start_opl=1.4, **film)
    ball = {
        k: v for k, v in tofrender.nlos_patch(start_opl=1.4, **film).items() if k != "hidden_patch"
    }
    material = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.7}}
    ball["hidden_ball"] = {
        "type": "sphere",
        "center": [0.1, 0, 1.0],
        "radius": 0.25,
        "bsdf": material,
    }
    x = -1 + (np.arange(96) + 0.5) * 2 / 96
    curves = {
        "a patch of 3 cm at (0.3, 0, 1) m": (patch, 2 * np.hypot(x - 0.3, 1.0), 256),
        "a sphere of radius 0.25 m at (0.1, 0, 1) m": (
            ball,
            2 * (np.hypot(x - 0.1, 1.0) - 0.25),
            4096,
        ),
    }
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.2), sharey=True, layout="constrained")
    for ax, (name, (described, line, spp)) in zip(axes, curves.items(), strict=True):
        described = confocal(described, filter_bounces=3)
        captured = tofrender.capture(described, spp=spp, progress=False)
        image = captured["transient"].values[0, :, :, 0].T
        start = 1.4
        stop = 1.4 + 120 * 0.012
        shown = ax.imshow(
            1e6 * image,
            origin="lower",
            aspect="auto",
            cmap="magma",
            norm=PowerNorm(0.4, vmin=0, vmax=1e6 * image.max()),
            extent=(-1, 1, start, stop),
        )
        ax.plot(x, line, ls=(0, (4, 8)), color="cyan", lw=1.2, label="first arrival, by formula")
        ax.set(title=name, xlabel="point of the wall, x [m]", ylim=(start, stop))
        ax.set_xticks(np.arange(-1, 1.1, 0.5))
        legend = ax.legend(loc="lower left")
        legend.get_texts()[0].set_color("white")
        figure.colorbar(shown, ax=ax, label=f"radiance per bin [10$^{{-6}}$ {RADIANCE}]")
    axes[0].set_ylabel("optical path length,\nwall to wall [m]")
    return figure


FIGURES: list[Callable] = [
    pulse_and_bins,
    wavefronts,
    steady_and_sum,
    wrapping,
    phasors,
    window,
    confocal_setting,
    cones,
]

if __name__ == "__main__":
    for make in FIGURES:
        if sys.argv[1:] and make.__name__ not in sys.argv[1:]:
            continue
        figure = make()
        figure.savefig(HERE / f"{make.__name__}.png", bbox_inches="tight")
        plt.close(figure)
        print(f"{make.__name__}.png")
