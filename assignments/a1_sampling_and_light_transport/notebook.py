# %% [markdown]
# # A1: sampling and light transport
#
# **Overview.** You warp uniform random numbers to points, normals and directions of a given
# density, sample directions toward lights, and write three path tracers that render the same
# picture with very different noise. For each problem, this notebook has a cell that contains its
# file, and a cell that runs it and draws pictures. The [handout](README.md) explains the theory and
# specifies each function.
#
# **What you will learn**
# - how to derive a warp from a density, and which errors a chi-square test detects and misses
# - how to sample triangles, cones of directions, and whole groups of lights
# - what ambient occlusion and direct light are as integrals
# - where BSDF sampling and light sampling have low noise, and how MIS combines them
#
# **How to work.** Fill in a cell that starts with `%%solution`, run it (it writes the file), run
# the cell below it, and then the problem's tests in a terminal: `pytest -m a1_tent`. First run
# the cells of "Set-up" and the cells of earlier problems, because their functions are used again.
# Cells that need an unsolved problem end with `NotImplementedError`, or with a `RuntimeError` of
# Mitsuba ("failed to instantiate unknown plugin", "error while performing a custom differentiable
# operation (see above)"); `NotImplementedError` and the problem's name are then further up in the
# output. You may also edit the files in an editor; then skip the cells that start with
# `%%solution` (a cell that still contains its stub does not overwrite a changed file).

# %% [markdown]
# ## Set-up

# %%
# %load_ext tofrender.course.student

# %%
import os
import time
from pathlib import Path

import drjit as dr
import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

import tofrender
from tofrender.sampling import chi_square_test, independent, stratified

SMALL = os.environ.get("TOFRENDER_NOTEBOOK_SIZE") == "small"  # for automatic tests
SAMPLES, CELLS = (50_000, 51) if SMALL else (1_000_000, 101)  # of a chi-square test, rows of cells
SIDE = 64 if SMALL else 192  # pixels along the side of pictures
SEEDS = 16  # renders for a measurement of noise; do not use fewer
SPP = 16 if SMALL else 64  # samples per pixel of each of them

deliverables = Path("deliverables")
deliverables.mkdir(exist_ok=True)
figures = Path("figures")
references = np.load(figures / "references.npz") if (figures / "references.npz").exists() else {}


def show(figure, name):
    """Save a figure for handing in, and show it."""
    figure.savefig(deliverables / f"{name}.png", dpi=80)
    plt.show()


def chi_square(sample, pdf, domain, name, **options):
    """A chi-square test, and its picture for handing in."""
    options = {"samples": SAMPLES, "resolution": CELLS, "name": name} | options
    verdict = chi_square_test(sample, pdf, domain, **options)
    verdict.figure().savefig(deliverables / f"chi_square_{name}.png", dpi=130)
    print(verdict)
    return verdict


def compare(image, name, exposure):
    """A picture, the reference, and their difference, red where the picture is brighter."""
    if name not in references:
        print(f"no reference for {name}")
        return
    wanted = references[name].astype(np.float32)
    factor = image.shape[0] // wanted.shape[0]
    blocks = image.reshape(wanted.shape[0], factor, wanted.shape[1], factor, 3).mean(axis=(1, 3))
    figure, axes = plt.subplots(1, 3, figsize=(11, 4.2), layout="constrained")
    axes[0].imshow(tofrender.tonemap(image, exposure=exposure))
    axes[1].imshow(tofrender.tonemap(wanted, exposure=exposure))
    difference = (blocks - wanted).mean(axis=-1) / wanted.mean()
    limit = 0.2
    shown = axes[2].imshow(difference, cmap="RdBu_r", vmin=-limit, vmax=limit)
    figure.colorbar(shown, ax=axes[2], label="part of the mean", shrink=0.7)
    for ax, title in zip(axes, (name, "reference", "difference"), strict=True):
        ax.set_title(title)
        ax.set_axis_off()
    show(figure, f"compare_{name}")
    print(f"{name}: mean {image.mean():.4f}, reference {wanted.mean():.4f}")


