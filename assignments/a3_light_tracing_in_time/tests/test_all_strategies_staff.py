"""a3.all_strategies: each strategy, and its share, in scenes that are drawn."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest
from test_all_strategies import NAME
from test_caustics_staff import mirrored
from test_light_tracer import check_bins, check_picture, in_the_way, render
from test_light_tracer_staff import same_numbers
from test_two_strategies_staff import agrees_with_a_path_tracer

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_all_strategies


@pytest.mark.parametrize("mis", ["balance", "power"])
def test_shares_of_indirect_light(submission, mis):
    """Three reflections in a sphere, strategy by strategy, pixel by pixel."""
    random = submission.random
    radius = drawn.between(random, 0.8, 1.5)
    albedo = drawn.between(random, 0.6, 0.8)
    intensity = drawn.between(random, 1, 5)
    n = 3
    options = drawn.inside(random, radius)
    view = formulas.View(**options)
    _, mine, other = formulas.in_sphere(view, view.pixels(16), radius)
    whole = formulas.sphere_bounce(n, radius, albedo, intensity)
    inner, last = formulas.shares(mine, n, other, {"balance": 1, "power": 2}[mis])
    for s in range(1, n + 2):
        strategy = f"{s},{n + 2 - s}"
        steady, _ = render(
            submission, "inside_sphere", options, name=NAME, radius=radius, albedo=albedo,
            intensity=intensity, spp=512,
            integrator={"max_depth": n + 1, "strategy": strategy, "mis": mis},
        )  # fmt: skip
        what = f"picture, strategy ({strategy}), mis {mis!r}"
        hint = "every vertex has a density from each end, also the two at the connection"
        share = last if s == n + 1 else inner
        wanted = np.repeat((share * whole)[..., None], 3, axis=-1)
        check_picture(steady, wanted, what, 4e-3, hint)


def test_long_paths(submission):
    """Up to six segments in a sphere, all strategies; and one of the longest alone."""
    random = submission.random
    radius = drawn.between(random, 0.6, 1.5)
    albedo = drawn.between(random, 0.6, 0.8)
    intensity = drawn.between(random, 1, 5)
    n = 5
    options = drawn.inside(random, radius)
    scene = {"name": NAME, "radius": radius, "albedo": albedo, "intensity": intensity}
    each = [formulas.sphere_bounce(k, radius, albedo, intensity) for k in range(1, n + 1)]
    steady, _ = render(
        submission, "inside_sphere", options, integrator={"max_depth": n + 1}, spp=32, seeds=8,
        **scene
    )  # fmt: skip
    hint = "all strategies of a path share it, however long it is"
    what = f"film's mean, max_depth {n + 1}"
    wanted = np.full(3, sum(each[:n]))
    expect.estimate(steady.mean((1, 2)), wanted, what, rounding=3e-3, hint=hint)
    strategy = "{},{}".format(*random.permutation([3, 4]))
    steady, _ = render(
        submission, "inside_sphere", options, spp=128, seeds=8, **scene,
        integrator={"max_depth": n + 1, "strategy": strategy, "mis": "none"},
    )  # fmt: skip
    hint = "alone and with mis 'none', each strategy has all light of its length"
    what = f"film's mean, strategy ({strategy})"
    expect.estimate(steady.mean((1, 2)), np.full(3, each[n - 1]), what, rounding=3e-3, hint=hint)


def test_connections_in_water(submission):
    """Light and camera in a bubble, in a sphere full of water: two reflections, one connection."""
    random = submission.random
    scene = {"radius": drawn.between(random, 0.8, 1.5), "albedo": drawn.between(random, 0.6, 0.8)}
    scene |= {"bubble": 0.02, "index": drawn.between(random, 1.2, 1.5)}
    scene["intensity"] = drawn.between(random, 1, 5)
    wanted, first = formulas.around_bubble(2, **scene)
    chords = 2 * scene["index"] * scene["radius"]
    bins = (4, first, chords / 4)
    options = drawn.inside(random, scene["radius"]) | {"origin": [0, 0, 0], "bins": bins}
    steady, transient = render(
        submission, "inside_bubble", options, name=NAME, spp=512,
        integrator={"max_depth": 5, "strategy": "3,3", "mis": "none"}, **scene,
    )  # fmt: skip
    hint = "in a medium of the index n light takes n times as long, also along a connection"
    what = "film's mean, strategy (3,3)"
    expect.estimate(steady.mean((1, 2)), np.full(3, wanted), what, rounding=1e-2, hint=hint)
    masses = wanted * formulas.chord_masses(np.linspace(0, 2, 5) * scene["radius"], scene["radius"])
    expect.estimate(
        transient.mean((1, 2))[..., 0], masses, "radiance per bin", rounding=1e-2, hint=hint
    )


def test_by_way_of_a_floor(submission):
    """A ceiling that gets a panel's light from a floor: all strategies of three segments."""
    random = submission.random
    options, panel = drawn.at_ceiling(random)
    color = drawn.color(random)
    albedo = drawn.between(random, 0.5, 0.8)
    x, y = (0.5 * k for k in options["target"][:2])
    screen = [x, y, drawn.between(random, 0.2, 0.4), drawn.between(random, 0.15, 0.25)]
    view = formulas.View(**options)
    part, opl, densities = formulas.by_floor(view, 1.0, panel, 1.0, albedo, screen)
    low, high = np.quantile(opl, [0.1, 0.9])
    bins = (4, low, (high - low) / 4)
    for s, mis in ((0, "balance"), (1, "balance"), (2, "balance"), (2, "none"), (3, "balance")):
        strategy = f"{s},{4 - s}"
        steady, transient = render(
            submission, "by_floor", options | {"bins": bins}, name=NAME, ceiling=1.0, panel=panel,
            radiance=color, albedo=albedo, screen=screen, spp=2048 if s % 3 == 0 else 512,
            integrator={"max_depth": 3, "strategy": strategy, "mis": mis},
        )  # fmt: skip
        share = part if mis == "none" else part * densities[s] / sum(densities)
        hint = "what is between two vertices hides one from the other; p over the sum of all p"
        what = f"film's mean, strategy ({strategy}), mis {mis!r}"
        wanted = share.sum() * np.array(color)
        expect.estimate(steady.mean((1, 2)), wanted, what, rounding=1e-2, hint=hint)
        if 0 < s < 3:
            hint = "the length of a path is the same whatever finds it"
            check_bins(transient, share * color[0], opl, bins, hint)


