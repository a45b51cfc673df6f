"""Integrator plugin `transient_path`: path tracing into the time bins of a film."""

from __future__ import annotations

from copy import copy

import mitsuba as mi

from ..films.exposure import BINS, PHASORS, Exposure, Weight
from ..runtime import checks
from ..runtime.settings import parameter
from ..signals.pulses import GaussianPulse, Pulse
from .base import TransientIntegrator
from .plan import Plan, Techniques

TECHNIQUES = ("caustic_photons", "caustic_rays", "chain_rays")
TEMPORAL_FILTERS = ("", "box", "gaussian")


class TransientPath(TransientIntegrator):
    """Path tracer whose film says when light arrives (plugin `transient_path`).

    Takes mitransient's parameters and runs on its film too. Besides those of
    `TransientIntegrator`:

    | parameter | default | meaning |
    |---|---|---|
    | `temporal_filter` | "" | "box", "gaussian", or "" for the `temporal_filter` of the film |
    | `gaussian_stddev` | 2.0 | standard deviation of the Gaussian filter [bins] |
    | `pulse_width_opl` | none | standard deviation of the light's Gaussian pulse [m] |
    | `caustic_photons` | true | photons find caustics, see below |
    | `caustic_rays` | true | rays find caustics that are seen in mirrors or clear glass |
    | `chain_rays` | true | extra rays find emitters that are seen in mirrors or clear glass |
    | `light_samples` | "auto" | points on lights that a path's first vertex connects to, 1 to 64; \
all further vertices connect to half as many, rounded up |

    Several light points make up for a large light's arrivals in many bins. "auto" takes 1 on films
    without time bins, and for one light that is a point or a direction. Else it divides the extent
    of the lights by the width of a bin, to which it adds half the length of the pulse's support as
    seen through the temporal filter: 8 points from a ratio of 20 on, 4 from 5, 1 below. The extent
    is the diagonal of the box around all lights, or, where one is infinitely far away, the diameter
    of the sphere around scene and sensor.

    In scenes with mirrors or clear glass, the paths leave some kinds of light to other techniques,
    see `paths.kinds` and `integrators.caustics`. Films with time bins and of phasors use them, in
    scenes without media. The expectation is the same without them. Photons land on any pixel, so
    that tiles of a film and cameras other than `perspective` and `thinlens` use caustic rays
    instead; so do polarised variants. Equal seeds give equal films up to rounding, since threads
    add photons in any order.

    The light's `pulse` can be set to any of `tofrender.signals.pulses`. Its energy in each bin is
    exact and adds no noise. The assignment's text has a pulse of 0.03 m and a `max_depth` of 8 by
    default, where these are none and 6.

    Participating media are followed, which Mitsuba's `path` ignores; see `TransientVolpath`, which
    differs behind panes and masks, too.

    In polarised variants, films have Stokes vectors, in the frames of Mitsuba's `stokes`: S1 is
    positive across the sensor's `up`.

    `mi.render(scene, params)` has derivatives where the light has a pulse; they leave out what
    becomes visible or hidden.

    Example:
        >>> import tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> steady, transient = mi.render(scene, spp=4)
        >>> transient.shape
        (16, 16, 300, 3)
    """

    fills_bins = True
    takes_light_samples = True
    shown = (
        *(*TransientIntegrator.shown, "discard_direct_light", "emitter_sampling"),
        *("temporal_filter", "gaussian_stddev", "pulse", "light_samples"),
    )

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        name, bins = props.get("temporal_filter", ""), props.get("gaussian_stddev", 2.0)
        self.temporal_filter = checks.one_of("temporal_filter", name, TEMPORAL_FILTERS)
        self.gaussian_stddev = checks.number("gaussian_stddev", bins, positive=True, unit="bins")
        self.techniques = self._read_techniques(props)
        width = parameter(props, "pulse_width_opl", None)
        self._pulse: Pulse | None = None if width is None else GaussianPulse(width)

    @property
    def uses_techniques(self) -> bool:
        """Whether renders may use the techniques for caustics."""
        return self.takes_light_samples

    def _read_techniques(self, props: mi.Properties) -> Techniques:
        """Read which techniques may be used; refuse them where none is used."""
        used = self.uses_techniques and self.emitter_sampling
        chosen = {}
        for name in TECHNIQUES:
            value = props.get(name, None)
            allowed = f"left out; {type(self).__name__} does not use it here"
            checks.require(name, value, value is None or used, allowed)
            chosen[name] = checks.boolean(name, True if value is None else value)
        return Techniques(**chosen)

    @property
    def pulse(self) -> Pulse | None:
        """Temporal profile of the light [m], None for an instant; others are a `TypeError`."""
        return self._pulse

    @pulse.setter
    def pulse(self, pulse: Pulse | None) -> None:
        if pulse is not None and not (hasattr(pulse, "cdf") and hasattr(pulse, "support")):
            raise TypeError(
                f"pulse = {checks.quote(pulse)}: must be a pulse like GaussianPulse(0.03), or None"
            )
        self._pulse = copy(pulse) if type(pulse) is GaussianPulse else pulse

    def plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None = None, weight: Weight | None = None
    ) -> Plan:
        """Return the plan, with the techniques that renders may use."""
        plan = super().plan(scene, sensor, weight)
        plan.techniques = self.techniques
        return plan

    def exposure(self) -> Exposure:
        """Return how light counts: its pulse, through the temporal filter."""
        return Exposure((BINS, PHASORS), self.pulse, self.temporal_filter, self.gaussian_stddev)
