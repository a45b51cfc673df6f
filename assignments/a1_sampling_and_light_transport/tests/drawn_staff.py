"""Helpers for tests with random inputs: regular sets of numbers, and checks of their warps."""

from __future__ import annotations

import numpy as np

from tofrender.course.judge import expect

LARGEST = 0.35
"""Largest chi-square per cell of regular numbers; of independent ones it is about 1."""


def regular(random, side=256):
    """One point in each cell of a grid over the unit square, in any order, shape (side^2, 2)."""
    cell = np.stack(np.divmod(random.permutation(side * side), side), axis=1)
    return np.floor((cell + random.random((side * side, 2))) / side * 2**24) / 2**24


def even(counts, probabilities, what, *, hint=""):
    """Check that regular points fill the cells much more evenly than independent points."""
    expect.finite(counts, what)
    expected = probabilities * (counts.sum() / probabilities.sum())
    chi2 = float(np.mean((counts - expected) ** 2 / expected))
    expect.true(
        chi2 < LARGEST,
        f"{what}: of numbers that cover the square evenly, each cell must get its share; "
        f"chi-square per cell is {chi2:.3g}, must be below {LARGEST}",
        hint=hint or "is the density right? a warp is a function of its two numbers alone",
    )


def asked_twice(submission, probe, what, square, **arguments):
    """Return the warped points of a probe; equal points of the square must give equal results."""
    rows = submission.ask(probe, points=np.concatenate([square, square]), **arguments)
    expect.finite(rows, what)
    first, again = np.split(rows, 2)
    hint = "a warp is a function of its two numbers; it draws none of its own"
    expect.close(
        again, first, f"{what}, for the same numbers again", rtol=1e-3, atol=1e-4, hint=hint
    )
    return first


def directions(random, count):
    """Uniform directions, shape (count, 3)."""
    v = random.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def tilted_normals(origin, z, normal, size, bsdf):
    """A square, `size` half its side, that looks along `z` and has other shading normals."""
    x = np.cross(z, [0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0])
    x = size * x / np.linalg.norm(x)
    y = np.cross(z, x)
    corners = np.array([origin - x - y, origin + x - y, origin + x + y, origin - x + y])
    return {
        "type": "with normals",
        "corners": corners,
        "normals": np.tile(normal, (4, 1)),
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        "bsdf": bsdf,
    }


def near(random, axis, angle):
    """A direction at an angle to an axis [rad]."""
    x = np.cross(axis, directions(random, 1)[0])
    return np.cos(angle) * axis + np.sin(angle) * x / np.linalg.norm(x)
