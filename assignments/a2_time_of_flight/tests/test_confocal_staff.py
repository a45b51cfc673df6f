"""Confocal light around a corner: drawn patches, screens, materials, depths and filters."""

import math

import numpy as np
import pytest
from cases_staff import Case, compare
from hidden_staff import Patch, facing, legs, lit_points, one_patch, two_patches
from scenes_staff import blocked, color, diffuse, ggx, panel, placed, point, sphere, square, unit

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_confocal

NAME = "ConfocalTransientIntegrator"


def add(case, eye, p, d, sums):
    """Add a ray with known sums (light, light x length)."""
    light, moment = (np.sum(each, axis=0) for each in zip(*sums, strict=True))
    case.add(eye, p, [(light, np.divide(moment, light, where=light > 0, out=light * 0))])


def test_behind_a_screen(submission):
    """A patch that the lit point sees, one that a screen hides; lamps that do not count."""
    random = submission.random
    wall = random.uniform(0.4, 0.9, 3)
    power = float(random.uniform(1, 4))
    center = random.uniform([0.45, -0.1, 0.65], [0.6, 0.1, 0.75])
    hidden = random.uniform([-0.5, 0.05, 0.65], [-0.4, 0.15, 0.7])
    # The one that is seen turns to the hidden one, which so has a good part of the light
    to_lit = unit(np.array([0.3, 0, 0]) - center)
    to_hidden = unit(hidden - center)
    aside = unit(to_hidden - (to_hidden @ to_lit) * to_lit)
    aim = center + 0.14 * to_lit + math.sqrt(1 - 0.14**2) * aside
    seen = Patch(center, (0.3, 0.25), random.uniform(0.6, 0.9, 3), **facing(center, aim))
    other = Patch(hidden, (0.35, 0.35), (0.9, 0.9, 0.9), **facing(hidden, (0.2, 0, 0.2)))
    screen = ((-0.165, 0.08, 0.25), (1, 0, 0), (0, 1, 0), (0.385, 0.4))
    above = random.uniform([0.0, 0.3, 0.5], [0.4, 0.5, 0.7])
    dark = Patch(above, (0.15, 0.1), (0.9, 0.9, 0.9), **facing(above, (0.2, 0, 0)))
    case = Case(
        {
            "relay_wall": square((0, 0, 0), 5.0, diffuse(wall)),
            "seen": seen.turned(True) if random.integers(2) else seen.part,
            "hidden": other.part,
            "screen": {"type": "rectangle", "to_world": placed(*screen), "bsdf": diffuse(0.0)},
            "back": dark.turned(False),
            "lamp": point((0.2, -0.4, 1.5), 50.0),
            "panel": panel(2.5, 0.5, 20.0),
        }
    )
    for p, eye, d in lit_points(random, 2):
        assert not blocked(p, seen.points, *screen).any()
        assert blocked(p, other.points, *screen).all()
        add(case, eye, p, d, [one_patch(p, d, seen, wall, power)])
    case.add(eye, p, active=False)
    case.add((0, 0, 3), (0.1, 0.2, 4.0), valid=False)
    hint = (
        "connections: is p visible from the vertex (scene.ray_test)? Emitters are ignored; Φ is "
        "power; lanes that miss everything are masked"
    )
    came = case.ask(
        submission,
        NAME,
        lanes=40960,
        max_depth=4,
        power=power,
        use_nlos_only=bool(random.integers(2)),
    )
    compare(came, case, hint, most=0.13)


@pytest.mark.parametrize("use_nlos_only", [False, True])
def test_filter_of_longer_paths(submission, use_nlos_only):
    """Paths that have met the hidden patch before or after the floor count, whatever the filter."""
    random = submission.random
    wall = random.uniform(0.4, 0.9, 3)
    power = 1.0
    center = random.uniform([0.4, 0.0, 0.7], [0.6, 0.2, 0.9])
    hidden = Patch(
        center, (0.25, 0.25), random.uniform(0.5, 0.9, 3), **facing(center, (0.2, -0.3, 0.2))
    )
    floor = Patch((0, 0, 0), (0.6, 0.6), random.uniform(0.5, 0.9, 3), cells=60)
    x = floor.points[:, 0]
    z = floor.points[:, 1] + 0.6
    floor.points = np.stack([x, np.full(x.shape, -0.5), z], 1)
    floor.normal = np.array([0, 1.0, 0])
    case = Case(
        {
            "wall": square((0, 0, 0), 5.0, diffuse(wall)),
            "hidden": hidden.part,
            "floor": {
                "type": "rectangle",
                "to_world": placed((0, -0.5, 0.6), (1, 0, 0), (0, 0, -1), (0.6, 0.6)),
                "bsdf": diffuse(floor.albedo),
            },
        }
    )
    for p, _, _ in lit_points(random, 2):
        eye = p + random.uniform([-0.6, 0.3, 0.5], [-0.3, 0.5, 0.7])
        d = float(np.linalg.norm(eye - p))
        sums = [one_patch(p, d, hidden, wall, power), two_patches(p, d, hidden, floor, wall, power)]
        if not use_nlos_only:
            sums.append(one_patch(p, d, floor, wall, power))
        add(case, eye, p, d, sums)
    came = case.ask(
        submission,
        NAME,
        lanes=12288,
        max_depth=4,
        relay_wall="floor, wall",
        use_nlos_only=use_nlos_only,
    )
    hint = "a path counts if any of its vertices so far was off the wall, not just the last one"
    compare(came, case, hint, most=0.1, rounding=8e-3)


