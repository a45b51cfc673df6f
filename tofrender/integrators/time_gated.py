"""Integrator plugin `time_gated_transient_path`: the scene at one instant, or at many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.deposit import FilmDeposit, open_gates
from ..films.image import image_film, transient_film
from ..paths.camera import CameraSample
from ..paths.endpoints import GatedLights, SceneLights
from ..paths.walk import transmits
from ..runtime import checks
from ..signals.pulses import GaussianPulse, Pulse
from .base import TransientIntegrator
from .passes import take

FILM_KEYS = ("temporal_bins", "start_opl", "bin_width_opl")


@dataclass
class Gate:
    """A measurement: light that arrives around one path length, weighted by a pulse.

    Attributes:
        total: Radiance per metre at the gate, of type `mi.UnpolarizedSpectrum`.
        weight: Takes a path length [m], gives its weight [1/m].
    """

    total: Any
    weight: Any

    def add(self, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
        """Add a contribution."""
        self.total += dr.select(active, spectrum * self.weight(opl), 0)


class TimeGatedTransientPath(TransientIntegrator):
    """Path tracer that sees one instant (plugin `time_gated_transient_path`).

    Every contribution is weighted by p(t - opl), where p is the light's pulse and t the target: the
    value is a radiance per metre, and the sum over gates times their spacing is the steady image.
    Besides the parameters of `TransientIntegrator`:

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 8 | longest path in segments, camera's included |
    | `pulse_width_opl` | 0.03 | standard deviation of the Gaussian pulse [m] |
    | `target_time` | none | path length of the gate [m], for `mi.render`; can be set later |

    Example:
        >>> integrator = mi.load_dict(
        ...     {"type": "time_gated_transient_path", "pulse_width_opl": 0.02}
        ... )
        >>> integrator.pulse
        GaussianPulse(width_opl=0.02)
    """

    def __init__(self, props: mi.Properties | None = None) -> None:
        props = mi.Properties("time_gated_transient_path") if props is None else props
        if "max_depth" not in props:
            props["max_depth"] = 8
        super().__init__(props)
        width = checks.metres("pulse_width_opl", props.get("pulse_width_opl", 0.03), positive=True)
        self.pulse: Pulse = GaussianPulse(width)
        target = props.get("target_time", None)
        self.target_time = None if target is None else checks.metres("target_time", target)
        self._gates = False

    def sample(self, scene, sampler, ray, target_time=None, medium=None, active=True, origin=None):
        """Radiance per metre along rays at one instant.

        Args:
            scene: The scene.
            sampler: Random numbers.
            ray: Camera rays.
            target_time: Path length of the gate [m]; by default the stored one.
            medium: Ignored.
            active: Lanes to trace.
            origin: Where lengths start, by default where the rays do: 1 mm or so in front of a
                perspective camera, by its near clip. `render_at_time` measures from the sensor.

        Returns:
            Spectrum [1/m], lanes that met a surface, and no AOVs.
        """
        target = self.target_time if target_time is None else target_time
        origin, gate = ray.o if origin is None else origin, self._gate(target)
        lights, closed = self._lights(scene, None, target), mi.Float(target) - self.pulse.support[0]
        gate, valid = self.trace(scene, sampler, ray, origin, gate, lights, active, last_opl=closed)
        return mi.Spectrum(gate.total), valid, []

    def _gate(self, target_time: Any) -> Gate:
        if target_time is None:
            raise ValueError("target_time = None: must be the gate's path length in metres")
        return Gate(mi.UnpolarizedSpectrum(0), lambda opl: self.pulse.eval(target_time - opl))

    def _lights(self, scene: mi.Scene, sensor: mi.Sensor | None, target_time: Any) -> SceneLights:
        """For a single gate, connections that look for light of its length."""
        rough_glass = transmits(scene, mi.BSDFFlags.GlossyTransmission)
        if self._gates or rough_glass or not self.emitter_sampling:
            return super().lights(scene, sensor)
        return GatedLights(scene, sensor, self._gate(target_time).weight)

    def lights(self, scene: mi.Scene, sensor: mi.Sensor | None = None) -> SceneLights:
        """As for every integrator; those of a single gate look for light of its length."""
        return self._lights(scene, sensor, dr.opaque(mi.Float, self.target_time or 0.0))

    def prepare(self, film: Any) -> None:
        """Refuse to render without a target time; empty the film."""
        self._gates = hasattr(film, "add_transient_data")
        if not self._gates:
            self._gate(self.target_time)
        super().prepare(film)

    def last_opl(self) -> Any:
        """Where a single gate closes [m]."""
        if self._gates or self.target_time is None:
            return None
        return dr.opaque(mi.Float, self.target_time - self.pulse.support[0])

    def measurement(self, film: Any, camera: CameraSample, spp: int) -> Any:
        """One gate, or on a film with time a gate at the centre of every bin."""
        if not self._gates:
            return self._gate(dr.opaque(mi.Float, self.target_time))
        wavelengths, weight = camera.ray.wavelengths, camera.weight / spp
        return FilmDeposit.into(film, camera.position, wavelengths, weight, self.pulse, open_gates)

    def to_string(self) -> str:
        """The integrator's parameters."""
        names = ("max_depth", "rr_depth", "hide_emitters", "camera_unwarp", "target_time", "pulse")
        values = ", ".join(f"{name} = {getattr(self, name)!r}" for name in names)
        return f"TimeGatedTransientPath[{values}]"


