"""a3.caustics: a ball of glass."""

import formulas
import pytest
from test_light_tracer import check_bins, render

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_caustics


def test_through_a_ball(submission):
    """What a glass ball lets through at once, on a floor below it."""
    bins = (8, 5.75, 0.1)
    ball = {"radius": 0.5, "light": 3.0, "floor_z": -1.5, "intensity": 1.0}
    # The camera looks from below the ball; its window is the middle of the pattern
    view = {"origin": (0, 0, -0.6), "target": (0, 0, -1.5), "fov": 25.0, "size": (3, 3)}
    view |= {"bins": bins}
    part, opl = formulas.through_ball(formulas.View(**view), **ball)
    steady, transient = render(
        submission, "under_ball", view, spp=8192, integrator={"max_depth": 4}, **ball
    )
    hint = "light, two surfaces of glass, the floor, the lens: four segments"
    expect.estimate(steady.mean((1, 2)), part.sum(), "film's mean", rounding=5e-3, hint=hint)
    check_bins(transient, part, opl, bins, "in glass, light takes index times as long")
