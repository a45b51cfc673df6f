"""Comparisons of the graded tests. A failure shows expected and actual values, and a hint.

    expect.close(area, 1.0, "integral of the density", hint="is 1/(σ√2π) in front?")

All statistical comparisons of an assignment share one probability of a false alarm, `ALPHA`. Each
comparison gets its part by Šidák's rule, from the number of comparisons in the rubric. If arrays
differ, a picture is written to the folder that the judge has chosen.

All comparisons raise `Failure`, and have these arguments:

| argument | meaning |
|---|---|
| `actual`, `samples` | the submission's answer, or several independent answers |
| `expected` | the correct answer |
| `what` | name of the quantity |
| `hint` | usual cause of a difference |
| `ratios` | hints for answers that are wrong by a factor, see `factors` |
| `x`, `x_label` | abscissae of a one-dimensional array, and their name, for the picture |
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
from scipy.special import chdtrc

from ...sampling.statistics import p_values, smallest_allowed
from . import factors
from .factors import Ratios

ALPHA = 1e-3  # probability that a correct submission fails any test of an assignment
# Beginnings of the lines of a failure
EXPECTED = "  expected: "
ACTUAL = "  actual:   "
FACTOR = "  factor:   "  # factor by which the answer is wrong
HINT = "  hint:     "  # usual cause
PICTURE = "  picture:  "  # path of the picture


class Failure(AssertionError):
    """A comparison failed. The text is for the student.

    Args:
        text: Lines of the failure.
        fraction: Fraction of the test's points that the answer still gets.
    """

    def __init__(self, text: str, fraction: float = 0.0) -> None:
        super().__init__(text)
        self.fraction = fraction


_settings = SimpleNamespace(comparisons=100, pictures=None, test="test")


def configure(**settings: Any) -> None:
    """Change the settings of all following comparisons.

    Args:
        **settings: Number of statistical `comparisons` in the assignment, folder of the
            `pictures`, or name of the current `test`.
    """
    vars(_settings).update(settings)


def close(
    actual: Any, expected: Any, what: str, *, rtol: float = 1e-4, atol: float = 0.0, **more: Any
) -> None:
    """Require that numbers or arrays differ by at most `atol + rtol |expected|` everywhere.

    `expected` is a number, or has the shape of `actual`.
    """
    # Shapes and finite values
    compared = _Comparison(what, **more)
    actual = compared.numbers(actual)
    expected = np.asarray(expected, np.float64)
    if expected.ndim:
        compared.require_shape(actual, expected.shape)
    compared.require_finite(actual)
    expected = np.broadcast_to(expected, actual.shape)

    # Differences; a failure names the factor by which the answer is wrong, if there is one
    excess = np.abs(actual - expected) - (atol + rtol * np.abs(expected))

    def agrees(other: np.ndarray) -> bool:
        return bool(np.all(np.abs(actual - other) <= atol + rtol * np.abs(other)))

    if not np.all(excess <= 0):
        tolerance = atol + rtol * float(np.max(np.abs(expected)))
        factor = factors.find(expected, agrees, compared.ratios, expected, tolerance)
        compared.fail_at(int(np.argmax(excess)), actual, expected, factor)


def finite(actual: Any, what: str, *, hint: str = "") -> None:
    """Require that no number is NaN or infinite."""
    compared = _Comparison(what, hint)
    compared.require_finite(compared.numbers(actual))


def shape(actual: Any, expected: tuple[int, ...], what: str, *, hint: str = "") -> None:
    """Require that an array has the shape `expected`."""
    compared = _Comparison(what, hint)
    compared.require_shape(compared.numbers(actual), expected)


def true(condition: Any, what: str, *, hint: str = "") -> None:
    """Require that a condition is true. `what` is the message if it is false."""
    if not bool(condition):
        raise Failure("\n".join([what, *_hint(hint)]))


def estimate(
    samples: Any, expected: Any, what: str, *, rounding: float = 1e-5, **more: Any
) -> None:
    """Require that independent estimates have the mean `expected`, by Student's t-test.

    Args:
        samples: Estimates of shape (seeds, ...), with eight seeds or more.
        expected: Expected mean, of a shape that broadcasts to (...).
        what: Name of the quantity.
        rounding: Relative difference that single precision explains.
        **more: `hint`, `ratios`, `x` and `x_label`, see above.
    """
    compared = _Comparison(what, **more)
    samples = compared.numbers(samples)
    compared.require_finite(samples)
    expected = np.broadcast_to(np.asarray(expected, np.float64), samples.shape[1:])
    _compare_means(samples, expected, compared, rounding)


def same(samples_a: Any, samples_b: Any, what: str, *, rounding: float = 1e-5, **more: Any) -> None:
    """Require that two sets of independent estimates have equal means, by Welch's t-test.

    For the arguments, see `estimate`.
    """
    compared = _Comparison(what, **more)
    samples_a = compared.numbers(samples_a)
    samples_b = compared.numbers(samples_b)
    compared.require_finite(samples_a)
    compared.require_finite(samples_b)
    compared.require_shape(samples_a, (len(samples_a), *samples_b.shape[1:]))
    _compare_means(samples_a, samples_b, compared, rounding)


def noise(samples: Any, most: float, what: str, *, hint: str = "") -> None:
    """Require that independent estimates have a small standard deviation.

    Args:
        samples: Estimates of shape (n, ...), with n >= 2.
        most: Largest allowed standard deviation, in the unit of the estimates. It is compared with
            the square root of the mean variance of all elements. Leave a margin, because a few
            estimates determine the deviation only roughly.
        what: Name of the quantity.
        hint: Usual cause of more noise.
    """
    compared = _Comparison(what, hint)
    samples = compared.numbers(samples)
    compared.require_finite(samples)
    deviation = float(np.sqrt(np.mean(samples.var(axis=0, ddof=1))))
    if not deviation <= most:
        compared = _Comparison(f"standard deviation of {what}", hint)
        most_text, deviation_text = _two_numbers(most, deviation)
        compared.fail(f"at most {most_text}", deviation_text)


def histogram(counts: Any, probabilities: Any, what: str, **more: Any) -> None:
    """Require that counts of samples follow the probabilities of their bins.

    The test is Pearson's chi-square test. Bins with fewer than five expected samples are pooled.

    Args:
        counts: Number of samples in each bin.
        probabilities: Probability of each bin. Their sum may be below 1, if samples can fall
            outside all bins.
        what: Name of the quantity.
        **more: `hint`, `x` and `x_label`, see above.
    """
    # Shapes and finite values
    compared = _Comparison(what, **more)
    counts = compared.numbers(counts)
    probabilities = np.asarray(probabilities, np.float64)
    compared.require_shape(counts, probabilities.shape)
    compared.require_finite(counts)
    total = counts.sum()
    if not total > 0:
        compared.fail("samples in the bins", "none")

    # No sample may fall into an impossible bin
    expected = probabilities * total / probabilities.sum()
    impossible = counts[expected == 0].sum()
    if impossible:
        outside = f"{impossible:.0f} of {total:.0f}"
        compared.fail("no samples where the density is 0", outside)

    # Pool the bins with few expected samples
    few = expected < 5
    pooled_counts = np.append(counts[~few], counts[few].sum())
    pooled_expected = np.append(expected[~few], expected[few].sum())
    used = pooled_expected > 0
    pooled_counts = pooled_counts[used]
    pooled_expected = pooled_expected[used]

    # Compute the statistic and its p-value
    chi2 = float(((pooled_counts - pooled_expected) ** 2 / pooled_expected).sum())
    freedom = pooled_expected.size - 1
    p = chdtrc(freedom, chi2) if freedom > 0 else 1.0
    if not p >= smallest_allowed(ALPHA, _settings.comparisons):
        worst = int(np.argmax(np.where(few, 0, (counts - expected) ** 2 / np.maximum(expected, 1))))
        text = f" (chi² = {chi2:.0f} of {freedom} degrees of freedom; the worst bin is shown)"
        replace(compared, what=what + text).fail_at(worst, counts, expected)


def _compare_means(
    samples: np.ndarray, reference: np.ndarray, compared: "_Comparison", rounding: float
) -> None:
    """Fail if the mean of samples differs from the reference.

    The reference contains either expected values, or samples with the dimensions of `samples`.
    """
    # All elements share the comparison's probability of a false alarm
    least = smallest_allowed(smallest_allowed(ALPHA, _settings.comparisons), samples[0].size)
    p = p_values(samples, reference, rounding=rounding)

    def agrees(other: np.ndarray) -> bool:
        return bool(p_values(samples, other, rounding=rounding).min() >= least)

    if not p.min() >= least:
        # Is the answer wrong by a factor?
        shown = reference if reference.ndim < samples.ndim else reference.mean(0)
        error = samples.std(axis=0, ddof=1) / len(samples) ** 0.5
        tolerance = 6 * float(error.max())
        factor = factors.find(reference, agrees, compared.ratios, shown, tolerance)

        # Show the element with the most significant difference
        worst = int(np.argmin(p))
        about = f" (mean of {len(samples)} renders, ± {_number(error.reshape(-1)[worst])})"
        named = replace(compared, what=compared.what + about)
        named.fail_at(worst, samples.mean(0), np.asarray(shown), factor)


@dataclass(frozen=True)
class _Comparison:
    """Description of a comparison, which raises its failures; for the fields see above."""

    what: str
    hint: str = ""
    ratios: Ratios | None = None
    x: Any = None
    x_label: str = ""

    def numbers(self, value: Any) -> np.ndarray:
        """Convert an answer to a non-empty array of numbers."""
        try:
            numbers = np.asarray(value, np.float64)
        except (TypeError, ValueError):
            self.fail("numbers", f"{value!r:.80}")
        if numbers.size == 0:
            self.fail("numbers", f"an empty array of shape {numbers.shape}")
        return numbers

    def require_finite(self, actual: np.ndarray) -> None:
        """Fail if a number is NaN or infinite, and report the first one's index."""
        bad = ~np.isfinite(actual)
        if bad.any():
            first = [int(i) for i in np.argwhere(bad)[0]]
            where = f", the first at {first}" if first else ""
            self.fail("finite numbers", f"{bad.sum()} that are NaN or infinite{where}")

    def require_shape(self, actual: np.ndarray, expected: tuple[int, ...]) -> None:
        """Fail if an array does not have the expected shape."""
        if actual.shape != tuple(expected):
            self.fail(f"shape {tuple(expected)}", f"shape {actual.shape}")

    def fail_at(self, index: int, actual: Any, expected: Any, factor: Any = None) -> NoReturn:
        """Fail the test. The message shows one element and a picture of all elements.

        Args:
            index: Flat index of the element.
            actual: Actual values.
            expected: Expected values, of the same shape.
            factor: Result of `factors.find`.
        """
        # Locate the element by its abscissa or its indices
        where = ""
        if actual.ndim == 1 and self.x is not None:
            where = f" at {self.x_label or 'x'} = {_number(np.asarray(self.x).reshape(-1)[index])}"
        elif actual.ndim:
            where = f" at {[int(i) for i in np.unravel_index(index, actual.shape)]}"

        # Compose the text; a hint for the factor replaces the general hint
        picture = self._picture(actual, expected)
        wrong = actual.reshape(-1)[index]
        right = expected.reshape(-1)[index]
        right_text, wrong_text = _two_numbers(right, wrong)
        ratio = f"{wrong / right:.4g}" if right else "1"
        text = wrong_text + f" ({ratio} times that)" * (ratio != "1")
        hint = self.hint
        fraction = 0.0
        if factor is not None:
            name, factor_hint, fraction = factor
            text += f"\n{FACTOR}{name} times the expected value, everywhere"
            hint = factor_hint or hint
        located = replace(self, what=self.what + where, hint=hint)
        located.fail(right_text, text, picture, fraction)

    def fail(self, expected: str, actual: str, picture: Any = "", fraction=0.0) -> NoReturn:
        """Raise `Failure` with descriptions of the expected and the actual value."""
        lines = [self.what, f"{EXPECTED}{expected}", f"{ACTUAL}{actual}", *_hint(self.hint)]
        if picture:
            lines.append(f"{PICTURE}{picture}")
        raise Failure("\n".join(lines), fraction)

    def _picture(self, actual: np.ndarray, expected: np.ndarray) -> Path | None:
        """Plot expected and actual values, and return the path of the picture.

        None without a folder for pictures, for one or two numbers, and above three dimensions.
        """
        if _settings.pictures is None or actual.ndim == 0 or actual.size < 3 or actual.ndim > 3:
            return None
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6 if actual.ndim == 1 else 8, 3.5), layout="constrained")
        curves = {"expected": expected, "actual": actual}
        if actual.ndim == 1:
            # Two curves in one plot
            axes = figure.subplots()
            axis = np.arange(actual.size) if self.x is None else np.asarray(self.x).reshape(-1)
            for (name, values), width in zip(curves.items(), (2, 1), strict=True):
                axes.plot(axis, values, label=name, lw=width)
            axes.set(xlabel=self.x_label)
            axes.legend()
        else:
            # Two images with the same color scale
            limits = {"vmin": float(expected.min()), "vmax": float(expected.max())}
            for (name, values), axes in zip(curves.items(), figure.subplots(1, 2), strict=True):
                image = axes.imshow(values.mean(-1) if values.ndim == 3 else values, **limits)
                axes.set_title(name)
            figure.colorbar(image, ax=figure.axes)

        # The file has the name of the test
        figure.suptitle(self.what, fontsize="small", wrap=True)
        _settings.pictures.mkdir(parents=True, exist_ok=True)
        path = _settings.pictures / (re.sub(r"[^\w-]+", "_", _settings.test) + ".png")
        figure.savefig(path)
        return path


def _hint(hint: str) -> list[str]:
    """Return a list with the line of a hint, or an empty list for an empty hint."""
    return [f"{HINT}{hint}"] if hint else []


def _number(value: Any) -> str:
    """Format a number with six digits."""
    return f"{float(value):.6g}"


def _two_numbers(one: float, other: float) -> tuple[str, str]:
    """Format two different numbers with six digits, or with as many digits as they need to differ.

    Example:
        >>> _two_numbers(1.0, 1.00000012)
        ('1', '1.0000001')
    """
    for digits in range(6, 18):
        texts = (f"{float(one):.{digits}g}", f"{float(other):.{digits}g}")
        if texts[0] != texts[1]:
            break
    return texts
