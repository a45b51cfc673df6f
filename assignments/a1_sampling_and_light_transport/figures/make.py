"""Make all figures of the handout: `python figures/make.py [NAME ...]`, about two minutes.

It also makes `references.npz`, small pictures that the notebook compares its own with.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import drjit as dr
import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

import tofrender
from tofrender.sampling import (
    HierarchicalWarp,
    Quad,
    Sphere,
    SurfaceGroup,
    chi_square_test,
    independent,
    square_to_beckmann,
    square_to_beckmann_pdf,
    square_to_tent,
    square_to_uniform_disk,
    stratified,
)

HERE = Path(__file__).parent
STRATEGIES = {"mats": "material sampling", "nee": "light sampling", "mis": "both (MIS)"}

plt.rcParams.update({"figure.dpi": 100, "font.size": 10, "axes.spines.top": False})
plt.rcParams.update({"axes.spines.right": False, "legend.frameon": False})


def picture(ax, image, title="", **options):
    """An image without axes."""
    shown = ax.imshow(image, interpolation="nearest", **options)
    ax.set_title(title)
    ax.set_axis_off()
    return shown


def inversion():
    """Inversion in one dimension, and what a warp does with the grid of the square."""
    figure, (density, cdf, grid, disk) = plt.subplots(
        1, 4, figsize=(13, 3.3), width_ratios=(1, 1, 1, 1), layout="constrained"
    )
    t = np.linspace(-1, 1, 401)
    density.plot(t, 1 - np.abs(t))
    density.set(title="density p₁", xlabel="t", ylabel="p₁(t)")
    distribution = np.where(t < 0, 0.5 * (1 + t) ** 2, 1 - 0.5 * (1 - t) ** 2)
    cdf.plot(t, distribution)
    u = (np.arange(12) + 0.5) / 12
    where = np.where(u < 0.5, np.sqrt(2 * u) - 1, 1 - np.sqrt(2 - 2 * u))
    for one, there in zip(u, where, strict=True):
        cdf.plot([-1, there, there], [one, one, 0], color="tab:orange", linewidth=0.7)
    cdf.plot(where, 0 * where, "o", color="tab:orange", markersize=4, clip_on=False)
    cdf.set(title="its integral P₁, read backwards", xlabel="t", ylabel="u = P₁(t)")
    cdf.set(xlim=(-1, 1), ylim=(0, 1))
    fine = np.linspace(0, 1 - 1e-6, 200)
    for ax, warp in ((grid, square_to_tent), (disk, square_to_uniform_disk)):
        for value in np.minimum(np.linspace(0, 1, 11), 1 - 1e-6):
            for uv in ((fine, np.full(200, value)), (np.full(200, value), fine)):
                ax.plot(*np.array(warp(mi.Point2f(*uv))), color="0.7", linewidth=0.8)
        ax.scatter(*np.array(warp(stratified(100))), s=9)
        ax.set(aspect="equal", xlabel="x", ylabel="y")
    grid.set_title("a 10 x 10 grid in the tent")
    disk.set_title("the same on the disk")
    return figure


def chi_square():
    """What a test says of a density that lacks a cosine, and of the right one."""

    def warp(sample):
        return square_to_beckmann(sample, 0.5)

    def right(m):
        return square_to_beckmann_pdf(m, 0.5)

    figure, axes = plt.subplots(1, 3, figsize=(13, 3.5), layout="constrained")
    theta = np.linspace(0, np.pi / 2 - 1e-4, 300)
    m = mi.Vector3f(np.sin(theta), 0, np.cos(theta))
    ring = 2 * np.pi * np.sin(theta) * np.pi / 180
    points = np.array(warp(independent(200_000)))
    angle = np.degrees(np.arctan2(np.hypot(*points[:2]), points[2]))
    axes[0].hist(angle, bins=90, range=(0, 90), density=True, color="0.85", label="points")
    axes[0].plot(np.degrees(theta), ring * np.array(right(m)), label="with cos³θ below")
    wrong = np.array(right(m)) / np.cos(theta)
    axes[0].plot(np.degrees(theta), ring * wrong, label="with cos⁴θ below")
    axes[0].set(xlabel="θ [degrees]", ylabel="density [1/degree]", title="Beckmann, α = 0.5")
    axes[0].legend()
    for ax, (name, pdf) in zip(
        axes[1:], {"cos³θ": right, "cos⁴θ": lambda m: right(m) / m.z}.items(), strict=True
    ):
        verdict = chi_square_test(warp, pdf, "hemisphere", samples=300_000, resolution=40)
        side = verdict.figure().axes[2]
        mesh = side.collections[0]
        values = mesh.get_array()
        edges = mesh.get_coordinates()
        shown = ax.pcolormesh(edges[..., 0], edges[..., 1], values, cmap="RdBu_r", vmin=-5, vmax=5)
        ax.set(xlabel=side.get_xlabel(), ylabel=side.get_ylabel())
        ax.set_title(f"{name}: {'passed' if verdict.passed else 'failed'}")
    figure.colorbar(shown, ax=axes[1:], label="(observed - expected) / √expected")
    return figure


def beckmann():
    """The density of normals for four roughnesses, and the normals of one of them."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.4), width_ratios=(1.3, 1, 1))
    theta = np.linspace(0, np.pi / 2 - 1e-4, 400)
    m = mi.Vector3f(np.sin(theta), 0, np.cos(theta))
    for alpha in (0.1, 0.3, 0.5, 1.0):
        density = np.array(square_to_beckmann_pdf(m, alpha))
        axes[0].plot(np.degrees(theta), density, label=f"α = {alpha}")
    axes[0].set(xlabel="θ [degrees]", ylabel="density [1/sr]", yscale="log", ylim=(1e-3, 50))
    axes[0].legend()
    for ax, alpha in zip(axes[1:], (0.1, 0.5), strict=True):
        x, y, _ = np.array(square_to_beckmann(stratified(1600), alpha))
        ax.scatter(x, y, s=2)
        ax.add_patch(plt.Circle((0, 0), 1, fill=False, color="0.6"))
        ax.set(title=f"normals from above, α = {alpha}", aspect="equal", xlabel="x", ylabel="y")
        ax.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05))
    figure.tight_layout()
    return figure


