"""State of a flight through media, and sampling of its channel."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class Flight:
    """State of the loop over null collisions and boundaries along a ray."""

    # Ray that finds the next surface. It starts behind the last boundary
    ray: mi.Ray3f

    # Next surface on the ray
    pi: mi.PreliminaryIntersection3f

    # Distance from the start of the flight to the next surface [m], infinite without a surface
    end: mi.Float

    # Distance from the start of the flight to the point reached so far [m]
    distance: mi.Float

    # Current medium, null in vacuum
    medium: mi.MediumPtr

    # Free flights: density of the flight in each channel, relative to the density in the sampled
    # channel. Connections: transmittance so far
    weight: mi.UnpolarizedSpectrum

    # Single-scattering albedo at the scattering point
    albedo: mi.UnpolarizedSpectrum

    # Lanes that have reached a scattering point
    scattered: mi.Bool

    # Lanes that continue
    active: mi.Bool

    # Lanes that have crossed a boundary, so that the next surface must be searched
    needs_intersection: mi.Bool

    # Lanes that cross area lights like boundaries, for hidden emitters
    passes_emitters: mi.Bool

    # Mueller matrix of null transmission along a connection, None in unpolarized variants
    mueller: mi.Spectrum | None = None

    # Lanes that stop at emitters on boundaries, None if no lane stops
    stops: mi.Bool | None = None

    @classmethod
    def start(
        cls, ray: mi.Ray3f, medium: mi.MediumPtr, active: mi.Bool, passes_emitters: mi.Bool | bool
    ) -> Flight:
        """Start a flight along a ray in a medium."""
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
    """Return probabilities of the channels, proportional to throughput."""
    total = dr.sum(dr.abs(β))
    return dr.select(total > 0, dr.abs(β) / total, mi.UnpolarizedSpectrum(1 / len(β)))


def sample_channel(q: mi.UnpolarizedSpectrum, xi: mi.Float) -> mi.UInt32:
    """Sample the index of a channel with the probabilities `q`, given a random number `xi`."""
    channel = mi.UInt32(0)
    cdf = mi.Float(0)
    for k in range(len(q) - 1):
        cdf = cdf + q[k]
        channel += dr.select(xi >= cdf, mi.UInt32(1), 0)
    return channel


def value_in(values: mi.UnpolarizedSpectrum, channel: mi.UInt32) -> mi.Float:
    """Return the value of the channel with an index that differs between lanes."""
    selected = mi.Float(values[0])
    for k in range(1, len(values)):
        selected = dr.select(channel == k, values[k], selected)
    return selected
