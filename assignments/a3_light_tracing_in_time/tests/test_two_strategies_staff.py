"""a3.two_strategies: shares of light that was reflected several times."""

import formulas
import pytest
from test_light_tracer import render
from test_two_strategies import NAME

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_two_strategies


@pytest.mark.parametrize("end", ["camera", "light"])
def test_shares_of_indirect_light(submission, end):
    """In a sphere, two and three reflections."""
    radius, albedo, intensity = 1.3, 0.7, 4.0
    view = {"origin": (0, 0, 0), "target": (0, 0, 1), "size": (4, 4), "fov": 100.0}
    shares = dict(
        zip(
            ("camera", "light"),
            formulas.sphere_shares(formulas.View(**view), 2, 2, False),
            strict=True,
        )
    )
    for max_depth in (3, 4):
        steady, _ = render(
            submission, "inside_sphere", view, name=NAME, radius=radius, albedo=albedo,
            intensity=intensity, integrator={"max_depth": max_depth, "end": end},
        )  # fmt: skip
        each = sum(
            formulas.sphere_bounce(n, radius, albedo, intensity) for n in range(1, max_depth)
        )
        expect.estimate(
            steady.mean((1, 2)),
            shares[end] * each,
            f"film's mean, end {end}, max_depth {max_depth}",
            rounding=3e-3,
            hint="the share is that of the whole path: every vertex has a density from each end",
        )
