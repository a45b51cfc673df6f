"""a1.tent."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_tent

INSIDE = formulas.inputs.number("inside of the tent", 0.125, low=0.06, high=0.4)


def test_points_follow_the_tent(submission):
    """Points in the cells of a grid, against the integral of the tent."""
    p = submission.ask(
        "warp", name="square_to_tent", points=formulas.uniform(100_000, submission.seed)
    )
    expect.finite(p, "points of the tent")
    expect.true(np.abs(p).max() <= 1, "all points must lie in [-1, 1]^2", hint="invert P1 per axis")
    expect.histogram(
        formulas.cells(p, (-1, -1), (1, 1), (12, 12)),
        formulas.tent_cells(12),
        "points in each cell of [-1, 1]^2",
        hint="is P1 solved for t on both sides of 1/2, and for x and y separately?",
    )


def test_density(submission):
    """The density inside, at the edges and outside."""
    t = np.array([-1.5, -1.0, -0.75, -0.25, 0.0, INSIDE, 0.5, 1.0, 1.25])
    p = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    density = submission.ask("warp_pdf", name="square_to_tent_pdf", points=p)
    outside = np.abs(p).max(axis=1) > 1
    expect.close(
        density[~outside],
        formulas.tent_pdf(p[~outside]),
        "density on [-1, 1]^2",
        atol=1e-6,
        hint="p1(x) p1(y) with p1(t) = 1 - |t|",
    )
    expect.close(
        density[outside],
        0.0,
        "density outside of [-1, 1]^2",
        hint="1 - |t| is negative outside, and two negative factors make a positive product",
    )


def test_corners_of_the_square(submission):
    """Samples at 0 and just below 1 give points at the tent's ends."""
    p = submission.ask("warp", name="square_to_tent", points=formulas.CORNERS)
    expect.finite(p, "points for samples at the square's edges", hint="a root of what is below 0?")
    expect.true(np.abs(p).max() <= 1, "samples at the edges must stay in [-1, 1]^2")
