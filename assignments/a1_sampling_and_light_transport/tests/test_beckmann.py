"""a1.beckmann."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_beckmann

ALPHAS = [
    formulas.inputs.number("smooth", 0.05, low=0.04, high=0.08),
    formulas.inputs.number("rough", 0.4, low=0.3, high=0.6),
    formulas.inputs.number("very rough", 1.5, low=1.3, high=1.8),
]


@pytest.mark.parametrize("alpha", ALPHAS)
def test_points_follow_the_density(submission, alpha):
    """Normals in rings and sectors, against the integrated density."""
    m = submission.ask(
        "warp",
        name="square_to_beckmann",
        points=formulas.uniform(100_000, submission.seed),
        parameters=[alpha],
    )
    expect.finite(m, "normals")
    expect.close(np.linalg.norm(m, axis=1), 1.0, "length of the normals", rtol=1e-4)
    theta, ring = formulas.beckmann_cells(alpha, 12)
    came = np.arctan2(np.hypot(m[:, 0], m[:, 1]), m[:, 2])
    expect.true(came.max() <= np.pi / 2, "no normal may point below the horizon")
    counts, *_ = np.histogram2d(came, formulas.azimuth(m), [theta, np.linspace(0, 1, 9)])
    expect.histogram(
        counts,
        np.outer(ring, np.full(8, 1 / 8)),
        f"normals in rings and sectors for alpha = {alpha}",
        hint="is alpha squared, the azimuth uniform, and u = 0 harmless?",
    )


@pytest.mark.parametrize("alpha", ALPHAS)
def test_density(submission, alpha):
    """The density above the horizon."""
    theta = np.arctan(alpha * np.linspace(0, 3, 31))
    theta, phi = (each.ravel() for each in np.meshgrid(theta, [0.0, 1.0, 4.0], indexing="ij"))
    m = formulas.direction(theta, phi)
    came = submission.ask("warp_pdf", name="square_to_beckmann_pdf", points=m, parameters=[alpha])
    expect.close(
        came,
        formulas.beckmann_pdf(m.astype(np.float32).astype(float), alpha),
        f"density for alpha = {alpha}",
        rtol=2e-3,
        atol=1e-6 / alpha**2,
        x=theta,
        x_label="theta [rad]",
        hint="cos(theta)^3 below, pi alpha^2 before; compute the tangent from x and y, not from z",
    )


@pytest.mark.parametrize("alpha", [0.2, 1.5])
def test_density_integrates_to_one(submission, alpha):
    """The integral over all directions."""
    m, solid_angle = formulas.sphere_grid(1200, 8)
    came = submission.ask("warp_pdf", name="square_to_beckmann_pdf", points=m, parameters=[alpha])
    expect.finite(came, "density", hint="0 / 0 at the horizon?")
    hint = "is the normalization 1 / (pi alpha^2), and the density 0 below the horizon?"
    expect.close(np.sum(came * solid_angle), 1.0, "integral of the density", rtol=5e-3, hint=hint)


def test_density_at_the_horizon_and_below(submission):
    """0, and finite; just above the horizon, too."""
    m = np.array([[1, 0, 1e-4], [1, 0, 0], [0, -1, 0], [0.6, 0, -0.8], [0, 0, -1]])
    for alpha in ALPHAS:
        came = submission.ask(
            "warp_pdf", name="square_to_beckmann_pdf", points=m, parameters=[alpha]
        )
        hint = "the tangent is infinite at the horizon, and even powers hide the sign of z"
        what = f"density at z <= 1e-4 for alpha = {alpha}"
        x = np.arccos(m[:, 2])
        x_label = "theta [rad]"
        expect.close(came, 0.0, what, atol=1e-6, hint=hint, x=x, x_label=x_label)


def test_corners_of_the_square(submission):
    """Samples at 0 and just below 1 give unit vectors above the horizon."""
    m = submission.ask("warp", name="square_to_beckmann", points=formulas.CORNERS, parameters=[0.5])
    expect.finite(m, "normals for samples at the square's edges", hint="the logarithm of 0?")
    expect.close(np.linalg.norm(m, axis=1), 1.0, "length of the normals", rtol=1e-4)
    expect.true(m[:, 2].min() > 0, "normals must point above the horizon")
