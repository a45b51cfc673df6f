"""Integrator plugin `amcw_transient_path`: correlation images of continuous-wave ToF cameras."""

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
from ..scenes.checking import check_view, require_modeled
from ..scenes.transient_integrators import path_tracer_of
from ..signals.modulations import AMCWPulse
from ..signals.phasors import phasor_parts
from .base import TransientIntegrator
from .render_loop import render_all, render_image
from .transient_path import TransientPath
from .user_defined import follows, is_user_defined

# Signature of a user-defined `sample()`
CALL = "sample(scene, sampler, ray)"
NO_MODULATION = "modulation is None. Set a modulation, for example set_modulation(AMCWPulse(20e6))"


class AMCWTransientPath(TransientPath):
    """Path tracer for amplitude-modulated light (plugin `amcw_transient_path`).

    On an `hdrfilm`, every contribution is weighted by the modulation m(opl), which `set_modulation`
    sets. The image is the correlation, the integral of L(opl) m(opl) over opl. On a
    `phasor_hdr_film`, the same paths contribute to the phasors of all frequencies of the film.

    The parameters are the parameters of `TransientIntegrator`, and the parameters in the table. The
    default of `max_depth` is 8 segments, which is 9 in the loop of the assignment's text.

    | parameter | default | meaning |
    |---|---|---|
    | `frequency_hz` | none | frequency of the initial cosine modulation [Hz] |
    | `phase_offset` | 0 | phase offset of the initial modulation [rad]; -pi/2 gives a sine |
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
        frequency = props.get("frequency_hz", None)
        offset = props.get("phase_offset", 0.0)
        self.modulation = None if frequency is None else AMCWPulse(frequency, offset)

    @property
    def uses_techniques(self) -> bool:
        """Whether renders may use techniques for caustics."""
        return True

    def set_modulation(self, modulation: Any) -> None:
        """Set the modulation.

        Args:
            modulation: An `AMCWPulse`, or any object with a method `eval(opl)`.

        Raises:
            TypeError: The object does not have the method `eval`.
        """
        if not hasattr(modulation, "eval"):
            raise TypeError(
                f"modulation = {modulation!r}: must be a modulation with eval(opl), for example "
                "AMCWPulse(20e6)"
            )
        self.modulation = modulation

    def sample(self, scene, sampler, ray, medium=None, active=True, origin=None):
        """Estimate the correlation with the modulation along camera rays.

        Indices of refraction are relative to the index at the start of the rays.

        Args:
            scene: The scene.
            sampler: The sampler.
            ray: Camera rays.
            medium: Ignored.
            active: Active lanes.
            origin: Points where path lengths start [m], by default the start of the rays.

        Returns:
            Spectrum, lanes that see a surface or an environment, and an empty list of AOVs.
        """
        if self.modulation is None:
            raise ValueError(NO_MODULATION)
        measurement = Weighted.zero(self.modulation.eval)
        return self.sampled(self.plan(scene), scene, sampler, ray, measurement, active, origin)

    def exposure(self) -> Exposure:
        """Return the weighting of light: the correlation on a picture, or phasors of the pulse."""
        steady_film_error = NO_MODULATION if self.modulation is None else ""
        weight = None if self.modulation is None else self.modulation.eval
        return Exposure(
            supported_films=(PICTURE, PHASORS),
            pulse=self.pulse,
            weight=weight,
            steady_film_error=steady_film_error,
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

    Equal seeds give equal paths. The paths do not depend on the modulation.

    Args:
        scene: The scene.
        integrator: An `AMCWTransientPath` with a modulation, or any object that defines
            `sample(scene, sampler, ray)`. The function `sample` is then called.
        sensor: The camera. Its film defines size, crop and reconstruction filter.
        spp: Samples per pixel.
        seed: Seed of the random numbers.
        checkpoint: As in `render`.
        progress: Whether to show a progress bar for renders of more than two seconds.

    Returns:
        Correlation, float32 array of shape (height, width, channels).

    Raises:
        ValueError: An argument is out of range, or the modulation is missing.
        TypeError: The integrator does not support modulations.
        KeyboardInterrupt: The render was stopped. The message describes how to resume it.

    Example:
        >>> import tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> integrator = AMCWTransientPath(mi.Properties())
        >>> integrator.set_modulation(AMCWPulse(20e6))
        >>> render_single_amcw(scene, integrator, scene.sensors()[0], spp=4).shape
        (16, 16, 3)
    """
    refusal = (
        "a modulation is not supported. Use an AMCWTransientPath, or an integrator that defines "
        f"{CALL}"
    )
    return render_image(
        scene=scene,
        integrator=integrator,
        sensor=sensor,
        method="set_modulation",
        refusal=refusal,
        call=CALL,
        targets=(),
        spp=spp,
        seed=seed,
        checkpoint=checkpoint,
        progress=progress,
    )


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
    """Render phasors of one or several frequencies, with the same paths for all frequencies.

    See also `transient_to_phasor`, `phasor_panel` and `unwrap`.

    Args:
        scene: The scene.
        sensor: The camera. Its film defines size, crop and reconstruction filter.
        frequency_hz: A frequency or a sequence of frequencies [Hz].
        spp: Samples per pixel.
        seed: Seed of the random numbers.
        integrator: An `AMCWTransientPath` or a `TransientPath`. By default, the integrator of the
            scene is used, with its parameters and its pulse. A path tracer of Mitsuba, or an
            integrator that does not support phasors, is replaced by a `TransientPath` with the same
            paths.
        checkpoint: As in `render`.
        progress: Whether to show a progress bar for renders of more than two seconds.

    Returns:
        Five arrays of shape (height, width, channels): in-phase part I, quadrature part Q,
        amplitude, phase in (-pi, pi], and depth in [0, c / 2f) [m]. If `frequency_hz` is a
        sequence, the first axis of the arrays is the frequency. Depth is half the path length. It
        equals the distance only if light and camera have the same position.

    Raises:
        ValueError: A frequency is not above 0, the sequence is empty, or the paths of the scene's
            integrator are not known.
        TypeError: The integrator overrides `sample()`.
        KeyboardInterrupt: The render was stopped. The message describes how to resume it.

    Example:
        >>> import tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> I, Q, amplitude, phase, depth = render_amcw_phasor(
        ...     scene, scene.sensors()[0], [20e6, 50e6], spp=4
        ... )
        >>> depth.shape
        (2, 16, 16, 3)
    """
    # Choose the integrator
    frequencies = parse_frequencies(frequency_hz)
    check_view(scene, sensor, **follows(integrator))
    tracer = integrator
    if tracer is None:
        tracer = with_phasors(scene.integrator())
        require_modeled(scene, sensor, **follows(tracer))

    # Create a film for the phasors
    plugin = plugins.qualified_name("phasor_hdr_film")
    described = {"type": plugin, "frequencies_hz": ", ".join(map(repr, frequencies))}
    film = mi.load_dict(described | pixels_of(sensor.film()))
    if is_user_defined(tracer):
        raise TypeError(
            f"integrator = {type(tracer).__name__}: the class defines sample(), which supports one "
            "modulation. Use an AMCWTransientPath, or call render_single_amcw once per modulation"
        )

    # Render
    render_all(
        scene=scene,
        integrator=tracer,
        sensor=sensor,
        record=tracer.recording(film),
        tracer=tracer.plan(scene, sensor),
        spp=spp,
        seed=seed,
        checkpoint=checkpoint,
        progress=progress,
    )

    # Separate the frequencies and the two parts of the phasors. The new axes are (part, frequency,
    # height, width, channels)
    phasors = np.array(film.develop()[1])
    height, width = phasors.shape[:2]
    parts = phasors.reshape(height, width, len(frequencies), 2, -1)
    parts = np.moveaxis(parts, (2, 3), (1, 0))

    # Without a sequence of frequencies, remove the axis of frequencies
    if np.ndim(frequency_hz) == 0 and not isinstance(frequency_hz, str):
        parts = parts[:, 0]
        frequencies = frequencies[0]
    I, Q = parts  # noqa: E741
    return (I, Q, *phasor_parts(I, Q, frequencies))


def with_phasors(integrator: mi.Integrator) -> TransientIntegrator:
    """Return an integrator that supports phasors and follows the same paths.

    Args:
        integrator: The integrator of a scene. It is returned if it supports phasors.
    """
    # Replace a path tracer of Mitsuba
    traits = getattr(integrator, "traits", None)
    if traits is None:
        return mi.load_dict(path_tracer_of(integrator))
    if PHASORS in integrator.exposure().supported_films:
        return integrator

    # Otherwise copy the parameters that define the paths, and the pulse
    tracer = mi.load_dict({"type": plugins.qualified_name("transient_path"), **traits})
    tracer.pulse = integrator.pulse
    return tracer
