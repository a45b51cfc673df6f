"""Derivatives of films: rates of their values, and gradients by the light of paths.

A film's values are linear in light. Forwards, the rate of a film is the film of the rates; in
reverse, a film's gradient is read where light lands. Time bins need a pulse for both: with its
cumulative distribution P, light at the length o leaves the fraction P(e' - o) - P(e - o) in a bin
from e to e', whose derivative is a difference of densities. A bin without a pulse would be all or
nothing.

Each method works for one step of the path loop: it differentiates what one vertex has brought.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.colours import channels_of
from ..films.contribution import CameraRays, Contribution
from ..films.recording import BinRecording, Recording
from ..films.sums import Radiance
from ..films.time_bins import TimeBins, bin_of_instant, bins_of_pulse, pulse_weight
from ..signals.polarisation import no_light, scaled

# Rates of parameters are needed again at the next vertex
FORWARDS = dr.ADFlag.ClearEdges | dr.ADFlag.AllowNoGrad
REVERSE = dr.ADFlag.Default | dr.ADFlag.AllowNoGrad

Binned = tuple[mi.Spectrum, mi.Float, mi.Bool]
Rates = list[mi.Spectrum]


@dataclass
class Collected:
    """Collects the light of one vertex."""

    measurement: Radiance
    binned: list[Binned]  # Spectrum, length and lanes of each contribution to time bins

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        self.measurement.add(contribution)


class Changes:
    """Derivatives of a recording of camera rays, by sums of any kind.

    `gradients`, in reverse mode only, are those of a loss by what the film develops: the picture,
    and the bins or phasors if it has some.
    """

    def __init__(
        self, record: Recording, camera: CameraRays, spp: int, gradients: Sequence[mi.TensorXf] = ()
    ) -> None:
        self.record, self.camera, self.spp, self.gradients = record, camera, spp, [*gradients]
        self.gradients_of_sums = self._gradients_of_sums() if gradients else []

    def step(self) -> Collected:
        """Create the measurement of one vertex."""
        return Collected(self.record.measurement(self.camera, self.spp), [])

    def zero(self) -> Rates:
        """Return sums that are 0."""
        return self.record.measurement(self.camera, self.spp).sums

    def move(self, collected: Collected, sums: Rates, more: Any) -> Rates:
        """Propagate rates to collected light and `more`; returns the rates of all sums so far."""
        new = collected.measurement.sums
        dr.forward_to([new, collected.binned, more], flags=FORWARDS)
        return [total + dr.grad(each) for total, each in zip(sums, new, strict=True)]

    def channels(self, rates: Rates) -> tuple[list[mi.Float], list[mi.Float]]:
        """Return rates of samples in the picture, before and behind their weight."""
        sums = [dr.zeros_like(rate) for rate in rates]
        with dr.resume_grad():
            dr.enable_grad(sums)
            dr.set_grad(sums, rates)
            before, behind = self._channels(sums)
            dr.forward_to([before, behind], flags=FORWARDS)
            return [dr.grad(each) for each in before], [dr.grad(each) for each in behind]

    def _channels(self, sums: Rates) -> tuple[list[mi.Float], list[mi.Float]]:
        measured = self.record.measurement(self.camera, self.spp).with_sums(sums)
        return self.record.channels(self.camera, measured, mi.Bool(False))

    def pull(self, collected: Collected, more: Any, gradient: Any) -> None:
        """Propagate gradients through collected light and `more`."""
        sums = collected.measurement.sums
        for total, gradient_of_sum in zip(sums, self.gradients_of_sums, strict=True):
            self.root(total, gradient_of_sum)
        self.root(more, gradient)
        dr.traverse(dr.ADMode.Backward, REVERSE)

    @staticmethod
    def root(value: Any, gradient: Any) -> None:
        """Add a value with its gradient to where the next traversal starts."""
        dr.accum_grad(value, gradient)
        dr.enqueue(dr.ADMode.Backward, value)

    def _gradients_of_sums(self) -> Rates:
        lanes = dr.zeros(mi.Float, dr.width(self.camera.ray))
        sums = [each + lanes for each in self.zero()]
        with dr.resume_grad():
            dr.enable_grad(sums)
            loss = mi.Float(0)
            for number, channel in enumerate(self._developed(*self._channels(sums))):
                loss += channel * self._gradient(number)
            dr.backward_from(loss / self.spp, flags=REVERSE)
            return [dr.grad(each) for each in sums]

    def _developed(self, before: list[mi.Float], behind: list[mi.Float]) -> list[mi.Float]:
        """Return the channels of a sample as the film develops them."""
        count = int(self.record.image.develop().shape[2]) - len(behind)
        colour, alpha = before[:3], before[3:]
        if count - len(alpha) < len(colour):
            grey = colour[0] if mi.is_monochromatic else mi.luminance(mi.Color3f(*colour))
            colour = [grey]
        return [*colour, *alpha, *behind]

    def _gradient(self, number: int) -> mi.Float:
        """Return the gradient of a channel; those of phasors are behind those of the picture."""
        picture, *others = self.gradients
        count = int(picture.shape[-1])
        if number < count:
            return dr.gather(mi.Float, picture.array, self.pixel() * count + number)
        index = self.pixel() * dr.prod(others[0].shape[2:]) + (number - count)
        return dr.gather(mi.Float, others[0].array, index)

    def pixel(self) -> mi.UInt32:
        """Return the number of the rays' pixel in the crop window."""
        film = self.record.film
        at = mi.Point2u(self.camera.position - mi.Vector2f(film.crop_offset()))
        return mi.UInt32(at.y * int(film.crop_size()[0]) + at.x)


