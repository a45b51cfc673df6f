# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""Losses between rendered and measured light, with derivatives.

Each compares Dr.Jit tensors of equal shape, of which the rendered one may be attached, and returns
a scalar that is 0 where both agree and has no unit, so that dim and bright scenes are fitted alike.
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

TIME = 2  # axis of time bins


def l2_loss(rendered: Any, target: Any) -> Any:
    """Squared difference in all bins, over the target's squares.

        L = Σ (R - T)² / Σ T²

    A black render has a loss of 1. Where rendered and measured light share no bin, as soon as it is
    off by more than about three widths of the pulse, the gradient does not point to the target: the
    loss is that of both, least for the least light, and things move out of sight. Start near, or
    with another loss.

    Args:
        rendered: A tensor of any shape.
        target: Measured light, a tensor or an array of the same shape.

    Returns:
        The loss, a tensor with one number.

    Raises:
        ValueError: Shapes that differ, or a target that is black.

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
    """Squared difference of the phasors of all pixels, channels and frequencies, over the target's.

        L = Σ |P_R(f) - P_T(f)|² / Σ |P_T(f)|²,   P(f) = Σ_k L_k exp(+i 2 π f opl_k / c)

    with the centre opl_k of bin k, as in `transient_to_phasor`: what an AMCW camera measures (Gupta
    et al., Phasor Imaging, 2015). The loss falls towards the target from as far as about c / 2f,
    and is the steeper the higher the frequency. Of several frequencies, the highest decides from
    how far: fit with a low one first, then with a high one.

    Args:
        rendered: A tensor (height, width, bins, channels).
        target: Measured light, a tensor or an array of the same shape, or a pair (I, Q) of the
            shape (height, width, channels) or (frequencies, height, width, channels) each.
        frequency_hz: Modulation frequency [Hz], above 0 and below c / (2 bin_width_opl), or a
            sequence of them.
        start_opl: Start of the first bin [m].
        bin_width_opl: Width of a bin [m], above 0.

    Returns:
        The loss, a tensor with one number.

    Raises:
        ValueError: A wrong frequency or time axis, shapes that differ, or a target without phasors.

    Example:
        >>> here, there = np.zeros((2, 1, 1, 100, 1), np.float32)
        >>> here[0, 0, 20], there[0, 0, 70] = 1, 1  # half a period apart, for bins of 3 cm
        >>> f, w = SPEED_OF_LIGHT / 3, 0.03
        >>> loss = phasor_loss(here, there, frequency_hz=f, start_opl=0.0, bin_width_opl=w)
        >>> round(loss.array[0], 4)
        4.0
    """
    start = checks.metres("start_opl", start_opl)
    width = checks.metres("bin_width_opl", bin_width_opl, positive=True)
    frequencies = check_below_limit(frequency_hz, width)
    rendered = _bins(rendered)
    bins = None
    if not isinstance(target, tuple):
        bins = _pair(rendered, target)[1]
    targets = _target_phasors(target, rendered, frequencies, start, width)
    difference = mi.Float(0)
    norm = mi.Float(0)
    for frequency, of_target in zip(frequencies, targets, strict=True):
        if bins is None:
            of_rendered = _phasors(rendered, frequency, start, width)
            apart = [own - wanted for own, wanted in zip(of_rendered, of_target, strict=True)]
        else:  # Differences of bins round less than differences of phasors
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
    """Squared sine of the phase difference, weighted with the squared rendered amplitude.

        L = Σ Im(A u*) Im(B u*) / Σ Re(A B*),   u = P_T / |P_T|

    over pixels, channels and frequencies, with the phasors A of `rendered`, B of `other` and P_T of
    the target, as in `phasor_loss`. The expectation of numerator and denominator is free of the
    variance of the noise, because A and B are independent renders of the same scene. `fit` renders
    both. With A = B, the loss is Σ |A|² sin²(φ_A - φ_T) / Σ |A|²: the variance of the noise adds to
    it, and a parameter that changes the variance is biased. With noise, the loss can be negative.
    If the denominator is not above 0, there is a warning and the loss is NaN, which ends `fit`.

    The loss does not depend on the gain of rendered light or target. Phase differences of 0 and of
    π have the same loss: start where the path length is wrong by less than c / 4f.

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
        ValueError: A wrong frequency or time axis, shapes that differ, or a target without phasors.

    Warns:
        UserWarning: The render holds no light, or only noise.

    Example:
        >>> here, there = np.zeros((2, 1, 1, 100, 1), np.float32)
        >>> here[0, 0, 20], there[0, 0, 45] = 1, 3  # a quarter of a period apart
        >>> axis = {"start_opl": 0.0, "bin_width_opl": 0.03}
        >>> loss = phase_loss(here, there, frequency_hz=SPEED_OF_LIGHT / 3, **axis)
        >>> round(loss.array[0], 4)
        1.0
    """
    start = checks.metres("start_opl", start_opl)
    width = checks.metres("bin_width_opl", bin_width_opl, positive=True)
    frequencies = check_below_limit(frequency_hz, width)
    first = _bins(rendered)
    if 0 in first.shape:
        raise ValueError(f"rendered with shape {first.shape}: must have pixels, bins and channels")
    if not isinstance(target, tuple):
        values = checks.finite("target", checks.real_array("target", target))
        if values.ndim == first.ndim:
            _pair(first, target)
    second = first if other is None else _bins(_second(other, first))
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
    """Return a second render; refuse another shape than that of the first."""
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
    """Squared difference in all bins with the best gain of the rendered light.

        L = 1 - Σ A T Σ B T / (Σ A B Σ T²)

    with the light A of `rendered` and B of `other`. With A = B = R, this is the least value of
    Σ (g R - T)² / Σ T² over all gains g. `fit` renders A and B with independent random numbers, so
    that the variance of the noise does not add to Σ A B. If Σ A B is not above 0, there is a
    warning and the loss is NaN, which ends `fit`.

    Args:
        rendered: A tensor of any shape.
        target: Measured light in any unit, a tensor or an array of the same shape.
        other: A second render with other random numbers. The default is `rendered`, for light
            without noise.

    Returns:
        The loss, a tensor with one number, from 0 to 1 without noise.

    Raises:
        ValueError: Shapes that differ, or a target that is black.

    Warns:
        UserWarning: The render holds no light, or only noise.

    Example:
        >>> round(float(scale_free_loss(mi.TensorXf([1.0, 2.0]), [2.5, 5.0]).array[0]), 4)
        0.0
    """
    rendered, target = _pair(rendered, target)
    other = rendered if other is None else _pair(_second(other, rendered), target)[0]
    norm = _nonzero_sum(dr.square(target))

    # Subtract the parts along the target first, which rounds less than 1 - along / power
    across = rendered - target * dr.sum(rendered * target, axis=None) / norm
    other_across = other - target * dr.sum(other * target, axis=None) / norm
    power = dr.sum(rendered * other, axis=None)
    return dr.sum(across * other_across, axis=None) / _positive(power)


def wasserstein_loss(rendered: Any, target: Any, *, energy_weight: float = 1.0) -> Any:
    """Distance that light would have to be moved in time, plus the difference of its energy.

        L = Σ_p (e_p / Σ e) mean_k (F_pk - G_pk)² + λ Σ_p (E_p - e_p)² / Σ e²

    over pixels and channels p, whose rendered and measured light, summed over bins, is E_p and e_p.
    F_pk and G_pk are the fractions of it up to the end of bin k. Light of one arrival that is late
    by a part x of the window has a first term of x, however short the pulse: it falls all the way
    to the target, where a difference of bins is flat. Pixels count by their measured light.

    The first term is the squared earth mover's distance of histograms in one dimension (Hou, Yu,
    Samaras 2016), which is Cramér's distance; Wasserstein's has |F - G| in place of the square.

    Args:
        rendered: A tensor (height, width, bins, channels).
        target: Measured light >= 0, a tensor or an array of the same shape.
        energy_weight: λ, 0 or more; 0 compares arrival times alone.

    Returns:
        The loss, a tensor with one number.

    Raises:
        ValueError: A wrong weight, shapes that differ, or a target that is black.

    Example:
        >>> early, late = np.zeros((2, 1, 1, 100, 1), np.float32)
        >>> early[0, 0, 20], late[0, 0, 70] = 1, 1
        >>> round(wasserstein_loss(early, late).array[0], 4)
        0.5
    """
    weight = checks.number("energy_weight", energy_weight, low=0)
    rendered, target = _pair(rendered, target, bins=True)
    cdf, energy = _cumulate(rendered)
    target_cdf, target_energy = _cumulate(target)
    total = _nonzero_sum(target_energy)
    distance = dr.mean(dr.square(cdf - target_cdf), axis=-1)
    off = dr.square(energy - target_energy) / _nonzero_sum(dr.square(target_energy))
    return dr.sum(target_energy / total * distance + weight * off, axis=None)


LOSSES = {
    "l2": l2_loss,
    "phasor": phasor_loss,
    "phase": phase_loss,
    "scale_free": scale_free_loss,
    "wasserstein": wasserstein_loss,
}

WITH_FREQUENCIES = ("phasor", "phase")

OF_TWO_RENDERS = ("phase", "scale_free")
"""Losses whose products need two independent renders; `fit` passes the second one as `other`."""


def loss_of(given: Any, frequency_hz: Any, film: Any) -> Callable[[Any, Any], Any]:
    """Return the loss as a function of rendered light and target."""
    name = given if isinstance(given, str) else None
    fits = name in WITH_FREQUENCIES or frequency_hz is None
    allowed = "left out; only loss='phasor' and loss='phase' have frequencies"
    checks.require("frequency_hz", frequency_hz, fits, allowed)
    if name is None:
        allowed = f"one of {', '.join(LOSSES)}, or a function"
        return checks.require("loss", given, callable(given), allowed)
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

    Bins are moved to the last axis: along others, Dr.Jit 1.5's `cumsum` loses derivatives.
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
    """Convert both to tensors of one shape."""
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

    The target holds bins of the shape of `rendered`, a pair (I, Q), or phases.
    """
    if not isinstance(target, tuple):
        values = _tensor("target", target)
        if values.shape == rendered.shape:
            return [_phasors(values, frequency, start, width) for frequency in frequencies]
        phase = np.array(dr.detach(values))
        target = (np.cos(phase), np.sin(phase))
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
    """Refuse a target of another shape than the rendered light."""
    allowed = f"{rendered.shape}, as what is rendered"
    checks.shape("target", target, rendered.shape == target.shape, allowed)


def _nonzero_sum(values: Any) -> Any:
    """Sum values of the target, which must not be black."""
    total = dr.detach(dr.sum(values, axis=None))
    if not float(np.array(total).item()) > 0:
        raise ValueError("target: holds no light; must have some to compare with")
    return total


def _positive(power: Any) -> Any:
    """Return a denominator from products of rendered light, or NaN with a warning.

    Of two independent renders with little light and much noise, the sum of products is near 0 or
    negative, and the sign of the loss is arbitrary.
    """
    value = float(np.array(dr.detach(power)).item())
    if value > 0:
        return power
    warnings.warn(
        f"loss: the render holds no light, or only noise (its power is {value:.3g}); raise spp, or "
        "start nearer",
        stacklevel=3,
    )
    return power + math.nan