def bust():
    """A point light, and ambient occlusion."""
    figure, axes = plt.subplots(1, 2, figsize=(7.4, 5), layout="constrained")
    for ax, (name, spp) in zip(axes, {"simple": 16, "ao": 256}.items(), strict=True):
        scene = tofrender.load_scene(f"bust_{name}", width=240, height=320)
        picture(ax, tofrender.tonemap(np.array(mi.render(scene, spp=spp)), exposure=1), name)
    return figure


def lights():
    """Densities of directions towards three lights."""
    turned = mi.ScalarTransform4f().translate([-0.4, 0.15, -1.6]).rotate([0, 1, 0], 65)
    panel = Quad((1.2, 0.9), emission=1, transform=turned)
    ball = Sphere((0.55, -0.1, -1.8), 0.6, emission=1)
    shapes = {
        "a quad: uniform by area": panel,
        "a sphere: uniform by solid angle": ball,
        "both as a group": SurfaceGroup([panel, ball]),
    }
    x, y = np.meshgrid(np.linspace(-1, 1, 240), np.linspace(-1, 1, 240))
    view = dr.normalize(mi.Vector3f(x.ravel(), y.ravel(), -1))
    origin = mi.Point3f(0, 0, 0)
    figure, axes = plt.subplots(1, 3, figsize=(12.5, 3.6), layout="compressed")
    for ax, (name, light) in zip(axes, shapes.items(), strict=True):
        density = np.array(light.pdf(origin, view)).reshape(x.shape)
        shown = ax.imshow(density, extent=(-1, 1, -1, 1), origin="lower")
        d = np.array(light.sample(origin, stratified(256)).d)
        ax.scatter(d[0] / -d[2], d[1] / -d[2], s=2, color="tab:red")
        ax.set(title=name, xlabel="x / -z", ylabel="y / -z", xlim=(-1, 1), ylim=(-1, 1))
        figure.colorbar(shown, ax=ax, label="density [1/sr]")
    return figure


