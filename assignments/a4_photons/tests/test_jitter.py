"""Jitter: masses of bins, histograms of stamps, and stamps that are drawn."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_jitter

SIGMA = formulas.inputs.number("jitter [ps]", 60.0, low=50, high=70) * 1e-12
TAIL = formulas.inputs.number("tail [ps]", 90.0, low=80, high=120) * 1e-12
WIDTH = 0.015
MASSES = np.array([0.1, 0.2, 0.4, 0.2, 0.1])
LATE = np.array([0.0, 0.3, 0.7])
DETECTIONS = np.zeros((2, 12))
CYCLE = np.zeros(9)
DETECTIONS[[0, 0, 0, 1, 1], [1, 7, 11, 0, 11]] = 3.0, 1.0, 2.5, 1.5, 2.0
CYCLE[[0, 7]] = 1.0, 4.0


def compare(found, sigma_s, tail_s, width, tail=1e-6):
    """Masses of a response, by its distribution function."""
    compare_masses(found, lambda opl: formulas.cdf(opl, sigma_s, tail_s), width, tail)


def compare_masses(found, cdf, width, tail):
    """Masses by a distribution function, for as many bins as came."""
    what = f"masses of bins of {width:g} m"
    expect.finite(found, what)
    right = found.ndim == 1 and found.size % 2 and found.size >= 3
    expect.true(right, f"{what}: shape (2 n + 1,), n at least 1; came {found.shape}")
    reach = found.size // 2
    ends = cdf((np.array([-1, 1]) * (reach + 0.5)) * width)
    left_out = max(ends[0], 1 - ends[1])
    text = f"{what}: {left_out:.3g} of the stamps are left out at an end, more than {tail:g}"
    expect.true(left_out <= 1.01 * tail, text, hint="ppf says where the tails begin")
    # The tolerances allow for sums and differences in single precision
    expect.close(found.sum(), 1.0, f"sum of the {what}", rtol=3e-6)
    wanted = np.diff(cdf((np.arange(-reach, reach + 2) - 0.5) * width))
    hint = "cdf at the end of the bin less cdf at its start, (k - 1/2) to (k + 1/2) width for "
    hint += "element n + k, k bins late"
    axis = {"x": np.arange(-reach, reach + 1), "x_label": "bins late"}
    expect.close(found, wanted, what, rtol=1e-4, atol=3 * tail + 1e-6, hint=hint, **axis)


def test_gaussian_masses(submission):
    """Masses of a Gaussian."""
    found = submission.ask("kernel", sigma_s=SIGMA, tail_s=0.0, width=WIDTH)
    compare(found, SIGMA, 0.0, WIDTH)


def test_masses_with_a_tail(submission):
    """A tail makes stamps late, not early."""
    found = submission.ask("kernel", sigma_s=SIGMA, tail_s=TAIL, width=WIDTH)
    compare(found, SIGMA, TAIL, WIDTH)
    lags = np.arange(found.size) - found.size // 2
    mean = found @ lags * WIDTH / formulas.SPEED_OF_LIGHT * 1e12
    hint = "element n + k is for stamps that are k bins late"
    expect.close(mean, TAIL * 1e12, "mean delay [ps]", rtol=1e-3, hint=hint)


def test_stamps_of_detections(submission):
    """Each detection goes to the bins around it; what leaves the window is lost."""
    for masses, name in ((MASSES, "stamps"), (LATE, "late_stamps")):
        found = submission.ask("add_jitter", detections=DETECTIONS, masses=masses, periodic=False)[
            "found"
        ]
        wanted = formulas.expected(name)
        hint = (
            "masses[n + k] goes k bins later; no stamp comes in at the ends, or from another pixel"
        )
        expect.close(found, wanted, "stamps per bin", atol=1e-6, hint=hint)


def test_stamps_of_a_cycle(submission):
    """Stamps that leave a cycle appear at its other end."""
    found = submission.ask("add_jitter", detections=CYCLE, masses=MASSES, periodic=True)
    wanted = formulas.expected("stamps_of_a_cycle")
    hint = "bins are counted modulo their number"
    expect.close(found["found"], wanted, "stamps per bin of a cycle", atol=1e-6, hint=hint)


def test_drawn_lags(submission):
    """Drawn lags follow the masses."""
    came = submission.ask("sample_jitter", masses=MASSES, size=20_000, seed=submission.seed)
    lags = came["found"]
    expect.shape(lags, (20_000,), "drawn lags")
    expect.true(came["whole"], f"type of the drawn lags: integers; came {lags.dtype}")
    inside = np.abs(lags).max() <= 2
    expect.true(inside, f"drawn lags: from -2 to 2; came {lags.min()} to {lags.max()}")
    counts = np.bincount(lags + 2, minlength=5)
    expect.histogram(counts, MASSES, "drawn lags, -2 to 2 bins")
    text = "lags under the same seed: the same; under another: others"
    expect.true(came["repeats"], text, hint="all random numbers come from rng")