def test_lit_point_off_the_wall(submission):
    """The device looks at something hidden: then the wall is what the lit point sees."""
    random = submission.random
    far = random.uniform(0.5, 0.9)
    wall = random.uniform(0.4, 0.9, 3)
    plate = random.uniform(0.4, 0.9, 3)
    power = float(random.uniform(1, 4))
    eye = random.uniform([-0.4, -0.4, 0.1], [0.4, 0.4, 0.3])
    case = Case(
        {
            "relay_wall": square((0, 0, 0), 60.0, diffuse(wall)),
            "plate": square((0, 0, far), 0.2, diffuse(plate), down=True),
        }
    )
    d = float(np.linalg.norm(eye - (0, 0, far)))
    light = power * plate**2 * wall / (3 * math.pi**2 * far**2)
    case.add(eye, (0, 0, far), [(light, 2 * d + 2.4 * far)])
    for use_nlos_only in (False, True):
        came = case.ask(
            submission,
            NAME,
            lanes=8192,
            max_depth=3,
            power=power,
            use_nlos_only=use_nlos_only,
        )
        hint = "any of its vertices: the first one, p, may be off the wall, too"
        compare(came, case, hint, most=0.05)


def test_any_material(submission):
    """A wall of rough metal: its material for the laser and for the camera, in their direction."""
    random = submission.random
    tint = random.uniform(0.4, 0.9, 3)
    alpha = float(random.uniform(0.35, 0.6))
    metal = {"type": "roughconductor", "material": "none", "alpha": alpha, "distribution": "ggx"}
    metal["specular_reflectance"] = color(tint)
    center = random.uniform([0.1, 0.3, 0.4], [0.4, 0.6, 0.6])
    hidden = Patch(
        center, (0.2, 0.15), random.uniform(0.3, 0.9, 3), cells=60, **facing(center, (0.2, 0, 0.1))
    )
    case = Case({"relay_wall": square((0, 0, 0), 5.0, metal), "hidden": hidden.part})
    for p, eye, d in lit_points(random, 2):
        _, r = legs(p, hidden)
        wo = (hidden.points - p) / r[:, None]
        f = ggx(alpha, unit(eye - p), wo)
        cos = np.maximum(-wo @ hidden.normal, 0)
        light = f**2 * cos**2 / math.pi / r**4 * hidden.area
        both = [np.sum(light), np.sum(light * (2 * d + 2 * r))]
        add(case, eye, p, d, [[each * tint**2 * hidden.albedo for each in both]])
    came = case.ask(submission, NAME, lanes=8192, max_depth=3)
    hint = "bsdf.eval of the wall, at both ends, with si.wi toward the device; not albedo / π"
    compare(came, case, hint, most=0.18)


def test_long_paths(submission):
    """Many bounces in a colored sphere, with roulette that begins early, late or by default."""
    random = submission.random
    for options, deepest in (
        ({"max_depth": 16, "rr_depth": int(random.integers(1, 5))}, 16),
        ({}, 8),
    ):
        power = float(random.uniform(1, 4)) if options else 1.0
        radius = random.uniform(0.6, 1.6)
        albedo = random.permutation([0.9, 0.75, 0.5])
        case = Case({"relay_wall": sphere(radius, albedo), "lamp": point((0, 0, 0), 5.0)})
        paths = [
            (power * albedo**n / (2 * math.pi * radius) ** 2, (2 + (n - 1) * 4 / 3) * radius)
            for n in range(3, deepest + 1)
        ]
        for direction in random.normal(size=(2, 3)):
            case.add((0, 0, 0), direction, paths)
        more = {"power": power} if options else {}
        came = case.ask(submission, NAME, seeds=8, lanes=16384, **options, **more)
        hint = f"a bounce more is a factor ρ: Σ Φ ρⁿ / (4π² R²), n from 3 to {deepest}"
        compare(came, case, hint, most=0.03)
    came = case.ask(
        submission, NAME, lanes=512, seeds=2, max_depth=18, rr_depth=30, after=12 * radius
    )
    share = came["late"].min()
    what = f"paths that go to and fro 17 times if rr_depth = 30: all; came {100 * share:.0f} %"
    expect.true(share > 0.9, what, hint="roulette may end a path from the vertex rr_depth on")
