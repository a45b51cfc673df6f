"""a1.lights: drawn lights, seen from drawn points."""

import drawn_staff as drawn
import formulas
import lights_staff as lights
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_lights


def compare(record, light, o, v, what):
    """Every field of records along directions `v` from `o`."""
    wanted = lights.seen(light, o, v)
    clear = wanted.pop("clear")
    expect.true(clear.mean() > 0.5, f"{what}: too few records to compare")
    record = {name: values[clear] for name, values in record.items()}
    wanted = {name: values[clear] for name, values in wanted.items()}
    hit = np.isfinite(wanted["distance"])
    hint = "valid says whether the light is met, on whichever side"
    expect.close(record["valid"], hit, f"valid of {what}", hint=hint)
    hint = "the density of the direction; 0 in lanes that miss"
    expect.close(record["pdf"], wanted["pdf"], f"pdf of {what}", rtol=5e-3, hint=hint)
    hint = "each channel's emission; 0 on the dark side, and in lanes that miss"
    radiance = wanted["radiance"]
    expect.close(record["radiance"], radiance, f"radiance of {what}", rtol=1e-4, hint=hint)
    weight = radiance / np.where(hit, wanted["pdf"], 1)[:, None]
    expect.close(record["weight"], weight, f"weight of {what}", rtol=5e-3, hint="radiance / pdf")
    expect.close(record["o"], o[clear], f"o of {what}", atol=1e-5)
    expect.close(record["d"], v[clear], f"d of {what}", atol=1e-5)
    distance = wanted["distance"][hit]
    expect.close(record["distance"][hit], distance, f"distance of {what}", rtol=2e-3, atol=2e-3)
    p = (o[clear] + np.where(hit, wanted["distance"], 0)[:, None] * v[clear])[hit]
    expect.close(record["p"][hit], p, f"p of {what}", rtol=2e-3, atol=5e-3)
    hint = "the unit normal, on the side that emits, wherever it is seen from"
    expect.close(record["n"][hit], wanted["n"][hit], f"n of {what}", atol=0.02, hint=hint)
    return hit


def group(random):
    """A group with a group, a black triangle and lights behind each other in it."""
    at = lights.around(random, 4)
    inner = [
        "SurfaceGroup",
        [lights.sphere(random, at[0], 0.6), lights.triangle(random, at[1])],
        {},
    ]
    black = lights.triangle(random, 0.7 * at[2], emission=0.0)
    behind = lights.sphere(random, 1.5 * at[2], 1.2)
    return ["SurfaceGroup", [black, inner, behind, lights.triangle(random, at[3])], {}], at


def test_records_of_drawn_lights(submission):
    """All fields of records of given and of sampled directions, from another point in each lane."""
    random = submission.random
    both, at = group(random)
    single = lights.triangle(random, at[1])
    ball = lights.sphere(random, at[0], random.uniform(0.5, 1.5))
    cases = {"a triangle": single, "a sphere": ball, "a group": both}
    for what, light in cases.items():
        o = random.uniform(-0.4, 0.4, (3000, 3))
        o[::6] += 2.5 * at[random.integers(0, 4, 500)]  # From the other sides
        o[3::6] = at[0] + random.normal(0, 0.1, (500, 3))  # From inside the ball
        target = at[random.integers(0, 4, 3000)] + random.normal(0, 0.5, (3000, 3))
        v = np.where(random.random((3000, 1)) < 0.8, target - o, drawn.directions(random, 3000))
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        came = submission.ask("light_record", light=light, o=o, v=v)
        hit = compare(came, light, o, v, f"given directions, {what}")
        expect.close(came["pdf_method"], came["pdf"], "pdf(o, v), and pdf of record(o, v)")
        expect.true(hit.any() and not hit.all(), f"{what}: directions that hit, and that miss")
        square = formulas.uniform(3000, random.integers(2**31))
        came = submission.ask("light_sample", light=light, o=o, points=square)
        expect.finite(came["d"], f"d of {what}")
        expect.close(np.linalg.norm(came["d"], axis=1), 1.0, f"length of d of {what}", rtol=1e-4)
        share = came["valid"].mean()
        expect.true(share > 0.998, f"all sampled directions must meet {what}; {share:.3g} do")
        compare(came, light, o, came["d"] / 1.0, f"sampled directions, {what}")
    one = submission.ask("light_record", light=both, o=o[:1], v=v)
    compare(one, both, np.repeat(o[:1], len(v), axis=0), v, "many directions from one point")


