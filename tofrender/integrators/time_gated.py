"""Integrator plugin `time_gated_transient_path`: the scene at one instant, or at many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from os import PathLike
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.exposure import BINS, PICTURE, Exposure
from ..films.recording import recording
from ..films.sums import Weighted
from ..films.windowed import transient_film
from ..media.gated import GatedFog
from ..media.space import Media
from ..paths.endpoints import GatedLights
from ..paths.surfaces import has_lobes
from ..runtime import checks
from ..runtime.checkpoints import Checkpoint
from ..scenes.checking import check_view
from ..signals.pulses import GaussianPulse, Pulse
from .base import TransientIntegrator
from .plan import Plan
from .running import render_all, render_image, require_method
from .user_defined import follows, is_user_defined

FILM_KEYS = ("temporal_bins", "start_opl", "bin_width_opl")
NO_TARGET = "target_time = None: must be the gate's path length in metres"
CALL = "sample(scene, sampler, ray, target_time)"
NO_GATES = (
    f"has no gates; must be a TimeGatedTransientPath, or have {CALL} of its own for single ones"
)


class Gate:
    """The weight of light by its length: a pulse seen at the path length `target_time` [m].

    It is 0 before `opens` and beyond `closes` [m], which are None if the pulse does not say.
    """

    def __init__(self, pulse: Pulse, target_time: mi.Float | float | None) -> None:
        if target_time is None:
            raise ValueError(NO_TARGET)
        if not hasattr(pulse, "eval"):
            raise TypeError(
                f"pulse = {type(pulse).__name__}: must have eval(t), a density like that of "
                "GaussianPulse(0.03)"
            )
        if not isinstance(target_time, mi.Float):
            target_time = dr.opaque(mi.Float, target_time)
        self.pulse, self.target_time = pulse, target_time
        support = getattr(pulse, "support", None)
        self.opens, self.closes = None, None
        if support is not None:
            self.opens, self.closes = target_time - support[1], target_time - support[0]

    def __call__(self, opl: mi.Float) -> mi.Float:
        """Density of the pulse at the gate [1/m]."""
        return self.pulse.eval(self.target_time - opl)

    def draw(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Sample a path length that the gate sees [m]; returns its weight as `Pulse.sample`."""
        offset, weight = self.pulse.sample(xi)
        return self.target_time - offset, weight


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

    A `max_depth` of 8 gives paths of 9 segments in the loop of the assignment's text, here of 8.

    Example:
        >>> mi.load_dict({"type": "time_gated_transient_path"}).pulse
        GaussianPulse(width_opl=0.03)
    """

    default_depth = 8
    shown = (*TransientIntegrator.shown, "target_time", "pulse")

    def __init__(self, props: mi.Properties | None = None) -> None:
        props = mi.Properties("time_gated_transient_path") if props is None else props
        super().__init__(props)
        width = checks.metres("pulse_width_opl", props.get("pulse_width_opl", 0.03), positive=True)
        self.pulse: Pulse = GaussianPulse(width)
        target = props.get("target_time", None)
        self.target_time = None if target is None else checks.metres("target_time", target)

    def sample(self, scene, sampler, ray, target_time=None, medium=None, active=True, origin=None):
        """Radiance per metre along camera rays at the path length `target_time` of a gate [m].

        Lengths start at `origin`, by default where the rays do: 1 mm or so in front of a
        perspective camera, by its near clip, where `render_at_time` measures from the sensor.
        Indices of refraction are over that at the rays' start. `medium` is ignored. Returns a
        spectrum [1/m], lanes that see a surface or an environment, and no AOVs.
        """
        gate = self.gate(self.target_time if target_time is None else target_time)
        plan, measurement = self.plan(scene, None, gate), Weighted.zero(gate)
        return self.sampled(plan, scene, sampler, ray, measurement, active, origin)

    def gate(self, target_time: mi.Float | float | None) -> Gate:
        """Return the gate at a path length [m]; a `ValueError` if that is None."""
        width = getattr(self.pulse, "width_opl", None)
        if not (width is None or target_time is None or isinstance(target_time, mi.Float)):
            checks.resolved("pulse_width_opl", float(width), target_time)
        return Gate(self.pulse, target_time)

    def exposure(self, target_time: float | None = None) -> Exposure:
        """Return how light counts: one gate on a picture, a gate at the centre of every bin."""
        target = self.target_time if target_time is None else target_time
        weight, steady_film_error = (None, NO_TARGET) if target is None else (self.gate(target), "")
        return Exposure(
            (BINS, PICTURE),
            self.pulse,
            at_centers=True,
            weight=weight,
            steady_film_error=steady_film_error,
        )

    def plan(self, scene, sensor=None, weight=None) -> Plan:
        """Plan gated next-event estimation, and paths that end when the gate closes."""
        plan = super().plan(scene, sensor)
        if weight is None:
            return plan
        plan.limits = self.limits(getattr(weight, "closes", None))
        # Behind rough glass, the index of a connection depends on its direction
        if self.emitter_sampling and not has_lobes(scene, mi.BSDFFlags.GlossyTransmission):
            # Connections along rays through media where they apply, else those of vertices alone
            has_samples = hasattr(self.pulse, "sample") and weight.closes is not None
            along_rays = isinstance(plan.space, Media) and GatedFog.serves(scene)
            along_rays &= has_samples and not (self.camera_unwarp or mi.is_polarized)
            kind = partial(GatedFog, plan.space) if along_rays else GatedLights
            plan.endpoint = self.emitters(kind, scene, sensor, weight)
        return plan

    def sample_arguments(self) -> tuple[Any, ...]:
        """Return the target time, which a `sample` of a subclass takes after the ray."""
        return (self.target_time,)


def render_at_time(
    scene: mi.Scene,
    integrator: Any,
    sensor: mi.Sensor,
    target_time: float,
    spp: int = 64,
    seed: int = 0,
    *,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> np.ndarray:
    """Render the scene at one instant.

    See also `render_transient`.

    Args:
        scene: The scene.
        integrator: A `TimeGatedTransientPath`, or any object with a
            `sample(scene, sampler, ray, target_time)` of its own, which is then called.
        sensor: The camera; its film says size, crop and filter.
        target_time: Path length of the gate [m], 0 or more.
        spp: Samples per pixel.
        seed: Seed of the random numbers.
        checkpoint: As for `render`.
        progress: Whether to show a bar for work that takes more than two seconds.

    Returns:
        Radiance per metre of path, float32 array of shape (height, width, channels).

    Raises:
        ValueError: An argument is out of range; one line.
        TypeError: The integrator has no `sample`; one line.
        KeyboardInterrupt: The render was stopped; one line that says how to go on.

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
    kind, settings = ("gate", NO_GATES, CALL), (spp, seed, checkpoint, progress)
    return render_image(scene, integrator, sensor, *kind, (target,), *settings, gate=target)