# %% [markdown]
# ## 1. Tent distribution
# $p(x, y) = p_1(x)\,p_1(y)$ with $p_1(t) = 1 - |t|$ on $[-1, 1]$.
#
# **Your derivation of the warp.** *(Replace this line: the distribution function $P_1(t)$, its
# inverse, and the resulting warp.)*

# %% [solution] tent.py

# %% [markdown]
# Stratified points and their warp. The histogram of one coordinate of many points should agree with
# the density along the axis.

# %%
from tent import square_to_tent, square_to_tent_pdf

t = np.linspace(-1.2, 1.2, 241)
figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
axes[0].scatter(*np.array(stratified(1024)), s=4)
axes[0].set(title="points of the square", xlabel="u", ylabel="v", aspect="equal")
axes[1].scatter(*np.array(square_to_tent(stratified(1024))), s=4)
axes[1].set(title="their warp", xlabel="x", ylabel="y", aspect="equal")
x = np.array(square_to_tent(independent(100_000)))[0]
axes[2].hist(x, bins=60, density=True, color="0.8", label="points")
axes[2].plot(t, np.array(square_to_tent_pdf(mi.Point2f(t, 0))), label="density at y = 0")
axes[2].set(xlabel="x", ylabel="density")
axes[2].legend(frameon=False)
plt.show()

tent_verdict = chi_square(square_to_tent, square_to_tent_pdf, "plane", "tent")
tent_verdict.figure()

# %% [markdown]
# Passing is not a proof: a warp and a density that are wrong in the same way agree with each other.
# An independently known moment reveals this: for the tent, the mean of $x^2$ is 1/6.

# %%
tent_moments = chi_square_test(
    square_to_tent,
    square_to_tent_pdf,
    "plane",
    samples=SAMPLES,
    expected_moments={"x": 0, "xx": 1 / 6, "yy": 1 / 6},
)
print(tent_moments)

# %% [markdown]
# ## 2. Disk, sphere, hemispheres

# %% [solution] disk.py

# %%
from disk import square_to_uniform_disk, square_to_uniform_disk_pdf

disk_verdict = chi_square(square_to_uniform_disk, square_to_uniform_disk_pdf, "disk", "disk")

lines = np.linspace(0, 1, 9)
fine = np.linspace(0, 1 - 1e-6, 200)
figure, axes = plt.subplots(1, 2, figsize=(8.5, 4.2), layout="constrained")
for ax, warp in zip(axes, (lambda sample: sample, square_to_uniform_disk), strict=True):
    for value in np.minimum(lines, 1 - 1e-6):
        for u, v in ((fine, np.full(200, value)), (np.full(200, value), fine)):
            ax.plot(*np.array(warp(mi.Point2f(u, v))), color="0.75", linewidth=0.8)
    ax.scatter(*np.array(warp(stratified(64))), s=10)
    ax.set(xlabel="x", ylabel="y", aspect="equal")
axes[0].set_title("a grid of the square, one point in each cell")
axes[1].set_title("its warp: all cells still have one area")
plt.show()

# %% [solution] sphere_and_hemispheres.py

# %%
from sphere_and_hemispheres import (
    square_to_cosine_hemisphere,
    square_to_cosine_hemisphere_pdf,
    square_to_uniform_hemisphere,
    square_to_uniform_hemisphere_pdf,
    square_to_uniform_sphere,
    square_to_uniform_sphere_pdf,
)

on_sphere = {  # warp, density, domain, mean of z
    "uniform_sphere": (square_to_uniform_sphere, square_to_uniform_sphere_pdf, "sphere", 0),
    "uniform_hemisphere": (
        square_to_uniform_hemisphere,
        square_to_uniform_hemisphere_pdf,
        "hemisphere",
        1 / 2,
    ),
    "cosine_hemisphere": (
        square_to_cosine_hemisphere,
        square_to_cosine_hemisphere_pdf,
        "hemisphere",
        2 / 3,
    ),
}
for name, (warp, pdf, domain, mean_z) in on_sphere.items():
    chi_square(warp, pdf, domain, name, expected_moments={"z": mean_z})

