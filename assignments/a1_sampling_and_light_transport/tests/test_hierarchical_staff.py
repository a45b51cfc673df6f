"""a1.hierarchical: drawn images."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_hierarchical


def image(random, n, span=2.0):
    """A random image with dark texels, a dark block, and often a dark border."""
    values = 10 ** random.uniform(-span, 0, (n, n))
    values[random.random((n, n)) < 0.2] = 0
    row, column = random.integers(0, 2, 2) * (n // 2)
    values[row : row + n // 2, column : column + n // 2] = 0
    values = np.roll(values, 1, axis=random.integers(0, 2)) if random.random() < 0.5 else values
    values[n // 2, n // 2] = values[0, 0] = values[-1, 0] = 1
    return values


def test_regular_numbers(submission):
    """Numbers that cover the square evenly stay even, for any size of the image."""
    random = submission.random
    for n in (4, int(random.choice([2, 8, 16]))):
        wanted = image(random, n, 1.0)
        square = drawn.regular(random)
        p = drawn.asked_twice(submission, "hierarchical", "points", square, image=wanted)
        expect.true((p >= 0).all() and (p < 1).all(), "all points must lie in [0, 1)^2")
        lower = p[np.argsort(square[:, 1]), 1] < 0.5
        switches = np.count_nonzero(np.diff(lower))
        hint = "first y selects a half of the image, then x a quadrant of that, and so on"
        text = f"the half of the image must depend on y alone; it switches {switches} times with y"
        expect.true(switches <= 4, text, hint=hint)
        counts = formulas.cells(p[:, ::-1], (0, 0), (1, 1), (n, n))
        dark = counts[wanted == 0].sum()
        expect.true(dark == 0, f"no point may lie in a texel that is 0; {dark:.0f} do")
        drawn.even(counts[wanted > 0], wanted[wanted > 0] / wanted.sum(), "points in each texel")


def test_edges_of_the_square(submission):
    """Samples at 0 and just below 1 stay in [0, 1)^2, and out of dark texels."""
    random = submission.random
    n = int(random.choice([2, 4, 8, 32]))
    values = image(random, n)
    u = np.append(formulas.CORNERS[:, 0], random.integers(0, 2**24, 48) / 2**24)
    square = np.stack([each.ravel() for each in np.meshgrid(u, u)], axis=1)
    for turned in (values, values[::-1, ::-1], values.T):
        p = submission.ask("hierarchical", image=turned, points=square)
        expect.finite(p, "points", hint="0 / 0 in dark blocks?")
        expect.true((p >= 0).all() and (p < 1).all(), "all points must lie in [0, 1)^2")
        column, row = (np.floor(p.astype(np.float32) * n).astype(int)).T
        dark = np.sum(turned[row, column] == 0)
        hint = "rounding must not lift a stretched number to 1, nor a choice into a dark block"
        text = f"no point may lie in a texel that is 0; {dark} of {len(p)} do"
        expect.true(dark <= 0.001 * len(p), text, hint=hint)


def test_density_of_other_images(submission):
    """The brightness over its mean, at the texels' edges and just outside of the square, too."""
    random = submission.random
    n = int(random.choice([2, 8, 64]))
    values = image(random, n, 4.0)
    corners = np.stack([each.ravel() for each in np.mgrid[0:n, 0:n]], axis=1) / n
    p = np.concatenate([corners, random.random((500, 2))])
    came = submission.ask("hierarchical_pdf", image=values, p=p)
    column, row = np.floor(p.astype(np.float32) * n).astype(int).clip(0, n - 1).T
    wanted = values[row, column] / values.mean()
    hint = "texel (i, j) covers [i/n, (i+1)/n) x [j/n, (j+1)/n)"
    expect.close(came, wanted, "density", rtol=1e-3, atol=1e-6, hint=hint)
    out = np.concatenate([-(10 ** random.uniform(-4, 5, 40)), 1 + 10 ** random.uniform(-4, 5, 40)])
    outside = np.stack([out, random.random(80)], axis=1)
    outside = np.concatenate([outside, outside[:, ::-1], outside[:, :1] * [1, 1]])
    came = submission.ask("hierarchical_pdf", image=values, p=outside)
    expect.close(came, 0.0, "density outside of the unit square", hint="0, just outside as well")
