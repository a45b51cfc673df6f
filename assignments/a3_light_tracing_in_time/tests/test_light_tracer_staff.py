"""a3.light_tracer: other lamps, floors, cameras, and paths of many bounces."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest
from test_light_tracer import (
    NAME,
    check_bins,
    check_noise,
    check_picture,
    expected_noise,
    in_the_way,
    render,
)

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_light_tracer
DIRECT = {"max_depth": 2}


def picture(radiance, color):
    return radiance.mean(-1)[..., None] * color


def test_two_lights(submission):
    """Lamps of different power and color, and another floor."""
    random = submission.random
    options = drawn.over_floor(random)
    albedo = drawn.between(random, 0.4, 0.8)
    view = formulas.View(**options)
    lamps = [[drawn.above(random), drawn.color(random)] for _ in range(2)]
    found = [formulas.under_point(view, view.pixels(16), at, 1.0, albedo) for at, _ in lamps]
    wanted = sum(picture(f[0], color) for f, (_, color) in zip(found, lamps, strict=True))
    steady, _ = render(
        *(submission, "floor", options, 2048), lights=lamps, albedo=albedo, integrator=DIRECT
    )
    hint = "emitted.weight has the chance of the light already"
    check_picture(steady, wanted, "picture", 2e-3, hint)
    parts = [(f[0] * color[0], f[2], f[3] / 2) for f, (_, color) in zip(found, lamps, strict=True)]
    check_noise(steady, expected_noise(parts), np.prod(options["size"]) * 2048)


def test_other_lamps(submission):
    """A spot, which is chosen more often, a panel, and a point: all at once."""
    random = submission.random
    options = drawn.over_floor(random)
    view = formulas.View(**options)
    d = view.pixels(16)
    at = drawn.above(random)
    color = drawn.color(random)
    spot = drawn.above(random)
    spots = drawn.color(random)
    cone = ([*drawn.between(random, -0.3, 0.3, 2), 0.0], drawn.between(random, 35, 45), 25.0)
    height = drawn.between(random, 2.3, 2.6)
    half = drawn.between(random, 0.15, 0.3)
    panels = drawn.color(random)
    wanted = formulas.under_point(view, d, at, 1.0)[0].mean() * np.array(color)
    wanted += formulas.under_point(view, d, spot, 1.0, cone=cone)[0].mean() * np.array(spots)
    part, _, _ = formulas.under_panel(view, half, height, 1.0)
    steady, _ = render(
        submission, "floor", options, lights=[[at, color]], panels=[[height, half, panels]],
        spots=[[spot, spots, *cone, drawn.between(random, 1.5, 3)]], spp=2048, integrator=DIRECT,
    )  # fmt: skip
    hint = "emitted.weight is right for every light: a spot shines in its cone only"
    wanted += part.sum() * np.array(panels)
    expect.estimate(steady.mean((1, 2)), wanted, "film's mean", rounding=2e-3, hint=hint)


@pytest.mark.parametrize("kind", ["metal", "back", "color", "half a mirror"])
def test_other_floors(submission, kind):
    """Rough metal, a floor seen and lit from its back, one without red, and half a mirror."""
    random = submission.random
    options = drawn.over_floor(random)
    view = formulas.View(**options)
    at = drawn.above(random)
    color = drawn.color(random)
    alpha = drawn.between(random, 0.3, 0.5) if kind == "metal" else None
    albedo = np.array([0.0, *drawn.between(random, 0.2, 0.8, 2)]) if kind == "color" else 0.5
    share = drawn.between(random, 0.3, 0.7) if kind == "half a mirror" else 0.0
    floor = {"alpha": alpha, "flipped": kind == "back", "mirrored": share}
    floor["albedo"] = np.broadcast_to(albedo, 3).tolist()
    radiance = formulas.under_point(view, view.pixels(16), at, 1.0, alpha=alpha)[0]
    wanted = picture(radiance * (1 - share), np.array(color) * albedo / 0.5)
    steady, _ = render(
        submission, "floor", options, lights=[[at, color]], **floor, spp=2048, integrator=DIRECT
    )
    hint = "the material says how much it reflects to the lens: bsdf.eval, in local directions"
    check_picture(steady, wanted, "picture", 3e-3, hint)
    if kind != "half a mirror":
        behind = [*at[:2], -at[2]]
        steady, _ = render(
            submission, "floor", options, lights=[[behind, color]], **floor, spp=64, seeds=8,
            integrator=DIRECT,
        )  # fmt: skip
        expect.close(steady, 0.0, "picture of a floor that is lit from below", hint=hint)


def test_long_paths(submission):
    """Up to eight segments in a sphere, from a point off its center; and the first arrivals."""
    random = submission.random
    radius = drawn.between(random, 0.6, 1.5)
    albedo = drawn.between(random, 0.6, 0.8)
    intensity = drawn.between(random, 1, 5)
    max_depth = int(random.integers(7, 9))
    options = drawn.inside(random, radius)
    color = [0.0, albedo, drawn.between(random, 0.3, 0.6)]
    steady, _ = render(
        submission, "inside_sphere", options, radius=radius, albedo=color, intensity=intensity,
        integrator={"max_depth": max_depth}, spp=1024,
    )  # fmt: skip
    orders = range(1, max_depth)
    wanted = [
        sum(formulas.sphere_bounce(n, radius, part, intensity) for n in orders) for part in color
    ]
    hint = "every vertex connects, and counts in full; Russian roulette divides by its chance"
    wanted = np.zeros(steady.shape[1:]) + wanted
    what = f"picture, max_depth {max_depth}"
    check_picture(steady, wanted, what, 2e-3, hint)
    each = [formulas.sphere_bounce(n, radius, albedo, intensity) for n in (1, 2)]
    bins = (8, radius * 1.45, radius * 0.3)
    _, transient = render(
        submission, "inside_sphere", options | {"bins": bins}, radius=radius, albedo=albedo,
        intensity=intensity, integrator={"max_depth": 3}, spp=1024,
    )  # fmt: skip
    view = formulas.View(**options)
    u, v, chord = formulas.even(1 << 17, 3)
    d = view.direction(u * view.size[0], v * view.size[1])
    length = formulas.in_sphere(view, d, radius)[0]
    opl = np.concatenate([radius + length, radius + 2 * radius * np.sqrt(chord) + length])
    part = np.repeat(np.array(each) / len(length), len(length))
    check_bins(transient, part, opl, bins, "each segment adds its length, from point to point")


def test_near_the_lens(submission):
    """Squares that hide the floor from camera and lamp, and one before the near plane."""
    random = submission.random
    near = drawn.between(random, 0.3, 0.6)
    lamp = [-0.2, 0.1, drawn.between(random, 0.35, 0.45)]
    in_the_way(submission, near_clip=near, lamp=lamp)


def test_another_lens(submission):
    """A lens with an extent, which the test brings: each path is connected to a point of it."""
    random = submission.random
    options = drawn.over_floor(random)
    options |= {"aperture": drawn.between(random, 0.2, 0.3), "focus": drawn.between(random, 1, 1.4)}
    view = formulas.View(**options)
    at = drawn.above(random)
    color = drawn.color(random)
    origin, d = view.through_lens()
    radiance, opl, _, _ = formulas.under_point(view, d, at, 1.0, origin=origin)
    low, high = np.quantile(opl, [0.05, 0.95])
    bins = (4, low, (high - low) / 4)
    steady, transient = render(
        submission, "floor", options | {"bins": bins}, lights=[[at, color]], spp=1024,
        integrator=DIRECT,
    )  # fmt: skip
    hint = "lens.arrive(si.p, lens.sample(sampler)): the lens that sample() gets"
    check_picture(steady, picture(radiance, color), "picture", 5e-3, hint)
    part = radiance.ravel() / radiance.size * color[0]
    check_bins(transient, part, opl.ravel(), bins, hint)


def test_random_numbers(submission):
    """Equal seeds, a different seed, and a single path."""
    same_numbers(submission, NAME)


def same_numbers(submission, name, **tracer):
    """Equal seeds give equal pictures, a different seed does not; one lane is enough."""
    random = submission.random
    options = {"radius": 1.0, "albedo": 0.7, "intensity": 2.0} | {"name": name}
    options["integrator"] = {"max_depth": 4} | tracer
    view = drawn.inside(random, 1.0) | {"size": (3, 2)}
    first, again = (
        render(submission, "inside_sphere", view, seeds=2, spp=64, **options)[0] for _ in range(2)
    )
    hint = "all random numbers are the sampler's"
    atol = 1e-3 * first.max()
    expect.close(again, first, "the same seed again", rtol=1e-3, atol=atol, hint=hint)
    apart = np.abs(first[1] - first[0]).max()
    expect.true(apart > 1e-5 * first.max(), "another seed gives the same picture", hint=hint)
    one = view | {"size": (1, 1)}
    alone, _ = render(submission, "inside_sphere", one, seeds=2, spp=1, **options)
    expect.finite(alone, "a picture of one pixel, one path")
