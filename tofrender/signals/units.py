"""Speed of light, and the two ways to say when light arrives: optical path length and time."""

from __future__ import annotations

from ..runtime.checks import shown

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum [m/s]."""


def opl_to_ns(opl):
    """Convert an optical path length to a time of flight.

    Args:
        opl: Optical path length [m], a number or an array of any kind.

    Returns:
        t = opl / c [ns], of the same kind and shape.

    Example:
        >>> round(opl_to_ns(3.0), 4)
        10.0069
    """
    return _times("opl", opl, 1e9 / SPEED_OF_LIGHT)


def ns_to_opl(time_ns):
    """Convert a time of flight to an optical path length.

    Args:
        time_ns: Time [ns], a number or an array of any kind.

    Returns:
        opl = c t [m], of the same kind and shape.

    Example:
        >>> round(ns_to_opl(10.0), 8)
        2.99792458
    """
    return _times("time_ns", time_ns, SPEED_OF_LIGHT * 1e-9)


def _times(name, value, factor):
    """A number or an array times a factor."""
    try:
        return value * factor
    except (TypeError, OverflowError):
        raise ValueError(f"{name} = {shown(value)}: must be a number or an array of any") from None
