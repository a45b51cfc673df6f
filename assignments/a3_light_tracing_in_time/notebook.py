# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Light tracing in time
#
# **Overview.** A path tracer starts at the camera and finds a small lamp only by chance. You also
# trace paths from the lamp, connect their vertices to the camera, and combine all strategies by
# MIS. The [handout](README.md) explains the theory and specifies each problem.
#
# **What you will learn**
# - the importance of a camera, and its density in several measures
# - how to trace light to the camera, and to compute film positions and arrival times of splats
# - how to compute the MIS weights of two strategies, and of all strategies
# - when the light of a caustic arrives, and which strategy samples it
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
import mitsuba as mi
import numpy as np

import tofrender

SMALL = os.environ.get("TOFRENDER_NOTEBOOK_SIZE") == "small"  # for automatic tests
SIZE, SPP = (24, 64) if SMALL else (40, 64)  # pixels, paths per pixel
DEPTH = 4  # segments: light, two surfaces of glass, the floor, the lens
OUT = Path("deliverables")
OUT.mkdir(exist_ok=True)


def save(name, **arrays):
    """Write arrays to deliverables/, numbers of pictures in single precision."""
    single = {k: np.asarray(v, np.float32) if np.ndim(v) > 1 else v for k, v in arrays.items()}
    np.savez_compressed(OUT / name, **single)
    print(f"wrote {OUT / name}: {', '.join(arrays)}")


def make(kind, **parameters):
    """An integrator of yours."""
    props = mi.Properties()
    for name, value in parameters.items():
        props[name] = value
    return kind(props)


def render(integrator, scene, spp=SPP, seed=0):
    """Steady image and bins."""
    steady, bins = integrator.render(scene, spp=spp, seed=seed)
    return np.array(steady), np.array(bins)


def show(ax, image, title="", **options):
    """A picture without axes."""
    ax.imshow(tofrender.tonemap(image, **options))
    ax.set_title(title)
    ax.set_axis_off()


# %% [markdown]
# ## 1. Camera importance
# Problem `a3.lens`. For every camera, the integral of $W_e \cos\theta$ over its window is 1. A
# point on the floor must be projected to the pixel that sees it.

# %% [solution] lens.py

# %%
from lens import Lens

window = {"start_opl": 4.2, "bin_width_opl": 0.04, "temporal_bins": 200}
scene = mi.load_dict(tofrender.caustic(width=SIZE, height=SIZE, **window))
sensor = scene.sensors()[0]
lens = Lens(sensor)

rng = np.random.default_rng(0)
film_points = mi.Point2f(rng.random((2, 100_000)).astype(np.float32))
rays, _ = sensor.sample_ray(0, 0.5, film_points, mi.Point2f(0.5))
cos = -np.array(rays.d.z)  # the camera looks along -z
ratio = np.array(lens.importance(rays.d)) * cos / np.array(lens.density(rays.d))
print(f"integral of We cos, by camera rays: {ratio.mean():.5f}")

seen = scene.ray_intersect(rays)
arrival = lens.arrive(seen.p, lens.sample(None))
error = np.array(arrival.position) - SIZE * np.array(film_points)
error = np.abs(error[:, np.array(seen.is_valid())]).max()
print(f"points land where they are seen from: within {error:.1e} pixels")

# %% [markdown]
# ## 2. Transient light tracer
# Problem `a3.light_tracer`, and with glass `a3.caustics`. A glass sphere is in the Cornell box, next
# to a small lamp. Which part of the picture is missing, and why?

# %% [solution] light_tracer.py

# %%
from light_tracer import TransientLightTracer

light_tracer = make(TransientLightTracer, max_depth=DEPTH)
light, light_bins = render(light_tracer, scene)
# The package also finds caustics by photons. Here, all paths start at the camera
from_camera = {"caustic_photons": False, "caustic_rays": False, "chain_rays": False}
path_tracer = mi.load_dict({"type": "transient_path", "max_depth": DEPTH, **from_camera})
path, path_bins = (np.array(part) for part in mi.render(scene, integrator=path_tracer, spp=SPP))

figure, axes = plt.subplots(1, 2, figsize=(9, 4.6), layout="constrained")
show(axes[0], path, "path tracer", exposure=0.8)
show(axes[1], light, "light tracer", exposure=0.8)
plt.show()

# %% [markdown]
# ## 3. Two strategies
# Problem `a3.two_strategies`. The contribution of each strategy with its MIS weights, and their
# sum. Compare its noise with the noise of the path tracer above.

# %% [solution] two_strategies.py

# %%
from two_strategies import TransientTwoStrategies

two = make(TransientTwoStrategies, max_depth=DEPTH)
ends = {
    end: render(make(TransientTwoStrategies, max_depth=DEPTH, end=end), scene)[0]
    for end in ("camera", "light")
}
together, _ = render(two, scene)
figure, axes = plt.subplots(1, 3, figsize=(13, 4.6), layout="constrained")
for ax, (end, image) in zip(axes, (ends | {"both": together}).items(), strict=True):
    show(ax, image, f"end: {end}", exposure=0.8)
plt.show()

