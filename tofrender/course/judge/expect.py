"""Comparisons of the graded tests: a failure says what was expected, what came, and a hint.

    expect.close(area, 1.0, "integral of the density", hint="is 1/(σ√2π) in front?")

The statistical ones share one chance of a false alarm, `ALPHA`, for a whole assignment; each gets
its part by Šidák's rule, from the number of comparisons that the rubric states. A failure of
arrays leaves a picture in the folder that the judge has chosen.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ...sampling.statistics import p_values, smallest_allowed
from . import factors
from .factors import Ratios

ALPHA = 1e-3
"""Chance that a right submission fails anywhere in an assignment."""
PICTURE = "  picture:  "
"""What the line of a failure starts with that names its picture."""
FACTOR = "  which is: "
"""What the line starts with that says by which factor all of an answer is off."""
HINT = "  hint:     "
"""What the line starts with that names the usual cause."""


class Failure(AssertionError):
    """What was expected did not come; the text is for the student.

    Attributes:
        share: Share of the test's points that there is for it all the same.
    """

    def __init__(self, text: str, share: float = 0.0) -> None:
        super().__init__(text)
        self.share = share


class _Settings:
    """What the judge sets: the share of each comparison, and where pictures go."""

    comparisons = 100
    pictures: Path | None = None
    test = "test"


def configure(
    *,
    comparisons: int | None = None,
    pictures: Path | None = None,
    test: str | None = None,
) -> None:
    """Set the number of comparisons, the folder of pictures, the name of the test that runs."""
    if comparisons is not None:
        _Settings.comparisons = comparisons
    if pictures is not None:
        _Settings.pictures = pictures
    if test is not None:
        _Settings.test = test


# ------------------------------------------------------------------------------ exact


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
    """Numbers or arrays agree to `atol + rtol |wanted|`, element by element.

    Args:
        came: What the submission answered.
        wanted: What is right, of a shape that broadcasts to that of `came`.
        what: What it is, for the text.
        rtol: Largest relative difference.
        atol: Largest difference where `wanted` is 0, in its units.
        hint: The usual cause of a difference.
        ratios: Hints for answers that are right but for a factor.
        x: Abscissae of a one-dimensional array, for the text and the picture.
        x_label: What they are, with the unit.

    Raises:
        Failure: They do not agree.
    """
    __tracebackhide__ = True
    came, wanted = _numbers(came, what, hint), np.asarray(wanted, np.float64)
    if wanted.ndim and came.shape != wanted.shape:
        shape(came, wanted.shape, what, hint=hint)
    finite(came, what, hint=hint)
    wanted = np.broadcast_to(wanted, came.shape)
    excess = np.abs(came - wanted) - (atol + rtol * np.abs(wanted))
    if not np.all(excess <= 0):
        factor = factors.find(
            wanted,
            lambda other: bool(np.all(np.abs(came - other) <= atol + rtol * np.abs(other))),
            ratios,
        )
        _fail_at(int(np.argmax(excess)), came, wanted, what, hint, x, x_label, factor)


def finite(came: Any, what: str, *, hint: str = "") -> None:
    """No NaN and no infinity.

    Raises:
        Failure: There is one; says how many and where the first is.
    """
    __tracebackhide__ = True
    came = _numbers(came, what, hint)
    bad = ~np.isfinite(came)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        where = f", the first at {list(first)}" if first else ""
        _fail(what, "finite numbers", f"{bad.sum()} that are NaN or infinite{where}", hint)


def shape(came: Any, wanted: tuple[int, ...], what: str, *, hint: str = "") -> None:
    """An array of this shape.

    Raises:
        Failure: It has another.
    """
    __tracebackhide__ = True
    came = _numbers(came, what, hint)
    if came.shape != tuple(wanted):
        _fail(what, f"shape {tuple(wanted)}", f"shape {came.shape}", hint)


def true(condition: Any, what: str, *, hint: str = "") -> None:
    """A condition holds; `what` says what was expected, and what came.

    Raises:
        Failure: It does not.
    """
    __tracebackhide__ = True
    if not bool(condition):
        raise Failure("\n".join([what, *_hint(hint)]))


# ------------------------------------------------------------------------------ with noise


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

    Args:
        samples: Estimates of shape (seeds, ...), eight seeds or more.
        wanted: Exact mean, of a shape that broadcasts to (...).
        what: What it is.
        hint: The usual cause of a difference.
        ratios: Hints for answers that are right but for a factor.
        rounding: Relative difference that single precision explains.
        x: Abscissae of one-dimensional estimates.
        x_label: What they are, with the unit.

    Raises:
        Failure: The means differ by more than the noise explains, or are not finite.
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
    """Two sets of independent estimates have the same mean (Welch's t-test); as `estimate`.

    Raises:
        Failure: The means differ by more than the noise explains, or are not finite.
    """
    __tracebackhide__ = True
    samples_a, samples_b = (_numbers(s, what, hint) for s in (samples_a, samples_b))
    finite(samples_a, what, hint=hint)
    finite(samples_b, what, hint=hint)
    if samples_a.shape[1:] != samples_b.shape[1:]:
        shape(samples_a, (len(samples_a), *samples_b.shape[1:]), what, hint=hint)
    _judge(samples_a, samples_b, what, hint, ratios, rounding, x, x_label)


def noise(samples: Any, most: float, what: str, *, hint: str = "") -> None:
    """Independent estimates do not scatter more than those of a good solution do.

    Args:
        samples: Estimates of shape (n, ...), n >= 2.
        most: Largest standard deviation, in their units: the root of the mean variance of all
            elements. Leave room above that of right solutions for the scatter of few estimates.
        what: What it is.
        hint: The usual cause of too much of it.

    Raises:
        Failure: They scatter more, or are not finite.
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

    Args:
        counts: Samples in each bin; bins that expect fewer than five are pooled.
        probabilities: Chance of each bin, of the same shape. What is missing to 1 is the chance
            of falling into no bin.
        what: What was sampled.
        hint: The usual cause of a difference.
        x: Centres of one-dimensional bins.
        x_label: What they are, with the unit.

    Raises:
        Failure: The counts do not follow, or fall where the probability is 0.
    """
    __tracebackhide__ = True
    import mitsuba as mi

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
    observed_cells = np.append(counts[~few], counts[few].sum())
    expected_cells = np.append(expected[~few], expected[few].sum())
    used = expected_cells > 0
    observed_cells, expected_cells = observed_cells[used], expected_cells[used]
    chi2 = float(((observed_cells - expected_cells) ** 2 / expected_cells).sum())
    freedom = used.sum() - 1
    p = 1 - mi.math_py.rlgamma(freedom / 2, chi2 / 2) if freedom > 0 else 1.0
    if not p >= smallest_allowed(ALPHA, _Settings.comparisons):
        worst = int(np.argmax(np.where(few, 0, (counts - expected) ** 2 / np.maximum(expected, 1))))
        text = f" (chi² = {chi2:.0f} of {freedom} degrees of freedom; the worst bin is shown)"
        _fail_at(worst, counts, expected, what + text, hint, x, x_label)


# ------------------------------------------------------------------------------ texts


def _judge(samples, reference, what, hint, ratios, rounding, x, x_label) -> None:
    """Fail if the mean of samples is not the reference: values, or samples of their own."""
    __tracebackhide__ = True
    least = smallest_allowed(smallest_allowed(ALPHA, _Settings.comparisons), samples[0].size)
    p = p_values(samples, reference, rounding=rounding)
    if not p.min() >= least:
        factor = factors.find(
            reference,
            lambda other: bool(p_values(samples, other, rounding=rounding).min() >= least),
            ratios,
        )
        shown = reference if reference.ndim < samples.ndim else reference.mean(0)
        error = samples.std(axis=0, ddof=1) / len(samples) ** 0.5
        worst = int(np.argmin(p))
        text = f"{what} (mean of {len(samples)} renders, ± {_number(error.reshape(-1)[worst])})"
        _fail_at(worst, samples.mean(0), np.asarray(shown), text, hint, x, x_label, factor)


def _numbers(value: Any, what: str, hint: str) -> np.ndarray:
    """The value as an array of numbers, if it is one and not empty."""
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
    expected, seen = wanted.reshape(-1)[index], came.reshape(-1)[index]
    ratio = f" ({seen / expected:.4g} times that)" if expected else ""
    text, share = _number(seen) + ratio, 0.0
    if factor is not None:
        text, share = f"{text}\n{FACTOR}{factor.name} times what is right, everywhere", factor.share
        hint = factor.hint or hint
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
    """Draw what was expected and what came; None for numbers, or if nobody wants pictures."""
    if _Settings.pictures is None or came.ndim == 0 or came.size < 3 or came.ndim > 3:
        return None
    from matplotlib.figure import Figure

    if came.ndim == 1:
        figure = Figure(figsize=(6, 3.5), layout="constrained")
        axes = figure.subplots()
        axis = np.arange(came.size) if x is None else np.asarray(x).reshape(-1)
        axes.plot(axis, wanted, label="expected", lw=2)
        axes.plot(axis, came, label="came", lw=1)
        axes.set(xlabel=x_label)
        axes.legend()
    else:
        figure = Figure(figsize=(8, 3.5), layout="constrained")
        low, high = float(wanted.min()), float(wanted.max())
        for axes, image, name in zip(
            figure.subplots(1, 2), (wanted, came), ("expected", "came"), strict=True
        ):
            flat = image.mean(-1) if image.ndim == 3 else image
            mappable = axes.imshow(flat, vmin=low, vmax=high)
            axes.set_title(name)
        figure.colorbar(mappable, ax=figure.axes)
    figure.suptitle(what, fontsize="small", wrap=True)
    _Settings.pictures.mkdir(parents=True, exist_ok=True)
    name = re.sub(r"[^\w-]+", "_", _Settings.test)
    path = _Settings.pictures / f"{name}.png"
    figure.savefig(path)
    return path
