"""a1.sphere_and_hemispheres: drawn numbers."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_sphere_and_hemispheres

CASES = {  # by name: the number that is uniform, and the density
    "square_to_uniform_sphere": (lambda v: (1 + v[:, 2]) / 2, lambda z: 0.25 / np.pi + 0 * z),
    "square_to_uniform_hemisphere": (
        lambda v: v[:, 2],
        lambda z: np.where(z > 0, 0.5 / np.pi, 0),
    ),
    "square_to_cosine_hemisphere": (
        lambda v: v[:, 0] ** 2 + v[:, 1] ** 2,
        lambda z: np.maximum(z, 0) / np.pi,
    ),
}
IDS = ["sphere", "uniform", "cosine"]


@pytest.mark.parametrize("name", CASES, ids=IDS)
def test_regular_numbers(submission, name):
    """Numbers that cover the square evenly, twice; and the square's edges."""
    random = submission.random
    edge = np.stack([random.choice([0, formulas.LAST], 8192), random.random(8192)], axis=1)
    edges = np.concatenate([formulas.CORNERS, edge, edge[:, ::-1]])
    square = np.concatenate([drawn.regular(random), edges])
    v = drawn.asked_twice(submission, "warp", f"directions of {name}", square, name=name)
    expect.close(np.linalg.norm(v, axis=1), 1.0, f"length of the vectors of {name}", rtol=1e-5)
    if "hemisphere" in name:
        lowest = v[:, 2].min()
        text = f"{name} must stay at z >= 0; one direction has z = {lowest:g}"
        expect.true(lowest >= -1e-6, text, hint="at the edges of the square, too")
    v = v[: -len(edges)]
    polar = np.stack([np.clip(CASES[name][0](v), 0, 1), formulas.azimuth(v)], axis=1)
    what = f"directions of {name} in parts of equal probability"
    drawn.even(formulas.cells(polar, (0, 0), (1, 1), (8, 16)), np.full((8, 16), 1 / 128), what)
    one = submission.ask("warp", name=name, points=square[:1])
    expect.close(one, v[:1], "a single direction, as one of many", atol=1e-5)


@pytest.mark.parametrize("name", CASES, ids=IDS)
def test_densities_elsewhere(submission, name):
    """The densities in drawn directions, close to the horizon as well."""
    random = submission.random
    low = np.arccos(random.choice([-1, 1], 100) * 10 ** random.uniform(-4, -1, 100))
    v = np.concatenate(
        [drawn.directions(random, 200), formulas.direction(low, random.uniform(0, 6, 100))]
    )
    v = v[np.abs(v[:, 2]) > 5e-5]
    came = submission.ask("warp_pdf", name=f"{name}_pdf", points=v)
    wanted = CASES[name][1](v[:, 2])
    hint = "per solid angle; 0 below the horizon, and neither clamped nor smoothed above it"
    expect.close(came, wanted, f"density of {name}", rtol=1e-3, atol=1e-7, hint=hint)
