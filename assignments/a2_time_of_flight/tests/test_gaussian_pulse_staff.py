"""The Gaussian pulse, of any width."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_gaussian_pulse

T = np.concatenate([np.linspace(-7, 7, 701), [-60.0, -20.0, 20.0, 60.0]])  # widths
CELLS = 4000


def drawn(submission):
    """Pairs of a width and the results of its pulse; the random numbers are stratified."""
    random = submission.random
    widths = np.exp(random.uniform(np.log([1e-3, 0.2]), np.log([0.1, 3.0])))
    widths = [float(width) for width in random.permutation(widths)]
    xi = (random.permutation(CELLS) + random.random(CELLS)) / CELLS
    came = submission.ask("pulses_side_by_side", widths=widths, t=T, xi=xi)
    return list(zip(widths, came, strict=True)), xi


def test_any_width(submission):
    """Two pulses, from a millimeter to a few meters, side by side."""
    for width, pulse in drawn(submission)[0]:
        what = f"of a pulse of σ = {width:.4g} m"
        expect.close(pulse["width_opl"], width, f"width_opl {what}", rtol=1e-5)
        expect.true(pulse["kept"], "arrays that eval, cdf and sample get: must stay as they are")
        expect.close(pulse["support"], [-5 * width, 5 * width], f"support {what}", rtol=1e-5)
        wanted = 1 / (width * np.sqrt(2 * np.pi))
        expect.true(pulse["is_number"], f"normalization {what}: a float; came something else")
        expect.close(pulse["normalization"], wanted, f"normalization {what}", rtol=1e-5)
        axis = {"x": T, "x_label": "t [σ]"}
        density = formulas.gaussian(T, 1.0)
        cdf = formulas.gaussian_cdf(T, 1.0)
        came = pulse["density"] * width
        expect.close(came, density, f"density x σ {what}", rtol=2e-4, atol=1e-6, **axis)
        expect.close(pulse["cdf"], cdf, f"cdf {what}", rtol=0, atol=3e-6, **axis)
        one = [np.ravel(each)[0] for each in pulse["one"]]
        wanted = [pulse[name][0] for name in ("density", "cdf", "offsets", "weight")]
        what = f"eval, cdf, offset and weight {what}, asked for one number"
        expect.close(one, wanted, what, rtol=1e-4, atol=1e-6 * width)


def test_samples_of_any_width(submission):
    """Even random numbers become offsets with even shares of the energy, the same again."""
    came, xi = drawn(submission)
    for width, pulse in came:
        offsets = pulse["offsets"]
        expect.shape(offsets, xi.shape, "offsets", hint="one for each random number")
        expect.finite(offsets, "offsets")
        hint = "the offset is a function of ξ: t = σ √2 erfinv(2ξ - 1)"
        shares = np.sort(formulas.gaussian_cdf(offsets / width, 1.0))
        even = (np.arange(CELLS) + 0.5) / CELLS
        what = f"energy below the offsets, in order, for evenly spread ξ and σ = {width:.4g} m"
        expect.close(shares, even, what, rtol=0, atol=2e-3, hint=hint)
        what = "offsets for the same ξ once more"
        expect.close(pulse["again"], offsets, what, rtol=1e-5, atol=1e-6 * width, hint=hint)
        expect.close(pulse["weight"], np.ones(CELLS), "weights", rtol=1e-5)