class BinChanges(Changes):
    """Derivatives of time bins, and of the sum for their steady image."""

    record: BinRecording

    def step(self) -> Collected:
        """Create the measurement of one vertex, with its contributions to bins."""
        binned: list[Binned] = []
        return Collected(TimeBins(no_light(), put=lambda *light: binned.append(light)), binned)

    def move(self, collected: Collected, sums: Rates, more: Any) -> Rates:
        """Propagate rates, also into time bins."""
        sums = super().move(collected, sums, more)
        for spectrum, opl, active in collected.binned:
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
                self._add_rate(k, spectrum, opl, spectrum_rate, opl_rate, filling)
                k += 1
                filling &= k <= last

    def _add_rate(self, k, spectrum, opl, spectrum_rate, opl_rate, active):
        film, camera = self.record.film, self.camera
        with dr.resume_grad():
            light, at = _variables(spectrum, opl)
            dr.set_grad(light, spectrum_rate)
            dr.set_grad(at, opl_rate)
            in_bin = self._in_bin(light, k, at)
            dr.forward_to(in_bin, flags=FORWARDS)
            rate = dr.grad(in_bin)
        centre = float(film.start_opl) + (k + 0.5) * float(film.bin_width_opl)
        where = camera.position, centre, camera.ray.wavelengths
        film.add_transient_data(*where, self._weighted(rate), mi.Float(1), active)

    def _weighted(self, light: mi.Spectrum) -> mi.Spectrum:
        return scaled(light, self.camera.weight / self.spp)

    def pull(self, collected: Collected, more: Any, gradient: Any) -> None:
        """Propagate gradients, also from time bins."""
        binned = collected.binned
        gradients = [self._gradient_of_bins(*map(dr.detach, light)) for light in binned]
        for (*light, _), by_light in zip(binned, gradients, strict=True):
            for value, gradient_of_value in zip(light, by_light, strict=True):
                self.root(value, gradient_of_value)
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
                index = cell * len(values) + number
                loss += value * dr.gather(mi.Float, self.gradients[1].array, index, active)
            dr.backward_from(loss, flags=REVERSE)
            return dr.grad(light), dr.grad(at)

    def _reached(self, opl: mi.Float) -> tuple[mi.Int32, mi.Int32]:
        record = self.record
        if record.profile is None:
            return bin_of_instant(record.film, opl)
        return bins_of_pulse(record.film, record.profile, opl, record.exposure.at_centres)

    def _in_bin(self, light: mi.Spectrum, k: mi.Int32, opl: mi.Float) -> mi.Spectrum:
        if self.record.profile is None:
            return light * 1  # Without a derivative by length
        film, gated = self.record.film, self.record.exposure.at_centres
        return scaled(light, pulse_weight(film, self.record.profile, k, opl, gated))


def _variables(light: mi.Spectrum, opl: mi.Float) -> tuple[mi.Spectrum, mi.Float]:
    """Copy values as new variables to differentiate by."""
    copies = dr.detach(light), dr.detach(opl)
    dr.enable_grad(copies)
    return copies
