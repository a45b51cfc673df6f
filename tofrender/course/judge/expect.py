"""Comparisons of the graded tests: a failure shows expected and actual values, and a hint.

    expect.close(area, 1.0, "integral of the density", hint="is 1/(σ√2π) in front?")

The statistical ones share one chance of a false alarm, `ALPHA`, for a whole assignment; each gets
its part by Šidák's rule, from the number of comparisons that the rubric states. A failure of
arrays leaves a picture in the folder that the judge has chosen.

Of all comparisons: `actual` is the submission's answer, `expected` the right one, `what` names the
quantity, `hint` the usual cause of a difference. `**more` are `hint`, `ratios` (hints for answers
that are right but for a factor), and `x` and `x_label` (the abscissae of a one-dimensional array).
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

ALPHA = 1e-3  # chance that a right submission fails anywhere in an assignment
PICTURE = "  picture:  "  # begin of the line of a failure that names its picture
FACTOR = "  which is: "  # begin of the line that says by which factor an answer is off
HINT = "  hint:     "  # begin of the line that names the usual cause


class Failure(AssertionError):
    """A comparison failed; the text is for the student.

    `fraction` is the fraction of the test's points that it still gives.
    """

    def __init__(self, text: str, fraction: float = 0.0) -> None:
        super().__init__(text)
        self.fraction = fraction


_settings = SimpleNamespace(comparisons=100, pictures=None, test="test")


def configure(**settings: Any) -> None:
    """Set `comparisons` (their number), `pictures` (their folder) or `test` (that runs now)."""
    vars(_settings).update(settings)


def close(
    actual: Any, expected: Any, what: str, *, rtol: float = 1e-4, atol: float = 0.0, **more: Any
) -> None:
    """Numbers or arrays agree to `atol + rtol |expected|`, element by element; else `Failure`.

    `expected` is a number, or has the shape of `actual`.
    """
    compared = _Compared(what, **more)
    actual, expected = compared.numbers(actual), np.asarray(expected, np.float64)
    if expected.ndim:
        compared.require_shape(actual, expected.shape)
    compared.require_finite(actual)
    expected = np.broadcast_to(expected, actual.shape)
    excess = np.abs(actual - expected) - (atol + rtol * np.abs(expected))

    def agrees(other: np.ndarray) -> bool:
        return bool(np.all(np.abs(actual - other) <= atol + rtol * np.abs(other)))

    if not np.all(excess <= 0):
        tolerance = atol + rtol * float(np.max(np.abs(expected)))
        factor = factors.find(expected, agrees, compared.ratios, expected, tolerance)
        compared.fail_at(int(np.argmax(excess)), actual, expected, factor)


def finite(actual: Any, what: str, *, hint: str = "") -> None:
    """No NaN and no infinity; else `Failure`, which says how many and where the first is."""
    compared = _Compared(what, hint)
    compared.require_finite(compared.numbers(actual))


def shape(actual: Any, expected: tuple[int, ...], what: str, *, hint: str = "") -> None:
    """An array of this shape; else `Failure`."""
    compared = _Compared(what, hint)
    compared.require_shape(compared.numbers(actual), expected)


def true(condition: Any, what: str, *, hint: str = "") -> None:
    """A condition holds; else `Failure` with `what` as its text."""
    if not bool(condition):
        raise Failure("\n".join([what, *_hint(hint)]))


def estimate(
    samples: Any, expected: Any, what: str, *, rounding: float = 1e-5, **more: Any
) -> None:
    """Independent estimates have the mean `expected` (Student's t-test, element by element).

    `samples` has the shape (seeds, ...) with eight seeds or more, `expected` one that broadcasts to
    (...); `rounding` is the relative difference that single precision explains.
    """
    compared = _Compared(what, **more)
    samples = compared.numbers(samples)
    compared.require_finite(samples)
    expected = np.broadcast_to(np.asarray(expected, np.float64), samples.shape[1:])
    _compare_means(samples, expected, compared, rounding)


def same(samples_a: Any, samples_b: Any, what: str, *, rounding: float = 1e-5, **more: Any) -> None:
    """Two sets of independent estimates have equal means (Welch's t-test); see `estimate`."""
    compared = _Compared(what, **more)
    samples_a, samples_b = map(compared.numbers, (samples_a, samples_b))
    compared.require_finite(samples_a)
    compared.require_finite(samples_b)
    compared.require_shape(samples_a, (len(samples_a), *samples_b.shape[1:]))
    _compare_means(samples_a, samples_b, compared, rounding)


def noise(samples: Any, most: float, what: str, *, hint: str = "") -> None:
    """Independent estimates do not scatter more than those of a good solution do.

    `samples` has the shape (n, ...), n >= 2. `most` is the largest standard deviation, in their
    units: the root of the mean variance of all elements. Allow for the scatter of few estimates.
    """
    compared = _Compared(what, hint)
    samples = compared.numbers(samples)
    compared.require_finite(samples)
    deviation = float(np.sqrt(np.mean(samples.var(axis=0, ddof=1))))
    if not deviation <= most:
        compared = _Compared(f"standard deviation of {what}", hint)
        compared.fail(f"at most {_number(most)}", _number(deviation))


def histogram(counts: Any, probabilities: Any, what: str, **more: Any) -> None:
    """Counts of samples follow the probabilities of their bins (Pearson's chi-square test).

    Bins that expect fewer than five samples are pooled. The probabilities may sum to less than 1:
    the remainder is the chance of falling into no bin.
    """
    compared = _Compared(what, **more)
    counts, probabilities = compared.numbers(counts), np.asarray(probabilities, np.float64)
    compared.require_shape(counts, probabilities.shape)
    compared.require_finite(counts)
    total = counts.sum()
    if not total > 0:
        compared.fail("samples in the bins", "none")
    expected = probabilities * total / probabilities.sum()
    impossible = counts[expected == 0].sum()
    if impossible:
        outside = f"{impossible:.0f} of {total:.0f}"
        compared.fail("no samples where the density is 0", outside)
    few = expected < 5
    pooled, of = (np.append(n[~few], n[few].sum()) for n in (counts, expected))
    pooled, of = pooled[of > 0], of[of > 0]
    chi2, freedom = float(((pooled - of) ** 2 / of).sum()), of.size - 1
    p = chdtrc(freedom, chi2) if freedom > 0 else 1.0
    if not p >= smallest_allowed(ALPHA, _settings.comparisons):
        worst = int(np.argmax(np.where(few, 0, (counts - expected) ** 2 / np.maximum(expected, 1))))
        text = f" (chi² = {chi2:.0f} of {freedom} degrees of freedom; the worst bin is shown)"
        replace(compared, what=what + text).fail_at(worst, counts, expected)


def _compare_means(samples, reference, compared: "_Compared", rounding: float) -> None:
    """Fail if the mean of samples differs from the reference: values, or other samples."""
    least = smallest_allowed(smallest_allowed(ALPHA, _settings.comparisons), samples[0].size)
    p = p_values(samples, reference, rounding=rounding)

    def agrees(other: np.ndarray) -> bool:
        return bool(p_values(samples, other, rounding=rounding).min() >= least)

    if not p.min() >= least:
        shown = reference if reference.ndim < samples.ndim else reference.mean(0)
        error = samples.std(axis=0, ddof=1) / len(samples) ** 0.5
        factor = factors.find(reference, agrees, compared.ratios, shown, 6 * float(error.max()))
        worst = int(np.argmin(p))
        about = f" (mean of {len(samples)} renders, ± {_number(error.reshape(-1)[worst])})"
        named = replace(compared, what=compared.what + about)
        named.fail_at(worst, samples.mean(0), np.asarray(shown), factor)


@dataclass(frozen=True)
class _Compared:
    """Quantity that a comparison is of, and the failures of it; the arguments are those above."""

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
            self.fail("numbers", f"none: an array of shape {numbers.shape}")
        return numbers

    def require_finite(self, actual: np.ndarray) -> None:
        """Fail if there is a NaN or an infinity."""
        bad = ~np.isfinite(actual)
        if bad.any():
            first = [int(i) for i in np.argwhere(bad)[0]]
            where = f", the first at {first}" if first else ""
            self.fail("finite numbers", f"{bad.sum()} that are NaN or infinite{where}")

    def require_shape(self, actual: np.ndarray, expected: tuple[int, ...]) -> None:
        """Fail if the shape is another."""
        if actual.shape != tuple(expected):
            self.fail(f"shape {tuple(expected)}", f"shape {actual.shape}")

    def fail_at(self, index: int, actual: Any, expected: Any, factor: Any = None) -> NoReturn:
        """Fail with the element that differs most, and a picture of all."""
        where = ""
        if actual.ndim == 1 and self.x is not None:
            where = f" at {self.x_label or 'x'} = {_number(np.asarray(self.x).reshape(-1)[index])}"
        elif actual.ndim:
            where = f" at {[int(i) for i in np.unravel_index(index, actual.shape)]}"
        picture = self._picture(actual, expected)
        wrong, right = actual.reshape(-1)[index], expected.reshape(-1)[index]
        ratio = f" ({wrong / right:.4g} times that)" if right else ""
        text, hint, fraction = _number(wrong) + ratio, self.hint, 0.0
        if factor is not None:
            name, own_hint, fraction = factor
            text += f"\n{FACTOR}{name} times what is right, everywhere"
            hint = own_hint or hint
        located = replace(self, what=self.what + where, hint=hint)
        located.fail(_number(right), text, picture, fraction)

    def fail(self, expected: str, actual: str, picture: Any = "", fraction=0.0) -> NoReturn:
        """Raise `Failure` with expected and actual value."""
        lines = [self.what, f"  expected: {expected}", f"  came:     {actual}", *_hint(self.hint)]
        raise Failure("\n".join(lines + ([f"{PICTURE}{picture}"] if picture else [])), fraction)

    def _picture(self, actual: np.ndarray, expected: np.ndarray) -> Path | None:
        """Plot expected and actual values; None for numbers, or without a folder for pictures."""
        if _settings.pictures is None or actual.ndim == 0 or actual.size < 3 or actual.ndim > 3:
            return None
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6 if actual.ndim == 1 else 8, 3.5), layout="constrained")
        curves = {"expected": expected, "came": actual}
        if actual.ndim == 1:
            axes = figure.subplots()
            axis = np.arange(actual.size) if self.x is None else np.asarray(self.x).reshape(-1)
            for (name, values), width in zip(curves.items(), (2, 1), strict=True):
                axes.plot(axis, values, label=name, lw=width)
            axes.set(xlabel=self.x_label)
            axes.legend()
        else:
            limits = {"vmin": float(expected.min()), "vmax": float(expected.max())}
            for (name, values), axes in zip(curves.items(), figure.subplots(1, 2), strict=True):
                image = axes.imshow(values.mean(-1) if values.ndim == 3 else values, **limits)
                axes.set_title(name)
            figure.colorbar(image, ax=figure.axes)
        figure.suptitle(self.what, fontsize="small", wrap=True)
        _settings.pictures.mkdir(parents=True, exist_ok=True)
        path = _settings.pictures / (re.sub(r"[^\w-]+", "_", _settings.test) + ".png")
        figure.savefig(path)
        return path


def _hint(hint: str) -> list[str]:
    return [f"{HINT}{hint}"] if hint else []


def _number(value: Any) -> str:
    return f"{float(value):.6g}"
