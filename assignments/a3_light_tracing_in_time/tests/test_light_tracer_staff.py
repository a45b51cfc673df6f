"""a3.light_tracer: several lights."""

import formulas
import pytest
from test_light_tracer import render

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_light_tracer


def test_two_lights(submission):
    """Lamps of different power and colour, and another floor."""
    options = {"origin": (0.8, 0.9, 1.7), "target": (0.1, 0.2, 0.0), "size": (3, 5), "fov": 55.0}
    view = formulas.View(**options)
    lamps = [[(0.4, -0.3, 0.9), (3.0, 0.5, 1.0)], [(-0.7, 0.5, 1.6), (0.2, 5.0, 2.0)]]
    wanted = sum(
        formulas.under_point(view, view.pixels(), place, 1.0, 0.7)[0].mean(-1)[..., None] * colour
        for place, colour in lamps
    )
    steady, _ = render(
        submission, "floor", options, lights=lamps, albedo=0.7, integrator={"max_depth": 2}
    )
    hint = "emitted.weight has the chance of the light already"
    expect.estimate(steady, wanted, "picture", rounding=2e-3, hint=hint)
