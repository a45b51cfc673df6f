"""a1.lights."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_lights

CORNERS = np.array([[-1.0, 0.2, 2.0], [1.5, -0.5, 2.5], [0.3, 1.8, 3.0]])  # its light goes to +z
FLIPPED = CORNERS[[0, 2, 1]]
TRIANGLE = ["Triangle", [FLIPPED.tolist()[0], *FLIPPED.tolist()[1:], 3.0], {}]
CENTER = np.array([0.5, -0.4, 2.0])
RADIUS = formulas.inputs.number("radius", 0.7, low=0.6, high=0.8)
SPHERE = ["Sphere", [CENTER.tolist(), RADIUS, 2.0], {}]
ORIGIN = np.array([0.1, 0.2, -0.3])
INSIDE = CENTER + np.array([0.2, 0.1, 0.3])
COUNT = 60_000


def sampled(submission, light, o=ORIGIN, count=COUNT, shift=0, only_valid=True):
    """Records of sampled directions from one point: all, or only directions that hit the light."""
    record = submission.ask(
        "light_sample",
        light=light,
        o=np.tile(o, (count, 1)),
        points=formulas.uniform(count, submission.seed + shift),
    )
    what = light[0]
    for name in ("d", "pdf", "weight"):
        expect.finite(record[name], f"{name} of the records of {what}")
    expect.close(np.linalg.norm(record["d"], axis=1), 1.0, f"length of d of {what}", rtol=1e-4)
    if not only_valid:
        return record
    valid = record["valid"] > 0  # rounding may let a direction miss the light's edge
    expect.true(valid.mean() > 0.999, f"all sampled directions must meet the light, {what}")
    return {name: values[valid] for name, values in record.items()}


def check_points(record, o, what):
    """Check that point, direction and distance of a record agree."""
    p = o + record["distance"][:, None] * record["d"]
    hint = "p is where the ray from o in the direction d first meets the light"
    expect.close(record["p"], p, f"p of {what}, from o, d and distance", atol=2e-3, hint=hint)


def recorded(submission, light, o, v):
    """Records of given directions."""
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    return submission.ask("light_record", light=light, o=np.broadcast_to(o, v.shape), v=v)


def in_cone(axis, cos_max, v):
    """Where directions lie in a cone, as numbers from 0 to 1 that are uniform if they are."""
    axis = axis / np.linalg.norm(axis)
    x = np.cross(axis, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    u = 0.5 * np.sum((v - axis) ** 2, axis=1) / (1 - cos_max)  # |v - axis|^2 = 2 (1 - cos)
    phi = np.arctan2(v @ np.cross(axis, x), v @ x) / (2 * np.pi) % 1
    return np.stack([u, phi], axis=1)


def test_triangle_samples(submission):
    """Points are uniform on the surface, and the density is per solid angle."""
    record = sampled(submission, TRIANGLE)
    square, beside = formulas.triangle_square(FLIPPED, record["p"])
    expect.true(beside.max() < 1e-4, "p must lie in the triangle's plane")
    expect.histogram(
        formulas.cells(np.clip(square, 0, 1), (0, 0), (1, 1), (10, 10)),
        np.full((10, 10), 1 / 100),
        "points in parts of the triangle of equal area",
        hint="uniform on the surface, as sample_triangle",
    )
    area = formulas.triangle_area(FLIPPED)
    normal = np.cross(FLIPPED[1] - FLIPPED[0], FLIPPED[2] - FLIPPED[0]) / (2 * area)
    wanted = formulas.patch_pdf(record["p"], ORIGIN, normal, area)
    hint = "density per solid angle: 1 / area times distance^2 / cos at the light"
    expect.close(record["pdf"], wanted, "pdf of sampled directions", rtol=2e-3, hint=hint)
    expect.close(record["radiance"], 3.0, "radiance on the side of the normal", hint="its emission")
    weight = 3 / wanted[:, None] * np.ones(3)
    expect.close(record["weight"], weight, "weight", rtol=2e-3, hint="radiance / pdf")
    check_points(record, ORIGIN, "a triangle")


def test_triangle_density(submission):
    """The density of given directions: hits from both sides, and misses."""
    area = formulas.triangle_area(FLIPPED)
    normal = np.cross(FLIPPED[1] - FLIPPED[0], FLIPPED[2] - FLIPPED[0]) / (2 * area)
    b = np.array([[0.2, 0.3], [0.6, 0.2], [0.1, 0.8], [0.01, 0.01]])
    p = FLIPPED[0] + b @ (FLIPPED[1:] - FLIPPED[0])
    for o, light, side in ((ORIGIN, 3.0, "front"), (np.array([0.3, 0.5, 6.0]), 0.0, "back")):
        came = recorded(submission, TRIANGLE, o, p - o)
        wanted = formulas.patch_pdf(p, o, normal, area)
        hint = "density per solid angle: 1 / area times distance^2 / cos at the light"
        expect.close(came["pdf"], wanted, f"pdf seen from the {side}", rtol=2e-3, hint=hint)
        expect.close(came["pdf_method"], came["pdf"], "pdf(o, v), and pdf of record(o, v)")
        hint = "light leaves on the side of the normal only"
        expect.close(came["radiance"], light, f"radiance seen from the {side}", hint=hint)
    off = FLIPPED[0] + np.array([[0.6, 0.6], [-0.1, 0.5], [0.5, -0.1]]) @ (FLIPPED[1:] - FLIPPED[0])
    away = np.concatenate([off - ORIGIN, ORIGIN - p])
    came = recorded(submission, TRIANGLE, ORIGIN, away)
    hint = "a ray beside the triangle, and one that leaves it behind, do not meet it"
    expect.close(came["pdf"], 0.0, "pdf of directions that miss", hint=hint)
    expect.close(came["radiance"], 0.0, "radiance of directions that miss", hint=hint)


def test_sphere_samples(submission):
    """Directions are uniform in the cone that the sphere fills, from outside and inside."""
    record = sampled(submission, SPHERE)
    axis = CENTER - ORIGIN
    far = np.linalg.norm(axis)
    u = in_cone(axis, np.sqrt(1 - (RADIUS / far) ** 2), record["d"])
    expect.true(
        u[:, 0].max() < 1 + 1e-3,
        "directions must lie in the cone of the sphere",
        hint="cos(theta_max) = sqrt(D^2 - r^2) / D, around the direction to the center",
    )
    expect.histogram(
        formulas.cells(np.clip(u, 0, 1), (0, 0), (1, 1), (8, 8)),
        np.full((8, 8), 1 / 64),
        "directions in parts of the cone of equal solid angle",
        hint="turn the cap's directions from +z to the center of the sphere",
    )
    wanted = formulas.cone_pdf(RADIUS, far)
    hint = "1 / (2 pi (1 - cos(theta_max))), without a geometry factor"
    expect.close(record["pdf"], wanted, "pdf of sampled directions", rtol=1e-3, hint=hint)
    beside = np.linalg.norm(record["p"] - CENTER, axis=1)
    expect.close(beside, RADIUS, "distance of p from the center", atol=2e-3)
    check_points(record, ORIGIN, "a sphere")
    inside = sampled(submission, SPHERE, INSIDE)
    hint = "from inside every direction meets the sphere, and the root is of a negative number"
    expect.close(inside["pdf"], 0.25 / np.pi, "pdf seen from inside", hint=hint)


def test_sphere_density(submission):
    """The density of given directions: hits, misses, from inside."""
    axis = CENTER - ORIGIN
    far = np.linalg.norm(axis)
    normal = np.cross(axis, [1.0, 0.0, 0.0])
    normal /= np.linalg.norm(normal)
    height = np.array([0.0, 0.5, 0.9, 0.98, 1.02, 1.2, 3.0]) * np.tan(np.arcsin(RADIUS / far))
    v = np.concatenate([axis / far + height[:, None] * normal, [-axis]])
    came = recorded(submission, SPHERE, ORIGIN, v)
    wanted = np.where([True] * 4 + [False] * 4, formulas.cone_pdf(RADIUS, far), 0)
    hint = "1 / solid angle of the cone for what meets the sphere, 0 for the rest"
    expect.close(came["pdf"], wanted, "pdf of directions", rtol=1e-3, hint=hint)
    expect.close(came["pdf_method"], came["pdf"], "pdf(o, v), and pdf of record(o, v)")
    expect.close(came["radiance"][:, 1], np.where(wanted > 0, 2, 0), "radiance of directions")
    expect.close(came["distance"][:1], far - RADIUS, "distance of the near side", rtol=1e-3)
    v, _ = formulas.sphere_grid(8, 6)
    came = recorded(submission, SPHERE, INSIDE, v)
    hint = "from inside every direction meets the sphere"
    expect.close(came["pdf"], 0.25 / np.pi, "pdf seen from inside", hint=hint)
    expect.close(came["radiance"], 0.0, "radiance seen from inside", hint="it emits outwards")


def test_far_sphere(submission):
    """A sphere that is seen small: the cosine of its cone rounds to 1."""
    for quotient in (1e-1, 1e-2, 1e-3):
        light = ["Sphere", [[0.0, 0.0, 1 / quotient], 1.0, 1.0], {}]
        record = sampled(submission, light, np.zeros(3), 4096)
        hint = "1 - cos = 2 sin(theta / 2)^2 keeps its digits; or s^2 / (1 + sqrt(1 - s^2))"
        what = f"pdf of a sphere with radius / distance = {quotient:g}"
        expect.close(record["pdf"], formulas.cone_pdf(quotient, 1.0), what, rtol=1e-3, hint=hint)


def test_group(submission):
    """Two spheres, one partly before the other, and a triangle."""
    near = ["Sphere", [[0.0, 0.0, 2.0], 0.5, 1.0], {}]
    far = ["Sphere", [[0.4, 0.0, 8.0], 2.0, 7.0], {}]
    corners = FLIPPED - [0, 5.0, 0]
    group = ["SurfaceGroup", [near, far, ["Triangle", [*corners.tolist(), 3.0], {}]], {}]
    zero = np.zeros(3)
    middle = corners.mean(axis=0)
    points = np.array([[0, 0, 2.0], [0.3, 0, 2], [2.2, 0, 8], middle, [0, 3, 1], [0, 0, -1]])
    came = recorded(submission, group, zero, points)
    a = formulas.cone_pdf(0.5, 2.0)
    b = formulas.cone_pdf(2.0, np.hypot(8, 0.4))
    area = formulas.triangle_area(corners)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0]) / (2 * area)
    c = formulas.patch_pdf(middle[None], zero, normal, area)[0]
    hint = "the mean over all lights that could have sent the sample there, 0 for those it misses"
    wanted = np.array([a + b, a + b, b, c, 0, 0]) / 3
    expect.close(came["pdf"], wanted, "pdf of a group", rtol=1e-3, hint=hint)
    hint = "what is seen is the nearest light, not the first in the list that the ray meets"
    expect.close(came["radiance"][:, 0], [1, 1, 7, 3, 0, 0], "radiance of a group", hint=hint)
    record = sampled(submission, group, zero, shift=1)
    check_points(record, zero, "a group")
    v = record["d"].astype(float)
    again = recorded(submission, group, zero, v)
    # A direction next to a light's edge may miss it by a rounding
    equal = np.isclose(record["pdf"], again["pdf"], rtol=1e-2)
    expect.true(
        equal.mean() > 0.999,
        "sample and record must agree on the pdf of a direction",
        hint="the mean over all lights also where a direction was sampled",
    )
    equal = np.isclose(record["radiance"][:, 0], again["radiance"][:, 0])
    expect.true(equal.mean() > 0.999, "sample and record must agree on what is seen", hint=hint)


def test_irradiance(submission):
    """The mean of weight times cosine is the light that arrives."""
    o = np.zeros(3)
    normal = np.array([0.0, 0.6, 0.8])
    second = ["Sphere", [[-2.0, 1.0, 3.0], 0.4, 7.0], {}]
    spheres = formulas.sphere_irradiance(CENTER, RADIUS, o, normal, 2.0)
    spheres += formulas.sphere_irradiance([-2, 1, 3], 0.4, o, normal, 7.0)
    cases = {
        "a triangle": (TRIANGLE, formulas.polygon_irradiance(FLIPPED, o, normal, 3.0)),
        "two spheres": (["SurfaceGroup", [SPHERE, second], {}], spheres),
    }
    for shift, (name, (light, wanted)) in enumerate(cases.items()):
        record = sampled(submission, light, o, shift=2 + shift, only_valid=False)
        cos = np.maximum(record["d"] @ normal, 0)
        samples = (record["weight"][:, 1] * cos).reshape(30, -1).mean(axis=1)
        hint = "weight is radiance / pdf, and the pdf that of the direction that was sampled"
        expect.estimate(samples, wanted, f"irradiance of {name}", rounding=1e-3, hint=hint)
