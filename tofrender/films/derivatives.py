"""Derivatives of films: rates of their values, and gradients by the light of paths.

A film's values are linear in light. Forwards, the rate of a film is the film of the rates; in
reverse, a film's gradient is read where light lands. Time bins need a pulse for both: with its
cumulative distribution P, light at the length o leaves the share P(e' - o) - P(e - o) in a bin from
e to e', whose derivative is a difference of densities. A bin without a pulse would be all or
nothing.

Each method works for one step of the path loop: it differentiates what one vertex has brought.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import no_light, scaled
from .colours import channels_of
from .contribution import Contribution
from .recording import BinRecording, Recording
from .time_bins import TimeBins, bins_of_pulse, pulse_weight

FORWARDS = dr.ADFlag.ClearEdges | dr.ADFlag.AllowNoGrad
"""Rates of parameters are needed again at the next vertex."""

REVERSE = dr.ADFlag.Default | dr.ADFlag.AllowNoGrad


@dataclass
class Collected:
    """Collects the light of one vertex.

    Attributes:
        measurement: Sums it.
        kept: Spectrum, length and lanes of each contribution to time bins.
    """

    measurement: Any
    kept: list[Any]

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        self.measurement.add(contribution)


class Changes:
    """Derivatives of a recording of camera rays, by sums of any kind.

    Args:
        record: The recording; the samples of its film are rates, or there is a gradient.
        camera: The rays.
        spp: Samples per pixel.
        gradients: Of a loss by what the film develops: the picture, and the bins or phasors if it
            has some. None if there are rates.
    """

    def __init__(
        self, record: Any, camera: Any, spp: int, gradients: Sequence[Any] | None = None
    ) -> None:
        self.record, self.camera, self.spp = record, camera, spp
        self.gradients: Any = gradients
        self.gradients_of_sums: list[Any] = [] if gradients is None else self._gradients_of_sums()

    def step(self) -> Collected:
        """Create the measurement of one vertex."""
        return Collected(self.record.measurement(self.camera, self.spp), [])

    def zero(self) -> list[Any]:
        """Return sums that are 0."""
        return self.record.measurement(self.camera, self.spp).sums

    # ---------------------------------------------------------------------- forwards

    def move(self, collected: Collected, sums: list[Any], more: Any) -> list[Any]:
        """Propagate rates to what was collected, and to more.

        Returns:
            The rates of all sums so far, to `sums`.
        """
        new = collected.measurement.sums
        dr.forward_to([new, collected.kept, more], flags=FORWARDS)
        return [total + dr.grad(each) for total, each in zip(sums, new, strict=True)]

    def channels(self, rates: list[Any]) -> tuple[list[Any], list[Any]]:
        """Return rates of samples in the picture, before and behind their weight."""
        sums = [dr.zeros_like(rate) for rate in rates]
        with dr.resume_grad():
            dr.enable_grad(sums)
            dr.set_grad(sums, rates)
            before, behind = self._channels(sums)
            dr.forward_to([before, behind], flags=FORWARDS)
            return [dr.grad(each) for each in before], [dr.grad(each) for each in behind]

    def _channels(self, sums: list[Any]) -> tuple[list[Any], list[Any]]:
        measured = self.record.measurement(self.camera, self.spp).with_sums(sums)
        return self.record.channels(self.camera, measured, mi.Bool(False))

    # ----------------------------------------------------------------------- reverse

    def pull(self, collected: Collected, more: Any, gradient: Any) -> None:
        """Propagate gradients through what was collected, and more."""
        for total, gradient_of_sum in zip(
            collected.measurement.sums, self.gradients_of_sums, strict=True
        ):
            self.root(total, gradient_of_sum)
        self.root(more, gradient)
        dr.traverse(dr.ADMode.Backward, REVERSE)

    @staticmethod
    def root(value: Any, gradient: Any) -> None:
        """Start the next traversal at a value, among others."""
        dr.accum_grad(value, gradient)
        dr.enqueue(dr.ADMode.Backward, value)

    def _gradients_of_sums(self) -> list[Any]:
        """Return the gradient of each sum."""
        lanes = dr.zeros(mi.Float, dr.width(self.camera.ray))
        sums = [each + lanes for each in self.zero()]
        with dr.resume_grad():
            dr.enable_grad(sums)
            loss = mi.Float(0)
            for number, channel in enumerate(self._developed(*self._channels(sums))):
                loss += channel * self._gradient(number)
            dr.backward_from(loss / self.spp, flags=REVERSE)
            return [dr.grad(each) for each in sums]

    def _developed(self, before: list[Any], behind: list[Any]) -> list[Any]:
        """Return the channels of a sample as the film develops them."""
        count = int(self.record.image.develop().shape[2]) - len(behind)
        colour, alpha = before[:3], before[3:]
        if count - len(alpha) < len(colour):
            grey = colour[0] if mi.is_monochromatic else mi.luminance(mi.Color3f(*colour))
            colour = [grey]
        return [*colour, *alpha, *behind]

    def _gradient(self, number: int) -> mi.Float:
        """Return the gradient of a channel; those of phasors are behind those of the picture."""
        own = int(self.gradients[0].shape[-1])
        if number < own:
            return self.read(self.gradients[0], self.pixel(), number, own)
        tensor = self.gradients[1]
        count = dr.prod(tensor.shape[2:])
        return self.read(tensor, self.pixel(), number - own, count)

    def pixel(self) -> mi.UInt32:
        """Return the number of the rays' pixel in the crop window."""
        film: mi.Film = self.record.film
        at = mi.Point2u(self.camera.position - mi.Vector2f(film.crop_offset()))
        return mi.UInt32(at.y * int(film.crop_size()[0]) + at.x)

    @staticmethod
    def read(tensor: Any, cell: Any, number: int, count: int, active: Any = True) -> mi.Float:
        """Read channel `number` of cells of a tensor that have `count` each."""
        return dr.gather(mi.Float, tensor.array, cell * count + number, active)


