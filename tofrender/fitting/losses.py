# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""How far rendered light is from what was measured: numbers with derivatives.

Each takes Dr.Jit tensors of equal shape, of which the rendered one may be attached, and gives a
scalar that is 0 where both agree and has no unit, so that dim and bright scenes are fitted alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..signals.units import SPEED_OF_LIGHT, check_frequencies

TIME = 2
"""The axis of time bins."""


def l2_loss(rendered: Any, target: Any) -> Any:
    """Squared difference in all bins, in units of the target's squares.

        L = Σ (R - T)² / Σ T²

    A black render has a loss of 1. Where rendered and measured light share no bin, as soon as it is
    off by more than about three widths of the pulse, nothing says where it should go, and the loss
    is that of both, least for the least light: things move out of sight. Start near, or with
    another loss.

    Args:
        rendered: A tensor of any shape.
        target: What was measured, of the same shape: a tensor or an array.

    Returns:
        The loss, a tensor with one number.

    Raises:
        ValueError: Shapes that differ, or a target that is black.

    Example:
        >>> float(l2_loss(mi.TensorXf([1.0, 2.0]), mi.TensorXf([1.0, 0.0])).array[0])
        4.0
    """
    rendered, target = _pair(rendered, target)
    return dr.sum(dr.square(rendered - target), axis=None) / _light(dr.square(target))


def phasor_loss(
    rendered: Any,
    target: Any,
    *,
    frequency_hz: float | Sequence[float],
    start_opl: float,
    bin_width_opl: float,
) -> Any:
    """Squared difference of the phasors of all pixels, channels and frequencies.

        L = Σ |P_R(f) - P_T(f)|² / Σ |P_T(f)|²,   P(f) = Σ_k L_k exp(+i 2 π f opl_k / c)

    with the centre opl_k of bin k, as in `transient_to_phasor`. The difference turns by one period
    where light moves by c / f: the loss falls towards the target from as far as about half of that,
    and is the steeper the higher the frequency. Of several frequencies, the highest decides from
    how far: fit by a low one first, which finds the place, and from there by a high one. What is
    compared in this way is what an AMCW camera measures (Gupta et al., Phasor Imaging, 2015).

    Args:
        rendered: A tensor (height, width, bins, channels).
        target: What was measured, of the same shape: a tensor or an array.
        frequency_hz: Modulation frequency [Hz], above 0 and below c / (2 bin_width_opl), or a
            sequence of them.
        start_opl: Where the first bin starts [m].
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
    between, itself = mi.Float(0), mi.Float(0)
    for frequency in frequencies:
        angle = 2 * math.pi * frequency / SPEED_OF_LIGHT * opl
        for wave in (np.cos(angle), np.sin(angle)):
            wave = mi.TensorXf(wave.astype(np.float32)[None, None, :, None])
            between += _sum(dr.square(dr.sum((rendered - target) * wave, axis=TIME)))
            itself += _sum(dr.square(dr.sum(target * wave, axis=TIME)))
    return mi.TensorXf(between / _light(itself), shape=())


def wasserstein_loss(rendered: Any, target: Any, *, energy_weight: float = 1.0) -> Any:
    """When light arrives, by how far it would have to be moved, and how much of it there is.

        L = Σ_p (e_p / Σ e) mean_k (F_pk - G_pk)² + λ Σ_p (E_p - e_p)² / Σ e²

    over pixels and channels p, whose rendered and measured light, summed over bins, is E_p and e_p.
    F_pk and G_pk are the shares of it that have arrived by the end of bin k. Light of one arrival
    that is late by a part x of the window has a first term of x, however short the pulse: it falls
    all the way to the target, where a difference of bins is flat. Pixels count by the light that
    was measured in them.

    The first term is the squared earth mover's distance of histograms in one dimension (Hou, Yu,
    Samaras 2016), which is Cramér's distance; Wasserstein's has |F - G| in place of the square.

    Args:
        rendered: A tensor (height, width, bins, channels).
        target: What was measured, of the same shape, not negative: a tensor or an array.
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
    share, found = _arrived(rendered)
    expected_share, expected = _arrived(target)
    total = _light(expected)
    apart = dr.mean(dr.square(share - expected_share), axis=-1)
    energy = dr.square(found - expected) / _light(dr.square(expected))
    return dr.sum(expected / total * apart + weight * energy, axis=None)


LOSSES = {"l2": l2_loss, "phasor": phasor_loss, "wasserstein": wasserstein_loss}
"""By the names that `fit` knows."""


def check_below_limit(frequency_hz: Any, width: float) -> list[float]:
    """The frequencies [Hz], which must be below those for which bins of a width [m] are too wide.

    Raises:
        ValueError: One is not, or is no frequency; one line.

    Example:
        >>> check_below_limit(20e6, 0.02)
        [20000000.0]
    """
    frequencies, _ = check_frequencies(frequency_hz)
    limit = SPEED_OF_LIGHT / (2 * width)
    if max(frequencies) >= limit:
        raise ValueError(
            f"frequency_hz = {max(frequencies):g}: must be below {limit:g}, where bins of "
            f"{width:g} m are half a period"
        )
    return frequencies


# ----------------------------------------------------------------------------------- helpers


def _arrived(light: Any) -> tuple[Any, Any]:
    """The share of light that has arrived by the end of each bin, 0 without any, and all light.

    Bins are moved to the last axis: along others, Dr.Jit 1.5's `cumsum` loses derivatives.
    """
    arrived = dr.cumsum(dr.moveaxis(light, TIME, -1), axis=-1)
    total = arrived[:, :, :, -1:]
    return arrived / dr.select(total > 0, total, 1), arrived[:, :, :, -1]


def _pair(rendered: Any, target: Any, bins: bool = False) -> tuple[Any, Any]:
    """Both as tensors of one shape."""
    rendered, target = (_tensor(*each) for each in (("rendered", rendered), ("target", target)))
    if bins and rendered.ndim != 4:
        raise ValueError(
            f"rendered with shape {rendered.shape}: must be (height, width, bins, channels)"
        )
    if rendered.shape != target.shape:
        raise ValueError(
            f"target with shape {target.shape}: must be {rendered.shape}, as what is rendered"
        )
    return rendered, target


def _tensor(name: str, values: Any) -> Any:
    if isinstance(values, mi.TensorXf):
        return values
    return mi.TensorXf(checks.real_array(name, values, np.float32))


def _sum(values: Any) -> Any:
    return dr.sum(values.array)


def _light(squares: Any) -> Any:
    """The sum of what a target has, which must not be nothing."""
    total = dr.detach(dr.sum(squares, axis=None))
    if not float(np.array(total).item()) > 0:
        raise ValueError("target: holds no light; must have some to compare with")
    return total
