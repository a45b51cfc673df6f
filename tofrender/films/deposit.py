"""The measurement that puts light into the time bins of a film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import no_light, scaled
from .colours import units_of
from .contribution import Contribution

if TYPE_CHECKING:
    from ..signals.pulses import Pulse

Put = Callable[[mi.Spectrum, mi.Float, mi.Bool], None]
"""Takes (spectrum, opl, active)."""


@dataclass
class FilmDeposit:
    """Adds each contribution to a transient film, and sums them as a steady camera does.

    Attributes:
        total: Radiance over all time, an `mi.UnpolarizedSpectrum` or a Stokes vector.
        put: What deposits a contribution. A function hides the film from the path loop, which
            would otherwise carry a copy of all bins as its state.
        land: What deposits one that lands on any pixel: takes (spectrum, opl, position, active).
    """

    total: Any
    put: Put
    land: Any = None

    @classmethod
    def into(
        cls,
        film: Any,
        position: mi.Point2f,
        wavelengths: Any,
        weight: Any,
        pulse: Pulse | None,
        reach: Callable[..., None] | None = None,
        picture: Any = None,
    ) -> FilmDeposit:
        """Nothing deposited yet.

        Args:
            film: Anything with mitransient's `add_transient_data`, `temporal_bins`, `start_opl`
                and `bin_width_opl`.
            position: Position on the film [pixels].
            wavelengths: Sampled wavelengths of the rays [nm]; empty unless the variant is spectral.
            weight: Factor of every deposit: the camera ray's weight over the samples per pixel.
            pulse: Temporal profile of the light, None for an instant. It is convolved by its exact
                energy in each bin, which adds no noise.
            reach: How the pulse reaches the bins: `spread` (its energy in each) by default, or
                `open_gates`.
            picture: Takes (spectra, position, active) of light that lands on any pixel, for the
                steady image; None if none does.
        """
        # Before the loop, as four components would look the same colours up at each vertex
        colours = units_of(wavelengths) if mi.is_polarized and mi.is_spectral else None

        def put(spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
            one = mi.Float(1)
            light = scaled(spectrum, weight)
            if colours is not None:
                film.add_coloured(position, opl, colours, light, active)
                return
            film.add_transient_data(position, opl, wavelengths, light, one, active)

        def put_pulse(spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
            (reach or spread)(film, pulse, put, spectrum, opl, active)

        def land(spectrum: Any, opl: mi.Float, place: mi.Point2f, active: mi.Bool) -> None:
            def splat(spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
                film.add_splat(place, opl, wavelengths, scaled(spectrum, weight), active)

            picture([spectrum], place, active)
            if pulse is None:
                splat(spectrum, opl, active)
            else:
                (reach or spread)(film, pulse, splat, spectrum, opl, active)

        total = no_light()
        return cls(total, put if pulse is None else put_pulse, land if picture else None)

    def add(self, contribution: Contribution) -> None:
        """Deposit a contribution."""
        spectrum, active = contribution.spectrum, contribution.active
        if contribution.position is not None:
            self.land(spectrum, contribution.opl, contribution.position, active)
            return
        self.total += dr.select(active, spectrum, 0)
        self.put(spectrum, contribution.opl, active)

    @property
    def sums(self) -> list[Any]:
        """All that is summed."""
        return [self.total]

    def with_sums(self, sums: list[Any]) -> FilmDeposit:
        """The same with other sums."""
        return replace(self, total=sums[0])


@dr.syntax
def spread(
    film: Any, pulse: Any, put: Put, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool
) -> None:
    """Deposit a pulse's energy in each bin that it reaches: a difference of its cdf."""
    start, width = float(film.start_opl), float(film.bin_width_opl)
    k, last = reached(film, pulse, opl, False)
    opl = opl - start
    before = pulse.cdf(k * width - opl)  # Energy before bin k
    filling = active & (k <= last)
    while filling:
        after = pulse.cdf((k + 1) * width - opl)
        put(spectrum * (after - before), start + (k + 0.5) * width, filling)
        before = mi.Float(after)
        k += 1
        filling &= k <= last


@dr.syntax
def open_gates(
    film: Any, pulse: Any, put: Put, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool
) -> None:
    """Deposit a pulse's density at the centre of each bin that it reaches: a gate for every bin."""
    start, width = float(film.start_opl), float(film.bin_width_opl)
    k, last = reached(film, pulse, opl, True)
    filling = active & (k <= last)
    while filling:
        put(spectrum * share(film, pulse, k, opl, True), start + (k + 0.5) * width, filling)
        k += 1
        filling &= k <= last


def reached(film: Any, pulse: Any, opl: mi.Float, at_centres: bool) -> tuple[mi.Int32, mi.Int32]:
    """The first and the last bin that a pulse reaches which arrives at a length."""
    bins, start, width = int(film.temporal_bins), float(film.start_opl), float(film.bin_width_opl)
    low, high = (dr.opaque(mi.Float, each) for each in pulse.support)  # One kernel for all widths
    first, last = (opl - start + low) / width, (opl - start + high) / width
    # The arrival at opl is seen by the gate at t with p(t - opl)
    first = dr.ceil(first - 0.5) if at_centres else dr.floor(first)
    last = dr.floor(last - 0.5) if at_centres else dr.floor(last)
    return mi.Int32(dr.clip(first, 0, bins)), mi.Int32(dr.clip(last, -1, bins - 1))


def share(film: Any, pulse: Any, k: mi.Int32, opl: mi.Float, at_centres: bool) -> mi.Float:
    """What bin `k` gets of a pulse that arrives at a length: energy, or density at its centre."""
    start, width = float(film.start_opl), float(film.bin_width_opl)
    opl = opl - start
    if at_centres:
        return pulse.eval((k + 0.5) * width - opl)
    return pulse.cdf((k + 1) * width - opl) - pulse.cdf(k * width - opl)
