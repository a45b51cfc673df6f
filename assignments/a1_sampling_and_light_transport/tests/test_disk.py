"""a1.disk."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_disk

INSIDE = formulas.inputs.number("inside of the disk", 0.3, low=0.1, high=0.9)


def test_points_are_uniform(submission):
    """Equal areas of the disk get equal shares of the points."""
    p = submission.ask(
        "warp", name="square_to_uniform_disk", points=formulas.uniform(100_000, submission.seed)
    )
    expect.finite(p, "points of the disk")
    r2 = np.sum(p**2, axis=1)
    expect.true(r2.max() <= 1 + 1e-5, f"all points must lie in the disk; one has r² = {r2.max():g}")
    polar = np.stack([np.minimum(r2, 1), formulas.azimuth(p)], axis=1)
    expect.histogram(
        formulas.cells(polar, (0, 0), (1, 1), (8, 16)),
        np.full((8, 16), 1 / 128),
        "points in rings and sectors of equal area",
        hint="the radius needs a root: an area element is r dr dphi",
    )


def test_density(submission):
    """1/pi on the disk, 0 off it."""
    r = np.array([0.0, INSIDE, 0.999, 1.001, 1.2, 3.0])
    phi = np.array([0.0, 1.0, 2.5, 4.0])
    p = (r[:, None, None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)).reshape(-1, 2)
    density = submission.ask("warp_pdf", name="square_to_uniform_disk_pdf", points=p)
    on = np.repeat(r < 1, len(phi))
    ratios = {
        "π": "the density is 1 over the area, π",
        "2": "the density of (x, y) is 1 over the area, not that of (r, φ)",
    }
    what = "density on the disk"
    hint = "1 over the area"
    expect.close(density[on], 1 / np.pi, what, hint=hint, ratios=ratios)
    expect.close(density[~on], 0.0, "density off the disk", hint="no point is ever sampled there")


def test_corners_of_the_square(submission):
    """Samples at 0, at 1/2 and just below 1 give points of the disk."""
    p = submission.ask("warp", name="square_to_uniform_disk", points=formulas.CORNERS)
    expect.finite(p, "points for samples at the square's edges", hint="a division 0 / 0?")
    expect.true(
        np.sum(p**2, axis=1).max() <= 1 + 1e-5, "samples at the edges must stay in the disk"
    )
