"""a1.triangles_and_caps."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_triangles_and_caps

CORNERS = np.array([[0.0, 0, 0], [1, 1, 1], [0.5, 1, 2]])
CAP = np.cos(formulas.inputs.number("cap", np.pi / 4, low=0.6, high=1.0))
CORNERS[2, 2] = formulas.inputs.number("corner", 2.0, low=1.5, high=2.5)


def test_triangle_points(submission):
    """Equal areas of the triangle get equal shares of the points."""
    p = submission.ask(
        "triangle", corners=CORNERS, points=formulas.uniform(100_000, submission.seed)
    )
    expect.finite(p, "points on the triangle")
    square, beside = formulas.triangle_square(CORNERS, p)
    expect.true(beside.max() < 1e-5, "all points must lie in the triangle's plane")
    inside = (square >= -1e-5).all() and (square <= 1 + 1e-5).all()
    expect.true(inside, "all points must lie inside of the triangle", hint="fold b1 + b2 > 1 back")
    expect.histogram(
        formulas.cells(np.clip(square, 0, 1), (0, 0), (1, 1), (12, 12)),
        np.full((12, 12), 1 / 144),
        "points in parts of the triangle of equal area",
        hint="b1 needs a root: triangle strips get shorter toward a corner",
    )


def test_triangle_density(submission):
    """1 / area on the triangle, 0 off it."""
    b = np.array([[1 / 3, 1 / 3], [0.1, 0.1], [0.8, 0.1], [0.05, 0.9]])
    p = CORNERS[0] + b @ (CORNERS[1:] - CORNERS[0])
    area = formulas.triangle_area(CORNERS)
    on = submission.ask("triangle_pdf", corners=CORNERS, p=p)
    missed = np.any(np.asarray(on) == 0)
    tolerance = "0 on the triangle: allow for rounding, about 1e-5 of the longest edge"
    hint = tolerance if missed else "1 / area of the triangle"
    ratios = dict.fromkeys(("2", "1/2"), "the cross product is twice the area")
    expect.close(on, 1 / area, "density on the triangle", hint=hint, ratios=ratios)
    b = np.array([[0.6, 0.6], [-0.1, 0.5], [0.5, -0.1], [1.5, 0.2]])
    beside = CORNERS[0] + b @ (CORNERS[1:] - CORNERS[0])
    off = submission.ask("triangle_pdf", corners=CORNERS, p=beside)
    expect.close(off, 0.0, "density beside the triangle", hint="three edges bound the triangle")
    normal = np.cross(CORNERS[1], CORNERS[2])
    above = submission.ask("triangle_pdf", corners=CORNERS, p=p + 0.2 * normal)
    expect.close(above, 0.0, "density above the plane", hint="such points are never sampled")


@pytest.mark.parametrize("cos_theta_max", [-1.0, 0.0, CAP, 0.97])
def test_cap_points(submission, cos_theta_max):
    """Zones of equal height have equal area, in the cap."""
    v = submission.ask(
        "warp",
        name="sample_sphere_cap",
        points=formulas.uniform(100_000, submission.seed),
        parameters=[cos_theta_max],
    )
    expect.finite(v, "directions of the cap")
    expect.close(np.linalg.norm(v, axis=1), 1.0, "length of the vectors", rtol=1e-4)
    u = (1 - v[:, 2]) / (1 - cos_theta_max)
    expect.true(
        u.max() < 1 + 1e-4,
        "all directions must lie in the cap",
        hint="z runs from cos_theta_max to 1; the cosine is passed, not the angle",
    )
    expect.histogram(
        formulas.cells(
            np.stack([np.clip(u, 0, 1), formulas.azimuth(v)], 1), (0, 0), (1, 1), (8, 8)
        ),
        np.full((8, 8), 1 / 64),
        "directions in zones of the cap of equal area",
        hint="z is uniform between cos_theta_max and 1, the azimuth between 0 and 2 pi",
    )


@pytest.mark.parametrize("cos_theta_max", [-0.5, 0.0, 0.7, 0.97])
def test_cap_density(submission, cos_theta_max):
    """1 / solid angle in the cap, 0 outside."""
    z = cos_theta_max + np.array([-0.02, -0.01, 0.01, 0.02])
    v = formulas.direction(*np.meshgrid(np.arccos(z), [0.0, 2.0], indexing="ij")).reshape(-1, 3)
    came = submission.ask(
        "warp_pdf", name="sample_sphere_cap_pdf", points=v, parameters=[cos_theta_max]
    )
    inside = v[:, 2] > cos_theta_max
    expect.close(
        came[inside],
        1 / (2 * np.pi * (1 - cos_theta_max)),
        "density in the cap",
        hint="the solid angle of a cap is 2 pi (1 - cos_theta_max)",
    )
    expect.close(came[~inside], 0.0, "density outside of the cap", hint="it ends at cos_theta_max")


def test_corners_of_the_square(submission):
    """Samples at 0 and just below 1 give points on the triangle and in the cap."""
    p = submission.ask("triangle", corners=CORNERS, points=formulas.CORNERS)
    expect.finite(p, "points on the triangle for samples at the square's edges")
    square, _ = formulas.triangle_square(CORNERS, p)
    expect.true((square[:, 0] <= 1 + 1e-4).all(), "samples at the edges must stay on the triangle")
    v = submission.ask("warp", name="sample_sphere_cap", points=formulas.CORNERS, parameters=[-1.0])
    hint = "a root of a number that rounding has made negative?"
    expect.finite(v, "directions of the cap for samples at the square's edges", hint=hint)
