"""State of a flight through media."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass
class Flight:
    """State of the loop over null collisions and boundaries along a ray.

    Attributes:
        ray: The ray that finds the next surface.
        pi: That surface.
        end: Its distance from the start of the flight [m].
        distance: Distance up to which the flight is sampled [m].
        medium: The current medium.
        weight: Density of the flight in each channel over that in the sampled channel; for
            connections, the transmittance.
        albedo: Albedo at a scattering point.
        scattered: Lanes that end at a scattering point.
        active: Lanes that go on.
        needs_intersection: Lanes whose next surface is not known.
        passes_emitters: Lanes that cross area lights like boundaries.
        mueller: Mueller matrix of null transmission along a connection, None without any.
    """

    ray: mi.Ray3f
    pi: mi.PreliminaryIntersection3f
    end: mi.Float
    distance: mi.Float
    medium: mi.MediumPtr
    weight: Any
    albedo: Any
    scattered: mi.Bool
    active: mi.Bool
    needs_intersection: mi.Bool
    passes_emitters: mi.Bool
    mueller: Any = None

    @classmethod
    def start(
        cls, ray: mi.Ray3f, medium: mi.MediumPtr, active: mi.Bool, passes_emitters: Any
    ) -> Flight:
        """Start a flight along a ray."""
        lanes = dr.width(ray)
        zero = dr.zeros(mi.Float, lanes)
        pi: Any = dr.zeros(mi.PreliminaryIntersection3f, lanes)
        pi.t = zero + dr.inf
        return cls(
            ray=mi.Ray3f(ray),
            pi=pi,
            end=mi.Float(zero),
            distance=mi.Float(zero),
            medium=mi.MediumPtr(medium),
            weight=mi.UnpolarizedSpectrum(1) + zero,
            albedo=mi.UnpolarizedSpectrum(0) + zero,
            scattered=dr.zeros(mi.Bool, lanes),
            active=mi.Bool(active),
            needs_intersection=mi.Bool(active),
            passes_emitters=mi.Bool(passes_emitters),
        )


def channel_probabilities(β: Any) -> Any:
    """Return channel probabilities in proportion to throughput.

    Example:
        >>> channel_probabilities(mi.Color3f(1, 3, 0))
        [[0.25, 0.75, 0]]
    """
    total = dr.sum(dr.abs(β))
    return dr.select(total > 0, dr.abs(β) / total, mi.UnpolarizedSpectrum(1 / len(β)))


def sample_channel(q: Any, xi: mi.Float) -> mi.UInt32:
    """Sample a channel with the probabilities `q`."""
    channel, cdf = mi.UInt32(0), mi.Float(0)
    for k in range(len(q) - 1):
        cdf = cdf + q[k]
        channel += dr.select(xi >= cdf, mi.UInt32(1), 0)
    return channel


def value_in(values: Any, channel: mi.UInt32) -> mi.Float:
    """Return the value of a channel."""
    selected = mi.Float(values[0])
    for k in range(1, len(values)):
        selected = dr.select(channel == k, values[k], selected)
    return selected
