"""Points on relay walls of any shapes."""

import numpy as np
import pytest
from scenes_staff import diffuse, square

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_relay_wall


def drawn(random, number):
    """Shapes in a row, and points above them with the number of the shape each meets, or -1."""
    parts = {"plaster": diffuse(0.5)}  # One material, of all of them
    plaster = {"type": "ref", "id": "plaster"}
    for k in range(number):
        ball = {"type": "sphere", "center": [3.0 * k, 0.0, 0.0], "radius": 1.0, "bsdf": plaster}
        tile = square((3.0 * k, 0.0, 0.0), 1.0, plaster)
        disk = tile | {"type": "disk"}
        cube = tile | {"type": "cube"}
        parts[f"part_{k}"] = (tile, disk, cube, ball)[int(random.integers(4))]
    there = random.integers(-1, number, 200)
    x = np.where(there < 0, -4.0, 3.0 * there) + random.uniform(-0.6, 0.6, 200)
    return parts, there, x, random.uniform(-0.6, 0.6, 200)


def ask(submission, parts, names, x, y):
    came = submission.ask("on_shapes", parts=parts, names=names, x=x, y=y, z=5.0)
    expect.shape(came, x.shape, "the mask", hint="one entry for each interaction")
    return np.asarray(came, bool)


def test_any_wall(submission):
    """Some of many shapes of any kind, in any order; rays that meet nothing."""
    random = submission.random
    number = int(random.integers(4, 8))
    parts, there, x, y = drawn(random, number)
    for size in (1, int(random.integers(2, number)), number):
        chosen = random.permutation(number)[:size]
        came = ask(submission, parts, [f"part_{k}" for k in chosen], x, y)
        wanted = np.isin(there, chosen)
        wrong = int((came != wanted).sum())
        what = f"points on {size} of {number} shapes: {wrong} of {wanted.size} answers are wrong"
        expect.true(wrong == 0, what, hint="compare si.shape with each shape, and join by or")


def test_any_number_of_points(submission):
    """One interaction, and interactions that are all nothing."""
    random = submission.random
    parts, there, x, y = drawn(random, 4)
    k = int(np.argmax(there >= 0))
    for names, wanted in (([f"part_{there[k]}"], True), ([f"part_{(there[k] + 1) % 4}"], False)):
        came = ask(submission, parts, names, x[k : k + 1], y[k : k + 1])
        expect.true(came[0] == wanted, f"a single point: expected {wanted}, came {came[0]}")
    came = ask(submission, parts, list(parts)[1:], x + 50.0, y)
    expect.true(not came.any(), "rays that meet nothing: none is on the wall; came some")
