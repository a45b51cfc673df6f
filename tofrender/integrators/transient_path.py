"""Integrator plugin `transient_path`: path tracing into the time bins of a film."""

from __future__ import annotations

from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from ..films.deposit import FilmDeposit
from ..films.phasor_sum import PhasorSum
from ..paths.camera import CameraSample
from ..runtime import checks
from ..signals.pulses import GaussianPulse, Pulse, SampledPulse, convolve
from .base import TransientIntegrator

TEMPORAL_FILTERS = ("", "box", "gaussian")


class TransientPath(TransientIntegrator):
    """Path tracer whose film says when light arrives (plugin `transient_path`).

    Takes mitransient's parameters and runs on its film too. Besides those of
    `TransientIntegrator`:

    | parameter | default | meaning |
    |---|---|---|
    | `temporal_filter` | "" | "box", "gaussian", or "" for the film's `rfilter` in time as well |
    | `gaussian_stddev` | 2.0 | standard deviation of the Gaussian filter [bins] |
    | `pulse_width_opl` | none | standard deviation of the light's Gaussian pulse [m] |

    The light's `pulse` can be set to any of `tofrender.signals.pulses`. Its energy in each bin is
    exact and adds no noise.

    Limitations: participating media and polarised variants, which `tofrender.render` refuses; no
    derivatives.

    Example:
        >>> import tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> steady, transient = mi.render(scene, spp=4)
        >>> transient.shape
        (16, 16, 300, 3)
    """

    fills_bins = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        name, bins = props.get("temporal_filter", ""), props.get("gaussian_stddev", 2.0)
        self.temporal_filter = checks.one_of("temporal_filter", name, TEMPORAL_FILTERS)
        self.gaussian_stddev = checks.metres("gaussian_stddev", bins, positive=True, unit="bins")
        width = props.get("pulse_width_opl", None)
        self._pulse: Pulse | None = None
        self._profile: Pulse | None = None
        if width is not None:
            self._pulse = GaussianPulse(checks.metres("pulse_width_opl", width, positive=True))

    @property
    def pulse(self) -> Pulse | None:
        """Temporal profile of the light [m], None for an instant.

        Raises:
            TypeError: What is assigned is not a pulse; one line.
        """
        return self._pulse

    @pulse.setter
    def pulse(self, pulse: Pulse | None) -> None:
        if pulse is not None and not (hasattr(pulse, "cdf") and hasattr(pulse, "support")):
            raise TypeError(f"pulse = {pulse!r}: must be a pulse like GaussianPulse(0.03), or None")
        self._pulse = pulse

    def temporal_profile(self, film: Any) -> Pulse | None:
        """The light's pulse, seen through the temporal filter."""
        blur = self._filter(film)
        if self.pulse is None or blur is None:
            return self.pulse or blur
        return convolve(self.pulse, blur)

    def prepare(self, film: Any) -> None:
        """Refuse a film without time, and filters that do not fit; empty the film."""
        if hasattr(film, "frequencies_hz"):
            self._profile = self.pulse
        elif hasattr(film, "add_transient_data"):
            self._profile = self.temporal_profile(film)
        else:
            raise TypeError(
                f"film: is a {film.class_name()}; must be a transient_hdr_film or another film "
                "with time"
            )
        super().prepare(film)

    def measurement(self, film: Any, camera: CameraSample, spp: int) -> Any:
        """Deposits every contribution in the film's bins, or sums its phasors."""
        if hasattr(film, "frequencies_hz"):
            return PhasorSum.zero(film.frequencies_hz)
        wavelengths, weight = camera.ray.wavelengths, camera.weight / spp
        return FilmDeposit.into(film, camera.position, wavelengths, weight, self._profile)

    def extra_channels(self, film: Any, camera: CameraSample, measured: Any) -> list[mi.Float]:
        """The phasors, if the film stores them."""
        if not isinstance(measured, PhasorSum):
            return []
        return film.channels(measured, partial(self.colour, camera), self._profile)

    def _filter(self, film: Any) -> Pulse | None:
        """The temporal filter as a pulse, None if it is a box: a bin's own width."""
        width = float(film.bin_width_opl)
        if self.temporal_filter == "gaussian":
            return GaussianPulse(self.gaussian_stddev * width)
        rfilter = film.rfilter()
        if self.temporal_filter == "box" or rfilter.is_box_filter():
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

    def to_string(self) -> str:
        """The integrator's parameters."""
        names = (
            *("max_depth", "rr_depth", "hide_emitters", "camera_unwarp", "discard_direct_light"),
            *("emitter_sampling", "temporal_filter", "gaussian_stddev", "pulse"),
        )
        values = ", ".join(f"{name} = {getattr(self, name)!r}" for name in names)
        return f"{type(self).__name__}[{values}]"
