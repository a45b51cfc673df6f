"""a3.lens: the camera as what light arrives at."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect
from tofrender.course.judge.factors import Ratio

pytestmark = pytest.mark.a3_lens

number = formulas.inputs.number
SQUARE = {"origin": (0.3, -0.2, 1.5), "target": (1.0, 0.5, 0.0), "size": (8, 8)}
SQUARE["fov"] = number("narrow view", 40.0, low=30, high=48)
WIDE = {"origin": (1.0, 2.0, -1.0), "target": (0.2, 0.0, 0.4), "size": (12, 5)}
WIDE["fov"] = number("wide view", 65.0, low=55, high=75)
NEAR = number("near plane", 0.2, low=0.1, high=0.4)
VIEWS = pytest.mark.parametrize("options", [SQUARE, WIDE], ids=["square", "wide"])


def along(submission, options, count=200):
    """A view, uniform directions in its window, and results of the lens for them."""
    view = formulas.View(**options)
    u, v = formulas.even(count, 2)
    d = view.direction(u * view.crop[2], v * view.crop[3])
    return view, d, submission.ask("lens_along", view=options, d=d)


def points(view, count=100):
    """Points before the camera, in and around its window, and their film positions."""
    u, v, w = formulas.even(count, 3)
    width, height = view.size
    d = view.direction((1.6 * u - 0.3) * width, (1.6 * v - 0.3) * height)
    p = view.origin + (0.5 + 3 * w)[:, None] * d
    return p, *view.position(p)


def inside(view, position):
    x, y, width, height = view.crop
    low = np.array([x, y])
    high = np.array([x + width, y + height])
    return np.all((position >= low) & (position < high), axis=-1)


def check_area(came, view):
    """A, one number."""
    hint = "A is width times height of the window at distance 1: Window has its extent"
    expect.close(np.ravel(came["area"])[0], view.area, "area of the window", hint=hint)


def check_density(came, view, d):
    cos = d @ view.axis
    ratios = {
        "cos": Ratio(cos, "three cosines, not two: one for the slant, two for the distance"),
        "1/cos": Ratio(1 / cos, "three cosines, not four: that is the importance"),
        "1/4": "the extent is the whole window, not half of it",
    }
    hint = "1 / (A cos³): one cosine for the slant, two for the distance 1 / cos"
    what = "density of directions"
    expect.close(came["density"], view.density(d), what, rtol=1e-3, hint=hint, ratios=ratios)


def check_importance(came, view, d):
    cos = d @ view.axis
    ratios = {"cos": Ratio(cos, "1 / (A cos⁴): the density over the cosine at the lens")}
    hint = "1 / (A cos⁴): the density over the cosine at the lens"
    wanted = view.density(d) / cos
    expect.close(came["importance"], wanted, "importance", rtol=1e-3, hint=hint, ratios=ratios)


def check_way(came, view, p, depth, near_clip):
    """Everything between points and lens."""
    way = view.origin - p
    distance = np.linalg.norm(way, axis=1)
    hint = "from the point to the lens, not to the near plane"
    expect.close(came["distance"], distance, "distance", hint=hint)
    hint = "a unit vector from the point to the lens"
    direction = way / distance[:, None]
    expect.close(came["direction"].T, direction, "direction", atol=1e-4, hint=hint)
    wanted = np.broadcast_to(view.origin, p.shape)
    expect.close(came["lens"].T, wanted, "lens", atol=1e-5, hint="the point that was given")
    near = view.origin - way * (near_clip / depth)[:, None]
    hint = "at the depth near_clip along the axis: at near_clip / cos along the ray"
    expect.close(came["near"].T, near, "near", atol=1e-4, hint=hint)


@VIEWS
def test_density(submission, options):
    """Area of the window, and the density of camera rays."""
    view, d, came = along(submission, options)
    check_area(came, view)
    check_density(came, view, d)


@VIEWS
def test_importance(submission, options):
    """We of directions."""
    view, d, came = along(submission, options)
    check_importance(came, view, d)


@VIEWS
def test_where_light_lands(submission, options):
    """Film positions of points, and the density of their rays."""
    view = formulas.View(**options)
    p, position, _ = points(view)
    came = submission.ask("lens_arrival", view=options, p=p)
    seen = inside(view, position)
    hint = "(x, y) / z, less the corner, over the extent, times the size, from the first pixel on"
    expect.close(came["position"].T[seen], position[seen], "position", atol=2e-3, hint=hint)
    d = p - view.origin
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    hint = "density of the camera's ray to the point; 0 where it is not seen"
    wanted = np.where(seen, view.density(d), 0)
    expect.close(came["density"], wanted, "density", rtol=1e-3, hint=hint)


@VIEWS
def test_distance_and_direction(submission, options):
    """Distances, directions, lens points and where rays cross the near plane."""
    options = options | {"near_clip": NEAR}
    view = formulas.View(**options)
    p, _, depth = points(view)
    came = submission.ask("lens_arrival", view=options, p=p)
    check_way(came, view, p, depth, NEAR)


def test_what_is_not_seen(submission):
    """Points outside of the window, behind the camera, and beyond the clips."""
    options = SQUARE | {"near_clip": 0.7, "far_clip": 2.0}
    view = formulas.View(**options)
    p, position, depth = points(view)
    clear = np.minimum(abs(depth - 0.7), abs(depth - 2.0)) > 1e-4  # rounding decides at the clips
    p = p[clear]
    position = position[clear]
    depth = depth[clear]
    behind = 2 * view.origin - p[:20]
    wanted = inside(view, position) & (depth >= 0.7) & (depth <= 2.0)
    wanted = np.append(wanted, np.zeros(20, bool))
    came = submission.ask("lens_arrival", view=options, p=np.concatenate([p, behind]))
    hint = "in the window, before the camera, with a depth from near_clip to far_clip"
    expect.close(came["seen"], wanted, "seen", hint=hint)
    hint = "density is 0 where a point is not seen"
    expect.close(came["density"][~wanted], 0 * came["density"][~wanted], "density", hint=hint)


def test_pinhole_is_a_point(submission):
    """The lens of a pinhole."""
    view = formulas.View(**SQUARE)
    came = submission.ask("lens_arrival", view=SQUARE, p=points(view, 10)[0])
    wanted = np.broadcast_to(view.origin, (10, 3))
    expect.close(came["sampled"].T, wanted, "sample", atol=1e-5, hint="it is the position")
