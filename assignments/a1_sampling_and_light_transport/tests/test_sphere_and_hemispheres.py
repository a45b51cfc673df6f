"""a1.sphere_and_hemispheres."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_sphere_and_hemispheres

SPHERE, UNIFORM, COSINE = (
    f"square_to_{name}" for name in ("uniform_sphere", "uniform_hemisphere", "cosine_hemisphere")
)


def directions(submission, name, lowest):
    """Many directions, after a look at their length and their half space."""
    v = submission.ask("warp", name=name, points=formulas.uniform(100_000, submission.seed))
    expect.finite(v, f"directions of {name}")
    expect.close(np.linalg.norm(v, axis=1), 1.0, f"length of the vectors of {name}", rtol=1e-4)
    expect.true(
        v[:, 2].min() >= lowest - 1e-5,
        f"{name} must stay at z >= {lowest}; one direction has z = {v[:, 2].min():g}",
    )
    return v


def compare(v, u, what, hint):
    """`u` must be uniform in [0, 1] and independent of the azimuth."""
    square = np.stack([np.clip(u, 0, 1), formulas.azimuth(v)], axis=1)
    counts = formulas.cells(square, (0, 0), (1, 1), (8, 16))
    expect.histogram(counts, np.full((8, 16), 1 / 128), what, hint=hint)


def test_uniform_sphere_points(submission):
    """Zones of equal height have equal area (Archimedes)."""
    v = directions(submission, SPHERE, -1)
    hint = "z is uniform on [-1, 1]; theta is not uniform"
    compare(v, (1 + v[:, 2]) / 2, "directions in zones of equal area", hint)


def test_uniform_hemisphere_points(submission):
    """Zones of equal height have equal area, above the horizon."""
    v = directions(submission, UNIFORM, 0)
    compare(v, v[:, 2], "directions in zones of equal area", "z is uniform on [0, 1]")


def test_cosine_hemisphere_points(submission):
    """sin(theta)^2 is uniform."""
    v = directions(submission, COSINE, 0)
    u = v[:, 0] ** 2 + v[:, 1] ** 2
    hint = "seen from above, the points are uniform on the disk; P(theta) = sin(theta)^2"
    compare(v, u, "directions in zones of equal cosine weight", hint)


@pytest.mark.parametrize(
    ("name", "density"),
    [
        (SPHERE, lambda z: np.full_like(z, 0.25 / np.pi)),
        (UNIFORM, lambda z: np.full_like(z, 0.5 / np.pi)),
        (COSINE, lambda z: z / np.pi),
    ],
    ids=["sphere", "uniform", "cosine"],
)
def test_densities_above_the_horizon(submission, name, density):
    """The densities per solid angle."""
    v, _ = formulas.sphere_grid(40, 8)
    v = v[v[:, 2] > 0]
    came = submission.ask("warp_pdf", name=f"{name}_pdf", points=v)
    hint = "a density per solid angle integrates to 1: is it normalized, with the cosine once?"
    x = np.arccos(v[:, 2])
    x_label = "theta [rad]"
    what = f"density of {name}"
    ratios = {
        "2": f"{hint} the whole sphere has 4π, its half 2π",
        "1/2": f"{hint} the whole sphere has 4π, its half 2π",
        "π": f"{hint} divide by π",
    }
    wanted = density(v[:, 2])
    expect.close(came, wanted, what, hint=hint, ratios=ratios, x=x, x_label=x_label)


@pytest.mark.parametrize("name", [UNIFORM, COSINE], ids=["uniform", "cosine"])
def test_densities_below_the_horizon(submission, name):
    """No direction below is ever sampled; the sphere's density is the same there."""
    v, _ = formulas.sphere_grid(40, 8)
    v = v[v[:, 2] < 0]
    below = submission.ask("warp_pdf", name=f"{name}_pdf", points=v)
    x = np.arccos(v[:, 2])
    x_label = "theta [rad]"
    hint = "clamp it; negative is wrong too"
    expect.close(below, 0.0, f"density of {name} at z < 0", hint=hint, x=x, x_label=x_label)
    sphere = submission.ask("warp_pdf", name=f"{SPHERE}_pdf", points=v)
    expect.close(sphere, 0.25 / np.pi, "density of the sphere at z < 0")


@pytest.mark.parametrize("name", [SPHERE, UNIFORM, COSINE], ids=["sphere", "uniform", "cosine"])
def test_corners_of_the_square(submission, name):
    """Samples at 0 and just below 1 give unit vectors."""
    v = submission.ask("warp", name=name, points=formulas.CORNERS)
    hint = "a root of a number that rounding has made negative?"
    expect.finite(v, f"{name} for samples at the square's edges", hint=hint)
    expect.close(np.linalg.norm(v, axis=1), 1.0, "length of the vectors", rtol=1e-3, hint=hint)