figure, axes = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
for ax, (name, (warp, *_)) in zip(axes, on_sphere.items(), strict=True):
    x, y, z = np.array(warp(stratified(1024)))
    ax.scatter(x, y, s=4, c=np.where(z < 0, "tab:orange", "tab:blue"))
    ax.set(title=f"{name}, from above", xlabel="x", ylabel="y", aspect="equal")
plt.show()

# %% [markdown]
# ## 3. Beckmann distribution of normals
# $$p(m) = \frac{e^{-\tan^2\theta/\alpha^2}}{\pi\alpha^2\cos^3\theta}.$$
#
# **Your derivation of the warp.** *(Replace this line: the density of $\theta$, the substitution,
# the distribution function and its inverse.)*

# %% [solution] beckmann.py

# %%
from beckmann import square_to_beckmann, square_to_beckmann_pdf

theta = np.linspace(0, np.pi / 2, 400)
in_plane = mi.Vector3f(np.sin(theta), 0, np.cos(theta))
figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for alpha in (0.1, 0.3, 0.5, 1.0):
    density = np.array(square_to_beckmann_pdf(in_plane, alpha))
    axes[0].plot(np.degrees(theta), density, label=f"α = {alpha}")
    m = np.array(square_to_beckmann(independent(100_000), alpha))
    angle = np.degrees(np.arctan2(np.hypot(m[0], m[1]), m[2]))
    ring = 2 * np.pi * np.sin(theta) * np.pi / 180  # solid angle of a ring, per degree
    (line,) = axes[1].plot(np.degrees(theta), ring * density)
    axes[1].hist(angle, bins=90, range=(0, 90), density=True, alpha=0.3, color=line.get_color())
axes[0].set(title="density", xlabel="θ [degrees]", ylabel="density [1/sr]", ylim=(0, 8))
axes[1].set(title="angles of points", xlabel="θ [degrees]", ylabel="density [1/degree]")
axes[1].set_ylim(0, 0.16)
axes[0].legend(frameon=False)
show(figure, "beckmann")

for alpha in (0.1, 0.3, 1.0):
    chi_square(
        lambda sample, alpha=alpha: square_to_beckmann(sample, alpha),
        lambda m, alpha=alpha: square_to_beckmann_pdf(m, alpha),
        "hemisphere",
        f"beckmann_{alpha}",
    )

# %% [markdown]
# A facet with the normal $m$ covers a ground area of $\cos\theta$ times its own area, and these
# projected areas add up to the area of the ground. The density above refers to projected area.
# $D(m)$ of many books, with $\cos^4\theta$ in the denominator, refers to facet area, and is not a
# density of directions. **Which result does the chi-square test give for $D(m)$?** Try it.

# %% [markdown]
# ## 4. Point light integrator

# %% [solution] simple.py

# %%
from simple import Simple

