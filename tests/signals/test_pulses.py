"""Pulses: density, cumulative energy and samples say the same, at every edge."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.support import ALPHA, COMPARISONS
from oracles import films as oracles
from scipy import integrate

from tofrender.sampling.statistics import smallest_allowed
from tofrender.signals.pulse_checks import check_pulse
from tofrender.signals.pulses import BoxPulse, GaussianPulse, KnotPulse, SampledPulse, convolve

PULSES = {
    "gaussian": GaussianPulse(0.03),
    "wide": GaussianPulse(12.0),
    "narrow": GaussianPulse(1e-4),
    "box": BoxPulse(0.3),
    "narrow box": BoxPulse(1e-4),
    "sampled": SampledPulse([1.0, 0.0, 3.0, 2.0, 0.0], -0.2, 0.125),
    "one bin": SampledPulse([4.0], 1.0, 0.5),
    "knots": KnotPulse([-0.1, 0.02, 0.05, 0.4], [1e-4, 0.5, 2.0, 3e-3]),
    "convolved": convolve(GaussianPulse(0.03), SampledPulse([1.0, 2.0], 0.0, 0.1)),
    "boxes": convolve(BoxPulse(0.1), BoxPulse(0.3)),
}

BINS = 51  # An odd number: then the chi-square distribution has a closed form
SMALLEST = smallest_allowed(ALPHA, COMPARISONS)


def uniform(n: int, seed: int) -> np.ndarray:
    """Random numbers as Mitsuba's samplers make them: multiples of 2^-24 in [0, 1)."""
    return np.random.default_rng(seed).integers(0, 1 << 24, n) / (1 << 24)


def chi_square(samples: np.ndarray, pulse) -> float:
    """P-value of samples against the density: its own integral must make them uniform."""
    low, high = pulse.support
    edges = np.linspace(low, high, 60_001)
    mass = np.append(0, called(pulse.eval, 0.5 * (edges[1:] + edges[:-1])))
    u = np.interp(samples, edges, np.cumsum(mass) / mass.sum())
    count = np.histogram(u, BINS, (0, 1))[0]
    mean = samples.size / BINS
    half = 0.5 * np.sum((count - mean) ** 2) / mean
    terms = (half**i / math.factorial(i) for i in range((BINS - 1) // 2))
    return math.exp(-half) * sum(terms)


def called(function, t) -> np.ndarray:
    return np.array(function(mi.Float(t)), dtype=np.float64)


def drawn(pulse, count: int, seed: int = 7) -> np.ndarray:
    return called(lambda xi: pulse.sample(xi)[0], uniform(count, seed))


@pytest.mark.parametrize("name", PULSES)
def test_density_integrates_to_one_and_to_the_cdf(name):
    pulse = PULSES[name]
    low, high = pulse.support
    t = np.linspace(1.1 * low - 0.1 * high, 1.1 * high - 0.1 * low, 4001)
    density, cdf = called(pulse.eval, t), called(pulse.cdf, t)
    middle = called(pulse.eval, 0.5 * (t[1:] + t[:-1]))
    assert density.min() >= 0
    assert np.cumsum(middle * np.diff(t)) == pytest.approx(cdf[1:], abs=2e-3)
    assert np.diff(cdf).min() >= -1e-7
    assert (cdf[0], cdf[-1]) == pytest.approx((0, 1), abs=1e-6)


@pytest.mark.parametrize("name", PULSES)
def test_samples_follow_the_cdf(name):
    """sample is the inverse of cdf: cdf(sample(xi)) = xi, with weight 1."""
    pulse = PULSES[name]
    xi = (np.arange(2048) + 0.5) / 2048
    t, weight = pulse.sample(mi.Float(xi))
    assert np.array(dr.zeros(mi.Float, 2048) + weight) == pytest.approx(np.ones(2048))
    assert np.array(pulse.cdf(t)) == pytest.approx(xi, abs=2e-5)


@pytest.mark.parametrize("name", PULSES)
def test_samples_are_finite_at_both_ends(name):
    """A 24-bit random number is 0 now and then."""
    pulse = PULSES[name]
    t = called(lambda xi: pulse.sample(xi)[0], [0.0, 2.0**-32, 2.0**-24, 0.5, 1 - 2.0**-24, 1.0])
    low, high = pulse.support
    margin = 0.2 * (high - low)
    assert np.isfinite(t).all()
    assert np.all((t >= low - margin) & (t <= high + margin))
    assert np.all(np.diff(t) >= 0)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("eval", lambda density, t: density - 0.01, "a density is never negative"),
        ("eval", lambda density, t: 2 * density, "the density integrates to 2, not to 1"),
        ("cdf", lambda cdf, t: cdf * cdf, "the cdf is 0.25 off the integral"),
        ("sample", lambda drawn, xi: (drawn[0], 1.0), "weights are an array"),
        ("sample", lambda drawn, xi: (drawn[0], 2 * xi), "offsets have the weight 1"),
        ("sample", lambda drawn, xi: (0.9 * drawn[0], drawn[1]), "samples are .* off the density"),
        ("sample", lambda drawn, xi: (drawn[0] / (xi * (1 - xi) != 0), drawn[1]), "at the ends"),
    ],
)
def test_check_pulse_says_what_is_broken(name, change, message):
    right = getattr(GaussianPulse, name)
    wrong = {name: lambda pulse, x: change(right(pulse, x), x)}
    broken = type("Broken", (GaussianPulse,), wrong)
    with pytest.raises(AssertionError, match=message):
        check_pulse(broken(0.03))


