"""Comparisons of the graded tests: a failure shows expected and actual values, and a hint.

    expect.close(area, 1.0, "integral of the density", hint="is 1/(σ√2π) in front?")

The statistical ones share one chance of a false alarm, `ALPHA`, for a whole assignment; each gets
its part by Šidák's rule, from the number of comparisons that the rubric states. A failure of
arrays leaves a picture in the folder that the judge has chosen.

Of all comparisons: `came` is the submission's answer, `wanted` the right one, `what` names the
quantity, `hint` the usual cause of a difference, `ratios` hints for answers that are right but
for a factor; `x` and `x_label` are the abscissae of a one-dimensional array, for text and picture.
"""

from __future__ import annotations

import re
from pathlib import Path
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

    `share` is the fraction of the test's points that it still gives.
    """

    def __init__(self, text: str, share: float = 0.0) -> None:
        super().__init__(text)
        self.share = share


class _Settings:
    """Settings of the judge: number of comparisons, folder of pictures, current test."""

    comparisons = 100
    pictures: Path | None = None
    test = "test"


def configure(**settings: Any) -> None:
    """Set `comparisons` (their number), `pictures` (their folder) or `test` (that runs now)."""
    for name, value in settings.items():
        setattr(_Settings, name, value)


def close(
    came: Any,
    wanted: Any,
    what: str,
    *,
    rtol: float = 1e-4,
    atol: float = 0.0,
    hint: str = "",
    ratios: Ratios | None = None,
    x: Any = None,
    x_label: str = "",
) -> None:
    """Numbers or arrays agree to `atol + rtol |wanted|`, element by element; else `Failure`.

    `wanted` is a number, or has the shape of `came`.
    """
    __tracebackhide__ = True
    came, wanted = _numbers(came, what, hint), np.asarray(wanted, np.float64)
    if wanted.ndim and came.shape != wanted.shape:
        shape(came, wanted.shape, what, hint=hint)
    finite(came, what, hint=hint)
    wanted = np.broadcast_to(wanted, came.shape)
    excess = np.abs(came - wanted) - (atol + rtol * np.abs(wanted))

    def agrees(other: np.ndarray) -> bool:
        return bool(np.all(np.abs(came - other) <= atol + rtol * np.abs(other)))

    if not np.all(excess <= 0):
        factor = factors.find(wanted, agrees, ratios)
        _fail_at(int(np.argmax(excess)), came, wanted, what, hint, x, x_label, factor)


def finite(came: Any, what: str, *, hint: str = "") -> None:
    """No NaN and no infinity; else `Failure`, which says how many and where the first is."""
    __tracebackhide__ = True
    came = _numbers(came, what, hint)
    bad = ~np.isfinite(came)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        where = f", the first at {list(first)}" if first else ""
        _fail(what, "finite numbers", f"{bad.sum()} that are NaN or infinite{where}", hint)


def shape(came: Any, wanted: tuple[int, ...], what: str, *, hint: str = "") -> None:
    """An array of this shape; else `Failure`."""
    __tracebackhide__ = True
    came = _numbers(came, what, hint)
    if came.shape != tuple(wanted):
        _fail(what, f"shape {tuple(wanted)}", f"shape {came.shape}", hint)


def true(condition: Any, what: str, *, hint: str = "") -> None:
    """A condition holds; else `Failure` with `what` as its text."""
    __tracebackhide__ = True
    if not bool(condition):
        raise Failure("\n".join([what, *_hint(hint)]))


def estimate(
    samples: Any,
    wanted: Any,
    what: str,
    *,
    hint: str = "",
    ratios: Ratios | None = None,
    rounding: float = 1e-5,
    x: Any = None,
    x_label: str = "",
) -> None:
    """Independent estimates have the mean `wanted` (Student's t-test, element by element).

    `samples` has the shape (seeds, ...) with eight seeds or more, `wanted` one that broadcasts to
    (...); `rounding` is the relative difference that single precision explains.
    """
    __tracebackhide__ = True
    samples = _numbers(samples, what, hint)
    finite(samples, what, hint=hint)
    wanted = np.broadcast_to(np.asarray(wanted, np.float64), samples.shape[1:])
    _judge(samples, wanted, what, hint, ratios, rounding, x, x_label)


def same(
    samples_a: Any,
    samples_b: Any,
    what: str,
    *,
    hint: str = "",
    ratios: Ratios | None = None,
    rounding: float = 1e-5,
    x: Any = None,
    x_label: str = "",
) -> None:
    """Two sets of independent estimates have equal means (Welch's t-test); see `estimate`."""
    __tracebackhide__ = True
    samples_a, samples_b = (_numbers(s, what, hint) for s in (samples_a, samples_b))
    finite(samples_a, what, hint=hint)
    finite(samples_b, what, hint=hint)
    if samples_a.shape[1:] != samples_b.shape[1:]:
        shape(samples_a, (len(samples_a), *samples_b.shape[1:]), what, hint=hint)
    _judge(samples_a, samples_b, what, hint, ratios, rounding, x, x_label)


def noise(samples: Any, most: float, what: str, *, hint: str = "") -> None:
    """Independent estimates do not scatter more than those of a good solution do.

    `samples` has the shape (n, ...), n >= 2. `most` is the largest standard deviation, in their
    units: the root of the mean variance of all elements. Allow for the scatter of few estimates.
    """
    __tracebackhide__ = True
    samples = _numbers(samples, what, hint)
    finite(samples, what, hint=hint)
    deviation = float(np.sqrt(np.mean(samples.var(axis=0, ddof=1))))
    if not deviation <= most:
        _fail(f"standard deviation of {what}", f"at most {_number(most)}", _number(deviation), hint)


def histogram(
    counts: Any,
    probabilities: Any,
    what: str,
    *,
    hint: str = "",
    x: Any = None,
    x_label: str = "",
) -> None:
    """Counts of samples follow the probabilities of their bins (Pearson's chi-square test).

    Bins that expect fewer than five samples are pooled. The probabilities may sum to less than 1:
    the remainder is the chance of falling into no bin.
    """
    __tracebackhide__ = True
    counts, probabilities = _numbers(counts, what, hint), np.asarray(probabilities, np.float64)
    shape(counts, probabilities.shape, what, hint=hint)
    finite(counts, what, hint=hint)
    total = counts.sum()
    if not total > 0:
        _fail(what, "samples in the bins", "none", hint)
    expected = probabilities * total / probabilities.sum()
    impossible = counts[expected == 0].sum()
    if impossible:
        _fail(what, "no samples where the density is 0", f"{impossible:.0f} of {total:.0f}", hint)
    few = expected < 5
    pooled, of = (np.append(n[~few], n[few].sum()) for n in (counts, expected))
    pooled, of = pooled[of > 0], of[of > 0]
    chi2, freedom = float(((pooled - of) ** 2 / of).sum()), of.size - 1
    p = chdtrc(freedom, chi2) if freedom > 0 else 1.0
    if not p >= smallest_allowed(ALPHA, _Settings.comparisons):
        worst = int(np.argmax(np.where(few, 0, (counts - expected) ** 2 / np.maximum(expected, 1))))
        text = f" (chi² = {chi2:.0f} of {freedom} degrees of freedom; the worst bin is shown)"
        _fail_at(worst, counts, expected, what + text, hint, x, x_label)


def _judge(samples, reference, what, hint, ratios, rounding, x, x_label) -> None:
    """Fail if the mean of samples differs from the reference: values, or other samples."""
    __tracebackhide__ = True
    least = smallest_allowed(smallest_allowed(ALPHA, _Settings.comparisons), samples[0].size)
    p = p_values(samples, reference, rounding=rounding)

    def agrees(other: np.ndarray) -> bool:
        return bool(p_values(samples, other, rounding=rounding).min() >= least)

    if not p.min() >= least:
        factor = factors.find(reference, agrees, ratios)
        shown = reference if reference.ndim < samples.ndim else reference.mean(0)
        error = samples.std(axis=0, ddof=1) / len(samples) ** 0.5
        worst = int(np.argmin(p))
        text = f"{what} (mean of {len(samples)} renders, ± {_number(error.reshape(-1)[worst])})"
        _fail_at(worst, samples.mean(0), np.asarray(shown), text, hint, x, x_label, factor)


def _numbers(value: Any, what: str, hint: str) -> np.ndarray:
    """Value as a non-empty array of numbers, else `Failure`."""
    __tracebackhide__ = True
    try:
        numbers = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        _fail(what, "numbers", f"{value!r:.80}", hint)
    if numbers.size == 0:
        _fail(what, "numbers", f"none: an array of shape {numbers.shape}", hint)
    return numbers


def _fail_at(index, came, wanted, what, hint, x, x_label, factor=None) -> None:
    """Fail with the element that differs most, and a picture of all."""
    __tracebackhide__ = True
    where = ""
    if came.ndim == 1 and x is not None:
        where = f" at {x_label or 'x'} = {_number(np.asarray(x).reshape(-1)[index])}"
    elif came.ndim:
        where = f" at {[int(i) for i in np.unravel_index(index, came.shape)]}"
    picture = _picture(came, wanted, what, x, x_label)
    expected, actual = wanted.reshape(-1)[index], came.reshape(-1)[index]
    ratio = f" ({actual / expected:.4g} times that)" if expected else ""
    text, share = _number(actual) + ratio, 0.0
    if factor is not None:
        name, own_hint, share = factor
        text += f"\n{FACTOR}{name} times what is right, everywhere"
        hint = own_hint or hint
    _fail(what + where, _number(expected), text, hint, picture, share)


def _fail(
    what: str, wanted: str, came: str, hint: str, picture: Path | None = None, share: float = 0.0
) -> NoReturn:
    __tracebackhide__ = True
    lines = [what, f"  expected: {wanted}", f"  came:     {came}", *_hint(hint)]
    raise Failure("\n".join(lines + ([f"{PICTURE}{picture}"] if picture else [])), share)


def _hint(hint: str) -> list[str]:
    return [f"{HINT}{hint}"] if hint else []


def _number(value: Any) -> str:
    return f"{float(value):.6g}"


def _picture(came, wanted, what, x, x_label) -> Path | None:
    """Plot expected and actual values; None for numbers, or without a folder for pictures."""
    if _Settings.pictures is None or came.ndim == 0 or came.size < 3 or came.ndim > 3:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6 if came.ndim == 1 else 8, 3.5), layout="constrained")
    curves = {"expected": wanted, "came": came}
    if came.ndim == 1:
        axes = figure.subplots()
        axis = np.arange(came.size) if x is None else np.asarray(x).reshape(-1)
        for (name, values), width in zip(curves.items(), (2, 1), strict=True):
            axes.plot(axis, values, label=name, lw=width)
        axes.set(xlabel=x_label)
        axes.legend()
    else:
        limits = {"vmin": float(wanted.min()), "vmax": float(wanted.max())}
        for (name, values), axes in zip(curves.items(), figure.subplots(1, 2), strict=True):
            image = axes.imshow(values.mean(-1) if values.ndim == 3 else values, **limits)
            axes.set_title(name)
        figure.colorbar(image, ax=figure.axes)
    figure.suptitle(what, fontsize="small", wrap=True)
    _Settings.pictures.mkdir(parents=True, exist_ok=True)
    path = _Settings.pictures / (re.sub(r"[^\w-]+", "_", _Settings.test) + ".png")
    figure.savefig(path)
    return path
