"""The measurement that adds light to the time bins of a film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import no_light, scaled
from ..signals.pulses import Pulse
from .colours import units_of
from .contribution import CameraRays, Contribution
from .sums import Radiance, Splat

Put = Callable[[mi.Spectrum, mi.Float, mi.Bool], None]
"""Adds light of an optical path length [m] to a film's bins, in active lanes."""

PutAt = Callable[[mi.Spectrum, mi.Float, mi.Point2f, mi.Bool], None]
"""As `Put`, at a position anywhere on the film [pixels]."""


@dataclass
class TimeBins(Radiance):
    """Adds contributions to the time bins of a film, and sums them as a steady camera does."""

    # adds a contribution to the bins. A function hides the film from the path loop, which would
    # otherwise carry a copy of all bins as its state
    put: Put | None = None
    # adds a contribution that has a position, to the bins and to the steady image
    splat_bins: PutAt | None = None

    @classmethod
    def of_film(
        cls,
        film: mi.Film,
        camera: CameraRays,
        spp: int,
        pulse: Pulse | None,
        at_centres: bool = False,
        splat_steady: Splat | None = None,
    ) -> TimeBins:
        """Create the measurement of the bins of a film, ours or mitransient's.

        A bin takes the pulse's exact energy within it, which adds no noise, or if `at_centres` its
        density at the bin's centre. `splat_steady` adds splats to the steady image.
        """
        position, wavelengths, weight = camera.position, camera.ray.wavelengths, camera.weight / spp
        # Before the loop, as four components would look the same colours up at each vertex
        spectral = mi.is_polarized and mi.is_spectral
        more = {"colours": units_of(wavelengths)} if spectral else {}

        def put(spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
            light = scaled(spectrum, weight)
            film.add_transient_data(position, opl, wavelengths, light, mi.Float(1), active, **more)

        def convolved(put: Put, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
            if pulse is None:
                put(spectrum, opl, active)
            else:
                add_pulse(film, pulse, put, spectrum, opl, active, at_centres)

        def splat(spectrum: mi.Spectrum, opl: mi.Float, at: mi.Point2f, active: mi.Bool) -> None:
            def put_splat(spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
                film.add_splat(at, opl, wavelengths, scaled(spectrum, weight), active)

            splat_steady([spectrum], at, active)
            convolved(put_splat, spectrum, opl, active)

        splat_bins = splat if splat_steady else None
        return cls(no_light(), put=partial(convolved, put), splat_bins=splat_bins)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        spectrum, active = contribution.spectrum, contribution.active
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
    at_centres: bool,
) -> None:
    """Add a pulse to each bin that it reaches: its energy there, a difference of its cdf.

    With `at_centres` its density at the bin's centre instead: a gate for every bin.
    """
    start, width = float(film.start_opl), float(film.bin_width_opl)
    k, last = bins_of_pulse(film, pulse, opl, at_centres)
    delay = opl - start
    before = mi.Float(0) if at_centres else pulse.cdf(k * width - delay)  # Energy before bin k
    filling = active & (k <= last)
    while filling:
        if dr.hint(at_centres, mode="scalar"):
            part = pulse_weight(film, pulse, k, opl, True)
        else:
            after = pulse.cdf((k + 1) * width - delay)
            part = after - before
            before = mi.Float(after)
        put(spectrum * part, start + (k + 0.5) * width, filling)
        k += 1
        filling &= k <= last


def bins_of_pulse(
    film: mi.Film, pulse: Pulse, opl: mi.Float, at_centres: bool
) -> tuple[mi.Int32, mi.Int32]:
    """Return the first and the last bin reached by a pulse that arrives at a length."""
    bins, start, width = int(film.temporal_bins), float(film.start_opl), float(film.bin_width_opl)
    low, high = (dr.opaque(mi.Float, each) for each in pulse.support)  # One kernel for all widths
    first, last = (opl - start + low) / width, (opl - start + high) / width
    # The arrival at opl is seen by the gate at t with p(t - opl)
    first = dr.ceil(first - 0.5) if at_centres else dr.floor(first)
    last = dr.floor(last - 0.5) if at_centres else dr.floor(last)
    return mi.Int32(dr.clip(first, 0, bins)), mi.Int32(dr.clip(last, -1, bins - 1))


def bin_of_instant(film: mi.Film, opl: mi.Float) -> tuple[mi.Int32, mi.Int32]:
    """Return the bin of light without a pulse, twice; (0, -1) outside the window."""
    bins, start, width = int(film.temporal_bins), float(film.start_opl), float(film.bin_width_opl)
    k = mi.Int32(dr.floor(dr.clip((opl - start) / width, -1, bins)))
    within = (k >= 0) & (k < bins)
    return dr.select(within, k, 0), dr.select(within, k, -1)


def pulse_weight(
    film: mi.Film, pulse: Pulse, k: mi.Int32, opl: mi.Float, at_centres: bool
) -> mi.Float:
    """Return energy in bin `k` of a pulse that arrives at a length, or density at its centre."""
    start, width = float(film.start_opl), float(film.bin_width_opl)
    opl = opl - start
    if at_centres:
        return pulse.eval((k + 0.5) * width - opl)
    return pulse.cdf((k + 1) * width - opl) - pulse.cdf(k * width - opl)