def test_gaussian_values():
    pulse, t = GaussianPulse(0.03), np.linspace(-0.15, 0.15, 101)
    density = np.exp(-0.5 * (t / 0.03) ** 2) / (0.03 * math.sqrt(2 * math.pi))
    assert pulse.normalization == pytest.approx(1 / (0.03 * math.sqrt(2 * math.pi)))
    assert called(pulse.eval, t) == pytest.approx(density, rel=1e-4, abs=1e-6)
    assert called(pulse.cdf, t) == pytest.approx(oracles.gaussian_cdf(t, 0.03), abs=2e-7)


@pytest.mark.statistical
@pytest.mark.parametrize("name", PULSES)
def test_samples_follow_the_density(name):
    """Chi-square of 100 000 samples, and none of them where the density is 0."""
    pulse = PULSES[name]
    samples = drawn(pulse, 100_000)
    assert chi_square(samples, pulse) > SMALLEST
    assert np.mean(called(pulse.eval, samples) == 0) < 1e-4


@pytest.mark.statistical
def test_right_samples_seldom_fail():
    """Over 200 seeds: no false alarm, and p-values that are uniform."""
    pulse = GaussianPulse(0.03)
    p = np.array([chi_square(drawn(pulse, 4000, seed), pulse) for seed in range(200)])
    assert p.min() > SMALLEST
    assert 0.4 < p.mean() < 0.6
    assert 0.01 < np.mean(p < 0.05) < 0.11


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("right", "claimed"),
    [
        (GaussianPulse(0.03), GaussianPulse(0.0315)),
        (BoxPulse(0.3), BoxPulse(0.31)),
        (BoxPulse(0.3), GaussianPulse(0.3 / math.sqrt(12))),
        (SampledPulse([1, 2, 3], 0, 0.1), SampledPulse([1, 2, 3], 0.003, 0.1)),
        (SampledPulse([1, 2, 3], 0, 0.1), SampledPulse([1.1, 2, 3], 0, 0.1)),
    ],
)
def test_a_wrong_density_is_found(right, claimed):
    assert chi_square(drawn(right, 100_000), claimed) < SMALLEST


def test_box_values():
    pulse = BoxPulse(0.25)
    t = [-0.126, -0.125, 0.0, 0.125, 0.126]
    assert called(pulse.eval, t).tolist() == [0, 4, 4, 4, 0]
    assert called(pulse.cdf, t).tolist() == [0, 0, 0.5, 1, 1]
    assert pulse.support == (-0.125, 0.125)
    assert repr(pulse) == "BoxPulse(width_opl=0.25)"


@pytest.mark.parametrize("name", PULSES)
@pytest.mark.parametrize("number", [0, 0.25, np.float64(0.5), np.float32(0.5), 1])
def test_numbers_give_numbers(name, number):
    pulse = PULSES[name]
    for function in (pulse.eval, pulse.cdf, lambda xi: pulse.sample(xi)[0]):
        value = function(number)
        assert isinstance(value, float)
        assert value == pytest.approx(called(function, number)[0], rel=1e-4, abs=1e-6)


