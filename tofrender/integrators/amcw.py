"""Integrator plugin `amcw_transient_path`: what a continuously modulated sensor measures."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..films.exposure import PHASORS, PICTURE, Exposure
from ..films.image import pixels_of
from ..films.phasor import parse_frequencies
from ..films.sums import Weighted
from ..runtime import plugins
from ..runtime.checkpoints import Checkpoint
from ..scenes.checking import check_view, require_modelled
from ..scenes.transient_integrators import path_tracer_of
from ..signals.modulations import AMCWPulse
from ..signals.phasors import phasor_parts
from .base import TransientIntegrator
from .running import render_all, render_image
from .transient_path import TransientPath
from .user_defined import follows, is_user_defined

CALL = "sample(scene, sampler, ray)"
NO_MODULATION = "modulation = None: must be set, e.g. set_modulation(AMCWPulse(20e6))"


class AMCWTransientPath(TransientPath):
    """Path tracer for amplitude-modulated light (plugin `amcw_transient_path`).

    On an ordinary film, every contribution is weighted by the modulation m(opl) that
    `set_modulation` sets: the image is the correlation integral of L(opl) m(opl). On a
    `phasor_hdr_film`, phasors of all its frequencies are summed in the same trace. Parameters as of
    `TransientIntegrator`, with a `max_depth` of 8 (segments; 9 in the loop of the assignment's
    text), and:

    | parameter | default | meaning |
    |---|---|---|
    | `frequency_hz` | none | frequency of a cosine modulation [Hz], as a start |
    | `phase_offset` | 0 | its phase offset [rad]; -pi/2 makes it a sine |
    | `pulse_width_opl` | none | standard deviation of the light's Gaussian pulse [m], for phasors |

    Example:
        >>> integrator = mi.load_dict({"type": "amcw_transient_path", "frequency_hz": 20e6})
        >>> round(integrator.modulation.get_unambiguous_range(), 3)
        7.495
    """

    default_depth = 8
    fills_bins = False
    takes_light_samples = False

    def __init__(self, props: mi.Properties | None = None) -> None:
        props = mi.Properties("amcw_transient_path") if props is None else props
        super().__init__(props)
        frequency, offset = props.get("frequency_hz", None), props.get("phase_offset", 0.0)
        self.modulation = None if frequency is None else AMCWPulse(frequency, offset)

    @property
    def uses_techniques(self) -> bool:
        """Whether renders may use the techniques for caustics."""
        return True

    def set_modulation(self, modulation: Any) -> None:
        """Set the modulation: an `AMCWPulse`, or anything with `eval(opl)`; else a `TypeError`."""
        if not hasattr(modulation, "eval"):
            raise TypeError(
                f"modulation = {modulation!r}: must be a modulation like AMCWPulse(20e6)"
            )
        self.modulation = modulation

    def sample(self, scene, sampler, ray, medium=None, active=True, origin=None):
        """Correlation with the modulation along camera rays.

        Lengths start at `origin`, by default where the rays do; indices of refraction are over that
        at the rays' start. `medium` is ignored. Returns a spectrum, lanes that see a surface or an
        environment, and no AOVs.
        """
        if self.modulation is None:
            raise ValueError(NO_MODULATION)
        measurement = Weighted.zero(self.modulation.eval)
        return self.sampled(self.plan(scene), scene, sampler, ray, measurement, active, origin)

    def exposure(self) -> Exposure:
        """Return how light counts: its correlation on a picture; phasors of its pulse."""
        steady_film_error = NO_MODULATION if self.modulation is None else ""
        weight = None if self.modulation is None else self.modulation.eval
        return Exposure(
            (PICTURE, PHASORS), self.pulse, weight=weight, steady_film_error=steady_film_error
        )


def render_single_amcw(
    scene: mi.Scene,
    integrator: Any,
    sensor: mi.Sensor,
    spp: int = 64,
    seed: int = 0,
    *,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> np.ndarray:
    """Render one correlation image.

    The integrator is an `AMCWTransientPath` with its modulation set, or any object with a
    `sample(scene, sampler, ray)` of its own, which is then called. The other arguments are those of
    `render_at_time`; the same seed gives the same paths, whatever modulation is set.

    Returns:
        Float32 array of shape (height, width, channels).

    Raises:
        TypeError: The integrator has neither a modulation nor a `sample` of its own; one line.

    Example:
        >>> import tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> integrator = AMCWTransientPath(mi.Properties())
        >>> integrator.set_modulation(AMCWPulse(20e6))
        >>> render_single_amcw(scene, integrator, scene.sensors()[0], spp=4).shape
        (16, 16, 3)
    """
    refusal = f"has no modulation; must be an AMCWTransientPath, or have {CALL} of its own"
    settings = spp, seed, checkpoint, progress
    return render_image(scene, integrator, sensor, "set_modulation", refusal, CALL, (), *settings)


def render_amcw_phasor(
    scene: mi.Scene,
    sensor: mi.Sensor,
    frequency_hz: float | Sequence[float],
    spp: int = 64,
    seed: int = 0,
    integrator: TransientIntegrator | None = None,
    *,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Render phasors of one or many frequencies, I and Q of all in one trace.

    `frequency_hz` is a frequency [Hz], or a sequence of them. The integrator is an
    `AMCWTransientPath` (or `TransientPath`), by default the scene's own, with all its parameters
    and its pulse: one of Mitsuba's path tracers, or one that stores no phasors, is taken for a
    `TransientPath` that follows the same paths. The other arguments are those of `render_at_time`.
    See also `transient_to_phasor`, `phasor_panel`, `unwrap`.

    Returns:
        I, Q, amplitude, phase in (-pi, pi] and depth in [0, c / 2f) [m], arrays of shape (height,
        width, channels), with an axis of frequencies in front if a sequence was given. Depth is
        half the path length, which is a distance only where light and camera coincide.

    Raises:
        ValueError: A frequency is not above 0, the list is empty, or the scene's integrator does
            not tell which paths it follows; one line.
        TypeError: The integrator has a `sample` of its own; one line.

    Example:
        >>> import tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> I, Q, amplitude, phase, depth = render_amcw_phasor(
        ...     scene, scene.sensors()[0], [20e6, 50e6], spp=4
        ... )
        >>> depth.shape
        (2, 16, 16, 3)
    """
    frequencies = parse_frequencies(frequency_hz)
    check_view(scene, sensor, **follows(integrator))
    tracer = integrator
    if tracer is None:
        tracer = in_time(scene.integrator())
        require_modelled(scene, sensor, **follows(tracer))
    plugin = plugins.qualified_name("phasor_hdr_film")
    described = {"type": plugin, "frequencies_hz": ", ".join(map(repr, frequencies))}
    film = mi.load_dict(described | pixels_of(sensor.film()))
    if is_user_defined(tracer):
        raise TypeError(
            f"integrator = {type(tracer).__name__}: has a sample of its own, which sees one "
            "modulation; must be an AMCWTransientPath without, or use render_single_amcw for each"
        )
    record, plan = tracer.recording(film), tracer.plan(scene, sensor)
    settings = spp, seed, checkpoint, progress
    render_all(scene, tracer, sensor, plan, record, *settings)
    phasors = np.array(film.develop()[1])
    height, width = phasors.shape[:2]
    parts = phasors.reshape(height, width, len(frequencies), 2, -1)
    parts = np.moveaxis(parts, (2, 3), (1, 0))  # (part, frequency, height, width, channels)
    if np.ndim(frequency_hz) == 0 and not isinstance(frequency_hz, str):
        parts, frequencies = parts[:, 0], frequencies[0]
    I, Q = parts  # noqa: E741
    return (I, Q, *phasor_parts(I, Q, frequencies))


def in_time(own: mi.Integrator) -> TransientIntegrator:
    """Return a scene's integrator, or one that stores phasors of the same paths."""
    traits = getattr(own, "traits", None)
    if traits is None:
        return mi.load_dict(path_tracer_of(own))
    if PHASORS in own.exposure().supported_films:
        return own
    tracer = mi.load_dict({"type": plugins.qualified_name("transient_path"), **traits})
    tracer.pulse = own.pulse
    return tracer
