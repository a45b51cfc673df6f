"""a1.hierarchical (bonus)."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_hierarchical

TWO = np.array([[8.0, 8.0], [3.0, 1.0]])


def picture(n=16):
    """An image with a bright spot, a gradient, and a dark part."""
    y, x = np.mgrid[0:n, 0:n] / n
    image = 0.2 + x + 20 * np.exp(-60 * ((x - 0.3) ** 2 + (y - 0.7) ** 2))
    image[n // 8 : n // 3, n // 2 :] = 0
    return image


def drawn(submission, image):
    """Many points, all of them in [0, 1)^2."""
    points = formulas.uniform(200_000, submission.seed)
    p = submission.ask("hierarchical", image=image, points=points)
    expect.finite(p, "points")
    expect.true((p >= 0).all() and (p < 1).all(), "all points must lie in [0, 1)^2")
    return p


def test_two_by_two(submission):
    """The four quadrants in proportion to their brightness."""
    p = drawn(submission, TWO)
    counts = formulas.cells(p[:, ::-1], (0, 0), (1, 1), (2, 2))
    hint = "y decides between the rows; is the first number x? Each row has its own columns"
    expect.histogram(counts, TWO / TWO.sum(), "points in row, column", hint=hint)


def test_image(submission):
    """A 16 x 16 image, and evenly distributed points within each texel."""
    image = picture()
    p = drawn(submission, image)
    fine = np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)
    counts = formulas.cells(p[:, ::-1], (0, 0), (1, 1), fine.shape)
    hint = "is what is left of each number stretched to [0, 1) before it goes on?"
    expect.histogram(counts, fine / fine.sum(), "points in quarters of each texel", hint=hint)


def test_density(submission):
    """The brightness over its mean, 0 outside."""
    image = picture()
    y, x = (np.mgrid[0:32, 0:32] + 0.5) / 32
    p = np.stack([x.ravel(), y.ravel()], axis=1)
    came = submission.ask("hierarchical_pdf", image=image, p=p)
    wanted = np.repeat(np.repeat(image, 2, axis=0), 2, axis=1).ravel() / image.mean()
    expect.close(came, wanted, "density", hint="per unit area: the mean over the square is 1")
    outside = np.array([[-0.1, 0.5], [1.1, 0.5], [0.5, -0.1], [0.5, 1.1]])
    came = submission.ask("hierarchical_pdf", image=image, p=outside)
    expect.close(came, 0.0, "density outside of the unit square", hint="mask the gather")