def test_convolution_of_bins():
    """Two boxes of widths 1 and 2 make a trapezium."""
    made = convolve(SampledPulse([1.0], 0.0, 1.0), SampledPulse([1.0], 0.5, 2.0))
    t = np.linspace(0.4, 3.6, 33)
    area = np.interp(t, [0.5, 1.5, 2.5, 3.5], [0, 0.25, 0.75, 1])
    ramp = np.where(t < 1.5, 0.25 * np.clip(t - 0.5, 0, 1) ** 2, area)
    ramp = np.where(t > 2.5, 1 - 0.25 * np.clip(3.5 - t, 0, 1) ** 2, ramp)
    assert called(made.cdf, t) == pytest.approx(ramp, abs=2e-3)


@pytest.mark.parametrize(
    ("narrow", "center"),
    [
        (BoxPulse(1e-6), 0.0),
        (GaussianPulse(1e-7), 0.0),
        (SampledPulse([3.0, 1.0], 0.2, 2e-6), 0.2 + 1.5e-6),
        (SampledPulse([1.0, 0.0, 0.0, 0.0, 9.0], -1e-4, 4e-5), -1e-4 + 4e-5 * 4.1),
    ],
)
@pytest.mark.parametrize("order", [1, -1])
def test_convolution_with_a_narrow_pulse_moves_nothing(narrow, center, order):
    """Means add, also where one pulse lies within a step of the other's samples."""
    wide = SampledPulse([1.0, 2.0, 1.0], -0.5, 0.4)
    made = convolve(*(wide, narrow)[::order])
    step = made.bin_width_opl
    centers = made.start_opl + (np.arange(made.density.size) + 0.5) * step
    mean = (made.density * step * centers).sum()
    assert mean == pytest.approx(0.1 + center, abs=0.01 * step)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        *(
            (lambda kind=kind, width=width: kind(width), r"width_opl = .*: must be a finite number")
            for kind in (GaussianPulse, BoxPulse, lambda width: SampledPulse([1], 0, width))
            for width in (0, math.nan, "0.1", 1e-50, 1e50)
        ),
        (lambda: SampledPulse([], 0, 1), "shape"),
        (lambda: SampledPulse([[1.0]], 0, 1), "shape"),
        (lambda: SampledPulse([0.0, 0.0], 0, 1), "all are 0"),
        (lambda: SampledPulse([1.0, -1.0], 0, 1), "-1"),
        (lambda: SampledPulse([1.0, math.nan], 0, 1), "nan"),
        (lambda: SampledPulse(["much"], 0, 1), "values = .*: must be a list of finite numbers"),
        (lambda: SampledPulse(None, 0, 1), "values = None: "),
        (lambda: SampledPulse([1.0], math.inf, 1), "start_opl = inf"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message) as error:
        make()
    assert "\n" not in str(error.value)


MEASURED = SampledPulse([1.0, 4.0, 3.0], -0.02, 0.01)


def test_values_whose_sum_overflows():
    assert SampledPulse([1e308, 1e308], 0, 1).density.tolist() == [0.5, 0.5]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "-0.015,1\n-0.005,4\n0.005,3\n"),
        ("a.CSV", "\ufeffopl (m),counts per bin\r\n-0.015,10\r\n-0.005,40\r\n0.005,30\r\n"),
        ("a.txt", "# a laser\n\n-0.015 1 # weak\n  -0.005\t4\n0.005 3"),
        ("a.txt", "opl;value\n-0.015; 1\n-0.00501; 4\n0.005; 3"),
    ],
)
def test_pulse_from_a_table(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="utf-8")
    made = SampledPulse.from_file(str(tmp_path / name))
    assert made.density == pytest.approx(MEASURED.density)
    assert made.support == pytest.approx(MEASURED.support)