def render_transient(
    scene: mi.Scene,
    integrator: Any,
    sensor: mi.Sensor,
    film_config: Mapping[str, Any],
    spp: int = 64,
    seed: int = 0,
    *,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> np.ndarray:
    """Render the scene at many instants, with the paths of one trace.

    `film_config` has `temporal_bins`, `start_opl` [m] and `bin_width_opl` [m]: gate k is at
    start_opl + (k + 1/2) bin_width_opl. The other arguments are those of `render_at_time`, where
    the integrator is a `TimeGatedTransientPath`, and `spp` samples are of all gates together.
    See also `render_at_time`, `render`.

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
    given = checks.quote(film_config)
    film_config = checks.mapping("film_config", film_config)
    for key in film_config:
        checks.one_of("film_config key", key, FILM_KEYS)
    if missing := [key for key in FILM_KEYS if key not in film_config]:
        known = ", ".join(FILM_KEYS)
        raise ValueError(f"film_config = {given}: has no {missing[0]}; must have {known}")
    bins = checks.integer("temporal_bins", film_config["temporal_bins"], 1, checks.MAX_BINS)
    start = checks.metres("start_opl", film_config["start_opl"])
    width = checks.metres("bin_width_opl", film_config["bin_width_opl"], positive=True)
    if is_user_defined(integrator):
        raise TypeError(
            f"integrator = {type(integrator).__name__}: has a sample of its own, which sees one "
            "instant; must be a TimeGatedTransientPath without, or use render_at_time for each"
        )
    require_method(integrator, "gate", NO_GATES)
    check_view(scene, sensor, **follows(integrator))
    film = transient_film(sensor.film(), bins, start, width)
    integrator.gate(start)  # Refuses where there is no pulse
    record = recording(film, replace(integrator.exposure(), at_centers=True))
    plan, settings = integrator.plan(scene, sensor), (spp, seed, checkpoint, progress)
    render_all(scene, integrator, sensor, plan, record, *settings)
    return film.take()[1]