class BinChanges(Changes):
    """Derivatives of time bins, and of the sum for their steady image."""

    record: BinRecording

    def step(self) -> Collected:
        """Create the measurement of one vertex, which keeps contributions to bins."""
        kept: list[Any] = []
        return Collected(TimeBins(no_light(), lambda *light: kept.append(light)), kept)

    def move(self, collected: Collected, sums: list[Any], more: Any) -> list[Any]:
        """Propagate rates, also into time bins."""
        sums = super().move(collected, sums, more)
        for spectrum, opl, active in collected.kept:
            rates = dr.grad(spectrum), dr.grad(opl)
            self._add_rates(dr.detach(spectrum), dr.detach(opl), *rates, dr.detach(active))
        return sums

    @dr.syntax
    def _add_rates(self, spectrum, opl, spectrum_rate, opl_rate, active):
        """Add the rate of each bin that a contribution reaches."""
        with dr.suspend_grad():
            k, last = self._reached(opl)
            filling = active & (k <= last)
            while filling:
                rate = self._rate(k, spectrum, opl, spectrum_rate, opl_rate)
                self._put(rate, k, filling)
                k += 1
                filling &= k <= last

    def _rate(self, k, spectrum, opl, spectrum_rate, opl_rate):
        with dr.resume_grad():
            light, at = _variables(spectrum, opl)
            dr.set_grad(light, spectrum_rate)
            dr.set_grad(at, opl_rate)
            in_bin = self._in_bin(light, k, at)
            dr.forward_to(in_bin, flags=FORWARDS)
            return dr.grad(in_bin)

    def _put(self, light: Any, k: mi.Int32, active: mi.Bool) -> None:
        """Add light to bin `k`."""
        film, wavelengths = self.record.film, self.camera.ray.wavelengths
        centre = float(film.start_opl) + (k + 0.5) * float(film.bin_width_opl)
        place = self.camera.position, centre, wavelengths
        film.add_transient_data(*place, self._weighted(light), mi.Float(1), active)

    def _weighted(self, light: Any) -> Any:
        return scaled(light, self.camera.weight / self.spp)

    def pull(self, collected: Collected, more: Any, gradient: Any) -> None:
        """Propagate gradients, also from time bins."""
        gradients = [self._gradient_of_bins(*map(dr.detach, light)) for light in collected.kept]
        for (spectrum, opl, _), (by_spectrum, by_opl) in zip(
            collected.kept, gradients, strict=True
        ):
            self.root(spectrum, by_spectrum)
            self.root(opl, by_opl)
        super().pull(collected, more, gradient)

    @dr.syntax
    def _gradient_of_bins(self, spectrum, opl, active):
        """Return the gradient of a contribution: that of all bins that it reaches."""
        with dr.suspend_grad():
            light, at = dr.zeros_like(spectrum), dr.zeros_like(opl)
            k, last = self._reached(opl)
            reading = active & (k <= last)
            while reading:
                more, later = self._gradient_of_bin(k, spectrum, opl, reading)
                light += more
                at += later
                k += 1
                reading &= k <= last
            return light, at

    def _gradient_of_bin(self, k, spectrum, opl, active):
        with dr.resume_grad():
            light, at = _variables(spectrum, opl)
            in_bin = self._weighted(self._in_bin(light, k, at))
            loss = mi.Float(0)
            values = channels_of(in_bin, self.camera.ray.wavelengths, active)
            cell = self.pixel() * self.record.film.temporal_bins + mi.UInt32(k)
            for number, value in enumerate(values):
                gradient = self.read(self.gradients[1], cell, number, len(values), active)
                loss += value * gradient
            dr.backward_from(loss, flags=REVERSE)
            return dr.grad(light), dr.grad(at)

    def _reached(self, opl: mi.Float) -> tuple[mi.Int32, mi.Int32]:
        record = self.record
        return bins_of_pulse(record.film, record.profile, opl, record.exposure.at_centres)

    def _in_bin(self, light: Any, k: mi.Int32, opl: mi.Float) -> Any:
        """Return the light in bin `k`."""
        film, gated = self.record.film, self.record.exposure.at_centres
        return scaled(light, pulse_weight(film, self.record.profile, k, opl, gated))


def changes(record: Recording, camera: Any, spp: int, gradients: Any = None) -> Changes:
    """Return the derivatives of a recording, see `Changes`."""
    kind = BinChanges if isinstance(record, BinRecording) else Changes
    return kind(record, camera, spp, gradients)


def _variables(*values: Any) -> tuple[Any, ...]:
    """Copy values as new variables to differentiate by."""
    copies = tuple(dr.detach(each) for each in values)
    dr.enable_grad(copies)
    return copies
