# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""A flight through media on its way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass
class Flight:
    """A flight on its way: the state of the loop over null collisions and boundaries.

    Attributes:
        ray: What is looked along for the next surface.
        found: That surface.
        end: Its distance from the start [m].
        at: Distance from which the flight goes on [m].
        medium: What it goes on in.
        left: Its chance in each channel over that in the one it is drawn in; of connections, what
            arrives.
        albedo: That of the point that scatters.
        here: Lanes that a medium has scattered.
        going: Lanes that go on.
        looking: Lanes whose next surface is not known.
        through_lamps: Lanes that go through lamps as through boundaries.
        turned: Mueller matrix of what has let a connection straight through, None if none can.
    """

    ray: mi.Ray3f
    found: mi.PreliminaryIntersection3f
    end: mi.Float
    at: mi.Float
    medium: mi.MediumPtr
    left: Any
    albedo: Any
    here: mi.Bool
    going: mi.Bool
    looking: mi.Bool
    through_lamps: mi.Bool
    turned: Any = None

    @classmethod
    def start(
        cls, ray: mi.Ray3f, medium: mi.MediumPtr, active: mi.Bool, through_lamps: Any
    ) -> Flight:
        """A flight along a ray, through a medium."""
        lanes = dr.width(ray)
        nothing = dr.zeros(mi.Float, lanes)
        found: Any = dr.zeros(mi.PreliminaryIntersection3f, lanes)
        found.t = nothing + dr.inf
        return cls(
            ray=mi.Ray3f(ray),
            found=found,
            end=mi.Float(nothing),
            at=mi.Float(nothing),
            medium=mi.MediumPtr(medium),
            left=mi.UnpolarizedSpectrum(1) + nothing,
            albedo=mi.UnpolarizedSpectrum(0) + nothing,
            here=dr.zeros(mi.Bool, lanes),
            going=mi.Bool(active),
            looking=mi.Bool(active),
            through_lamps=mi.Bool(through_lamps),
        )
