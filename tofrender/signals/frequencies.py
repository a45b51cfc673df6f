"""Frequencies of modulation, as callers give them."""

from __future__ import annotations

from typing import Any

from ..runtime import checks

MIN_FREQUENCY, MAX_FREQUENCY = 1e-9, 1e18
"""Range of frequencies [Hz] whose period in metres single precision can divide by."""


def check_frequency(name: str, value: Any) -> float:
    """Return `value`, a frequency in hertz, as a float.

    Args:
        name: The parameter's name, for the message.
        value: A number from 1e-9 to 1e18; NaN, infinities, bools and text are refused.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> check_frequency("frequency_hz", 0)
        Traceback (most recent call last):
        ValueError: frequency_hz = 0: must be a finite number of hertz from 1e-09 to 1e+18
    """
    return checks.number(name, value, unit="hertz", low=MIN_FREQUENCY, high=MAX_FREQUENCY)


def check_frequencies(value: Any, name: str = "frequency_hz") -> tuple[list[float], bool]:
    """The frequencies [Hz] that are given as a number or a sequence, and whether as a sequence.

    Raises:
        ValueError: An empty sequence, or a frequency out of range; one line.

    Example:
        >>> check_frequencies([20e6, 0])
        Traceback (most recent call last):
        ValueError: frequency_hz[1] = 0: must be a finite number of hertz from 1e-09 to 1e+18
    """
    try:
        values = None if isinstance(value, str | bytes | dict) else list(value)
    except TypeError:
        values = None
    if values is None:
        return [check_frequency(name, value)], False
    if not values:
        raise ValueError(
            f"{name} = {checks.shown(value)}: must hold at least one frequency in hertz"
        )
    named = [(f"{name}[{index}]", each) for index, each in enumerate(values)]
    return [check_frequency(n, each) for n, each in named], True
