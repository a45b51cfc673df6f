"""Exposure: how an integrator weights light by path length, independent of the film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ..signals.pulses import GaussianPulse, Pulse, SampledPulse, convolve
from .image import temporal_filter_of

Weight = Callable[[mi.Float], mi.Float]
"""Weight as a function of the optical path length [m]. If the function has an attribute `closes`
[m], the weight is 0 for larger path lengths.
"""

BINS = "transient_hdr_film"
PHASORS = "phasor_hdr_film"
PICTURE = "hdrfilm"


@dataclass(frozen=True)
class Exposure:
    """Weighting of light by its path length on a film."""

    # Supported kinds of film
    supported_films: tuple[str, ...] = (BINS, PHASORS)

    # Temporal profile of the emitted light, None for an instant
    pulse: Pulse | None = None

    # Filter in time: "box", "gaussian", or "" for the temporal filter of the film
    temporal_filter: str = "box"

    # Standard deviation of the Gaussian filter [bins]
    gaussian_stddev: float = 2.0

    # Whether a bin measures the pulse's density at its center, as a time gate does, instead of the
    # pulse's energy in the bin
    at_centers: bool = False

    # Weight by path length on a steady picture, None if all light has the weight 1
    weight: Weight | None = None

    # Error message if a steady picture is not supported, otherwise ""
    steady_film_error: str = ""


def profile(film: mi.Film, exposure: Exposure) -> Pulse | None:
    """Return the convolution of the light's pulse with the temporal filter, None for an instant."""
    blur = _filter(film, exposure)
    if exposure.pulse is None or blur is None:
        return exposure.pulse or blur
    return convolve(exposure.pulse, blur)


def _filter(film: mi.Film, exposure: Exposure) -> Pulse | None:
    """Return the temporal filter as a pulse, or None for a box filter of the width of a bin."""
    width = float(film.bin_width_opl)
    name = exposure.temporal_filter or temporal_filter_of(film)
    if name == "gaussian":
        return GaussianPulse(exposure.gaussian_stddev * width)
    rfilter = film.rfilter()
    if name == "box" or rfilter.is_box_filter():
        return None

    # Sample the reconstruction filter of the film, with bins as unit instead of pixels
    radius = rfilter.radius()
    step = 2 * radius / 4096
    values = np.array(rfilter.eval(mi.Float(-radius + step * (np.arange(4096) + 0.5))))
    if np.any(values < 0):
        raise ValueError(
            f"the film's rfilter {rfilter.class_name()} has negative lobes, which are not "
            "supported in time. Set the parameter temporal_filter of the integrator to 'box'"
        )
    return SampledPulse(values, -radius * width, step * width)
