"""a1.triangles_and_caps: drawn triangles of any size, and drawn caps."""

import drawn_staff as drawn
import formulas
import lights_staff as lights
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_triangles_and_caps


def triangle(random, size):
    """A triangle of a given size near the origin, with sides of similar length."""
    at = lights.around(random, 1, 1.0, 2.0)[0]
    return size * np.array(lights.triangle(random, at)[1][:3])


def test_regular_triangle_numbers(submission):
    """Numbers that cover the square evenly, twice, on triangles of any size and shape."""
    random = submission.random
    square = drawn.regular(random)
    for size in (1.0, 10 ** random.uniform(-3, 3)):
        corners = triangle(random, size)
        thin = random.uniform(0.05, 0.5)
        corners[2] = (1 - thin) * corners[1] + thin * corners[2]
        p = drawn.asked_twice(submission, "triangle", "points", square, corners=corners)
        where, beside = formulas.triangle_square(corners, p)
        expect.true(beside.max() < 1e-4 * size, "all points must lie in the triangle's plane")
        inside = (where >= -1e-3).all() and (where <= 1 + 1e-3).all()
        expect.true(inside, "all points must lie inside of the triangle")
        counts = formulas.cells(np.clip(where, 0, 1), (0, 0), (1, 1), (10, 10))
        drawn.even(counts, np.full((10, 10), 1 / 100), "points in parts of equal area")
    one = submission.ask("triangle", corners=corners, points=square[:1])
    expect.close(one, p[:1], "a single point, as one of many", rtol=1e-3, atol=1e-5 * size)


def test_triangle_density_of_any_size(submission):
    """1 / area on the triangle and its edges, with a tolerance for rounding; 0 farther away."""
    random = submission.random
    for size in (10 ** random.uniform(-3, -1), 1.0, 10 ** random.uniform(1, 3)):
        corners = triangle(random, size)
        edges = np.roll(corners, -1, axis=0) - corners
        longest = np.linalg.norm(edges, axis=1).max()
        area = formulas.triangle_area(corners)
        normal = np.cross(edges[0], edges[1]) / (2 * area)
        t = random.uniform(0.05, 0.95, (3, 40, 1))
        on_edges = (corners[:, None] + t * edges[:, None]).reshape(-1, 3)
        outwards = np.cross(edges, normal)
        outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
        outwards = np.repeat(outwards, 40, axis=0)
        b = random.dirichlet([1, 1, 1], 60)
        within = b @ corners
        above = np.where(random.random((60, 1)) < 0.5, 1, -1) * normal
        on = [
            within,
            on_edges,
            on_edges + 2e-6 * longest * outwards,
            within + 2e-6 * longest * above,
        ]
        on = np.concatenate(
            [*on, submission.ask("triangle", corners=corners, points=formulas.CORNERS)]
        )
        came = submission.ask("triangle_pdf", corners=corners, p=on)
        what = f"density on a triangle of the size {size:.3g}"
        hint = "allow for about 1e-5 of the longest edge: points on the edges belong to it"
        expect.close(came, 1 / area, what, rtol=1e-3, hint=hint)
        off = 10 ** random.uniform(-2.5, 1, (180, 1)) * longest
        beside = np.concatenate([on_edges + off[:120] * outwards, within + off[120:] * above])
        came = submission.ask("triangle_pdf", corners=corners, p=beside)
        what = f"density beside and above a triangle of the size {size:.3g}"
        hint = "0 farther off than about 1e-5 of the longest edge"
        expect.close(came, 0.0, what, hint=hint)


def test_regular_cap_numbers(submission):
    """Numbers that cover the square evenly, twice, on a cap; and on two, by an array of cosines."""
    random = submission.random
    square = drawn.regular(random)
    one = float(random.uniform(-1, 0.99))
    cosines = random.uniform([-1, 0.5], [0, 0.998])[random.integers(0, 2, len(square))]
    name = "sample_sphere_cap"
    for c in (one, cosines):
        if c is one:
            what = f"directions for cos_theta_max = {c:.3g}"
            v = drawn.asked_twice(submission, "warp", what, square, name=name, parameters=[c])
            single = submission.ask("warp", name=name, points=square[:1], parameters=[c])
            expect.close(single, v[:1], "a single direction, as one of many", atol=1e-4)
        else:
            what = "directions for an array of cos_theta_max, one for each lane"
            v = submission.ask("warp", name=name, points=square, parameters=[c])
            expect.finite(v, what)
        expect.close(np.linalg.norm(v, axis=1), 1.0, f"length of {what}", rtol=1e-4)
        u = (1 - v[:, 2]) / (1 - c)
        expect.true(u.max() < 1 + 1e-3, f"{what} must lie in the cap")
        counts = np.stack([np.clip(u, 0, 1), formulas.azimuth(v)], axis=1)
        counts = formulas.cells(counts, (0, 0), (1, 1), (8, 8))
        drawn.even(counts, np.full((8, 8), 1 / 64), f"{what}, in parts of equal area")
        edges = np.concatenate([formulas.CORNERS] * 2)
        c = c if c is one else np.resize(cosines, 32)
        v = submission.ask("warp", name=name, points=edges, parameters=[c])
        expect.finite(v, "directions for samples at the square's edges")
        expect.close(np.linalg.norm(v, axis=1), 1.0, "length of the vectors", rtol=1e-3)
        low = np.min(v[:, 2] - c)
        text = "samples at the square's edges must stay in the cap"
        expect.true(low >= -1e-5, text, hint="z runs from cos_theta_max to 1")


def test_cap_density_elsewhere(submission):
    """1 / solid angle inside, 0 outside, for one cosine and for one in each lane."""
    random = submission.random
    for c in (float(random.uniform(-0.9, 0.99)), random.uniform(-1, 0.999, 400)):
        cosine = np.broadcast_to(c, 400)
        inside = random.random(400) < 0.5
        t = random.uniform(0.002, 1, 400)
        z = np.where(inside, cosine + t * (1 - cosine), cosine - t * (1 + cosine))
        v = formulas.direction(np.arccos(z), random.uniform(0, 2 * np.pi, 400))
        clear = np.abs(z - cosine) > 1e-5
        came = submission.ask("warp_pdf", name="sample_sphere_cap_pdf", points=v, parameters=[c])
        wanted = np.where(inside, 1 / (2 * np.pi * (1 - cosine)), 0)
        what = "density of the cap" if isinstance(c, float) else "density for an array of cosines"
        hint = "1 / solid angle in the cap, 0 outside; a number or a Dr.Jit float"
        expect.close(came[clear], wanted[clear], what, rtol=2e-3, hint=hint)
