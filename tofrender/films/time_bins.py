"""Measurement that adds light to the time bins of a film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from ..signals.polarization import no_light, scaled
from ..signals.pulses import Pulse
from .channels import units_of
from .contribution import CameraSample, Contribution
from .sums import Radiance, Splat

Put = Callable[[mi.Spectrum, mi.Float, mi.Bool], None]
"""Function that adds light with an optical path length [m] to a film's bins, in active lanes."""

PutAt = Callable[[mi.Spectrum, mi.Float, mi.Point2f, mi.Bool], None]
"""Function like `Put` for light at any position of the film [pixels]."""


@dataclass
class TimeBins(Radiance):
    """Measurement that adds light to time bins, and sums all light as a steady camera does."""

    # Function that adds a contribution to the bins. A function hides the film from the path loop,
    # which would otherwise carry a copy of all bins as state
    put: Put | None = None

    # Function that adds a contribution with a position to the bins and to the steady image
    splat_bins: PutAt | None = None

    @classmethod
    def of_film(
        cls,
        film: mi.Film,
        camera: CameraSample,
        weight: mi.UnpolarizedSpectrum,
        pulse: Pulse | None,
        at_centers: bool = False,
        splat_steady: Splat | None = None,
        one_writer: bool = False,
    ) -> TimeBins:
        """Create the measurement of the bins of this package's or mitransient's film.

        Args:
            film: The film.
            camera: The camera rays.
            weight: Weight of the camera rays over the number of samples per pixel.
            pulse: Temporal profile of the light, None for an instant.
            at_centers: False for bins that measure the exact energy of the pulse in the bin, which
                does not add noise. True for bins that measure the density of the pulse at their
                center.
            splat_steady: Function that adds splats to the steady image.
            one_writer: Whether only one thread writes to each pixel. mitransient's film does not
                support this.
        """
        position = camera.position
        wavelengths = camera.ray.wavelengths

        # Convert wavelengths to colors once, because polarized light would otherwise convert them
        # for four components at each vertex
        spectral = mi.is_polarized and mi.is_spectral
        options: dict[str, Any] = {"colors": units_of(wavelengths)} if spectral else {}
        if one_writer:
            options["one_writer"] = True

        def put(spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
            """Add light of an instant to a bin."""
            light = scaled(spectrum, weight)
            film.add_transient_data(
                position, opl, wavelengths, light, mi.Float(1), active, **options
            )

        def convolved(put: Put, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
            """Add the light of a pulse to the bins."""
            if pulse is None:
                put(spectrum, opl, active)
            else:
                add_pulse(film, pulse, put, spectrum, opl, active, at_centers)

        def splat(spectrum: mi.Spectrum, opl: mi.Float, at: mi.Point2f, active: mi.Bool) -> None:
            """Add light to the bins and the steady image, at any position of the film."""

            def put_splat(spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
                """Add a splat of an instant to a bin."""
                film.add_splat(at, opl, wavelengths, scaled(spectrum, weight), active)

            splat_steady([spectrum], at, active)
            convolved(put_splat, spectrum, opl, active)

        splat_bins = splat if splat_steady else None
        return cls(no_light(), put=partial(convolved, put), splat_bins=splat_bins)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution to the bins and to the steady sum."""
        spectrum = contribution.spectrum
        active = contribution.active
        if contribution.position is not None:
            self.splat_bins(spectrum, contribution.opl, contribution.position, active)
            return
        self.total += dr.select(active, spectrum, 0)
        self.put(spectrum, contribution.opl, active)


@dr.syntax
def add_pulse(
    film: mi.Film,
    pulse: Pulse,
    put: Put,
    spectrum: mi.Spectrum,
    opl: mi.Float,
    active: mi.Bool,
    at_centers: bool,
) -> None:
    """Add light with the temporal profile of a pulse to all bins that the pulse reaches.

    | loop state | meaning |
    |---|---|
    | `k` | index of the bin |
    | `before` | fraction of the pulse's energy before bin k |
    | `filling` | lanes with more bins |

    Args:
        film: The film.
        pulse: The pulse.
        put: Function that adds light to one bin.
        spectrum: The light.
        opl: Optical path length of the pulse's center [m].
        active: Active lanes.
        at_centers: False to add the pulse's energy in each bin, a difference of its cdf. True to
            add the pulse's density at the center of each bin, which is a time gate for each bin.
    """
    # --------------------- Which bins does the pulse reach? ---------------------

    start = float(film.start_opl)
    width = float(film.bin_width_opl)
    k, last = bins_of_pulse(film, pulse, opl, at_centers)
    delay = opl - start
    before = mi.Float(0) if at_centers else pulse.cdf(k * width - delay)
    filling = active & (k <= last)

    # --------------------- Add a part of the pulse to each bin ---------------------

    while filling:
        if dr.hint(at_centers, mode="scalar"):
            part = pulse_weight(film, pulse, k, opl, True)
        else:
            after = pulse.cdf((k + 1) * width - delay)
            part = after - before
            before = mi.Float(after)
        put(spectrum * part, start + (k + 0.5) * width, filling)
        k += 1
        filling &= k <= last


def bins_of_pulse(
    film: mi.Film, pulse: Pulse, opl: mi.Float, at_centers: bool
) -> tuple[mi.Int32, mi.Int32]:
    """Return the first and the last bin that a pulse with an optical path length reaches."""
    bins = int(film.temporal_bins)
    start = float(film.start_opl)
    width = float(film.bin_width_opl)

    # Ends of the pulse in bins. Opaque values make one kernel for all widths of the pulse
    low, high = (dr.opaque(mi.Float, each) for each in pulse.support)
    first = (opl - start + low) / width
    last = (opl - start + high) / width

    # With `at_centers`, the center of a bin must be between the ends
    first = dr.ceil(first - 0.5) if at_centers else dr.floor(first)
    last = dr.floor(last - 0.5) if at_centers else dr.floor(last)
    return mi.Int32(dr.clip(first, 0, bins)), mi.Int32(dr.clip(last, -1, bins - 1))


def bin_of_instant(film: mi.Film, opl: mi.Float) -> tuple[mi.Int32, mi.Int32]:
    """Return the bin of light without a pulse as first and last bin, (0, -1) outside the window."""
    bins = int(film.temporal_bins)
    start = float(film.start_opl)
    width = float(film.bin_width_opl)
    k = mi.Int32(dr.floor(dr.clip((opl - start) / width, -1, bins)))
    within = (k >= 0) & (k < bins)
    return dr.select(within, k, 0), dr.select(within, k, -1)


def pulse_weight(
    film: mi.Film, pulse: Pulse, k: mi.Int32, opl: mi.Float, at_centers: bool
) -> mi.Float:
    """Return the fraction of a pulse's energy in bin `k`, or its density at the bin's center.

    Args:
        film: The film.
        pulse: The pulse.
        k: Index of the bin.
        opl: Optical path length of the pulse's center [m].
        at_centers: Whether the density at the center of the bin is returned [1/m].
    """
    start = float(film.start_opl)
    width = float(film.bin_width_opl)
    opl = opl - start
    if at_centers:
        return pulse.eval((k + 0.5) * width - opl)
    return pulse.cdf((k + 1) * width - opl) - pulse.cdf(k * width - opl)