bust = tofrender.bust_simple(width=3 * SIDE // 4, height=SIDE)
scene = mi.load_dict(bust)
assert isinstance(scene.integrator(), Simple)  # it is yours that renders
image = np.array(mi.render(scene, spp=16))
np.savez_compressed(deliverables / "simple.npz", image=image)
compare(image, "simple", 1.0)

# %% [markdown]
# ## 5. Ambient occlusion

# %% [solution] ao.py

# %%
from ao import AmbientOcclusion

bust = tofrender.bust_ao(width=3 * SIDE // 4, height=SIDE)
scene = mi.load_dict(bust)
assert isinstance(scene.integrator(), AmbientOcclusion)
image = np.array(mi.render(scene, spp=64 if SMALL else 256))
np.savez_compressed(deliverables / "ao.npz", image=image)
compare(image, "ao", 1.0)
print(f"from {image.min():.2f} to {image.max():.2f}")

# %% [markdown]
# With cosine-weighted directions, a sample is 1 if its ray reaches the sky and 0 if not, so its
# variance is $L(1 - L)$. Compare with the measured variance.

# %%
small = mi.load_dict(tofrender.bust_ao(width=48, height=64))
renders = np.array([mi.render(small, spp=16, seed=k) for k in range(SEEDS)])[..., 1]
openness = renders.mean(axis=0)
measured = 16 * renders.var(axis=0, ddof=1)
figure, ax = plt.subplots(figsize=(5.5, 4), layout="constrained")
ax.scatter(openness, measured, s=2, label="pixels")
level = np.linspace(0, 1, 100)
ax.plot(level, level * (1 - level), color="black", label="$L(1 - L)$")
ax.set(xlabel="ambient occlusion L", ylabel="variance of a sample")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# The pixels are near the curve or below it: the scene's sampler distributes the 16 samples of a pixel
# more evenly than `independent` does. Change the `sampler` of `small` and compare.
#
# ## 6. Triangles and caps

# %% [solution] triangles_and_caps.py

# %%
from triangles_and_caps import (
    sample_sphere_cap,
    sample_sphere_cap_pdf,
    sample_triangle,
    sample_triangle_pdf,
)

CORNERS = ((0, 0, 0), (1, 1, 1), (0.5, 1, 2))
COS_MAX = float(np.cos(np.pi / 4))

chi_square(
    lambda sample: sample_sphere_cap(sample, COS_MAX),
    lambda v: sample_sphere_cap_pdf(v, COS_MAX),
    "sphere",
    "sphere_cap",
)
p = np.array(sample_triangle(*CORNERS, independent(SAMPLES)))
print("mean of the triangle's points:", p.mean(axis=1).round(3), "centroid: [0.5, 0.667, 1.0]")
print("density:", sample_triangle_pdf(mi.Point3f(0.5, 2 / 3, 1), *CORNERS)[0], "1 / area: 1.069")

# %% [markdown]
# All point sets for `deliverables/`, from independent random numbers, so that the densities can be
# tested.

# %%
count = 10_000
numbers = independent(count, seed=7)
sets = {
    "tent": square_to_tent(numbers),
    "uniform_disk": square_to_uniform_disk(numbers),
    "uniform_sphere": square_to_uniform_sphere(numbers),
    "uniform_hemisphere": square_to_uniform_hemisphere(numbers),
    "cosine_hemisphere": square_to_cosine_hemisphere(numbers),
    "beckmann": square_to_beckmann(numbers, 0.5),
    "triangle": sample_triangle(*CORNERS, numbers),
    "sphere_cap": sample_sphere_cap(numbers, COS_MAX),
}
sets = {name: np.array(points).T for name, points in sets.items()}
np.savez_compressed(deliverables / "warps.npz", **sets)

figure = plt.figure(figsize=(13, 6.6), layout="constrained")
for k, (name, points) in enumerate(sets.items()):
    points = points[:1500]
    if points.shape[1] == 2:
        ax = figure.add_subplot(2, 4, k + 1)
        ax.set(aspect="equal", xlim=(-1.05, 1.05), ylim=(-1.05, 1.05))
    else:
        ax = figure.add_subplot(2, 4, k + 1, projection="3d")
        ax.set_box_aspect(np.ptp(points, axis=0))
        ax.tick_params(labelsize=7)
    ax.scatter(*points.T, s=1.5)
    ax.set_title(name)
show(figure, "warps")

# %% [markdown]
# ## 7. Area lights

# %% [solution] lights.py

# %%
from lights import Sphere, SurfaceGroup, Triangle

panel = Triangle((-0.9, -0.4, -1.2), (0.1, -0.6, -2.2), (-0.5, 0.8, -1.8), emission=1)
ball = Sphere((0.55, 0.1, -1.8), 0.55, emission=1)
lights = {"Triangle": panel, "Sphere": ball, "SurfaceGroup": SurfaceGroup([panel, ball])}

x, y = np.meshgrid(np.linspace(-1, 1, 160), np.linspace(-1, 1, 160))
view = dr.normalize(mi.Vector3f(x.ravel(), y.ravel(), -1))
origin = mi.Point3f(0, 0, 0)
figure, axes = plt.subplots(1, 3, figsize=(14, 3.9), layout="compressed")
for ax, (name, light) in zip(axes, lights.items(), strict=True):
    density = np.array(light.pdf(origin, view)).reshape(x.shape)
    shown = ax.imshow(density, extent=(-1, 1, -1, 1), origin="lower", cmap="viridis")
    d = np.array(light.sample(origin, stratified(256)).d)
    ax.scatter(d[0] / -d[2], d[1] / -d[2], s=2, color="tab:red")
    ax.set(title=name, xlabel="x / -z", ylabel="y / -z", xlim=(-1, 1), ylim=(-1, 1))
    figure.colorbar(shown, ax=ax, label="density [1/sr]")
show(figure, "lights")

# %% [markdown]
# The image shows the density of all directions (`pdf`), the dots are directions drawn by `sample`.
# The chi-square tests below compare the two.

# %%
light_verdicts = {
    name: chi_square(
        lambda sample, light=light: light.sample(mi.Point3f(0, 0, 0), sample).d,
        lambda v, light=light: light.pdf(mi.Point3f(0, 0, 0), v),
        "sphere",
        f"light_{name}",
    )
    for name, light in lights.items()
}

# %% [markdown]
# The mean of `weight` times the cosine is the irradiance. For a sphere above the horizon it is
# $\pi L_e (r/D)^2\cos\theta$, which should also hold at a hundred times the distance.

# %%
for scale in (1, 10, 100):
    far = Sphere((0.3 * scale, 0, scale), 0.4, emission=2)
    record = far.sample(origin, independent(100_000, seed=scale))
    came = float(np.mean(np.array(record.weight)[0] * np.array(record.d)[2]))
    distance = scale * np.hypot(0.3, 1)
    wanted = 2 * np.pi * (0.4 / distance) ** 2 * scale / distance
    print(f"distance {distance:7.2f} m: irradiance {came:.5e}, expected {wanted:.5e}")

# %% [markdown]
# ## 8. Three path tracers
# Each cell registers your integrator as the plugin of that name, so that your code renders the
# built-in scenes.

# %% [solution] path_tracer_mats.py

# %% [solution] path_tracer_nee.py

# %% [solution] path_tracer_mis.py

# %%
from path_tracer_mats import PathTracerMats
from path_tracer_mis import PathTracerMIS
from path_tracer_nee import PathTracerNEE

STRATEGIES = ("mats", "nee", "mis")
PLUGINS = (PathTracerMats, PathTracerNEE, PathTracerMIS)


def render_all(builder, spp=SPP, seeds=SEEDS, **options):
    """Independent renders, shape (seeds, height, width, 3)."""
    described = builder(**options)
    described["sensor"]["sampler"] = {"type": "independent"}
    scene = mi.load_dict(described)
    assert isinstance(scene.integrator(), PLUGINS)  # it is yours that renders
    return np.array([mi.render(scene, spp=spp, seed=k) for k in range(seeds)], dtype=np.float32)


def three(builder, spp=SPP, **options):
    """The same by each of the three path tracers, and the seconds that each took."""
    found = {}
    seconds = {}
    for name in STRATEGIES:
        begin = time.perf_counter()
        found[name] = render_all(builder, spp, integrator=f"path_tracer_{name}", **options)
        seconds[name] = time.perf_counter() - begin
    return found, seconds


def show_three(renders, name, exposure):
    """One render of each, and their mean colors."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    for ax, (strategy, images) in zip(axes, renders.items(), strict=True):
        ax.imshow(tofrender.tonemap(images[0], exposure=exposure))
        ax.set_title(strategy)
        ax.set_axis_off()
        mean = images.mean(axis=(1, 2, 3))
        print(f"{strategy}: mean {mean.mean():.4f} ± {mean.std(ddof=1) / np.sqrt(len(mean)):.4f}")
    show(figure, name)


def save(name, renders):
    """Save renders for handing in, small ones: means over blocks of pixels."""
    n = max(SIDE // 64, 1)
    small = {}
    for key, images in renders.items():
        seeds, height, width, _ = images.shape
        blocks = images.reshape(seeds, height // n, n, width // n, n, 3)
        small[key] = blocks.mean(axis=(2, 4))
    np.savez_compressed(deliverables / f"{name}.npz", **small)


# %% [markdown]
# ### Veach's plates, direct light
# Four lights of equal power, and four plates, from nearly specular (top) to rough (bottom). All
# three pictures use the same number of paths.

# %%
veach, seconds = three(tofrender.veach, width=3 * SIDE // 2, height=SIDE, max_bounces=1)
save("veach", veach)
show_three(veach, "veach", 1.2)
compare(veach["mis"].mean(axis=0), "veach", 1.2)

# %% [markdown]
# The standard deviation of a sample in each pixel, estimated from renders with different seeds; and
# variance times render time, which compares the techniques at equal time.

# %%
figure, axes = plt.subplots(1, 3, figsize=(14, 3.6), layout="compressed")
for ax, (name, images) in zip(axes, veach.items(), strict=True):
    deviation = np.sqrt(SPP * images.mean(axis=-1).var(axis=0, ddof=1))
    shown = ax.imshow(np.log10(np.maximum(deviation, 1e-4)), cmap="magma", vmin=-2.5, vmax=1)
    ax.set_title(name)
    ax.set_axis_off()
    cost = np.mean(deviation**2) / SPP * seconds[name] / SEEDS
    print(f"{name}: {seconds[name]:.1f} s, variance times seconds {cost:.2e}")
figure.colorbar(shown, ax=axes, label="log$_{10}$ standard deviation of a sample")
show(figure, "veach_noise")

# %% [markdown]
# Two means may differ by more than their ± suggests: where a technique is poor, most samples are 0
# and a few are very large, and sixteen renders are too few to estimate how rare these are.
#
# **Where is each technique good, and why?** *(Replace this line: plates and lights by name.)*
#
# ### Lights of equal power
# Sphere lights of radius 0.03, 0.3 and 0.9 m with equal power give equal pictures, because the
# irradiance of an entirely visible sphere does not depend on its radius. This reveals a wrong
# density. *Arrival times* do depend on the radius: see the assignment on time of flight.

# %%
spheres = {
    size: render_all(
        getattr(tofrender, f"sphere_light_{size}"), width=SIDE, height=SIDE // 2, max_bounces=1
    )
    for size in ("small", "medium", "large")
}
save("sphere_lights", spheres)
show_three(spheres, "sphere_lights", 1.0)

# %% [markdown]
# ### One light as two shapes
# The panel is a quad, or two triangles. Both pictures should be equal.

# %%
rectangle = {
    kind: render_all(
        getattr(tofrender, f"rectangle_light_{kind}"),
        width=SIDE,
        height=SIDE,
        integrator="path_tracer_nee",
    )
    for kind in ("quad", "triangles")
}
save("rectangle_light", rectangle)
difference = rectangle["triangles"].mean(axis=0) - rectangle["quad"].mean(axis=0)
print(f"mean difference: {difference.mean() / rectangle['quad'].mean():+.4f} of the mean")
by_material = {
    kind: render_all(
        getattr(tofrender, f"rectangle_light_{kind}"),
        width=SIDE,
        height=SIDE,
        integrator="path_tracer_mats",
        seeds=1,
    )
    for kind in ("quad", "triangles")
}
figure, axes = plt.subplots(1, 4, figsize=(14, 3.8), layout="constrained")
pictures = {f"nee, {kind}": images[0] for kind, images in rectangle.items()}
pictures |= {f"mats, {kind}": images[0] for kind, images in by_material.items()}
for ax, (name, picture) in zip(axes, pictures.items(), strict=True):
    ax.imshow(tofrender.tonemap(picture, exposure=1.0))
    ax.set_title(name)
    ax.set_axis_off()
show(figure, "rectangle_light")

# %% [markdown]
# ### Full paths
# Four bounces in a small box. The larger the fraction of indirect light, the less the techniques
# differ.

# %%
box, _ = three(tofrender.small_box, width=SIDE, height=SIDE, max_bounces=4)
save("small_box", box)
show_three(box, "small_box", 1.2)
compare(box["mis"].mean(axis=0), "small_box", 1.2)

# %% [markdown]
# With a mirror and a glass sphere in the box, some light can be found by BSDF sampling only. It
# causes the bright dots next to the glass.

# %%
described = tofrender.small_box(
    width=SIDE, height=SIDE, integrator="path_tracer_mis", max_bounces=-1, spheres="mirror_glass"
)
picture = np.array(mi.render(mi.load_dict(described), spp=64 if SMALL else 256))
figure, ax = plt.subplots(figsize=(4.5, 4.5), layout="constrained")
ax.imshow(tofrender.tonemap(picture, exposure=1.2))
ax.set_axis_off()
show(figure, "small_box_mirror_glass")

# %% [markdown]
# ## 9. Bonus: points distributed like an image

# %% [solution] hierarchical.py

# %% [markdown]
# First an image of two by two texels, then a sky with a sun, and your own light probe if you have
# one (square, with a power of two as its size).

# %%
from hierarchical import HierarchicalWarp

tiny = np.array([[6.0, 2.0], [1.0, 1.0]])
n = 64 if SMALL else 512
rows, columns = np.mgrid[0:n, 0:n]
to_sun = np.hypot((rows - 0.3 * n) / n, (columns - 0.65 * n) / n)
sky = 1.5 - rows / n + 8 * np.exp(-((to_sun / 0.06) ** 2)) + (rows > 0.7 * n)
images = {"2 x 2": tiny, "sky": sky}

figure, axes = plt.subplots(2, 2, figsize=(8, 8.2), layout="constrained")
for row, (name, brightness) in zip(axes, images.items(), strict=True):
    warp = HierarchicalWarp(brightness)
    row[0].imshow(brightness, cmap="gray", extent=(0, 1, 1, 0), vmin=0)
    row[1].scatter(*np.array(warp.sample(stratified(4096))), s=0.7, color="black")
    row[1].set(xlim=(0, 1), ylim=(1, 0), aspect="equal")
    row[0].set(title=name, xlabel="x", ylabel="y")
    row[1].set(title="points", xlabel="x", ylabel="y")
    chi_square(warp.sample, warp.pdf, "square", f"hierarchical_{len(brightness)}")
show(figure, "hierarchical")

saved = sky.reshape(32, n // 32, 32, n // 32).mean(axis=(1, 3)).astype(np.float32)
points = np.array(HierarchicalWarp(saved).sample(independent(50_000, seed=3))).T
np.savez_compressed(deliverables / "hierarchical.npz", image=saved, points=points)

# %% [markdown]
# ## Handing in

# %%
for path in sorted(deliverables.iterdir()):
    print(f"{path.stat().st_size / 1024:8.0f} KiB  {path.name}")

# %% [markdown]
# In a terminal, `tofrender submit a1 .` runs the public tests and packs the zip file.
#
# ## See also
# - the [handout](README.md) and the [written exercises](exercises.md)
# - Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th edition, chapters 2, 12 and 13
# - Veach, Guibas, "Optimally Combining Sampling Techniques for Monte Carlo Rendering", 1995
