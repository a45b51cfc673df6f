"""Speed of light, conversion of optical path length and time, and checks of frequencies."""

from typing import Any

from ..runtime import checks

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum [m/s]."""

# Range of frequencies [Hz]; single precision can represent their periods in meters
MIN_FREQUENCY = 1e-9
MAX_FREQUENCY = 1e18


def opl_to_ns(opl):
    """Convert an optical path length [m] to time of flight t = opl / c [ns].

    The argument is a number or an array of any package.

    Example:
        >>> round(opl_to_ns(3.0), 4)
        10.0069
    """
    return _times("opl", opl, 1e9 / SPEED_OF_LIGHT, {"units": "ns", "long_name": "time"})


def ns_to_opl(time_ns):
    """Convert a time of flight t [ns] to optical path length c t [m].

    The argument is a number or an array of any package.

    Example:
        >>> round(ns_to_opl(10.0), 8)
        2.99792458
    """
    labels = {"units": "m", "long_name": "optical path length"}
    return _times("time_ns", time_ns, SPEED_OF_LIGHT * 1e-9, labels)


def _times(name, value, factor, labels):
    """Multiply a number or an array by a factor. Raise an error for other types.

    A DataArray gets the given labels, because its unit changes.
    """
    try:
        found = value * factor
    except (TypeError, OverflowError):
        shown = checks.quote(value)
        raise ValueError(f"{name} = {shown}: must be a number or an array of numbers") from None
    if hasattr(found, "attrs") and hasattr(found, "dtype"):
        found.attrs = labels
    return found


def check_frequency(name: str, value: Any) -> float:
    """Require a frequency from 1e-9 to 1e18 [Hz], and return it as a float."""
    return checks.number(name, value, unit="hertz", low=MIN_FREQUENCY, high=MAX_FREQUENCY)


def check_frequencies(value: Any, name: str = "frequency_hz") -> tuple[list[float], bool]:
    """Require a frequency or a sequence of frequencies [Hz].

    Returns:
        The list of frequencies, and whether the value was a sequence.
    """
    try:
        values = None if isinstance(value, str | bytes | dict) else list(value)
    except TypeError:
        values = None
    if values is None:
        return [check_frequency(name, value)], False
    if not values:
        shown = checks.quote(value)
        raise ValueError(f"{name} = {shown}: must contain at least one frequency in hertz")
    return [check_frequency(f"{name}[{i}]", each) for i, each in enumerate(values)], True


def check_below_limit(frequency_hz: Any, width: float) -> list[float]:
    """Require frequencies [Hz] with half periods that are longer than a bin, and return them.

    Args:
        frequency_hz: A frequency or a sequence of frequencies [Hz].
        width: Width of a bin [m].
    """
    frequencies, _ = check_frequencies(frequency_hz)
    limit = SPEED_OF_LIGHT / (2 * width)
    if max(frequencies) >= limit:
        raise ValueError(
            f"frequency_hz = {max(frequencies):g}: must be below {limit:g}, so that half a period "
            f"is longer than a bin of {width:g} m"
        )
    return frequencies
