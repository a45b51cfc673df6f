"""Amplitude, phase and depth of phasors, in the convention P = sum L exp(+i 2 pi f opl/c).

The whole package uses this convention: I = Re P, Q = Im P, and a longer path has a larger phase.
"""

# ruff: noqa: E741 (I and Q are the field's names)

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..runtime import checks
from .units import SPEED_OF_LIGHT, check_frequencies


def wrap(values: Any, period: float) -> np.ndarray:
    """Wrap values to [0, period).

    Unlike `np.mod`, this function does not round small negative values to the period itself.

    Example:
        >>> wrap([-1e-20, 7.5], 5.0)
        array([0. , 2.5])
    """
    wrapped = np.mod(values, period)
    return np.where(wrapped >= period, 0.0, wrapped)


def phase_of(I: Any, Q: Any) -> np.ndarray:
    """Return the phase atan2(Q, I) in (-pi, pi] [rad].

    Unlike `np.arctan2`, this function returns pi instead of -pi if Q is -0 and I is negative.

    Example:
        >>> phase_of(-1.0, -0.0).round(4).item()
        3.1416
    """
    phase = np.arctan2(Q, I)
    return np.where(phase <= -math.pi, math.pi, phase)


def _frequencies_first(name: str, values: Any, frequencies: Sequence[float]) -> Any:
    """Move the axis `frequency` of a DataArray to the front. Return other data unchanged."""
    import xarray as xr  # Slow: rendering does not need it

    if not isinstance(values, xr.DataArray):
        return values
    if "frequency" not in values.dims:
        raise ValueError(
            f"{name} has the axes {tuple(values.dims)}, without frequency. Pass frequency_hz as a "
            "number, or name the axis of the frequencies: rename(...='frequency')"
        )
    given = values["frequency"].values
    if "frequency" in values.coords and not np.array_equal(given, frequencies):
        raise ValueError(
            f"{name} has the frequencies {given.tolist()} Hz, but frequency_hz differs. Pass "
            "frequency_hz in the same order"
        )
    return values.transpose("frequency", ...)


def _of_same_axes(I: Any, Q: Any) -> Any:
    """Return Q in the order of the axes of I. Raise an error if axes or labels differ."""
    import xarray as xr  # Slow: rendering does not need it

    if not (isinstance(I, xr.DataArray) and isinstance(Q, xr.DataArray)):
        return Q
    if set(I.dims) != set(Q.dims):
        raise ValueError(f"I has the axes {I.dims}, and Q has {Q.dims}. Pass parts of one phasor")
    for axis in I.indexes.keys() & Q.indexes.keys():
        if not I.indexes[axis].equals(Q.indexes[axis]):
            raise ValueError(
                f"I and Q have different labels along the axis {axis}. Select the same part of both"
            )
    return Q.transpose(*I.dims)


def phasor_parts(
    I: Any, Q: Any, frequency_hz: float | Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return amplitude, phase and depth of phasors I + iQ.

    depth = c (phase mod 2 pi) / (4 pi f) is half the path length, wrapped to [0, c / 2f). This is
    the distance of a surface if light and camera are at the same point and all light is direct.

    Args:
        I: Real part, any shape. With a sequence of frequencies, the first axis is the frequency;
            of a DataArray, it is the axis `frequency`.
        Q: Imaginary part, of the same shape.
        frequency_hz: Modulation frequency [Hz], above 0, or a sequence of frequencies.

    Returns:
        (amplitude, phase, depth), float64 of the same shape: amplitude in units of I, phase =
        atan2(Q, I) in (-pi, pi] [rad], depth [m]. Without light all three are 0.

    Raises:
        ValueError: If the shapes do not fit, or a frequency is not finite and above 0.

    Example:
        >>> amplitude, phase, depth = phasor_parts(0.0, -2.0, 20e6)  # three quarters of a turn
        >>> bool(np.isclose(depth, 0.75 * SPEED_OF_LIGHT / (2 * 20e6)))
        True
    """
    # Check the arguments
    frequencies, many = check_frequencies(frequency_hz)
    Q = _of_same_axes(I, Q)
    if many:
        I = _frequencies_first("I", I, frequencies)
        Q = _frequencies_first("Q", Q, frequencies)
    I = checks.real_array("I", I, np.float64)
    Q = checks.real_array("Q", Q, np.float64)
    if I.shape != Q.shape or (many and I.shape[:1] != (len(frequencies),)):
        first = f", {len(frequencies)} frequencies first" if many else ""
        raise ValueError(f"I, Q with shapes {I.shape}, {Q.shape}: must be equal{first}")

    # Convert the phase to depth, below the unambiguous range of each frequency
    phase = phase_of(I, Q)
    ranges = SPEED_OF_LIGHT / (2 * np.array(frequencies))
    ranges = ranges.reshape(-1, *[1] * (I.ndim - 1)) if many else ranges[0]
    depth = np.mod(phase, 2 * math.pi) / (2 * math.pi) * ranges
    return np.hypot(I, Q), phase, np.minimum(depth, np.nextafter(ranges, 0))
