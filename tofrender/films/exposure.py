"""Exposure: an integrator's description of how light counts, independent of the film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ..signals.pulses import GaussianPulse, Pulse, SampledPulse, convolve
from .image import temporal_filter_of

Weight = Callable[[mi.Float], mi.Float]
"""Function of the optical path length [m]; 0 beyond its optional attribute `closes` [m]."""

BINS, PHASORS, PICTURE = "transient_hdr_film", "phasor_hdr_film", "hdrfilm"


@dataclass(frozen=True)
class Exposure:
    """Weighting of light by its path length on a film."""

    onto: tuple[str, ...] = (BINS, PHASORS)  # Supported kinds of film
    pulse: Pulse | None = None  # Temporal profile of the light, None for an instant
    temporal_filter: str = "box"  # Or "gaussian", or "" for the temporal filter of the film
    gaussian_stddev: float = 2.0  # Standard deviation of the Gaussian filter [bins]
    at_centres: bool = False  # Bins have the pulse's density at their centre, not its energy
    weight: Weight | None = None  # By length, on a picture; None if all light counts alike
    lacks: str = ""  # Message that refuses a picture, "" if there can be one


def profile(film: mi.Film, exposure: Exposure) -> Pulse | None:
    """Return the light's pulse as the bins of a film see it, through the temporal filter."""
    blur = _filter(film, exposure)
    if exposure.pulse is None or blur is None:
        return exposure.pulse or blur
    return convolve(exposure.pulse, blur)


def _filter(film: mi.Film, exposure: Exposure) -> Pulse | None:
    """Return the temporal filter as a pulse, None if it is a box: a bin's own width."""
    width = float(film.bin_width_opl)
    name = exposure.temporal_filter or temporal_filter_of(film)
    if name == "gaussian":
        return GaussianPulse(exposure.gaussian_stddev * width)
    rfilter = film.rfilter()
    if name == "box" or rfilter.is_box_filter():
        return None

    # Take the rfilter of the film, in bins instead of pixels
    radius = rfilter.radius()
    step = 2 * radius / 4096
    values = np.array(rfilter.eval(mi.Float(-radius + step * (np.arange(4096) + 0.5))))
    if np.any(values < 0):
        raise ValueError(
            f"the film's rfilter {rfilter.class_name()} has negative lobes, which have no meaning "
            "in time. Set the parameter temporal_filter of the integrator to 'box'"
        )
    return SampledPulse(values, -radius * width, step * width)
