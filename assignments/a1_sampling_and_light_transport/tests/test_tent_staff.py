"""a1.tent: drawn numbers."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_tent


def random_ends(random):
    """Pairs of numbers; at least one number of each pair is 0, close to 0, or close to 1."""
    rest = random.uniform(0.1, 0.9, 6)
    ends = np.array([0.0, 1e-7, 1 - 1e-7] * 2)
    return np.where(np.arange(6)[:, None] < [3, 3], np.c_[ends, rest], np.c_[rest, ends])


def test_regular_numbers(submission):
    """Numbers that cover the square evenly, twice; and one number for each coordinate."""
    square = drawn.regular(submission.random)
    p = drawn.asked_twice(submission, "warp", "points of the tent", square, name="square_to_tent")
    expect.true(np.abs(p).max() <= 1, "all points must lie in [-1, 1]^2")
    u = formulas.tent_cdf(p)
    drawn.even(formulas.cells(u, (0, 0), (1, 1), (12, 12)), np.full((12, 12), 1 / 144), "points")
    ends = random_ends(submission.random)
    t = submission.ask("warp", name="square_to_tent", points=ends)
    hint = "P1(t) = u has an exact solution near 0 and 1, too"
    came = np.abs(t).max(axis=1)
    what = "the larger of |x| and |y| for u or v near 0 or 1"
    expect.close(came, 1.0, what, atol=3e-3, hint=hint)
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
