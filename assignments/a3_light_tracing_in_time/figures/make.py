"""Make all figures of the handout: `python figures/make.py [NAME ...]`, about two minutes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tofrender

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "tests"))
SIZE = 112  # pixels of the pictures

plt.rcParams.update({"figure.dpi": 110, "font.size": 10, "axes.spines.top": False})
plt.rcParams.update({"axes.spines.right": False, "legend.frameon": False})


def picture(ax, image, title="", **options):
    """An image without axes."""
    ax.imshow(tofrender.tonemap(image, **options), interpolation="nearest")
    ax.set_title(title)
    ax.set_axis_off()


def rendered(kind, spp, depth=6, **options):
    """The scene `caustic` by an integrator in time."""
    return tofrender.render(
        tofrender.load_scene("caustic", width=SIZE, height=SIZE),
        integrator={"type": kind, "max_depth": depth, **options},
        spp=spp,
        window=(4.2, 12.2),
        temporal_bins=200,
        progress=False,
    )


def flight():
    """A caustic at four instants, and two integrators."""
    film = rendered("transient_bdpt", 512)
    figure = plt.figure(figsize=(10, 7.4), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=(1, 1.7))
    for ax, opl in zip(top.subplots(1, 4), (5.2, 5.5, 5.75, 6.3), strict=True):
        k = int((opl - 4.2) / 0.04)
        title = f"{opl:.2f} m = {tofrender.opl_to_ns(opl):.1f} ns"
        picture(ax, film["transient"].values[:, :, k], title, exposure=8)
    left, right = bottom.subplots(1, 2)
    few = rendered("transient_path", 64)["steady"].values
    picture(left, few, "path tracer, 64 paths per pixel", exposure=0.8)
    few = rendered("transient_bdpt", 64)["steady"].values
    picture(right, few, "all strategies, 64 paths per pixel", exposure=0.8)
    return figure


def window():
    """The window at distance 1, and what becomes of the density."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    half = np.tan(np.radians(20))
    left.plot([0, 1, 1, 0], [0, half, -half, 0], color="0.3")
    left.plot([1, 1], [-half, half], color="tab:blue", lw=4)
    left.annotate("window, area A", (1.03, 0.2), color="tab:blue")
    left.plot([0, 1.6], [0, 0], color="0.6", lw=0.8, ls="--")
    left.annotate("axis", (1.45, 0.03), color="0.4")
    for share in np.linspace(-0.75, 0.75, 4):
        left.plot([0, 1.4], [0, 1.4 * share * half], color="tab:orange", lw=1)
    left.annotate("1 / cos θ", (0.4, 0.24), color="tab:orange", rotation=12)
    left.plot(0, 0, "o", color="black")
    left.annotate("pinhole", (-0.02, -0.12))
    left.set(xlim=(-0.1, 1.9), ylim=(-0.6, 0.6), xticks=(), yticks=(), aspect="equal")
    left.set_title("rays that are even on the film")
    for spine in left.spines.values():
        spine.set_visible(False)
    θ = np.linspace(0, 60, 200)
    cos = np.cos(np.radians(θ))
    right.plot(θ, 1 / cos**3, label="density p, times A")
    right.plot(θ, 1 / cos**4, label="importance We, times A")
    right.set(xlabel="angle to the axis [degrees]", ylim=(0, 10))
    right.legend()
    return figure


def slab():
    """The caustic of the test in time."""
    import formulas

    view = formulas.View((0, 0, 0.45), (0, 0, 0), fov=120.0)
    part, opl = formulas.through_slab(view, 0.5, 0.8, 1.8, 1.0, count=1 << 20)
    figure, ax = plt.subplots(figsize=(8, 3.2), layout="constrained")
    for width, label in ((0.2, "bins of the test"), (0.01, "narrow bins")):
        edges = 2.2 + width * np.arange(round(2 / width) + 1)
        density = np.histogram(opl, edges, weights=part)[0] / width
        ax.stairs(density, edges, label=label)
    ax.axvline(2.4, color="0.6", ls=":", label="straight down")
    ax.set(xlabel="optical path length [m]", xlim=(2.2, 4.2))
    ax.set_ylabel("film's mean per meter")
    ax.legend()
    return figure


def strategies():
    """Strategies of four segments, alone and shared."""
    described = tofrender.caustic(width=SIZE // 2, height=SIZE // 2)
    pyramid = tofrender.strategy_pyramid(
        described, max_depth=4, spp=256, window=(4.2, 12.2), bins=1, progress=False
    )
    figure, axes = plt.subplots(2, 5, figsize=(11, 4.9), layout="constrained")
    for row, weighting in zip(axes, ("none", "mis"), strict=True):
        for s, ax in enumerate(row):
            image = pyramid["steady"].sel(weighting=weighting, strategy=f"{s},{5 - s}").values
            picture(ax, image, f"({s}, {5 - s})", exposure=3)
    return figure


FIGURES: dict[str, Callable] = {f.__name__: f for f in (flight, window, slab, strategies)}


def main(names: list[str]) -> None:
    """Write the figures of these names, all if there are none."""
    for name in names or FIGURES:
        FIGURES[name]().savefig(HERE / f"{name}.png", bbox_inches="tight")
        print(f"wrote {name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
