"""Speed of light, conversion of optical path length and time, and frequencies of modulation."""

from typing import Any

from ..runtime import checks

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum [m/s]."""

MIN_FREQUENCY, MAX_FREQUENCY = 1e-9, 1e18
"""Range of frequencies [Hz] whose period in metres single precision can divide by."""


def opl_to_ns(opl):
    """Time of flight t = opl / c [ns] of an optical path length [m], a number or any array.

    Example:
        >>> round(opl_to_ns(3.0), 4)
        10.0069
    """
    return _times("opl", opl, 1e9 / SPEED_OF_LIGHT, {"units": "ns", "long_name": "time"})


def ns_to_opl(time_ns):
    """Optical path length c t [m] of a time of flight [ns], a number or any array.

    Example:
        >>> round(ns_to_opl(10.0), 8)
        2.99792458
    """
    labels = {"units": "m", "long_name": "optical path length"}
    return _times("time_ns", time_ns, SPEED_OF_LIGHT * 1e-9, labels)


def _times(name, value, factor, labels):
    """Multiply by a factor; labeled values get labels of their own."""
    try:
        found = value * factor
    except (TypeError, OverflowError):
        given = checks.quote(value)
        raise ValueError(f"{name} = {given}: must be a number or an array of any") from None
    if hasattr(found, "attrs") and hasattr(found, "dtype"):  # A DataArray, of units of its own
        found.attrs = labels
    return found


def check_frequency(name: str, value: Any) -> float:
    """Require a frequency [Hz] from 1e-9 to 1e18 and return it as a float."""
    return checks.number(name, value, unit="hertz", low=MIN_FREQUENCY, high=MAX_FREQUENCY)


def check_frequencies(value: Any, name: str = "frequency_hz") -> tuple[list[float], bool]:
    """List of one frequency [Hz] or of a sequence of them, and whether it was a sequence."""
    try:
        values = None if isinstance(value, str | bytes | dict) else list(value)
    except TypeError:
        values = None
    if values is None:
        return [check_frequency(name, value)], False
    if not values:
        given = checks.quote(value)
        raise ValueError(f"{name} = {given}: must hold at least one frequency in hertz")
    return [check_frequency(f"{name}[{i}]", each) for i, each in enumerate(values)], True


def check_below_limit(frequency_hz: Any, width: float) -> list[float]:
    """Return the frequencies [Hz], whose half periods must be longer than bins of a width [m]."""
    frequencies, _ = check_frequencies(frequency_hz)
    limit = SPEED_OF_LIGHT / (2 * width)
    if max(frequencies) >= limit:
        raise ValueError(
            f"frequency_hz = {max(frequencies):g}: must be below {limit:g}, where bins of "
            f"{width:g} m are half a period"
        )
    return frequencies
