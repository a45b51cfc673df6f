"""a3.two_strategies: other lamps, and shares of light that was reflected several times."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest
from path_traced import ROOM, reference
from test_caustics_staff import mirrored
from test_light_tracer import check_picture, in_the_way, render
from test_light_tracer_staff import same_numbers
from test_two_strategies import NAME, share

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_two_strategies
ENDS = ("camera", "light")


def test_shares_of_indirect_light(submission):
    """In a sphere, from a point off its center: two to four reflections, pixel by pixel."""
    random = submission.random
    radius = drawn.between(random, 0.8, 1.5)
    albedo = drawn.between(random, 0.6, 0.8)
    intensity = drawn.between(random, 1, 5)
    max_depth = int(random.integers(3, 6))
    options = drawn.inside(random, radius)
    view = formulas.View(**options)
    _, mine, other = formulas.in_sphere(view, view.pixels(16), radius)
    each = sum(formulas.sphere_bounce(n, radius, albedo, intensity) for n in range(1, max_depth))
    for end, part in zip(ENDS, formulas.shares(mine, 1, other, 2), strict=True):
        steady, _ = render(
            submission, "inside_sphere", options, name=NAME, radius=radius, albedo=albedo,
            intensity=intensity, integrator={"max_depth": max_depth, "end": end}, spp=512,
        )  # fmt: skip
        hint = "the share is that of the whole path: every vertex has a density from each end"
        what = f"picture, end {end}, max_depth {max_depth}"
        wanted = np.repeat((part * each)[..., None], 3, axis=-1)
        check_picture(steady, wanted, what, 4e-3, hint)


def test_several_lamps(submission):
    """A spot, a panel and a point on a floor, metal or seen from its back: what each end finds."""
    random = submission.random
    options = drawn.over_floor(random, fov=drawn.between(random, 105, 115))
    options["target"] = [*options["origin"][:2], 0.0]  # So wide that both ends find much
    view = formulas.View(**options)
    d = view.pixels(16)
    at = drawn.above(random)
    spot = drawn.above(random)
    colors = [drawn.color(random) for _ in range(3)]
    cone = [[*drawn.between(random, -0.3, 0.3, 2), 0.0], drawn.between(random, 35, 45), 25.0]
    height = drawn.between(random, 2.3, 2.6)
    half = drawn.between(random, 0.2, 0.4)
    weight = drawn.between(random, 1.5, 3)
    part, _, (_, *by_panel) = formulas.under_panel(view, half, height, 1.0)
    found = [formulas.under_point(view, d, p, 1.0, cone=c) for p, c in ((at, None), (spot, cone))]
    found = [(f[0] / f[0].size, *f[2:]) for f in found] + [(part, *by_panel)]
    for k, end in enumerate(ENDS):
        wanted = np.zeros(3)
        # A connection chooses a lamp as often as light starts there
        for (radiance, *both), color in zip(found, colors, strict=True):
            wanted += (radiance * share(both[k], both[1 - k])).sum() * np.array(color)
        steady, _ = render(
            submission, "floor", options, name=NAME, lights=[[at, colors[0]]], spp=2048,
            panels=[[height, half, colors[2]]], spots=[[spot, colors[1], *cone, weight]],
            integrator={"max_depth": 2, "end": end}, flipped=True,
        )  # fmt: skip
        hint = "emission.ratio knows every lamp: which one, and how wide it shines"
        what = f"film's mean, end {end}"
        expect.estimate(steady.mean((1, 2)), wanted, what, rounding=4e-3, hint=hint)


def test_between_two_surfaces(submission):
    """Light that a colored mirror has sent from one part of a floor to another: both find it."""
    options, scene, part, _, both = mirrored(submission.random)
    color = np.array(scene["lamp"][1]) * scene["color"]
    for end, own, other in ((ENDS[0], *both), (ENDS[1], *both[::-1]), ("both", 1, 0)):
        steady, _ = render(
            submission, "by_mirror", options, name=NAME, spp=1 << 12, **scene,
            integrator={"max_depth": 4, "end": end},
        )  # fmt: skip
        wanted = (part * share(own, other)).sum() * color
        hint = "a mirror between two vertices: the same density from both ends"
        what = f"film's mean, end {end}"
        expect.estimate(steady.mean((1, 2)), wanted, what, rounding=5e-3, hint=hint)


def test_what_is_in_the_way(submission):
    """Squares that hide the floor from camera and lamp, and one before the near plane."""
    near_clip = drawn.between(submission.random, 0.3, 0.6)
    in_the_way(submission, NAME, near_clip=near_clip, spp=4096)


def test_another_room(submission):
    """The glossy room of another size, with a lamp of another color."""
    agrees_with_a_path_tracer(submission, NAME, "glossy", mirror=False)


def agrees_with_a_path_tracer(submission, name, case, mirror):
    random = submission.random
    unit = drawn.between(random, 0.5, 2.5)
    radiance = drawn.color(random, 1, 5)
    factor = np.array(radiance) / (3.0, 2.2, 1.5)
    view = ROOM | {"origin": [unit * x for x in ROOM["origin"]]}
    view["target"] = [unit * x for x in ROOM["target"]]
    count, start, width = ROOM["bins"]
    view["bins"] = (count, start * unit, width * unit)
    wanted, bins = reference(case)
    steady, transient = render(
        submission, "room", view, name=name, spp=1024, integrator={"max_depth": 4}, mirror=mirror,
        unit=unit, radiance=radiance, seeds=8,
    )  # fmt: skip
    hint = "lengths and colors of the room have changed, and nothing else"
    came = steady.mean((1, 2)) / factor
    expect.same(came, wanted, "film's mean", rounding=5e-3, hint=hint)
    came = transient.mean((1, 2))[:, :, 0] / factor[0]
    expect.same(came, bins[:, :, 0], "red per bin", rounding=1e-2, hint=hint)


def test_random_numbers(submission):
    """Equal seeds, a different seed, and a single path."""
    same_numbers(submission, NAME)
