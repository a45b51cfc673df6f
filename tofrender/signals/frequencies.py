"""Frequencies of modulation, as callers give them."""

from __future__ import annotations

from typing import Any

from ..runtime import checks


def check_frequencies(value: Any, name: str = "frequency_hz") -> tuple[list[float], bool]:
    """The frequencies [Hz] that are given as a number or a sequence, and whether as a sequence.

    Raises:
        ValueError: An empty sequence, or a frequency that is not finite and above 0.

    Example:
        >>> check_frequencies([20e6, 0])
        Traceback (most recent call last):
        ValueError: frequency_hz[1] = 0: must be a finite number of hertz above 0
    """
    try:
        values = None if isinstance(value, str | bytes | dict) else list(value)
    except TypeError:
        values = None
    if values is None:
        return [checks.number(name, value, unit="hertz", positive=True)], False
    if not values:
        raise ValueError(
            f"{name} = {checks.shown(value)}: must hold at least one frequency in hertz"
        )
    named = [(f"{name}[{index}]", each) for index, each in enumerate(values)]
    return [checks.number(n, each, unit="hertz", positive=True) for n, each in named], True