def test_pulse_from_arrays(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, values=[1, 4, 3], start_opl=-0.02, bin_width_opl=[0.01])
    made = SampledPulse.from_file(path)
    assert made.density.tolist() == MEASURED.density.tolist()
    assert made.support == MEASURED.support


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.dat", b"", r"must end in .npz, .csv or .txt"),
        ("none.csv", None, "none.csv"),
        ("a.csv", b"", "0 rows"),
        ("a.csv", b"opl,value\n0,1", "1 rows"),
        ("a.csv", b"0,1\n1,2,3\n", "line 2 = '1,2,3': must be two numbers"),
        ("a.csv", b"0,1\none,2\n", "line 2 = 'one,2'"),
        ("a.csv", b"0,one\n1,2\n", "line 1 = '0,one'"),
        ("a.csv", b"nan,1\n1,2\n", "line 1 = 'nan,1'"),
        ("a.txt", b"0 1\n1 2\n3 3\n", "opl = 1: "),
        ("a.txt", b"2 1\n1 2\n0 3\n", "opl = 0: "),
        ("a.txt", b"1 1\n1 2\n", "opl = 1: "),
        ("a.txt", b"0 0\n1 0\n", "values: all are 0"),
        ("a.txt", b"0 1\n1 -2\n", "values: contain -2"),
        ("a.txt", b"\xff\xfe0\x000", "must be text in UTF-8"),
        ("a.npz", b"", "damaged or of another kind"),
        ("a.npz", b"PK\x03\x04 and then nothing", "damaged or of another kind"),
        ("a.npz", {"bin_width_opl": []}, "must be one number"),
        ("a.npz", {"start_opl": [0, 1]}, "must be one number"),
        ("a.npz", {"bin_width_opl": 0}, "bin_width_opl = 0"),
        ("a.npz", {"values": ["a"]}, "values = .*: must be a list"),
        ("a.npz", {"values": [0]}, "values: all are 0"),
    ],
)
def test_bad_files(tmp_path, name, content, message):
    path = tmp_path / name
    if isinstance(content, dict):
        np.savez(path, **{"values": [1], "start_opl": 0, "bin_width_opl": 1} | content)
    elif content is not None:
        path.write_bytes(content)
    kind = FileNotFoundError if content is None else ValueError
    with pytest.raises(kind, match=message) as error:
        SampledPulse.from_file(path)
    assert str(error.value).startswith(f"path = {str(path)!r}: ")
    assert "\n" not in str(error.value)


def test_an_array_that_is_missing(tmp_path):
    np.savez(tmp_path / "a.npz", values=[1.0], start_opl=0)
    with pytest.raises(ValueError, match="bin_width_opl is missing"):
        SampledPulse.from_file(tmp_path / "a.npz")


KNOTS = np.array([-0.1, 0.02, 0.05, 0.4])
LEVELS = np.array([1e-4, 0.5, 2.0, 3e-3])


def knot_density(t: np.ndarray) -> np.ndarray:
    """The density of KNOTS and LEVELS, not normalized."""
    inside = (t >= KNOTS[0]) & (t <= KNOTS[-1])
    return np.where(inside, np.exp(np.interp(t, KNOTS, np.log(LEVELS))), 0.0)


def test_pulse_of_knots_has_a_linear_logarithm_between_them():
    pulse = KnotPulse(KNOTS, LEVELS)
    whole = integrate.quad(lambda t: float(knot_density(np.array(t))), -0.1, 0.4, points=KNOTS)[0]
    for t in (-0.05, 0.021, 0.04, 0.1, 0.39):
        part = integrate.quad(lambda x: float(knot_density(np.array(x))), -0.1, t, points=KNOTS)[0]
        assert float(pulse.cdf(t)) == pytest.approx(part / whole, abs=3e-4)
        assert float(pulse.eval(t)) == pytest.approx(
            float(knot_density(np.array(t))) / whole, rel=0.05
        )
    assert pulse.support == pytest.approx((-0.1, 0.4))
    assert pulse.eval(0.41) == 0.0
    assert float(pulse.cdf(0.4)) == 1.0


def test_pulse_of_equal_knots_is_a_box():
    pulse = KnotPulse([0.0, 0.1, 0.5], [2.0, 2.0, 2.0])
    assert float(pulse.cdf(0.2)) == pytest.approx(0.4, abs=1e-6)


@pytest.mark.parametrize(
    ("opl", "values", "words"),
    [
        ([0.0, 0.0], [1.0, 1.0], "rise"),
        ([0.0], [1.0], "rise"),
        ([0.0, 1.0], [1.0], "2 numbers"),
        ([0.0, 1.0], [1.0, 0.0], "above 0"),
        ([0.0, 1e-9, 1.0], [1.0, 1.0, 1.0], "even steps"),
    ],
)
def test_wrong_knots_are_refused(opl, values, words):
    with pytest.raises(ValueError, match=words):
        KnotPulse(opl, values)
