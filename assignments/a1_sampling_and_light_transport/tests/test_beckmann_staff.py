"""a1.beckmann: drawn roughnesses, a number or one for each lane."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_beckmann


def check(m, alpha, what):
    """Normals of regular numbers: unit vectors above the horizon that follow the density."""
    expect.close(np.linalg.norm(m, axis=1), 1.0, f"length of {what}", rtol=1e-4)
    expect.true(m[:, 2].min() > 0, f"{what} must point above the horizon")
    tan2 = (m[:, 0] ** 2 + m[:, 1] ** 2) / m[:, 2] ** 2
    polar = np.stack([np.exp(-tan2 / alpha**2), formulas.azimuth(m)], axis=1)
    counts = formulas.cells(np.clip(polar, 0, 1), (0, 0), (1, 1), (8, 8))
    drawn.even(counts, np.full((8, 8), 1 / 64), what)


def test_regular_numbers(submission):
    """Numbers that cover the square evenly, twice, for a drawn roughness and for two at once."""
    random = submission.random
    alpha = float(random.uniform(0.1, 2.0))
    square = drawn.regular(random)
    name = "square_to_beckmann"
    what = f"normals for alpha = {alpha:.3g}"
    m = drawn.asked_twice(submission, "warp", what, square, name=name, parameters=[alpha])
    check(m, alpha, what)
    one = submission.ask("warp", name=name, points=square[:1], parameters=[alpha])
    expect.close(one, m[:1], "a single normal, as one of many", rtol=1e-3, atol=1e-5)
    alphas = random.uniform([0.02, 1], [0.1, 3])[random.integers(0, 2, len(square))]
    m = submission.ask("warp", name=name, points=square, parameters=[alphas])
    expect.finite(m, "normals for an array of alpha")
    check(m, alphas, "normals for an array of alpha, one for each lane")


def test_density_for_other_roughnesses(submission):
    """Nearly smooth, very rough, and one for each lane."""
    random = submission.random
    very = [float(10 ** random.uniform(-4.3, -3.3)), float(random.uniform(2, 4))]
    for alpha in (*very, 10 ** random.uniform(-2, 0.3, 300)):
        theta = np.arctan(alpha * random.uniform(0, 3, 300))
        m = formulas.direction(theta, random.uniform(0, 2 * np.pi, 300))
        came = submission.ask(
            "warp_pdf", name="square_to_beckmann_pdf", points=m, parameters=[alpha]
        )
        wanted = formulas.beckmann_pdf(m.astype(np.float32).astype(float), alpha)
        lanes = isinstance(alpha, np.ndarray)
        what = "density for an array of alpha" if lanes else f"density for alpha = {alpha:.3g}"
        hint = "alpha is any number above 0, or a Dr.Jit float; take the tangent from x and y"
        excess = np.max(1e-6 / np.square(alpha))
        expect.close(came, wanted, what, rtol=3e-3, atol=min(excess, 1e-3), hint=hint)


def test_close_to_the_horizon(submission):
    """0 and finite for directions a little above the horizon, on it and below."""
    random = submission.random
    z = np.concatenate([10 ** random.uniform(-10, -3, 100), np.zeros(10)])
    z = np.concatenate([z, -(10 ** random.uniform(-7, -1e-9, 100))])
    m = formulas.direction(np.arccos(np.clip(z, -1, 1)), random.uniform(0, 2 * np.pi, len(z)))
    m[:, 2] = z
    alpha = float(random.uniform(0.02, 1.5))
    came = submission.ask("warp_pdf", name="square_to_beckmann_pdf", points=m, parameters=[alpha])
    expect.close(came, 0.0, f"density for alpha = {alpha:.3g} at z <= 1e-3", atol=1e-6)
    square = np.concatenate([formulas.CORNERS, random.random((64, 2)) * [1, 1e-5]])
    alpha = float(random.uniform(1, 4))
    normals = submission.ask("warp", name="square_to_beckmann", points=square, parameters=[alpha])
    expect.finite(normals, f"normals for alpha = {alpha:.3g} at the square's edges")
    expect.close(np.linalg.norm(normals, axis=1), 1.0, "length of the normals", rtol=1e-4)
    expect.true(normals[:, 2].min() > 0, "normals must point above the horizon")
