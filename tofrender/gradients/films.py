"""Derivatives of films: the film's JVP from rates of light, and gradients of light by VJP.

The values of a film are linear in light. Therefore the derivative of a film in forward mode is a
film of the derivatives of light. In reverse mode, the gradient of the film is read at the position
and the bin of each contribution.

Time bins need a pulse for derivatives by length. Let P be the cumulative distribution of the pulse.
Light with the length o adds the fraction P(e' - o) - P(e - o) of its energy to a bin from e to e'.
The derivative of this fraction is a difference of densities. Without a pulse, the fraction is
either 0 or 1, and its derivative is not defined.

Each method works for one step of the path loop and differentiates the light of one vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.channels import channels_of
from ..films.contribution import CameraSample, Contribution
from ..films.recording import BinRecording, Recording
from ..films.sums import Radiance
from ..films.time_bins import TimeBins, bin_of_instant, bins_of_pulse, pulse_weight
from ..signals.polarization import no_light, scaled

# Keep the rates of parameters, which are needed again at the next vertex
FORWARDS = dr.ADFlag.ClearEdges | dr.ADFlag.AllowNoGrad
REVERSE = dr.ADFlag.Default | dr.ADFlag.AllowNoGrad

Binned = tuple[mi.Spectrum, mi.Float, mi.Bool]
"""Spectrum, optical path length [m] and active lanes of a contribution to time bins."""

Rates = list[mi.Spectrum]
"""Derivatives of the sums of a measurement."""


@dataclass
class Collected:
    """The light of one vertex."""

    # Sums of the light
    measurement: Radiance

    # Contributions to time bins
    binned: list[Binned]

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        self.measurement.add(contribution)


class Changes:
    """Derivatives of a recording of camera rays, for measurements that are sums.

    Args:
        record: The recording.
        camera: The camera rays.
        gradients: Reverse mode only: gradients of a loss by the developed tensors of the film,
            first the picture, then the bins or phasors.
    """

    def __init__(
        self, record: Recording, camera: CameraSample, gradients: Sequence[mi.TensorXf] = ()
    ) -> None:
        self.record = record
        self.camera = camera
        self.gradients = [*gradients]
        self.gradients_of_sums = self._gradients_of_sums() if gradients else []

    def step(self) -> Collected:
        """Create the measurement of one vertex."""
        return Collected(self.record.measurement(self.camera), [])

    def zero(self) -> Rates:
        """Return sums that are 0."""
        return self.record.measurement(self.camera).sums

    # --------------------- Forward mode ---------------------

    def jvp(self, collected: Collected, sums: Rates, state: Any) -> Rates:
        """Propagate derivatives to the collected light and to the state of the next vertex.

        Args:
            collected: Light of one vertex.
            sums: Derivatives of the sums up to this vertex.
            state: State of the path after the step; its derivatives are set.

        Returns:
            Derivatives of the sums including this vertex.
        """
        new = collected.measurement.sums
        dr.forward_to([new, collected.binned, state], flags=FORWARDS)
        return [total + dr.grad(each) for total, each in zip(sums, new, strict=True)]

    def channels(self, rates: Rates) -> tuple[list[mi.Float], list[mi.Float]]:
        """Return the derivatives of the picture's channels before and after its weight channel."""
        sums = [dr.zeros_like(rate) for rate in rates]
        with dr.resume_grad():
            dr.enable_grad(sums)
            dr.set_grad(sums, rates)
            before, behind = self._channels(sums)
            dr.forward_to([before, behind], flags=FORWARDS)
            return [dr.grad(each) for each in before], [dr.grad(each) for each in behind]

    def _channels(self, sums: Rates) -> tuple[list[mi.Float], list[mi.Float]]:
        """Return the picture's channels for given sums of light."""
        measured = self.record.measurement(self.camera).with_sums(sums)
        return self.record.channels(self.camera, measured, mi.Bool(False))

    # --------------------- Reverse mode ---------------------

    def vjp(self, collected: Collected, state: Any, gradient: Any) -> None:
        """Propagate gradients from the collected light and from the state of the next vertex.

        Args:
            collected: Light of one vertex.
            state: State of the path after the step.
            gradient: Gradient of the loss by this state.
        """
        sums = collected.measurement.sums
        for total, gradient_of_sum in zip(sums, self.gradients_of_sums, strict=True):
            self.root(total, gradient_of_sum)
        self.root(state, gradient)
        dr.traverse(dr.ADMode.Backward, REVERSE)

    @staticmethod
    def root(value: Any, gradient: Any) -> None:
        """Add a gradient to a value, and start the next reverse traversal from this value."""
        dr.accum_grad(value, gradient)
        dr.enqueue(dr.ADMode.Backward, value)

    def _gradients_of_sums(self) -> Rates:
        """Return the gradients of the loss by the sums of light of each camera ray."""
        lanes = dr.zeros(mi.Float, dr.width(self.camera.ray))
        sums = [each + lanes for each in self.zero()]
        with dr.resume_grad():
            dr.enable_grad(sums)
            loss = mi.Float(0)
            for number, channel in enumerate(self._developed(*self._channels(sums))):
                loss += channel * self._gradient(number)
            dr.backward_from(loss / self.record.accumulation.spp, flags=REVERSE)
            return [dr.grad(each) for each in sums]

    def _developed(self, before: list[mi.Float], behind: list[mi.Float]) -> list[mi.Float]:
        """Return the channels of a sample in the form that the film develops.

        A film of format "luminance" develops one channel instead of three.
        """
        count = int(self.record.image.develop().shape[2]) - len(behind)
        color = before[:3]
        alpha = before[3:]
        if count - len(alpha) < len(color):
            gray = color[0] if mi.is_monochromatic else mi.luminance(mi.Color3f(*color))
            color = [gray]
        return [*color, *alpha, *behind]

    def _gradient(self, channel: int) -> mi.Float:
        """Return the gradient of a channel. Channels of phasors follow after the picture's."""
        picture, *others = self.gradients
        count = int(picture.shape[-1])
        if channel < count:
            return dr.gather(mi.Float, picture.array, self.pixel() * count + channel)
        index = self.pixel() * dr.prod(others[0].shape[2:]) + (channel - count)
        return dr.gather(mi.Float, others[0].array, index)

    def pixel(self) -> mi.UInt32:
        """Return the index of each ray's pixel in the crop window."""
        film = self.record.film
        at = mi.Point2u(self.camera.position - mi.Vector2f(film.crop_offset()))
        return mi.UInt32(at.y * int(film.crop_size()[0]) + at.x)


