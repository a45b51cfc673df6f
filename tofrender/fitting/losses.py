# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""Losses between rendered and measured light, with derivatives.

Each loss compares Dr.Jit tensors of equal shape. The rendered tensor may track gradients. The
result is a scalar without a unit that is 0 if both are equal, so that dim and bright scenes are
fitted in the same way.
"""

import math
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.image import time_bins
from ..runtime import checks
from ..signals.units import SPEED_OF_LIGHT, check_below_limit

# Axis of time bins
TIME = 2


def l2_loss(rendered: Any, target: Any) -> Any:
    """Return the squared difference of all bins, divided by the target's squares.

        L = Σ (R - T)² / Σ T²

    A black render has the loss 1. If rendered and measured light share no bin, the gradient does
    not point to the target. This happens at a distance of more than about three widths of the
    pulse. Then the loss is the sum of both, which is smallest without rendered light, and objects
    move out of sight. Start near the target, or use another loss.

    Args:
        rendered: A tensor of any shape.
        target: Measured light, a tensor or an array of the same shape.

    Returns:
        The loss, a tensor with one number.

    Raises:
        ValueError: The shapes differ, or the target is black.

    Example:
        >>> float(l2_loss(mi.TensorXf([1.0, 2.0]), mi.TensorXf([1.0, 0.0])).array[0])
        4.0
    """
    rendered, target = _pair(rendered, target)
    return dr.sum(dr.square(rendered - target), axis=None) / _nonzero_sum(dr.square(target))


def phasor_loss(
    rendered: Any,
    target: Any,
    *,
    frequency_hz: float | Sequence[float],
    start_opl: float,
    bin_width_opl: float,
) -> Any:
    """Return the squared difference of the phasors, divided by the target's squared phasors.

        L = Σ |P_R(f) - P_T(f)|² / Σ |P_T(f)|²,   P(f) = Σ_k L_k exp(+i 2 π f opl_k / c)

    The sums include all pixels, channels and frequencies. opl_k is the center of bin k, as in
    `transient_to_phasor`. Phasors are what an AMCW camera measures (Gupta et al., Phasor Imaging,
    2015). The loss decreases towards the target from a distance of about c / 2f, and is steeper for
    higher frequencies. The highest of several frequencies determines this distance. Fit with a low
    frequency first, then with a high frequency.

    Args:
        rendered: A tensor (height, width, bins, channels).
        target: Measured light, a tensor or an array of the same shape, or a pair (I, Q) of the
            shape (height, width, channels) or (frequencies, height, width, channels) each.
        frequency_hz: Modulation frequency [Hz], above 0 and below c / (2 bin_width_opl), or a
            sequence of frequencies.
        start_opl: Start of the first bin [m].
        bin_width_opl: Width of a bin [m], above 0.

    Returns:
        The loss, a tensor with one number.

    Raises:
        ValueError: Frequency or time axis are invalid, the shapes differ, or the target has no
            phasors.

    Example:
        >>> here, there = np.zeros((2, 1, 1, 100, 1), np.float32)
        >>> here[0, 0, 20], there[0, 0, 70] = 1, 1  # half a period apart, for bins of 3 cm
        >>> f, w = SPEED_OF_LIGHT / 3, 0.03
        >>> loss = phasor_loss(here, there, frequency_hz=f, start_opl=0.0, bin_width_opl=w)
        >>> round(loss.array[0], 4)
        4.0
    """
    # Check the arguments
    start = checks.meters("start_opl", start_opl)
    width = checks.meters("bin_width_opl", bin_width_opl, positive=True)
    frequencies = check_below_limit(frequency_hz, width)
    rendered = _bins(rendered)
    bins = None
    if not isinstance(target, tuple):
        bins = _pair(rendered, target)[1]
    targets = _target_phasors(target, rendered, frequencies, start, width)

    # Compare the phasors. Differences of bins have smaller rounding errors than differences of
    # phasors
    difference = mi.Float(0)
    norm = mi.Float(0)
    for frequency, of_target in zip(frequencies, targets, strict=True):
        if bins is None:
            of_rendered = _phasors(rendered, frequency, start, width)
            apart = [own - wanted for own, wanted in zip(of_rendered, of_target, strict=True)]
        else:
            apart = _phasors(rendered - bins, frequency, start, width)
        for each, wanted in zip(apart, of_target, strict=True):
            difference += dr.sum(dr.square(each).array)
            norm += dr.sum(dr.square(wanted).array)
    return mi.TensorXf(difference / _nonzero_sum(norm), shape=())


def phase_loss(
    rendered: Any,
    target: Any,
    *,
    other: Any = None,
    frequency_hz: float | Sequence[float],
    start_opl: float,
    bin_width_opl: float,
) -> Any:
    """Return the squared sine of the phase difference, weighted with the squared amplitude.

        L = Σ Im(A u*) Im(B u*) / Σ Re(A B*),   u = P_T / |P_T|

    over pixels, channels and frequencies, with the phasors A of `rendered`, B of `other` and P_T of
    the target, as in `phasor_loss`. A and B are independent renders of the same scene. Therefore
    the variance of the noise does not contribute to the expectation of numerator and denominator.
    `fit` renders both. With A = B, the loss is Σ |A|² sin²(φ_A - φ_T) / Σ |A|². Then the variance
    of the noise contributes, and biases parameters that change the variance. With noise, the loss
    can be negative. If the denominator is not above 0, a warning is issued and the loss is NaN,
    which ends `fit`.

    The loss does not depend on the gain of rendered light or target. Phase differences of 0 and π
    have the same loss. Start at a path length that is wrong by less than c / 4f.

    Args:
        rendered: A tensor (height, width, bins, channels).
        target: Measured light of the same shape, a pair (I, Q), or phases [rad]. I, Q and phases
            have the shape (height, width, channels), or (frequencies, height, width, channels).
        other: A second render with other random numbers. The default is `rendered`, for light
            without noise.
        frequency_hz: As for `phasor_loss`.
        start_opl: Start of the first bin [m].
        bin_width_opl: Width of a bin [m], above 0.

    Returns:
        The loss, a tensor with one number.

    Raises:
        ValueError: Frequency or time axis are invalid, the shapes differ, or the target has no
            phasors.

    Warns:
        UserWarning: The render is black, or contains only noise.

    Example:
        >>> here, there = np.zeros((2, 1, 1, 100, 1), np.float32)
        >>> here[0, 0, 20], there[0, 0, 45] = 1, 3  # a quarter of a period apart
        >>> axis = {"start_opl": 0.0, "bin_width_opl": 0.03}
        >>> loss = phase_loss(here, there, frequency_hz=SPEED_OF_LIGHT / 3, **axis)
        >>> round(loss.array[0], 4)
        1.0
    """
    # Check the arguments
    start = checks.meters("start_opl", start_opl)
    width = checks.meters("bin_width_opl", bin_width_opl, positive=True)
    frequencies = check_below_limit(frequency_hz, width)
    first = _bins(rendered)
    if 0 in first.shape:
        raise ValueError(f"rendered with shape {first.shape}: must have pixels, bins and channels")
    if not isinstance(target, tuple):
        values = checks.finite("target", checks.real_array("target", target))
        if values.ndim == first.ndim:
            _pair(first, target)
    second = first if other is None else _bins(_second(other, first))

    # Compare the phasors
    targets = _target_phasors(target, first, frequencies, start, width)
    out_of_phase = mi.Float(0)
    power = mi.Float(0)
    for frequency, (target_i, target_q) in zip(frequencies, targets, strict=True):
        first_i, first_q = _phasors(first, frequency, start, width)
        second_i, second_q = _phasors(second, frequency, start, width)

        # Components along the direction of the target's phasor, and across
        amplitude = dr.sqrt(dr.square(target_i) + dr.square(target_q))
        _nonzero_sum(amplitude)
        inverse = dr.select(amplitude > 0, 1 / dr.maximum(amplitude, 1e-30), 0)
        cos = target_i * inverse
        sin = target_q * inverse
        first_across = first_q * cos - first_i * sin
        second_across = second_q * cos - second_i * sin
        first_along = first_i * cos + first_q * sin
        second_along = second_i * cos + second_q * sin
        out_of_phase += dr.sum((first_across * second_across).array)
        power += dr.sum((first_along * second_along + first_across * second_across).array)
    return mi.TensorXf(out_of_phase / _positive(power), shape=())


def _second(other: Any, rendered: Any) -> Any:
    """Return a second render. Raise an error if its shape differs from the first render."""
    expected = tuple(rendered.shape)
    try:
        shape = tuple(other.shape) if isinstance(other, mi.TensorXf) else np.shape(other)
    except (TypeError, ValueError):
        shape = None
    if shape is None:
        checks.require("other", other, False, f"a tensor or an array of the shape {expected}")
    if shape != expected:
        raise ValueError(f"other with shape {shape}: must be {expected}, as rendered")
    return other


def scale_free_loss(rendered: Any, target: Any, *, other: Any = None) -> Any:
    """Return the squared difference of all bins for the best gain of the rendered light.

        L = 1 - Σ A T Σ B T / (Σ A B Σ T²)

    with the light A of `rendered` and B of `other`. With A = B = R, this is the minimum of
    Σ (g R - T)² / Σ T² over all gains g. `fit` renders A and B with independent random numbers, so
    that the variance of the noise does not contribute to Σ A B. If Σ A B is not above 0, a warning
    is issued and the loss is NaN, which ends `fit`.

    Args:
        rendered: A tensor of any shape.
        target: Measured light in any unit, a tensor or an array of the same shape.
        other: A second render with other random numbers. The default is `rendered`, for light
            without noise.

    Returns:
        The loss, a tensor with one number, from 0 to 1 without noise.

    Raises:
        ValueError: The shapes differ, or the target is black.

    Warns:
        UserWarning: The render is black, or contains only noise.

    Example:
        >>> round(float(scale_free_loss(mi.TensorXf([1.0, 2.0]), [2.5, 5.0]).array[0]), 4)
        0.0
    """
    rendered, target = _pair(rendered, target)
    other = rendered if other is None else _pair(_second(other, rendered), target)[0]
    norm = _nonzero_sum(dr.square(target))

    # Subtract the parts along the target first, which has smaller rounding errors than the formula
    across = rendered - target * dr.sum(rendered * target, axis=None) / norm
    other_across = other - target * dr.sum(other * target, axis=None) / norm
    power = dr.sum(rendered * other, axis=None)
    return dr.sum(across * other_across, axis=None) / _positive(power)


def wasserstein_loss(rendered: Any, target: Any, *, energy_weight: float = 1.0) -> Any:
    """Return the distance by which light must be moved in time, plus a difference of energy.

        L = Σ_p (e_p / Σ e) mean_k (F_pk - G_pk)² + λ Σ_p (E_p - e_p)² / Σ e²

    The sums include all pixels and channels p. E_p and e_p are rendered and measured light, summed
    over bins. F_pk and G_pk are the fractions of this light up to the end of bin k. If all light is
    late by the fraction x of the window, the first term is x, also for short pulses. It decreases
    continuously towards the target, where a difference of bins is constant. Pixels are weighted
    with their measured light.

    The first term is the squared earth mover's distance of histograms in one dimension (Hou, Yu,
    Samaras 2016), which is Cramér's distance. Wasserstein's distance has |F - G| instead of the
    square.

    Args:
        rendered: A tensor (height, width, bins, channels).
        target: Measured light >= 0, a tensor or an array of the same shape.
        energy_weight: Weight λ, at least 0. With 0, only arrival times are compared.

    Returns:
        The loss, a tensor with one number.

    Raises:
        ValueError: The weight is negative, the shapes differ, or the target is black.

    Example:
        >>> early, late = np.zeros((2, 1, 1, 100, 1), np.float32)
        >>> early[0, 0, 20], late[0, 0, 70] = 1, 1
        >>> round(wasserstein_loss(early, late).array[0], 4)
        0.5
    """
    weight = checks.number("energy_weight", energy_weight, low=0)
    rendered, target = _pair(rendered, target, bins=True)

    # Compare the distributions over bins, and the energies
    cdf, energy = _cumulate(rendered)
    target_cdf, target_energy = _cumulate(target)
    total = _nonzero_sum(target_energy)
    distance = dr.mean(dr.square(cdf - target_cdf), axis=-1)
    energy_error = dr.square(energy - target_energy) / _nonzero_sum(dr.square(target_energy))
    return dr.sum(target_energy / total * distance + weight * energy_error, axis=None)


LOSSES = {
    "l2": l2_loss,
    "phasor": phasor_loss,
    "phase": phase_loss,
    "scale_free": scale_free_loss,
    "wasserstein": wasserstein_loss,
}

WITH_FREQUENCIES = ("phasor", "phase")

OF_TWO_RENDERS = ("phase", "scale_free")
"""Losses with products that need two independent renders. `fit` passes the second as `other`."""


def loss_of(given: Any, frequency_hz: Any, film: Any) -> Callable[[Any, Any], Any]:
    """Return the loss as a function of rendered light and target.

    Args:
        given: Name of the loss, or a function.
        frequency_hz: Frequencies of the losses "phasor" and "phase" [Hz].
        film: The film, with its time bins.
    """
    name = given if isinstance(given, str) else None
    fits = name in WITH_FREQUENCIES or frequency_hz is None
    allowed = "left out; only loss='phasor' and loss='phase' have frequencies"
    checks.require("frequency_hz", frequency_hz, fits, allowed)

    # A function
    if name is None:
        allowed = f"one of {', '.join(LOSSES)}, or a function"
        return checks.require("loss", given, callable(given), allowed)

    # A loss by name
    loss = LOSSES[checks.one_of("loss", name, tuple(LOSSES))]
    if name not in ("l2", "scale_free") and time_bins(film) is None:
        raise ValueError(
            f"loss = {name!r}: must be 'l2' or 'scale_free' for a film without time bins"
        )
    if name not in WITH_FREQUENCIES:
        return loss
    if frequency_hz is None:
        raise ValueError(f"frequency_hz = None: must be given with loss={name!r}, in hertz")
    axis: dict[str, Any] = {name: getattr(film, name) for name in ("start_opl", "bin_width_opl")}
    check_below_limit(frequency_hz, axis["bin_width_opl"])
    return partial(loss, frequency_hz=frequency_hz, **axis)


def _cumulate(light: Any) -> tuple[Any, Any]:
    """Return the cumulative distribution over bins, 0 without light, and the energy.

    Bins are moved to the last axis, because `cumsum` of Dr.Jit 1.5 loses derivatives along others.
    """
    sums = dr.cumsum(dr.moveaxis(light, TIME, -1), axis=-1)
    total = sums[:, :, :, -1:]
    return sums / dr.select(total > 0, total, 1), sums[:, :, :, -1]


def _tensor(name: str, values: Any) -> mi.TensorXf:
    """Convert values to a tensor."""
    if isinstance(values, mi.TensorXf):
        return values
    return mi.TensorXf(checks.real_array(name, values, np.float32))


def _bins(rendered: Any) -> mi.TensorXf:
    """Convert rendered light to a tensor (height, width, bins, channels)."""
    rendered = _tensor("rendered", rendered)
    checks.shape("rendered", rendered, rendered.ndim == 4, "(height, width, bins, channels)")
    return rendered


def _pair(rendered: Any, target: Any, bins: bool = False) -> tuple[Any, Any]:
    """Convert rendered light and target to tensors of the same shape."""
    rendered = _bins(rendered) if bins else _tensor("rendered", rendered)
    target = _tensor("target", target)
    require_same_shape(rendered, target)
    return rendered, target


def _phasors(light: mi.TensorXf, frequency: float, start: float, width: float) -> tuple[Any, Any]:
    """Return I and Q of bins at a frequency, (height, width, channels) each."""
    opl = start + (np.arange(light.shape[TIME]) + 0.5) * width
    angle = 2 * math.pi * frequency / SPEED_OF_LIGHT * opl
    parts = []
    for wave in (np.cos(angle), np.sin(angle)):
        wave = mi.TensorXf(wave.astype(np.float32)[None, None, :, None])
        parts.append(dr.sum(light * wave, axis=TIME))
    return parts[0], parts[1]


def _target_phasors(
    target: Any, rendered: mi.TensorXf, frequencies: Sequence[float], start: float, width: float
) -> list[tuple[Any, Any]]:
    """Return I and Q of the target at each frequency.

    The target contains bins of the shape of `rendered`, a pair (I, Q), or phases.
    """
    # Bins, or phases
    if not isinstance(target, tuple):
        values = _tensor("target", target)
        if values.shape == rendered.shape:
            return [_phasors(values, frequency, start, width) for frequency in frequencies]
        phase = np.array(dr.detach(values))
        target = (np.cos(phase), np.sin(phase))

    # I and Q
    height, columns, _, channels = rendered.shape
    shape = (len(frequencies), height, columns, channels)
    parts = []
    for name, values in zip(("I", "Q"), target, strict=True):
        array = np.array(dr.detach(_tensor(f"target: {name}", values)))
        if array.ndim == 3 and len(frequencies) == 1:
            array = array[None]
        allowed = f"{shape[1:]} for one frequency, or {shape}"
        checks.shape(f"target: {name}", array, array.shape == shape, allowed)
        parts.append(array)
    return [(mi.TensorXf(i), mi.TensorXf(q)) for i, q in zip(*parts, strict=True)]


def require_same_shape(rendered: Any, target: Any) -> None:
    """Raise a ValueError if a target has another shape than the rendered light."""
    allowed = f"{rendered.shape}, as what is rendered"
    checks.shape("target", target, rendered.shape == target.shape, allowed)


def _nonzero_sum(values: Any) -> Any:
    """Sum values of the target. Raise an error for a black target."""
    total = dr.detach(dr.sum(values, axis=None))
    if not float(np.array(total).item()) > 0:
        raise ValueError("target: all values are 0. Pass a target with light")
    return total


def _positive(power: Any) -> Any:
    """Return a denominator from products of rendered light, or NaN with a warning.

    The sum of products of two independent renders with little light and much noise is near 0 or
    negative, so that the sign of the loss is arbitrary.
    """
    value = float(np.array(dr.detach(power)).item())
    if value > 0:
        return power
    warnings.warn(
        f"loss: the render is black or contains only noise (its power is {value:.3g}). Increase "
        "spp, or choose start values nearer to the target",
        stacklevel=3,
    )
    return power + math.nan
