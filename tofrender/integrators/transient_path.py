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

# Parameters that switch techniques on and off, see `Techniques`
TECHNIQUES = ("caustic_photons", "caustic_rays", "chain_rays", "shared_paths")
TEMPORAL_FILTERS = ("", "box", "gaussian")


class TransientPath(TransientIntegrator):
    """Path tracer for films that store when light arrives (plugin `transient_path`).

    The integrator supports the parameters and the film of mitransient. The parameters are the
    parameters of `TransientIntegrator`, and:

    | parameter | default | meaning |
    |---|---|---|
    | `temporal_filter` | "" | filter in time: "box", "gaussian", or "" for the filter of the film |
    | `gaussian_stddev` | 2.0 | standard deviation of the Gaussian filter [bins] |
    | `pulse_width_opl` | none | standard deviation of the light's Gaussian pulse [m] |
    | `caustic_photons` | true | find caustics with photons, see below |
    | `caustic_rays` | true | find caustics in mirrors or clear glass with caustic rays |
    | `chain_rays` | true | find emitters in mirrors or clear glass with extra rays |
    | `shared_paths` | true | share the paths of indirect light between neighboring pixels |
    | `light_samples` | "auto" | number of points on lights that the first vertex of a path \
connects to, 1 to 64; later vertices connect to half as many points, rounded up |

    The light of a large emitter arrives in many time bins. Several points on lights reduce the
    noise of these bins. With "auto", the number is chosen from a ratio of two lengths:

    - The extent of the lights is the diagonal of the box around all lights. If a light is
      infinitely far away, the extent is the diameter of the sphere around scene and sensor.
    - The resolution is the width of a bin plus half the length of the support of the pulse, after
      convolution with the temporal filter.

    The number is 8 if the ratio is at least 20, 4 if the ratio is at least 5, and 1 otherwise. The
    number is also 1 on films without time bins, and for a single point light or directional light.

    In scenes with mirrors or clear glass, other techniques than the paths find some kinds of light,
    see `paths.path_kinds` and `integrators.caustic_techniques`. These techniques
    are used for films with time bins and phasor films, in scenes without media. The expected value
    of the film does not depend on the techniques. Photons may reach any pixel. Tiles of a film,
    polarized variants, and cameras other
    than `perspective` and `thinlens` therefore use caustic rays instead of photons. Equal seeds
    give equal films up to rounding, because threads add photons in any order.

    In scenes with diffuse surfaces only, the pixels of small tiles share the paths of indirect
    light, see `integrators.shared_paths`. The noise of neighboring pixels is then correlated. With
    `light_samples = "auto"`, direct light then has 8 points on lights, except for a single point
    light or directional light.

    The attribute `pulse` can be set to any pulse of `tofrender.signals.pulses`. The energy of the
    pulse in each bin is exact and does not add noise. By default, the pulse is an instant and
    `max_depth` is 6. The text of the assignment uses a pulse of 0.03 m and a `max_depth` of 8.

    Participating media scatter the paths, whereas Mitsuba's `path` ignores media. See
    `TransientVolpath`, which also differs behind panes and masks.

    In polarized variants, films store Stokes vectors in the frames of Mitsuba's `stokes`: S1 is
    positive for polarization perpendicular to the sensor's `up`.

    `mi.render(scene, params)` supports derivatives if the light has a pulse. The derivatives do not
    include changes of visibility.

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
        *TransientIntegrator.shown,
        "discard_direct_light",
        "emitter_sampling",
        "temporal_filter",
        "gaussian_stddev",
        "pulse",
        "light_samples",
    )

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)

        # Read the temporal filter
        name = props.get("temporal_filter", "")
        self.temporal_filter = checks.one_of("temporal_filter", name, TEMPORAL_FILTERS)
        bins = props.get("gaussian_stddev", 2.0)
        self.gaussian_stddev = checks.number("gaussian_stddev", bins, positive=True, unit="bins")

        # Read the techniques and the pulse
        self.techniques = self._read_techniques(props)
        width = parameter(props, "pulse_width_opl", None)
        self._pulse: Pulse | None = None if width is None else GaussianPulse(width)

    @property
    def uses_techniques(self) -> bool:
        """Whether renders may use techniques for caustics."""
        return self.takes_light_samples

    def _read_techniques(self, props: mi.Properties) -> Techniques:
        """Read the parameters of techniques. Raise an error if no techniques are used."""
        # Techniques need next-event estimation, which finds the remaining light
        used = self.uses_techniques and self.emitter_sampling
        chosen = {}
        for name in TECHNIQUES:
            value = props.get(name, None)
            allowed = f"left out, because {type(self).__name__} does not use {name} here"
            checks.require(name, value, value is None or used, allowed)
            chosen[name] = checks.boolean(name, True if value is None else value)
        return Techniques(**chosen)

    @property
    def pulse(self) -> Pulse | None:
        """Temporal profile of the light, None for an instant.

        Raises:
            TypeError: The value is set to an object without the methods of a pulse.
        """
        return self._pulse

    @pulse.setter
    def pulse(self, pulse: Pulse | None) -> None:
        if pulse is not None and not (hasattr(pulse, "cdf") and hasattr(pulse, "support")):
            raise TypeError(
                f"pulse = {checks.quote(pulse)}: must be a pulse like GaussianPulse(0.03) or None"
            )

        # Copy the pulse, because `parameters_changed` sets its width
        self._pulse = copy(pulse) if type(pulse) is GaussianPulse else pulse

    def plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None = None, weight: Weight | None = None
    ) -> Plan:
        """Return the plan, with the techniques that renders may use."""
        plan = super().plan(scene, sensor, weight)
        plan.techniques = self.techniques
        return plan

    def exposure(self) -> Exposure:
        """Return the weighting of light: the pulse and the temporal filter."""
        return Exposure(
            supported_films=(BINS, PHASORS),
            pulse=self.pulse,
            temporal_filter=self.temporal_filter,
            gaussian_stddev=self.gaussian_stddev,
        )