class BinChanges(Changes):
    """Derivatives of time bins, and of the sums for their steady image."""

    record: BinRecording

    def step(self) -> Collected:
        """Create the measurement of one vertex, which stores its contributions to bins."""
        binned: list[Binned] = []
        return Collected(TimeBins(no_light(), put=lambda *light: binned.append(light)), binned)

    # --------------------- Forward mode ---------------------

    def jvp(self, collected: Collected, sums: Rates, state: Any) -> Rates:
        """Propagate derivatives as `Changes` does, and add them to the film's time bins."""
        sums = super().jvp(collected, sums, state)
        for spectrum, opl, active in collected.binned:
            rates = dr.grad(spectrum), dr.grad(opl)
            self._add_rates(dr.detach(spectrum), dr.detach(opl), *rates, dr.detach(active))
        return sums

    @dr.syntax
    def _add_rates(self, spectrum, opl, spectrum_rate, opl_rate, active):
        """Add the derivatives of all bins that a contribution reaches."""
        with dr.suspend_grad():
            k, last = self._reached(opl)
            filling = active & (k <= last)
            while filling:
                self._add_rate(k, spectrum, opl, spectrum_rate, opl_rate, filling)
                k += 1
                filling &= k <= last

    def _add_rate(self, k, spectrum, opl, spectrum_rate, opl_rate, active):
        """Add the derivative of bin `k`."""
        film = self.record.film
        camera = self.camera

        # Differentiate the light in the bin
        with dr.resume_grad():
            light, at = _variables(spectrum, opl)
            dr.set_grad(light, spectrum_rate)
            dr.set_grad(at, opl_rate)
            in_bin = self._in_bin(light, k, at)
            dr.forward_to(in_bin, flags=FORWARDS)
            rate = dr.grad(in_bin)

        # Add the derivative at the center of the bin
        center = float(film.start_opl) + (k + 0.5) * float(film.bin_width_opl)
        where = camera.position, center, camera.ray.wavelengths
        film.add_transient_data(*where, self._weighted(rate), mi.Float(1), active)

    def _weighted(self, light: mi.Spectrum) -> mi.Spectrum:
        """Return light with the weight of its sample."""
        return scaled(light, self.record.accumulation.sample_weight(self.camera.weight))

    # --------------------- Reverse mode ---------------------

    def vjp(self, collected: Collected, state: Any, gradient: Any) -> None:
        """Propagate gradients as `Changes` does, and from the time bins to the collected light."""
        binned = collected.binned
        gradients = [self._gradient_of_bins(*map(dr.detach, light)) for light in binned]
        for (*light, _), by_light in zip(binned, gradients, strict=True):
            for value, gradient_of_value in zip(light, by_light, strict=True):
                self.root(value, gradient_of_value)
        super().vjp(collected, state, gradient)

    @dr.syntax
    def _gradient_of_bins(self, spectrum, opl, active):
        """Return the gradient of the loss by spectrum and length of a contribution.

        The gradient is the sum over all bins that the contribution reaches.
        """
        with dr.suspend_grad():
            by_spectrum = dr.zeros_like(spectrum)
            by_opl = dr.zeros_like(opl)
            k, last = self._reached(opl)
            reading = active & (k <= last)
            while reading:
                spectrum_in_bin, opl_in_bin = self._gradient_of_bin(k, spectrum, opl, reading)
                by_spectrum += spectrum_in_bin
                by_opl += opl_in_bin
                k += 1
                reading &= k <= last
            return by_spectrum, by_opl

    def _gradient_of_bin(self, k, spectrum, opl, active):
        """Return the gradient of the loss by spectrum and length, from bin `k` only."""
        with dr.resume_grad():
            light, at = _variables(spectrum, opl)
            in_bin = self._weighted(self._in_bin(light, k, at))

            # The loss is linear in the channels, with the film's gradient as coefficients
            loss = mi.Float(0)
            values = channels_of(in_bin, self.camera.ray.wavelengths, active)
            cell = self.pixel() * self.record.film.temporal_bins + mi.UInt32(k)
            for channel, value in enumerate(values):
                index = cell * len(values) + channel
                loss += value * dr.gather(mi.Float, self.gradients[1].array, index, active)
            dr.backward_from(loss, flags=REVERSE)
            return dr.grad(light), dr.grad(at)

    # --------------------- Both modes ---------------------

    def _reached(self, opl: mi.Float) -> tuple[mi.Int32, mi.Int32]:
        """Return the first and the last bin that light of a length reaches."""
        record = self.record
        if record.profile is None:
            return bin_of_instant(record.film, opl)
        return bins_of_pulse(record.film, record.profile, opl, record.exposure.at_centers)

    def _in_bin(self, light: mi.Spectrum, k: mi.Int32, opl: mi.Float) -> mi.Spectrum:
        """Return the light in bin `k`; its derivative by length is 0 without a pulse."""
        if self.record.profile is None:
            return light * 1
        film = self.record.film
        at_centers = self.record.exposure.at_centers
        return scaled(light, pulse_weight(film, self.record.profile, k, opl, at_centers))


def _variables(light: mi.Spectrum, opl: mi.Float) -> tuple[mi.Spectrum, mi.Float]:
    """Copy values to new variables with gradients enabled."""
    copies = dr.detach(light), dr.detach(opl)
    dr.enable_grad(copies)
    return copies