def test_regular_numbers(submission):
    """Directions of numbers that cover the square evenly, twice."""
    random = submission.random
    square = drawn.regular(random)
    o = random.uniform(-0.5, 0.5, 3)
    at = lights.around(random, 3)
    single = lights.triangle(random, at[0])
    p = _twice(submission, single, o, square)["p"]
    where, beside = formulas.triangle_square(single[1][:3], p)
    expect.true(beside.max() < 1e-3, "p must lie in the triangle's plane")
    counts = formulas.cells(np.clip(where, 0, 1), (0, 0), (1, 1), (10, 10))
    drawn.even(counts, np.full((10, 10), 1 / 100), "points of a triangle in parts of equal area")
    for quotient in (random.uniform(0.05, 0.95), 10 ** random.uniform(-3, -2)):
        radius = quotient * np.linalg.norm(at[1] - o)
        light = lights.sphere(random, at[1], radius)
        record = _twice(submission, light, o, np.concatenate([square, formulas.CORNERS]))
        hint = "it was aimed at the sphere: clamp the discriminant at 0, at the cone's edge, too"
        expect.close(record["valid"], 1.0, "valid of directions to a sphere", hint=hint)
        what = f"directions to a sphere, r / D = {quotient:.3g}"
        _even_cone(record["d"][: len(square)], at[1] - o, quotient, what)
        v = (at[1] - o)[None] / np.linalg.norm(at[1] - o)
        given = submission.ask("light_record", light=light, o=o[None], v=v)["pdf"]
        pdf = formulas.cone_pdf(quotient, 1.0)
        expect.close(given, pdf, f"pdf of a given direction, r / D = {quotient:.3g}", rtol=2e-3)
    inside = at[1] + 0.9 * radius * drawn.directions(random, 1)[0]
    d = _twice(submission, light, inside, square)["d"]
    whole = np.stack([(1 + d[:, 2]) / 2, formulas.azimuth(d)], axis=1)
    counts = formulas.cells(np.clip(whole, 0, 1), (0, 0), (1, 1), (8, 8))
    hint = "from inside every direction meets the sphere, with equal density"
    drawn.even(counts, np.full((8, 8), 1 / 64), "directions from inside a sphere", hint=hint)
    shapes = [lights.sphere(random, each, 0.3 * np.linalg.norm(each - o)) for each in at]
    d = _twice(submission, ["SurfaceGroup", shapes, {}], o, square)["d"]
    to = (at - o) / np.linalg.norm(at - o, axis=1, keepdims=True)
    picked = np.argmax(d @ to.T, axis=1)
    hint = "each shape is picked with equal chance"
    drawn.even(np.bincount(picked, minlength=3), np.full(3, 1 / 3), "shapes picked", hint=hint)
    for k in range(3):
        _even_cone(d[picked == k], to[k], 0.3, "directions to one shape of a group", 4)


def _twice(submission, light, o, square):
    """Records of sampled directions from one point, the same for the same numbers."""
    points = np.concatenate([square, square])
    record = submission.ask("light_sample", light=light, o=o[None], points=points)
    expect.finite(record["d"], "d")
    first, again = np.split(record["d"], 2)
    hint = "a direction is a function of the two numbers"
    expect.close(again, first, "d for the same numbers again", atol=1e-4, hint=hint)
    return {name: values[: len(square)] for name, values in record.items()}


def _even_cone(d, axis, quotient, what, parts=8):
    """Directions must be even in a cone with the given sine."""
    axis = axis / np.linalg.norm(axis)
    x, y = lights._across(axis)
    below = quotient**2 / (1 + np.sqrt(1 - quotient**2))
    u = 0.5 * np.sum((d - axis) ** 2, axis=1) / below
    expect.true(u.max() < 1 + 5e-3, f"{what} must lie in its cone")
    cells = np.stack([np.clip(u, 0, 1), np.arctan2(d @ y, d @ x) / (2 * np.pi) % 1], axis=1)
    counts = formulas.cells(cells, (0, 0), (1, 1), (parts, parts))
    drawn.even(counts, np.full((parts, parts), parts**-2), what)