# %% [markdown]
# ## 4. All strategies
# Problem `a3.all_strategies`. Each strategy of four segments alone, above unweighted, below with
# its MIS weights. Which one contains the caustic?

# %% [solution] all_strategies.py

# %%
from all_strategies import TransientBDPT

strategies = [(s, DEPTH + 1 - s) for s in range(DEPTH + 1)]
alone, shared = (
    np.stack(
        [
            render(make(TransientBDPT, max_depth=DEPTH, strategy=f"{s},{t}", mis=mis), scene)[0]
            for s, t in strategies
        ]
    )
    for mis in ("none", "power")
)
figure, axes = plt.subplots(2, 5, figsize=(14, 6), layout="constrained")
for row, images in zip(axes, (alone, shared), strict=True):
    for ax, (s, t), image in zip(row, strategies, images, strict=True):
        show(ax, image, f"({s}, {t})", exposure=3)
plt.show()

# %%
save("strategies.npz", strategies=np.array(strategies, float), alone=alone, shared=shared)

# %% [markdown]
# ## 5. The caustic in flight
# All strategies, in time bins. Light through the center of the sphere is not refracted; in glass,
# its optical path length is $n$ times the geometric one:
#
# $$\mathrm{opl} = |x_\mathrm{lamp} - x_\mathrm{floor}| + 2r(n - 1) + |x_\mathrm{floor} - x_\mathrm{camera}|.$$

# %%
bdpt = make(TransientBDPT, max_depth=DEPTH)
steady, bins = render(bdpt, scene, spp=4 * SPP, seed=1)
save("caustic.npz", transient=bins, steady=steady, start_opl=4.2, bin_width_opl=0.04)

lamp = np.array([-0.7, 0, -0.45])
ball = np.array([-0.25, -0.56, -0.1])
index = 1.5
radius = 0.4
direction = (ball - lamp) / np.linalg.norm(ball - lamp)
floor = lamp + direction * (lamp[1] + 1) / -direction[1]  # the floor is at y = -1
eye = np.array([0, 0, 3.9])
expected = np.linalg.norm(floor - lamp) + 2 * radius * (index - 1) + np.linalg.norm(floor - eye)
where = lens.arrive(mi.Point3f(*floor.tolist()), lens.sample(None)).position
x, y = (int(np.array(each)[0]) for each in (where.x, where.y))
opl = 4.2 + 0.04 * (np.arange(200) + 0.5)
response = bins[y - 1 : y + 2, x - 1 : x + 2].mean((0, 1, 3))

figure, ax = plt.subplots(figsize=(8, 3), layout="constrained")
ax.plot(opl, response)
ax.axvline(expected, color="tab:orange", ls="--", label="through the middle of the glass")
ax.set(xlabel="optical path length [m]", xlim=(5, 7.5), title=f"pixels around ({x}, {y})")
ax.set_ylabel("radiance per bin [W m$^{-2}$ sr$^{-1}$]")
ax.legend(frameon=False)
figure.savefig(OUT / "caustic_response.png", dpi=110)
plt.show()

# %%
animation = tofrender.visualize_transient(bins[:, :, 15:75:2], 4.2 + 15 * 0.04, 0.08)
animation.save(OUT / "animation.gif", writer="pillow", fps=10, dpi=60)
animation

# %% [markdown]
# ## 6. Comparison of the noise
# Mean squared errors, relative to a render with many more paths, on the pixels that see neither
# glass nor lamp.

# %%
pictures = {"path": path, "light": light, "two": together, "bdpt": render(bdpt, scene)[0]}
centers = (np.arange(SIZE) + 0.5) / SIZE
grid = np.stack(np.meshgrid(centers, centers)).reshape(2, -1).astype(np.float32)
si = scene.ray_intersect(sensor.sample_ray(0, 0.5, mi.Point2f(grid), mi.Point2f(0.5))[0])
smooth = np.array(mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)).reshape(SIZE, SIZE)
away = np.array(si.p).T - eye
away /= np.linalg.norm(away, axis=1)[:, None]


def beside(point):
    """How far the pixels' rays pass by a point [m]."""
    return np.linalg.norm(np.cross(away, point - eye), axis=1).reshape(SIZE, SIZE)


mask = smooth & (beside(ball) > radius + 0.15) & (beside(lamp) > 0.15)
errors = [((image - steady)[mask] ** 2).mean() for image in pictures.values()]
for name, error in zip(pictures, errors, strict=True):
    print(f"{name:>6}: mean squared error {error:.2e}")
save(
    "comparison.npz",
    **pictures,
    reference=steady,
    mask=mask.astype(float),
    mse=np.array(errors),
)

# %% [markdown]
# **Questions.** Answer in this cell.
# 1. Which light is missing in the light tracer's picture? Which strategy of `strategies.npz` has it?
# 2. Why does (2, 3) contain the floor, but not the caustic?
# 3. The light through the center of the sphere is not the last light of the caustic to arrive.
#    Which light arrives later, and along which path?
# 4. Where in the picture is the light tracer worse than the path tracer? Would more paths change
#    the ratio?
#
# ## See also
# - `README.md`, `exercises.md`
# - `pytest` for all problems, and `tofrender submit a3 .` to pack what you hand in