def render_at_time(
    scene: mi.Scene,
    integrator: Any,
    sensor: mi.Sensor,
    target_time: float,
    spp: int = 64,
    seed: int = 0,
) -> np.ndarray:
    """Render the scene at one instant.

    Args:
        scene: The scene.
        integrator: A `TimeGatedTransientPath`.
        sensor: The camera; its film says size, crop and filter.
        target_time: Path length of the gate [m], 0 or more.
        spp: Samples per pixel.
        seed: Seed of the random numbers.

    Returns:
        Radiance per metre of path, float32 array of shape (height, width, channels).

    Raises:
        ValueError: An argument is out of range; one line.

    Example:
        >>> import tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> integrator = TimeGatedTransientPath(mi.Properties())
        >>> render_at_time(scene, integrator, scene.sensors()[0], 5.9, spp=4).shape
        (16, 16, 3)
    """
    target = checks.metres("target_time", target_time)
    if target < 0:
        raise ValueError(f"target_time = {target_time!r}: must be 0 m or more, light starts there")
    film = image_film(sensor.film())
    stored, integrator.target_time = integrator.target_time, target
    try:
        take(scene, integrator, sensor, film, spp, seed)
    finally:
        integrator.target_time = stored
    return np.array(film.develop())


def render_transient(
    scene: mi.Scene,
    integrator: Any,
    sensor: mi.Sensor,
    film_config: Mapping[str, Any],
    spp: int = 64,
    seed: int = 0,
) -> np.ndarray:
    """Render the scene at many instants, with the paths of one trace.

    Args:
        scene: The scene.
        integrator: A `TimeGatedTransientPath`.
        sensor: The camera; its film says size, crop and filter.
        film_config: `temporal_bins`, `start_opl` [m] and `bin_width_opl` [m]: gate k is at
            start_opl + (k + 1/2) bin_width_opl.
        spp: Samples per pixel, of all gates together.
        seed: Seed of the random numbers.

    Returns:
        Radiance per metre of path, float32 array of shape (height, width, temporal_bins, channels).
        Times `bin_width_opl` it compares with the bins of a film.

    Raises:
        ValueError: A key is missing or unknown, or a value is out of range; one line.

    Example:
        >>> import tofrender
        >>> scene = mi.load_dict(tofrender.cornell_box(width=16, height=16))
        >>> gates = {"temporal_bins": 30, "start_opl": 3.5, "bin_width_opl": 0.2}
        >>> integrator = TimeGatedTransientPath(mi.Properties())
        >>> render_transient(scene, integrator, scene.sensors()[0], gates, spp=4).shape
        (16, 16, 30, 3)
    """
    for key in film_config:
        checks.one_of("film_config key", key, FILM_KEYS)
    for key in FILM_KEYS:
        if key not in film_config:
            raise ValueError(f"film_config: has no {key}; must have {', '.join(FILM_KEYS)}")
    bins = checks.integer("temporal_bins", film_config["temporal_bins"], 1, checks.MAX_BINS)
    start = checks.metres("start_opl", film_config["start_opl"])
    width = checks.metres("bin_width_opl", film_config["bin_width_opl"], positive=True)
    film = transient_film(sensor.film(), bins, start, width)
    take(scene, integrator, sensor, film, spp, seed)
    return film.take()[1]