def test_between_two_surfaces(submission):
    """Light that a colored mirror has sent from one part of a floor to another."""
    options, scene, part, _, both = mirrored(submission.random)
    color = np.array(scene["lamp"][1]) * scene["color"]
    for strategy, k in (("1,4", 0), ("4,1", 1)):
        steady, _ = render(
            submission, "by_mirror", options, name=NAME, spp=1 << 12, **scene,
            integrator={"max_depth": 4, "strategy": strategy, "mis": "balance"},
        )  # fmt: skip
        wanted = (part * both[k] / (both[0] + both[1])).sum() * color
        hint = "a mirror between two vertices: two strategies connect to it, and have no share"
        what = f"film's mean, strategy ({strategy}), mis 'balance'"
        expect.estimate(steady.mean((1, 2)), wanted, what, rounding=5e-3, hint=hint)


def test_several_lamps(submission):
    """A spot, a panel and a point on a floor that is seen from its back, in color."""
    random = submission.random
    options = drawn.over_floor(random)
    view = formulas.View(**options)
    d = view.pixels(16)
    at = drawn.above(random)
    spot = drawn.above(random)
    colors = [drawn.color(random) for _ in range(3)]
    cone = [[*drawn.between(random, -0.3, 0.3, 2), 0.0], drawn.between(random, 35, 45), 25.0]
    height = drawn.between(random, 2.3, 2.6)
    half = drawn.between(random, 0.2, 0.4)
    weight = drawn.between(random, 1.5, 3)
    parts = [formulas.under_point(view, d, at, 1.0)[0].mean()]
    parts.append(formulas.under_point(view, d, spot, 1.0, cone=cone)[0].mean())
    parts.append(formulas.under_panel(view, half, height, 1.0)[0].sum())
    wanted = sum(p * np.array(c) for p, c in zip(parts, colors, strict=True))
    steady, _ = render(
        submission, "floor", options, name=NAME, lights=[[at, colors[0]]], spp=1024,
        panels=[[height, half, colors[2]]], spots=[[spot, colors[1], *cone, weight]],
        integrator={"max_depth": 2}, flipped=True,
    )  # fmt: skip
    hint = "emission.ratio knows every lamp: which one, and how wide it shines"
    expect.estimate(steady.mean((1, 2)), wanted, "film's mean", rounding=4e-3, hint=hint)


def test_what_is_in_the_way(submission):
    """Squares that hide the floor from camera and lamp, and one before the near plane."""
    near_clip = drawn.between(submission.random, 0.3, 0.6)
    in_the_way(submission, NAME, near_clip=near_clip, spp=4096)


def test_another_room(submission):
    """The room with a mirror, of another size, with a lamp of another color."""
    agrees_with_a_path_tracer(submission, NAME, "mirror", mirror=True)


def test_random_numbers(submission):
    """Equal seeds, a different seed, and a single path."""
    same_numbers(submission, NAME)
