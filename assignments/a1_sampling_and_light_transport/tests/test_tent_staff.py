"""a1.tent: drawn numbers."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_tent


def test_regular_numbers(submission):
    """Numbers that cover the square evenly, twice; and one number for each coordinate."""
    square = drawn.regular(submission.random)
    p = drawn.asked_twice(submission, "warp", "points of the tent", square, name="square_to_tent")
    expect.true(np.abs(p).max() <= 1, "all points must lie in [-1, 1]^2")
    u = formulas.tent_cdf(p)
    drawn.even(formulas.cells(u, (0, 0), (1, 1), (12, 12)), np.full((12, 12), 1 / 144), "points")
    one = submission.ask("warp", name="square_to_tent", points=square[:1])
    expect.close(one, p[:1], "a single point, as one of many", atol=1e-5)


def test_density_elsewhere(submission):
    """The density at drawn points, near and far."""
    random = submission.random
    near = random.uniform(-1.3, 1.3, (400, 2))
    far = random.uniform(-1, 1, (200, 2)) * 10 ** random.uniform(0, 6, (200, 2))
    p = np.concatenate([near, far, random.permuted(far[:50], axis=1) * [1, 1e-3]])
    came = submission.ask("warp_pdf", name="square_to_tent_pdf", points=p)
    outside = np.abs(p).max(axis=1) > 1
    expect.close(came[outside], 0.0, "density outside of [-1, 1]^2", hint="0 outside, far as well")
    wanted = formulas.tent_pdf(p[~outside])
    expect.close(came[~outside], wanted, "density on [-1, 1]^2", rtol=1e-3, atol=1e-5)
