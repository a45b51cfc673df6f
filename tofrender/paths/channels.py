# pyright: reportArgumentType=false, reportCallIssue=false
"""The colour channel that a flight through a medium is sampled in."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi


def shares_of(β: Any) -> Any:
    """The share of each channel in what a path carries.

    Example:
        >>> shares_of(mi.Color3f(1, 3, 0))
        [[0.25, 0.75, 0]]
    """
    total = dr.sum(dr.abs(β))
    return dr.select(total > 0, dr.abs(β) / total, mi.UnpolarizedSpectrum(1 / len(β)))


def drawn_from(q: Any, xi: mi.Float) -> mi.UInt32:
    """A channel, with the chances `q`."""
    channel, below = mi.UInt32(0), mi.Float(0)
    for k in range(len(q) - 1):
        below = below + q[k]
        channel += dr.select(xi >= below, mi.UInt32(1), 0)
    return channel


def value_in(values: Any, channel: mi.UInt32) -> mi.Float:
    """The value of a channel."""
    found = mi.Float(values[0])
    for k in range(1, len(values)):
        found = dr.select(channel == k, values[k], found)
    return found
