"""a1.disk: drawn numbers."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_disk


def test_regular_numbers(submission):
    """Numbers that cover the square evenly, twice."""
    square = drawn.regular(submission.random)
    what = "points of the disk"
    p = drawn.asked_twice(submission, "warp", what, square, name="square_to_uniform_disk")
    r2 = np.sum(p**2, axis=1)
    expect.true(r2.max() <= 1 + 1e-5, f"all points must lie in the disk; one has r² = {r2.max():g}")
    hint = "radii from 0 to 1"
    expect.true(r2.min() < 5e-4, f"points near the middle: none has r² < {r2.min():g}", hint=hint)
    polar = np.stack([np.minimum(r2, 1), formulas.azimuth(p)], axis=1)
    drawn.even(formulas.cells(polar, (0, 0), (1, 1), (8, 16)), np.full((8, 16), 1 / 128), what)
    one = submission.ask("warp", name="square_to_uniform_disk", points=square[:1])
    expect.close(one, p[:1], "a single point, as one of many", atol=1e-5)


def test_density_at_the_edge(submission):
    """1/pi on the edge itself, where rounding puts points a little outside; 0 beyond."""
    random = submission.random
    phi = random.uniform(0, 2 * np.pi, 4000)
    edge = np.stack([np.cos(phi), np.sin(phi)], axis=1).astype(np.float32).astype(float)
    edge = edge[np.sum(edge**2, axis=1) <= 1 + 1.1e-7]
    on = submission.ask("warp_pdf", name="square_to_uniform_disk_pdf", points=edge)
    hint = "the edge belongs to the disk; allow for a rounding of 1e-7"
    expect.close(on, 1 / np.pi, "density on the edge", hint=hint)
    r = np.append(random.uniform(1.0003, 3, 100), 10 ** random.uniform(0.5, 6, 50))
    phi = random.uniform(0, 2 * np.pi, 150)
    beyond = (r * np.stack([np.cos(phi), np.sin(phi)])).T
    off = submission.ask("warp_pdf", name="square_to_uniform_disk_pdf", points=beyond)
    expect.close(off, 0.0, "density off the disk", hint="no point is ever sampled there")
