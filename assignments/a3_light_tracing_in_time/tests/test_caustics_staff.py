"""a3.caustics: a ball of glass, water, and what a mirror sends on to another surface."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest
from test_caustics import BELOW
from test_light_tracer import check_bins, render

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_caustics


def test_through_a_ball(submission):
    """Light through a glass ball without internal reflection, on a floor below it."""
    random = submission.random
    bins = (8, 5.7, 0.1)
    ball = {"radius": 0.5, "light": drawn.between(random, 2.9, 3.1), "floor_z": -1.5}
    ball |= {"index": drawn.between(random, 1.47, 1.55), "intensity": drawn.between(random, 1, 3)}
    # The camera looks from below the ball; its window is the middle of the pattern
    view = {"origin": (0, 0, -0.6), "target": (0, 0, -1.5), "fov": 25.0, "size": (4, 3)}
    view |= {"bins": bins}
    part, opl = formulas.through_ball(formulas.View(**view), **ball)
    steady, transient = render(
        submission, "under_ball", view, spp=8192, integrator={"max_depth": 4}, **ball
    )
    hint = "light, two surfaces of glass, the floor, the lens: four segments"
    expect.estimate(steady.mean((1, 2)), part.sum(), "film's mean", rounding=5e-3, hint=hint)
    check_bins(transient, part, opl, bins, "in glass, light takes index times as long")


def test_reflected_in_a_slab(submission):
    """Light that both surfaces of a slab reflect before it leaves arrives separately."""
    random = submission.random
    slab = {"bottom": 0.5, "top": 0.7, "light": drawn.between(random, 1.6, 1.9)}
    slab |= {"index": drawn.between(random, 1.9, 2.1), "intensity": drawn.between(random, 1, 3)}
    view = {"origin": (0, 0, 0.45), "target": (0, 0, 0), "fov": 40.0, "size": (2, 2)}
    part, opl = formulas.through_slab(formulas.View(**view), **slab, order=1)
    bins = (1, opl.min() - 0.02, 0.1)  # Earlier than what the floor sends to the slab and back
    _, transient = render(
        *(submission, "under_slab", view | {"bins": bins}), spp=1 << 16,
        integrator={"max_depth": 6}, **slab,
    )  # fmt: skip
    hint = "in glass, light takes index times as long, also after it was reflected inside"
    check_bins(transient, part, opl, bins, hint)


def test_into_other_water(submission):
    """A lamp over a liquid of some index and depth, and a floor of some albedo."""
    random = submission.random
    water = {"depth": drawn.between(random, 0.46, 0.8), "intensity": drawn.between(random, 1, 3)}
    water |= {"index": drawn.between(random, 1.2, 1.5), "albedo": drawn.between(random, 0.4, 0.8)}
    water["light"] = water["depth"] + drawn.between(random, 0.7, 1.2)
    part = formulas.into_water(formulas.View(**BELOW), **water)
    steady, _ = render(
        submission, "under_water", BELOW, integrator={"max_depth": 3}, spp=4096, **water
    )
    hint = "radiance is compressed at refraction, light's power is not: TransportMode.Importance"
    expect.estimate(steady.mean((1, 2)), part.sum(), "film's mean", rounding=3e-3, hint=hint)


def test_between_two_surfaces(submission):
    """A spot on a floor, which a colored mirror sends back to another part of it."""
    random = submission.random
    case = mirrored(random)
    options, scene, part, opl, _ = case
    low, high = np.quantile(opl, [0.02, 0.98])
    bins = (4, low, (high - low) / 4)
    steady, transient = render(
        submission, "by_mirror", options | {"bins": bins}, spp=1 << 13, **scene,
        integrator={"max_depth": 4},
    )  # fmt: skip
    wanted = part.sum() * np.array(scene["lamp"][1]) * scene["color"]
    hint = "after a mirror the path goes on, with its color: floor, mirror, floor"
    expect.estimate(steady.mean((1, 2)), wanted, "film's mean", rounding=5e-3, hint=hint)
    check_bins(transient, part * wanted[0] / part.sum(), opl, bins, hint)
    steady, _ = render(
        submission, "by_mirror", options, spp=256, seeds=2, **scene, integrator={"max_depth": 3}
    )
    hint = "a mirror is a segment more"
    expect.close(steady, np.zeros(steady.shape), "picture, max_depth 3", hint=hint)


def mirrored(random):
    """A floor that sees its lit part in a mirror: camera, scene, and the result of `by_mirror`."""
    mirror = drawn.between(random, 0.38, 0.45)
    options, lamp = drawn.facing(random, mirror)
    albedo = drawn.between(random, 0.5, 0.8)
    position, *rest = lamp["position"], lamp["target"], lamp["cutoff"], lamp["beam"]
    scene = {"lamp": [position, drawn.color(random), *rest], "mirror": mirror, "albedo": albedo}
    scene["color"] = drawn.color(random, 0.4, 0.95)
    view = formulas.View(**options)
    return options, scene, *formulas.by_mirror(view, (position, 1.0, *rest), mirror, albedo)
