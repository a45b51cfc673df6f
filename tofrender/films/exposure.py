"""Exposure: an integrator's description of how light counts, independent of the film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ..signals.pulses import GaussianPulse, Pulse, SampledPulse, convolve

Weight = Callable[[mi.Float], mi.Float]
"""Takes an optical path length [m]. May say in `closes` beyond which it is 0 [m]."""

BINS, PHASORS, PICTURE = "transient_hdr_film", "phasor_hdr_film", "hdrfilm"


@dataclass(frozen=True)
class Exposure:
    """Weighting of light by its path length on a film.

    Attributes:
        onto: Supported kinds of film, of BINS, PHASORS and PICTURE.
        pulse: Temporal profile of the light, None for an instant.
        temporal_filter: "box", "gaussian", or "" for the film's `rfilter` in time as well.
        gaussian_stddev: Standard deviation of the Gaussian filter [bins].
        at_centres: Whether a bin has the pulse's density at its centre, as a gate has, rather than
            its energy within the bin.
        weight: Weight of contributions by their length on a picture; None if all count alike.
        lacks: Message that refuses a picture, "" if there can be one.
    """

    onto: tuple[str, ...] = (BINS, PHASORS)
    pulse: Pulse | None = None
    temporal_filter: str = "box"
    gaussian_stddev: float = 2.0
    at_centres: bool = False
    weight: Weight | None = None
    lacks: str = ""


def profile(film: mi.Film, exposure: Exposure) -> Pulse | None:
    """Return the light's pulse as the bins of a film see it, through the temporal filter.

    Raises:
        ValueError: The filter has negative lobes; one line.
    """
    blur = _filter(film, exposure)
    if exposure.pulse is None or blur is None:
        return exposure.pulse or blur
    return convolve(exposure.pulse, blur)


def _filter(film: mi.Film, exposure: Exposure) -> Pulse | None:
    """Return the temporal filter as a pulse, None if it is a box: a bin's own width."""
    width = float(film.bin_width_opl)
    if exposure.temporal_filter == "gaussian":
        return GaussianPulse(exposure.gaussian_stddev * width)
    rfilter = film.rfilter()
    if exposure.temporal_filter == "box" or rfilter.is_box_filter():
        return None
    radius = rfilter.radius()
    step = 2 * radius / 4096
    values = np.array(rfilter.eval(mi.Float(-radius + step * (np.arange(4096) + 0.5))))
    if np.any(values < 0):
        raise ValueError(
            "temporal_filter = '': takes the film's rfilter, whose negative lobes have no "
            "meaning in time; must be 'box' or 'gaussian' with this film"
        )
    return SampledPulse(values, -radius * width, step * width)