def test_transformed_sphere(submission):
    """A sphere that a transform turns, scales and moves."""
    random = submission.random
    scale = random.uniform(0.3, 3)
    move = random.uniform(-2, 2, 3)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * lights.turn(random), move
    center = random.uniform(-1, 1, 3)
    radius = random.uniform(0.3, 0.6)
    light = lights.sphere(random, center, radius)
    moved = matrix[:3, :3] @ center + move
    plain = [light[0], [moved.tolist(), scale * radius, light[1][2]], {}]
    o = moved + scale * radius * random.uniform(1.5, 4, (400, 1)) * drawn.directions(random, 400)
    v = moved + 0.7 * scale * radius * random.normal(size=(400, 3)) - o
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    light[2]["transform"] = matrix if random.random() < 0.5 else matrix.tolist()
    came = submission.ask("light_record", light=light, o=o, v=v)
    expected = lights.seen(plain, o, v)
    clear = expected["clear"]
    hint = "the transform moves the center, and its scale changes the radius"
    what = "pdf of a moved sphere"
    expect.close(came["pdf"][clear], expected["pdf"][clear], what, rtol=1e-2, hint=hint)
    hit = clear & np.isfinite(expected["distance"])
    for name in ("distance", "n", "radiance"):
        what = f"{name} of a moved sphere"
        expect.close(came[name][hit], expected[name][hit], what, rtol=1e-2, atol=2e-2, hint=hint)


def test_irradiance_from_other_points(submission):
    """Light of all kinds together in each channel, with one light before another."""
    random = submission.random
    normal = lights.turn(random)[:, 2]
    x, y = lights._across(normal)
    o = random.uniform(-1, 1, 3)
    phi = random.uniform(0, 2 * np.pi) + np.arange(3) * 2 * np.pi / 3
    low = random.uniform(0.7, 1.0, 3)
    to = np.outer(np.cos(phi), x) + np.outer(np.sin(phi), y) + low[:, None] * normal
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    flat = lights.triangle(random, 3 * to[0])
    flat[1][:3] = (np.array(flat[1][:3]) + o).tolist()
    ball = lights.sphere(random, o + random.uniform(2, 4) * to[1], random.uniform(0.3, 0.8))
    far = lights.sphere(random, o + 6 * to[2], 2.0)
    near = lights.sphere(random, o + 2.5 * to[2], random.uniform(0.2, 0.6))
    between = o + 3.5 * (to[0] + to[1])  # Its light goes away from o
    away = lights.triangle(random, between - o)
    away[1][:3] = (np.array(away[1][:3])[[0, 2, 1]] + o).tolist()

    def of(light):
        return formulas.sphere_irradiance(light[1][0], light[1][1], o, normal, 1.0)

    wanted = formulas.polygon_irradiance(flat[1][:3], o, normal, 1.0) * np.array(flat[1][3])
    wanted += of(ball) * np.array(ball[1][2]) + of(near) * np.array(near[1][2])
    wanted += (of(far) - of(near)) * np.array(far[1][2])
    light = ["SurfaceGroup", [flat, near, ball, far, away], {}]
    square = formulas.uniform(64_000, random.integers(2**31))
    record = submission.ask("light_sample", light=light, o=o[None], points=square)
    cos = np.maximum(record["d"] @ normal, 0)
    samples = (record["weight"] * cos[:, None]).reshape(32, 2000, 3).mean(axis=1)
    hint = "light leaves a triangle on the side of its normal only, but hides what is behind"
    what = "irradiance of two triangles and three spheres, R, G and B"
    expect.estimate(samples, wanted, what, rounding=1e-3, hint=hint)
    relative = samples / wanted * np.sqrt(2000)
    hint = "of n shapes each is picked with equal chance, and the density is the mean of theirs"
    expect.noise(relative, 4.0, "one sample of the irradiance, as a part of it", hint=hint)


def test_who_emits(submission):
    """A light emits if any channel does, a group if any of its shapes does."""
    random = submission.random
    at = lights.around(random, 2)
    black = lights.triangle(random, at[0], emission=[0.0, 0.0, 0.0])
    blue = ["Sphere", [at[1].tolist(), 0.5, [0.0, 0.0, float(random.uniform(0.1, 3))]], {}]
    groups = [[black], [black, blue], [blue, black], [black, ["SurfaceGroup", [black, blue], {}]]]
    each = [black, blue, *(["SurfaceGroup", members, {}] for members in groups)]
    came = submission.ask("emissive", lights=each)
    wanted = np.array([0, 1, 0, 1, 1, 1])
    expect.close(came, wanted, "is_emissive of lights and of groups", hint="any of the shapes")
