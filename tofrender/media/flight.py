"""State of a flight through media."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class Flight:
    """State of the loop over null collisions and boundaries along a ray."""

    ray: mi.Ray3f  # the ray that finds the next surface
    pi: mi.PreliminaryIntersection3f  # that surface
    end: mi.Float  # its distance from the start of the flight [m]
    distance: mi.Float  # distance up to which the flight is sampled [m]
    medium: mi.MediumPtr  # the current medium
    # density of the flight in each channel over that in the sampled channel; for connections, the
    # transmittance
    weight: mi.UnpolarizedSpectrum
    albedo: mi.UnpolarizedSpectrum  # albedo at a scattering point
    scattered: mi.Bool  # lanes that end at a scattering point
    active: mi.Bool  # lanes that go on
    needs_intersection: mi.Bool  # lanes whose next surface is not known
    passes_emitters: mi.Bool  # lanes that cross area lights like boundaries
    mueller: mi.Spectrum | None = None  # of null transmission along a connection
    stops: mi.Bool | None = None  # lanes that stop at emitters on boundaries; None if none do

    @classmethod
    def start(
        cls, ray: mi.Ray3f, medium: mi.MediumPtr, active: mi.Bool, passes_emitters: mi.Bool | bool
    ) -> Flight:
        """Start a flight along a ray."""
        lanes = dr.width(ray)
        zero = dr.zeros(mi.Float, lanes)
        pi = dr.zeros(mi.PreliminaryIntersection3f, lanes)
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


def channel_probabilities(β: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
    """Return channel probabilities in proportion to throughput."""
    total = dr.sum(dr.abs(β))
    return dr.select(total > 0, dr.abs(β) / total, mi.UnpolarizedSpectrum(1 / len(β)))


def sample_channel(q: mi.UnpolarizedSpectrum, xi: mi.Float) -> mi.UInt32:
    """Sample a channel with the probabilities `q`."""
    channel, cdf = mi.UInt32(0), mi.Float(0)
    for k in range(len(q) - 1):
        cdf = cdf + q[k]
        channel += dr.select(xi >= cdf, mi.UInt32(1), 0)
    return channel


def value_in(values: mi.UnpolarizedSpectrum, channel: mi.UInt32) -> mi.Float:
    """Return the value of a channel."""
    selected = mi.Float(values[0])
    for k in range(1, len(values)):
        selected = dr.select(channel == k, values[k], selected)
    return selected