def veach():
    """Veach's plates by three path tracers with the same number of paths."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.2), layout="constrained")
    for ax, (name, title) in zip(axes, STRATEGIES.items(), strict=True):
        described = tofrender.veach(width=270, height=180, integrator=f"path_tracer_{name}")
        described["sensor"]["sampler"] = {"type": "independent"}
        image = np.array(mi.render(mi.load_dict(described), spp=16))
        picture(ax, tofrender.tonemap(image, exposure=1.2), title)
    return figure


def equal_lights():
    """Sphere lights of one power: the same picture, other times."""
    radii = {"small": 0.03, "medium": 0.3, "large": 0.9}
    figure, axes = plt.subplots(
        1, 4, figsize=(13.5, 3), width_ratios=(1, 1, 1, 1.3), layout="constrained"
    )
    for ax, (size, radius) in zip(axes, radii.items(), strict=False):
        described = getattr(tofrender, f"sphere_light_{size}")(width=192, height=128)
        dataset = tofrender.render(described, spp=128, window=(5, 11), bins=300, progress=False)
        steady = dataset["steady"].values
        picture(ax, tofrender.tonemap(steady, exposure=1), f"r = {radius} m")
        ax.plot(96, 16, "o", color="tab:red", markersize=5)
        response = dataset["transient"].values[14:19, 90:103, :, 1].mean(axis=(0, 1))
        axes[3].step(dataset["opl"], response, where="mid", label=f"r = {radius} m")
    axes[3].set(xlabel="optical path length [m]", ylabel="radiance per bin", xlim=(7.2, 9))
    axes[3].set_title("when it arrives at the dot")
    axes[3].legend()
    return figure


def small_box():
    """Direct light, all light, and what only materials find."""
    kinds = {
        "direct light": {"max_bounces": 1},
        "eight bounces": {"max_bounces": 8},
        "mirror and glass, eight bounces": {"max_bounces": 8, "spheres": "mirror_glass"},
    }
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.9), layout="constrained")
    for ax, (title, options) in zip(axes, kinds.items(), strict=True):
        scene = tofrender.load_scene(tofrender.small_box(width=200, height=200, **options))
        image = np.array(mi.render(scene, spp=256))
        picture(ax, tofrender.tonemap(image, exposure=1.2), title)
    return figure


def hierarchical():
    """Points on their way down the mip map of a picture."""
    n = 128
    scene = tofrender.load_scene("bust_simple", width=n, height=n)
    image = np.array(mi.render(scene, spp=64)).mean(axis=-1)
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.5), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.12)
    picture(axes[0], image**0.45, "the image", cmap="gray", extent=(0, 1, 1, 0))
    for ax, m in zip(axes[1:], (2, 8, n), strict=True):
        blocks = image.reshape(m, n // m, m, n // m).mean(axis=(1, 3))
        ax.scatter(*np.array(HierarchicalWarp(blocks).sample(stratified(4096))), s=0.5, c="black")
        ax.set(title=f"points of {m} x {m} sums", xlim=(0, 1), ylim=(1, 0), aspect="equal")
        ax.set(xticks=(), yticks=())
    return figure


def references():
    """Small pictures of the right answers, for the notebook."""
    described = {
        "simple": (tofrender.bust_simple(width=48, height=64), 256),
        "ao": (tofrender.bust_ao(width=48, height=64), 1024),
        "veach": (tofrender.veach(width=96, height=64), 4096),
        "small_box": (tofrender.small_box(width=64, height=64, max_bounces=4), 2048),
    }
    images = {
        name: np.array(mi.render(mi.load_dict(scene), spp=spp)).astype(np.float16)
        for name, (scene, spp) in described.items()
    }
    np.savez_compressed(HERE / "references.npz", **images)


FIGURES: dict[str, Callable] = {
    each.__name__: each
    for each in (
        inversion, chi_square, beckmann, bust, lights, veach, equal_lights, small_box,
        hierarchical, references,
    )
}  # fmt: skip


def main(names: list[str]) -> None:
    """Make the named figures, or all."""
    for name in names or FIGURES:
        figure = FIGURES[name]()
        if figure is None:
            continue
        path = HERE / f"{name}.png"
        figure.savefig(path)
        plt.close(figure)
        from PIL import Image

        with Image.open(path) as image:
            image.convert("RGB").quantize(256).save(path, optimize=True)
        print(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main(sys.argv[1:])
