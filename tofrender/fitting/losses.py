# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""Losses between rendered and measured light, with derivatives.

Each compares Dr.Jit tensors of equal shape, of which the rendered one may be attached, and returns
a scalar that is 0 where both agree and has no unit, so that dim and bright scenes are fitted alike.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

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
        target: Measured light, a tensor or an array of the same shape.
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
    rendered, target = _pair(rendered, target, bins=True)
    opl = start + (np.arange(rendered.shape[TIME]) + 0.5) * width
    difference, norm = mi.Float(0), mi.Float(0)
    for frequency in frequencies:
        angle = 2 * math.pi * frequency / SPEED_OF_LIGHT * opl
        for wave in (np.cos(angle), np.sin(angle)):
            wave = mi.TensorXf(wave.astype(np.float32)[None, None, :, None])
            difference += dr.sum(dr.square(dr.sum((rendered - target) * wave, axis=TIME)).array)
            norm += dr.sum(dr.square(dr.sum(target * wave, axis=TIME)).array)
    return mi.TensorXf(difference / _nonzero_sum(norm), shape=())


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


LOSSES = {"l2": l2_loss, "phasor": phasor_loss, "wasserstein": wasserstein_loss}


def loss_of(given: Any, frequency_hz: Any, film: Any) -> Callable[[Any, Any], Any]:
    """Return the loss as a function of rendered light and target."""
    name = given if isinstance(given, str) else None
    fits = name == "phasor" or frequency_hz is None
    allowed = "left out; only loss='phasor' has frequencies"
    checks.require("frequency_hz", frequency_hz, fits, allowed)
    if name is None:
        allowed = f"one of {', '.join(LOSSES)}, or a function"
        return checks.require("loss", given, callable(given), allowed)
    loss = LOSSES[checks.one_of("loss", name, tuple(LOSSES))]
    if name != "l2" and not hasattr(film, "temporal_bins"):
        raise ValueError(f"loss = {name!r}: must be 'l2' for a film without time bins")
    if name != "phasor":
        return loss
    if frequency_hz is None:
        raise ValueError("frequency_hz = None: must be given with loss='phasor', in hertz")
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


def _pair(rendered: Any, target: Any, bins: bool = False) -> tuple[Any, Any]:
    """Convert both to tensors of one shape."""
    rendered, target = (
        x if isinstance(x, mi.TensorXf) else mi.TensorXf(checks.real_array(name, x, np.float32))
        for name, x in (("rendered", rendered), ("target", target))
    )
    valid = not bins or rendered.ndim == 4
    checks.shape("rendered", rendered, valid, "(height, width, bins, channels)")
    require_same_shape(rendered, target)
    return rendered, target


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
