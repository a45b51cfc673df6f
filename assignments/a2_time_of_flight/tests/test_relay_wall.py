"""Points on the relay wall."""

import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_relay_wall

X = np.array([-2.4, -1.6, -0.3, 0.4, 1.7, 2.9, 4.0, 0.1])
Y = np.array([0.0, 0.5, -0.9, 0.2, 0.3, -0.8, 0.0, 3.0])
SHAPE = np.array(["left", "left", "middle", "middle", "right", "right", "", ""])


def on_wall(submission, names):
    came = submission.ask("on_wall", names=names, x=X, y=Y)
    expect.shape(came, X.shape, "the mask", hint="one entry for each interaction")
    return np.asarray(came, bool)


def expect_mask(came, names):
    wanted = np.isin(SHAPE, names)
    text = f"points on {' and '.join(names)}: expected {wanted.tolist()}, came {came.tolist()}"
    expect.true(np.array_equal(came, wanted), text, hint="compare si.shape with each shape, or")


def test_one_shape(submission):
    """A wall of one shape, next to other shapes."""
    expect_mask(on_wall(submission, ["middle"]), ["middle"])


def test_any_of_several_shapes(submission):
    """A wall of two shapes: a point is on it if it is on either."""
    for names in (["left", "right"], ["right", "middle"], ["left", "middle", "right"]):
        expect_mask(on_wall(submission, names), names)
