"""a1.lights: lights in other places."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_lights


def test_transformed_sphere(submission):
    """A sphere that a transform turns, scales and moves."""
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2.5 * turn, [1, 2, 3]
    light = ["Sphere", [[1.0, 0.0, 0.0], 0.4, 2.0], {"transform": matrix}]
    centre, radius = np.array([1, 4.5, 3]), 1.0
    aside = np.array([3.0, 0, -1]) / np.sqrt(10)  # At right angles to the centre
    v = np.array([centre, centre + 0.95 * aside, centre + 1.2 * aside])
    came = submission.ask(
        "light_record", light=light, o=np.zeros((3, 3)), v=v / np.linalg.norm(v, axis=1)[:, None]
    )
    far = np.linalg.norm(centre)
    pdf = formulas.cone_pdf(radius, far)
    hint = "the transform moves the centre, and its scale changes the radius"
    expect.close(came["pdf"], [pdf, pdf, 0], "pdf of a moved sphere", rtol=1e-3, hint=hint)
    expect.close(came["distance"][:1], far - radius, "distance of it", rtol=1e-3, hint=hint)


def test_irradiance_from_other_points(submission):
    """Light of a triangle and a sphere together, at points around them."""
    corners = np.array([[2.0, -1, 1], [2.0, 1, 1.5], [2.5, 0, 3]])
    group = [
        "SurfaceGroup",
        [["Triangle", [*corners.tolist(), 4.0], {}], ["Sphere", [[-1.0, 0.0, 3.0], 0.6, 1.5], {}]],
        {},
    ]
    normal = np.array([0.0, 0, 1])
    out = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    for shift, o in enumerate(np.array([[0.0, 0, 0], [0.5, -0.5, 0.2], [3.5, 0, 0]])):
        facing = out @ (o - corners[0]) > 0
        wanted = formulas.sphere_irradiance([-1, 0, 3], 0.6, o, normal, 1.5)
        wanted += formulas.polygon_irradiance(corners, o, normal, 4.0) if facing else 0
        record = submission.ask(
            "light_sample",
            light=group,
            o=np.tile(o, (60_000, 1)),
            points=formulas.uniform(60_000, submission.seed + shift),
        )
        cos = np.maximum(record["d"] @ normal, 0)
        samples = (record["weight"][:, 1] * cos).reshape(30, -1).mean(axis=1)
        hint = "light leaves a triangle on the side of its normal only, but hides what is behind"
        expect.estimate(samples, wanted, f"irradiance at {o.tolist()}", rounding=1e-3, hint=hint)
