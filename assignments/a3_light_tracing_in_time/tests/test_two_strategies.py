"""a3.two_strategies: next-event estimation and light tracing share their light."""

import formulas
import numpy as np
import pytest
from path_traced import ROOM, reference
from test_caustics import SLAB
from test_light_tracer import ASLANT, COLOR, LIGHT, check_bins, render

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_two_strategies
NAME = "TransientTwoStrategies"
PANEL = {"half": formulas.inputs.number("half of the panel", 0.4, low=0.35, high=0.45)}
PANEL |= {"height": 1.2, "radiance": 3.0}
RADIUS = formulas.inputs.number("radius of the sphere", 0.7, low=0.6, high=0.9)
OVER = {"origin": (0, 0, 0.8), "target": (0, 0, 0), "size": (4, 4), "fov": 70.0}
HINT = "p² over the sum of both p²: densities by area of floor and light, from either end"


def share(own, other):
    return own**2 / (own**2 + other**2)


@pytest.mark.parametrize("end", ["camera", "light"])
def test_shares_of_direct_light(submission, end):
    """Weighted part of each end in the light of a lamp and of a panel."""
    view = formulas.View(**ASLANT)
    radiance, _, *both = formulas.under_point(view, view.pixels(), LIGHT, 1.0)
    own, other = both if end == "camera" else both[::-1]
    wanted = (radiance * share(own, other)).mean(-1)[..., None] * COLOR
    steady, _ = render(
        submission, "floor", ASLANT, name=NAME, lights=[[LIGHT, COLOR]],
        integrator={"max_depth": 2, "end": end},
    )  # fmt: skip
    expect.estimate(steady, wanted, f"light of a lamp, end {end}", rounding=3e-3, hint=HINT)
    part, _, (_, *both) = formulas.under_panel(formulas.View(**OVER), **PANEL)
    own, other = both if end == "camera" else both[::-1]
    steady, _ = render(
        submission, "under_panel", OVER, name=NAME, **PANEL,
        integrator={"max_depth": 2, "end": end},
    )  # fmt: skip
    wanted = (part * share(own, other)).sum()
    what = f"light of a panel, end {end}, film's mean"
    expect.estimate(steady.mean((1, 2)), wanted, what, rounding=3e-3, hint=HINT)


def test_together(submission):
    """Both ends, pixel by pixel and in time."""
    bins = (10, 2.9, 0.1)
    options = ASLANT | {"bins": bins}
    view = formulas.View(**options)
    radiance, opl, _, _ = formulas.under_point(view, view.pixels(16), LIGHT, 1.0)
    steady, transient = render(
        submission, "floor", options, name=NAME, lights=[[LIGHT, COLOR]],
        integrator={"max_depth": 2},
    )  # fmt: skip
    wanted = radiance.mean(-1)[..., None] * COLOR
    hint = "the two shares of a path add up to 1"
    expect.estimate(steady, wanted, "picture", rounding=3e-3, hint=hint)
    hint = "both ends share what they find: neither counts in full, or as one half"
    means = steady[..., 0].mean((1, 2))
    expect.noise(means, 0.004 * wanted[..., 0].mean(), "the film's mean", hint=hint)
    hint = "both ends measure the same length, from light to lens"
    check_bins(transient, radiance / radiance.size, opl, bins, hint)


@pytest.mark.parametrize("max_depth", [3, 4])
def test_many_bounces(submission, max_depth):
    """In a sphere, where the light of each bounce is known."""
    view = {"origin": (0, 0, 0), "target": (0, 0, 1), "size": (4, 4)}
    steady, _ = render(
        submission, "inside_sphere", view, name=NAME, radius=RADIUS, albedo=0.6, intensity=2.0,
        integrator={"max_depth": max_depth},
    )  # fmt: skip
    wanted = sum(formulas.sphere_bounce(n, RADIUS, 0.6, 2.0) for n in range(1, max_depth))
    hint = "densities of the way back are those of a path that comes from the other end"
    expect.estimate(
        steady.mean((1, 2)), wanted, f"film's mean, max_depth {max_depth}", rounding=1e-3,
        hint=hint,
    )  # fmt: skip


def test_what_one_alone_finds(submission):
    """Through glass only light finds the camera, in a mirror only the camera; no lamp is seen."""
    view = {"origin": (0, 0, 0.45), "target": (0, 0, 0), "fov": 120.0, "size": (4, 4)}
    part, _ = formulas.through_slab(formulas.View(**view), **SLAB)
    steady, _ = render(
        submission, "under_slab", view, name=NAME, integrator={"max_depth": 4}, **SLAB
    )
    hint = "a strategy that would connect to glass finds nothing: it gets no share"
    expect.estimate(steady.mean((1, 2)), part.sum(), "film's mean", rounding=3e-3, hint=hint)
    seen = {"origin": (0.2, 0, 0.8), "target": (1, 0, 0.5), "fov": 15.0, "size": (3, 2)}
    seen |= {"up": (0, 0, 1)}
    view = formulas.View(**seen)
    wanted = formulas.under_point(view, view.pixels(), (1.7, 0.1, 0.8), 1.0)[0].mean(-1)
    steady, _ = render(
        submission, "beside_mirror", seen, name=NAME, x=1.0, light=(0.3, 0.1, 0.8),
        intensity=1.0, integrator={"max_depth": 3},
    )  # fmt: skip
    hint = "what is seen in a mirror is found from the camera alone, and counts in full"
    expect.estimate(steady[..., 0], wanted, "picture in a mirror", rounding=3e-3, hint=hint)
    upwards = {"origin": (0, 0, 0.5), "target": (0, 0, 1), "size": (2, 2), "fov": 10.0}
    steady, _ = render(
        submission, "under_panel", upwards, name=NAME, **PANEL, integrator={"max_depth": 2}, seeds=2
    )
    expect.close(
        steady,
        np.zeros(steady.shape),
        "a light that is seen directly",
        hint="hits do not count here",
    )


def test_agrees_with_a_path_tracer(submission):
    """A room with glossy walls, without the lamp itself, and what the camera's end has of it."""
    wanted, bins = reference("glossy")
    steady, transient = render(
        submission, "room", ROOM, name=NAME, spp=1024, integrator={"max_depth": 4}, mirror=False
    )
    hint = "what both ends find adds up to all light but that of hits"
    expect.same(steady.mean((1, 2)), wanted, "film's mean", rounding=2e-3, hint=hint)
    hint = "the same light at the same time"
    came = transient.mean((1, 2))[:, :, 1]
    expect.same(came, bins[:, :, 1], "green per bin", rounding=1e-2, hint=hint)
    wanted, _ = reference("camera")
    steady, _ = render(
        submission, "room", ROOM, name=NAME, spp=1024, mirror=False,
        integrator={"max_depth": 4, "end": "camera"},
    )  # fmt: skip
    hint = "glossy surfaces are left with other densities from either end: Vertex.back"
    what = "film's mean, end camera"
    expect.same(steady.mean((1, 2)), wanted, what, rounding=5e-3, hint=hint)
