"""The Cramér-Rao bound of drawn responses."""

import formulas_staff as formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_bound


def test_any_response(submission):
    """Drawn signal, background, tail and width of bins."""
    random = submission.random
    for _ in range(4):
        sigma = np.exp(random.uniform(np.log(3e-11), np.log(3e-10)))
        tail_s = random.choice([0.0, random.uniform(0.3, 2.0) * sigma])
        width = random.uniform(0.1, 1.5) * sigma * formulas.SPEED_OF_LIGHT
        signal = np.exp(random.uniform(0, 8, random.integers(1, 4, 2)))
        background = random.uniform(0.01, 20.0, signal.shape)
        found = submission.ask(
            "depth_bound",
            signal=signal,
            background=background,
            sigma_s=sigma,
            tail_s=tail_s,
            width=width,
        )
        wanted = formulas.depth_bound(signal, background, sigma, tail_s, width)
        what = f"bounds [m], σ = {1e12 * sigma:.0f} ps, tail {1e12 * tail_s:.0f} ps"
        expect.close(found, wanted, what, rtol=1e-3)


def test_long_tail(submission):
    """A tail that is much longer than the Gaussian, and the shape () of one pixel."""
    random = submission.random
    sigma = random.uniform(2e-11, 4e-11)
    tail_s = random.uniform(8, 12) * sigma
    width = 0.5 * sigma * formulas.SPEED_OF_LIGHT
    for signal, background in ((200.0, 0.0), (3000.0, 0.05)):
        found = submission.ask(
            "depth_bound",
            signal=np.array(signal),
            background=background,
            sigma_s=sigma,
            tail_s=tail_s,
            width=width,
        )
        wanted = formulas.depth_bound(np.array(signal), background, sigma, tail_s, width)
        hint = "sum all bins that the response reaches, its tail included"
        what = f"bound [m], tail {tail_s / sigma:.1f} σ, {background:g} counts of background"
        expect.close(found, wanted, what, rtol=1e-3, hint=hint)
