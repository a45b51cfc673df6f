"""Base class of all integrators: parameters, plans, and rendering."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.exposure import Exposure, Weight
from ..films.recording import Recording, recording, warn_not_finite
from ..films.sums import Radiance
from ..media.space import Media
from ..paths.endpoints import EmitterHits, SceneLights
from ..paths.endpoints.scene_lights import checked_count
from ..paths.motion import Velocities
from ..paths.protocols import Endpoint, Scattering, Space
from ..paths.records import Limits
from ..paths.refraction import index_around
from ..paths.scattering import Materials
from ..paths.space import Vacuum
from ..paths.surfaces import has_lobes
from ..runtime import checks
from ..runtime.interface import readable
from ..runtime.settings import parameter
from ..scenes.checking import check_scene
from ..scenes.media import beyond, media_of
from ..scenes.motion import motions_of
from ..signals.polarisation import to_spectrum
from ..signals.pulses import GaussianPulse, Pulse
from .derivatives import Derivative, replaced
from .differentiable import require_changes, require_derivatives, tracked, warn_of_edges
from .passes import steps
from .plan import Plan
from .user_defined import Tracer, UserDefinedTracer, follows, is_user_defined

GRADIENT_SAMPLINGS = ("detached", "attached")


class TransientIntegrator(mi.SamplingIntegrator):
    """Base of the integrators that know how long each path is.

    A subclass says how light counts on a film, in `exposure`, and what paths are like, in
    `endpoint`, `scattering` and `limits`, of which `plan` is made. It keeps parameters only.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 6 | longest path in segments, camera's included; -1 is unlimited |
    | `rr_depth` | 5 | surface vertices from which on Russian roulette may end a path |
    | `hide_emitters` | false | emitters are invisible to the camera |
    | `camera_unwarp` | false | leave out the segment from the camera to the first surface |
    | `discard_direct_light` | false | drop light that comes straight from an emitter |
    | `emitter_sampling` | true | connect to emitters; if false, paths must run into them |
    | `gradient_sampling` | "detached" | or "attached", for derivatives: see `gradients.detached` |
    """

    def __init__(self, props: mi.Properties) -> None:
        self.max_depth = parameter(props, "max_depth", self.default_depth)
        self.rr_depth = checks.integer("rr_depth", props.get("rr_depth", 5), 1, checks.MAX_DEPTH)
        timeout = checks.number("timeout", props.get("timeout", -1.0))
        checks.require("timeout", timeout, timeout <= 0, "left out; Ctrl-C stops a render")
        super().__init__(props)
        flags = {"camera_unwarp": False, "discard_direct_light": False, "emitter_sampling": True}
        self.camera_unwarp, self.discard_direct_light, self.emitter_sampling = (
            checks.boolean(name, props.get(name, default)) for name, default in flags.items()
        )
        name, sampling = "gradient_sampling", props.get("gradient_sampling", "detached")
        allowed = f"left out; {type(self).__name__} has no derivatives"
        checks.require(name, sampling, self.has_derivatives or name not in props, allowed)
        self.gradient_sampling = checks.one_of(name, sampling, GRADIENT_SAMPLINGS)
        points = props.get("light_samples", None)
        self.light_samples: str | int = 1
        if self.takes_light_samples and self.emitter_sampling:
            self.light_samples = checked_count("auto" if points is None else points)
        else:
            allowed = "left out; here vertices connect to one light point or none"
            checks.require("light_samples", points, points is None, allowed)

    @property
    def traits(self) -> dict[str, Any]:
        """Parameters that say which paths are followed, and where their lengths start."""
        names = *TransientIntegrator.shown, "discard_direct_light", "emitter_sampling"
        return {name: getattr(self, name) for name in names}

    fills_bins = False  # Bins get the radiance that arrives in each, as `tofrender.render` needs
    needs_lights = True  # A scene without emitters would be black
    follows_media = True  # Paths go through media, and are scattered there
    follows_polarisation = True  # Paths carry polarised light in variants that have it
    goes_straight = False  # Connections pass surfaces that transmit straight on, as in `volpath`
    starts_at_lights = False  # There are paths from lights
    has_derivatives = True
    takes_light_samples = False  # A vertex may connect to several points of emitters

    default_depth = 6
    shown: tuple[str, ...] = ("max_depth", "rr_depth", "hide_emitters", "camera_unwarp")
    pulse: Pulse | None = None
    temporal_filter: str = "box"

    def exposure(self) -> Exposure:
        """Return how light counts on a film."""
        return Exposure(pulse=self.pulse)

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> Endpoint:
        """Return the light-sampling technique."""
        if not self.emitter_sampling:
            return self.emitters(EmitterHits, scene, sensor)
        return self.emitters(SceneLights, scene, sensor, light_samples=self.light_samples)

    def scattering(self, scene: mi.Scene) -> Scattering:
        """Return the scattering at surfaces."""
        return Materials(scene)

    def limits(self, max_opl: mi.Float | None = None) -> Limits:
        """Return the limits of paths; `max_opl` [m] is the greatest length, None for any."""
        return Limits(self.max_depth, self.rr_depth, max_opl, self.camera_unwarp)

    def emitters(self, kind, scene, sensor, *more, **named):
        """Create an endpoint with this integrator's `hide_emitters` and `discard_direct_light`."""
        visible = self.hide_emitters, self.discard_direct_light
        return kind(scene, sensor, *more, *visible, **named)

    def plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None = None, weight: Weight | None = None
    ) -> Plan:
        """Return the plan for a sensor, None if only rays are given, as by `sample`.

        `weight` is set where a single sum weighted by path length is wanted, as by a gate.
        """
        space = self.space(scene, sensor)
        scattering = space.with_phase_functions(self.scattering(scene))
        return Plan(scene, space, self.endpoint(scene, sensor), scattering, self.limits())

    def space(self, scene: mi.Scene, sensor: mi.Sensor | None) -> Space:
        """Return a scene's vacuum or media; without sensor, indices are over the rays' start's."""
        index = 1.0 if sensor is None else index_around(scene, sensor)
        straight = self._passes_null(scene)
        if straight or (self.follows_media and media_of(scene, sensor)):
            outside = None if sensor is None else sensor.get_medium()
            distant = beyond(scene, outside) if self.starts_at_lights else None
            return Media(scene, outside, distant, self.hide_emitters, straight, index)
        return Vacuum(scene, index)

    def _passes_null(self, scene: mi.Scene) -> bool:
        """Whether there are surfaces that connections pass, boundaries included."""
        return self.goes_straight and has_lobes(scene, mi.BSDFFlags.Null)

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Steady radiance along rays, lanes that see a surface or an environment, and no AOVs."""
        return self.sampled(self.plan(scene), scene, sampler, ray, Radiance.zero(), active)

    def sampled(self, plan, scene, sampler, ray, measurement, active=True, origin=None):
        """Trace camera rays, and return the sum as `sample` does."""
        origin = ray.o if origin is None else origin
        measured, path = plan.trace(sampler, ray, origin, measurement, mi.Bool(active))
        sees_sky = scene.environment() is not None and not self.hide_emitters
        return to_spectrum(measured.total), path.valid_ray | sees_sky, []

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render with the scene's own film and sampler; `mi.render` calls this.

        Arguments are Mitsuba's: 0 samples per pixel are the sampler's, and `evaluate` is False
        where derivatives may be asked for later. What has none is refused if parameters track
        gradients. Returns `(steady, transient)` as the film develops them, None without `develop`.
        """
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        check_scene(scene, sensor, **follows(self))
        film, sampler = sensor.film(), sensor.sampler().clone()
        if spp:
            sampler.set_sample_count(spp)
        record = self.recording(film)
        if not evaluate:
            self._require_derivatives(scene, sensor, record)
        if develop:
            record.require_memory(sampler.sample_count())
        with dr.suspend_grad():
            for _ in steps(self.tracer(scene, sensor, record), record, sensor, sampler, seed):
                pass
            warn_not_finite(record.not_finite)
            return film.develop() if develop else None

    def render_forward(self, scene, params, sensor=0, seed=0, spp=0):
        """Forward derivative of what `render` returns, by the gradients of `params`.

        `mi.render(scene, params)` calls this and `render_backward`. Errors as for `render`.
        """
        self._require_own_derivatives()
        require_changes(params)
        with replaced(params) as fresh:
            return self._differentiated(scene, fresh, sensor, spp).forward(seed, fresh)

    def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
        """Propagate the gradient `grad_in` by what `render` returns to `params`."""
        self._require_own_derivatives()
        require_changes(params)
        gradients = grad_in if isinstance(grad_in, tuple) else (grad_in,)
        self._differentiated(scene, params, sensor, spp).reverse(seed, gradients)

    def _differentiated(self, scene, params, sensor, spp) -> Derivative:
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        record = self.recording(sensor.film())
        attached = self.gradient_sampling == "attached"
        straight = self._passes_null(scene)
        require_derivatives(scene, sensor, record, tracked(params), straight, attached)
        plan = self.plan(scene, sensor)
        spp = spp or sensor.sampler().sample_count()
        return Derivative(plan, record, sensor, spp, self.gradient_sampling == "detached")

    def _require_derivatives(self, scene: mi.Scene, sensor: mi.Sensor, record: Recording) -> None:
        """Refuse a render that has no derivatives, if parameters track gradients."""
        parts = [scene, self] if sensor in scene.sensors() else [scene, self, sensor]
        names = [name for part in parts for name in tracked(readable(mi.traverse(part)))]
        if names:
            self._require_own_derivatives()
            attached = self.gradient_sampling == "attached"
            straight = self._passes_null(scene)
            require_derivatives(scene, sensor, record, names, straight, attached)
            warn_of_edges(names)

    def _require_own_derivatives(self) -> None:
        if not self.has_derivatives or is_user_defined(self):
            raise RuntimeError(
                f"integrator = {type(self).__name__}: has no derivatives; must be one that has, "
                "e.g. transient_path, or parameters must not track gradients"
            )

    def traverse(self, callback):
        """Expose the width of the light's pulse, if that is Gaussian."""
        if type(self.pulse) is GaussianPulse and dr.is_array_v(self.pulse.width):
            kind = mi.ParamFlags.Differentiable
            callback.put("pulse_width_opl", self.pulse.width, kind)

    def parameters_changed(self, keys=()):
        """Update the pulse after its width was set."""
        if "pulse_width_opl" in keys and isinstance(self.pulse, GaussianPulse):
            self.pulse.take_width()

    def recording(self, film: mi.Film) -> Recording:
        """Return the recording of this integrator's light on a film, see `films.recording`."""
        return recording(film, self.exposure())

    def tracer(self, scene: mi.Scene, sensor: mi.Sensor, record: Recording) -> Tracer:
        """Return the plan, or a tracer that calls the `sample` of a user-defined subclass."""
        if is_user_defined(self):
            return UserDefinedTracer(self, scene, record, *self.sample_arguments())
        plan = self.plan(scene, sensor, record.weight)
        if record.needs_rates and motions_of(scene):
            return plan.with_motion(Velocities(scene, sensor))
        return plan

    def sample_arguments(self) -> tuple[Any, ...]:
        """Return further arguments of a user-defined subclass's `sample`."""
        return ()

    def to_string(self) -> str:
        """The integrator's parameters."""
        values = ", ".join(f"{name} = {getattr(self, name)!r}" for name in self.shown)
        return f"{type(self).__name__}[{values}]"
