"""a3.lens: any camera, any points, and windows that are not the whole film, in its middle."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest
from test_lens import (
    along,
    check_area,
    check_density,
    check_importance,
    check_way,
    inside,
    points,
)

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_lens


def camera(random, **more):
    """A camera somewhere, with a film that is not square."""
    return {
        "origin": drawn.between(random, -2, 2, 3),
        "target": [*drawn.between(random, -2, 2, 2), 4.0],
        "size": drawn.pixels(random, 5, 14),
        "fov": drawn.between(random, 25, 80),
    } | more


def crop(random, size):
    """A part of a film: first pixel, and size."""
    first = [int(random.integers(1, n // 2)) for n in size]
    return *first, *(int(random.integers(2, n - k + 1)) for n, k in zip(size, first, strict=True))


def seen(view, position, depth, near=0.0, far=np.inf):
    return inside(view, position) & (depth > 0) & (depth >= near) & (depth <= far)


def test_any_camera(submission):
    """Area, density and importance of cameras, one of them mirrored."""
    random = submission.random
    for mirrored in (False, True):
        view, d, came = along(submission, camera(random, mirrored=mirrored))
        check_area(came, view)
        check_density(came, view, d)
        check_importance(came, view, d)


def test_any_point(submission):
    """Points before and behind a camera: many, and one alone."""
    random = submission.random
    near = drawn.between(random, 0.3, 0.9)
    far = drawn.between(random, 2, 3)
    options = camera(random, near_clip=near, far_clip=far)
    view = formulas.View(**options)
    p = np.concatenate([points(view)[0], view.origin + random.normal(0, 2, (200, 3))])
    position, depth = view.position(p)
    close = np.abs(position - np.round(position)) < 2e-3  # at an edge, perhaps
    clear = ~close.any(1) & (np.abs(depth - near) > 1e-3) & (np.abs(depth - far) > 1e-3)
    clear &= np.abs(depth) > 0.05
    p = p[clear]
    position = position[clear]
    depth = depth[clear]
    wanted = seen(view, position, depth, near, far)
    for some in (np.arange(len(p)), np.flatnonzero(wanted)[:1]):
        came = submission.ask("lens_arrival", view=options, p=p[some])
        hint = "in the window, before the camera, with a depth from near_clip to far_clip"
        expect.close(came["seen"], wanted[some], "seen", hint=hint)
        still = "write p - lens; p -= lens changes the caller's points"
        expect.close(came["points"].T, p[some], "points after the call", atol=1e-5, hint=still)
        there = some[wanted[some]]
        mine = np.flatnonzero(wanted[some])
        hint = "(x, y) / z, less the corner, over the extent, times the size"
        at = came["position"].T[mine]
        expect.close(at, position[there], "position", atol=5e-3, hint=hint)
        d = p - view.origin
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        density = np.where(wanted, view.density(d), 0)[some]
        hint = "density of the camera's ray to the point; 0 where it is not seen"
        expect.close(came["density"], density, "density", rtol=1e-3, hint=hint)
        before = depth[some] > 0
        front = {
            name: came[name][..., before] for name in ("distance", "direction", "lens", "near")
        }
        check_way(front, view, p[some][before], depth[some][before], near)
        origin = np.broadcast_to(view.origin, (len(some), 3))
        expect.close(came["sampled"].T, origin, "sample", atol=1e-5, hint="it is the position")


@pytest.mark.parametrize("kind", ["cropped", "shifted"])
def test_shifted_and_cropped(submission, kind):
    """A cropped film, and a film with its middle not on the axis."""
    random = submission.random
    options = camera(random)
    if kind == "cropped":
        options["crop"] = crop(random, options["size"])
    else:
        options["shift"] = drawn.between(random, 0.1, 0.3, 2)
    view, d, came = along(submission, options)
    hint = "corner, extent, first and size of Window are those of the pixels that are rendered"
    expect.close(np.ravel(came["area"])[0], view.area, "area of the window", rtol=1e-3, hint=hint)
    expect.close(came["density"], view.density(d), "density of directions", rtol=1e-3, hint=hint)
    p, position, depth = points(view)
    clear = ~(np.abs(position - np.round(position)) < 5e-3).any(1)
    p = p[clear]
    position = position[clear]
    depth = depth[clear]
    came = submission.ask("lens_arrival", view=options, p=p)
    wanted = inside(view, position)
    expect.close(came["position"].T[wanted], position[wanted], "position", atol=1e-2, hint=hint)
    expect.close(came["seen"], wanted, "seen", hint=hint)
