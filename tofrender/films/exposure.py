"""How light exposes a film: what an integrator says of it, whatever the film is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mitsuba as mi

if TYPE_CHECKING:
    from ..signals.pulses import Pulse

Weight = Callable[[mi.Float], Any]
"""Takes an optical path length [m]. May say in `closes` beyond which it is 0 [m]."""

BINS, PHASORS, PICTURE = "transient_hdr_film", "phasor_hdr_film", "hdrfilm"


@dataclass(frozen=True)
class Exposure:
    """How light of some path length counts on a film.

    Attributes:
        onto: Kinds of film that it makes sense on, of BINS, PHASORS and PICTURE.
        pulse: Temporal profile of the light, None for an instant.
        temporal_filter: "box", "gaussian", or "" for the film's `rfilter` in time as well.
        gaussian_stddev: Standard deviation of the Gaussian filter [bins].
        at_centres: Whether a bin takes the pulse's density at its centre, as a gate does, rather
            than its energy within the bin.
        weight: What a contribution counts by its length on a picture; None if all count alike.
        lacks: Why there can be no picture yet, as the message that refuses it; "" if there can.
    """

    onto: tuple[str, ...] = (BINS, PHASORS)
    pulse: Pulse | None = None
    temporal_filter: str = "box"
    gaussian_stddev: float = 2.0
    at_centres: bool = False
    weight: Weight | None = None
    lacks: str = ""
