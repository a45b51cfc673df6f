"""Base class of all integrators: parameters, plans, and rendering."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.exposure import Exposure, Weight
from ..films.recording import Recording, recording, warn_not_finite
from ..films.sums import Radiance
from ..media.participating import Media
from ..paths.endpoints import EmitterHits, SceneLights
from ..paths.endpoints.scene_lights import checked_count
from ..paths.protocols import Endpoint, Scattering, Space
from ..paths.records import Limits
from ..paths.refraction import index_around
from ..paths.scattering import Materials
from ..paths.space import Vacuum
from ..paths.surfaces import has_lobes
from ..paths.velocities import Velocities
from ..runtime import checks
from ..runtime.interface import readable
from ..runtime.settings import parameter
from ..scenes.checking import check_scene
from ..scenes.media import beyond, media_of
from ..scenes.motion import motions_of
from ..signals.polarization import to_spectrum
from ..signals.pulses import GaussianPulse, Pulse
from .derivatives import Derivative, replaced
from .differentiable import require_changes, require_derivatives, tracked, warn_of_edges
from .passes import steps
from .plan import Plan
from .user_defined import Tracer, UserDefinedTracer, follows, is_user_defined

GRADIENT_SAMPLINGS = ("detached", "attached")


class TransientIntegrator(mi.SamplingIntegrator):
    """Base class of integrators that record the length of each path.

    A subclass overrides `exposure` to define how light is weighted on a film. It overrides
    `endpoint`, `scattering` and `limits` to define the paths. The method `plan` combines these
    parts. An integrator only stores parameters.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 6 | longest path in segments, including the camera segment; -1 is unlimited |
    | `rr_depth` | 5 | number of vertices after which Russian roulette may end a path |
    | `hide_emitters` | false | emitters are invisible to the camera |
    | `camera_unwarp` | false | exclude the segment from the camera to the first surface from path \
lengths |
    | `discard_direct_light` | false | ignore emitters that the camera sees directly |
    | `emitter_sampling` | true | connect to emitters; if false, paths must hit emitters by chance |
    | `gradient_sampling` | "detached" | sampling for derivatives, "detached" or "attached", see \
`gradients.detached` |
    """

    def __init__(self, props: mi.Properties) -> None:
        # Read the parameters of Mitsuba's path tracers
        self.max_depth = parameter(props, "max_depth", self.default_depth)
        self.rr_depth = checks.integer("rr_depth", props.get("rr_depth", 5), 1, checks.MAX_DEPTH)
        timeout = checks.number("timeout", props.get("timeout", -1.0))
        checks.require("timeout", timeout, timeout <= 0, "left out. Press Ctrl-C to stop a render")
        super().__init__(props)

        # Read the parameters that define which light counts
        self.camera_unwarp = checks.boolean("camera_unwarp", props.get("camera_unwarp", False))
        discard = props.get("discard_direct_light", False)
        self.discard_direct_light = checks.boolean("discard_direct_light", discard)
        emitter_sampling = props.get("emitter_sampling", True)
        self.emitter_sampling = checks.boolean("emitter_sampling", emitter_sampling)

        # Read the sampling for derivatives
        name = "gradient_sampling"
        sampling = props.get("gradient_sampling", "detached")
        allowed = f"left out, because {type(self).__name__} does not support derivatives"
        checks.require(name, sampling, self.has_derivatives or name not in props, allowed)
        self.gradient_sampling = checks.one_of(name, sampling, GRADIENT_SAMPLINGS)

        # Read the number of emitter samples
        points = props.get("light_samples", None)
        self.light_samples: str | int = 1
        if self.takes_light_samples and self.emitter_sampling:
            self.light_samples = checked_count("auto" if points is None else points)
        else:
            allowed = "left out, because vertices connect to at most one point on lights here"
            checks.require("light_samples", points, points is None, allowed)

    @property
    def traits(self) -> dict[str, Any]:
        """Parameters that define the paths and the start of path lengths, by name."""
        names = (*TransientIntegrator.shown, "discard_direct_light", "emitter_sampling")
        return {name: getattr(self, name) for name in names}

    # Whether a time bin stores the radiance that arrives in the bin, as `tofrender.render` requires
    fills_bins = False

    # Whether a scene without emitters is black
    needs_lights = True

    # Whether media scatter the paths
    follows_media = True

    # Whether paths transport polarized light in polarized variants
    follows_polarization = True

    # Whether connections pass surfaces with null transmission, as in Mitsuba's `volpath`
    goes_straight = False

    # Whether paths start at emitters
    starts_at_lights = False

    # Whether derivatives are supported
    has_derivatives = True

    # Whether the method `gate` makes time gates
    has_gates = False

    # Whether a vertex may connect to several points on emitters
    takes_light_samples = False

    # Default of `max_depth`
    default_depth = 6

    # Parameters that `to_string` prints
    shown: tuple[str, ...] = ("max_depth", "rr_depth", "hide_emitters", "camera_unwarp")

    # Temporal profile of the emitted light, None for an instant
    pulse: Pulse | None = None

    # Filter in time: "box", "gaussian", or "" for the temporal filter of the film
    temporal_filter: str = "box"

    def exposure(self) -> Exposure:
        """Return the weighting of light by path length on a film."""
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
        """Return the limits of paths.

        Args:
            max_opl: Largest optical path length [m], None if path lengths are not limited.
        """
        return Limits(self.max_depth, self.rr_depth, max_opl, self.camera_unwarp)

    def emitters(self, kind, scene, sensor, *arguments, **options):
        """Create an endpoint with this integrator's `hide_emitters` and `discard_direct_light`.

        Args:
            kind: Class of the endpoint.
            scene: The scene.
            sensor: The sensor, None if only rays are given.
            arguments: Further positional arguments, before the two parameters.
            options: Keyword arguments.
        """
        visible = (self.hide_emitters, self.discard_direct_light)
        return kind(scene, sensor, *arguments, *visible, **options)

    def plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None = None, weight: Weight | None = None
    ) -> Plan:
        """Return the plan of a render.

        Args:
            scene: The scene.
            sensor: The sensor, None if only rays are given, as in `sample`.
            weight: Weight by path length for a steady picture, for example a time gate. None if
                the film does not weight light by path length.
        """
        space = self.space(scene, sensor)
        scattering = space.with_phase_functions(self.scattering(scene))
        return Plan(
            scene=scene,
            space=space,
            endpoint=self.endpoint(scene, sensor),
            scattering=scattering,
            limits=self.limits(),
        )

    def space(self, scene: mi.Scene, sensor: mi.Sensor | None) -> Space:
        """Return the vacuum or the media of a scene.

        Without a sensor, indices of refraction are relative to the index at the start of the rays.
        """
        index = 1.0 if sensor is None else index_around(scene, sensor)
        straight = self._passes_null(scene)
        if straight or (self.follows_media and media_of(scene, sensor)):
            outside = None if sensor is None else sensor.get_medium()
            distant = beyond(scene, outside) if self.starts_at_lights else None
            return Media(
                scene=scene,
                outside=outside,
                beyond=distant,
                hide_emitters=self.hide_emitters,
                straight=straight,
                index=index,
            )
        return Vacuum(scene, index)

    def _passes_null(self, scene: mi.Scene) -> bool:
        """Return whether connections pass some surfaces of the scene, including boundaries."""
        return self.goes_straight and has_lobes(scene, mi.BSDFFlags.Null)

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Estimate steady radiance along rays.

        Returns:
            Spectrum, lanes that see a surface or an environment, and an empty list of AOVs.
        """
        return self.sampled(self.plan(scene), scene, sampler, ray, Radiance.zero(), active)

    def sampled(self, plan, scene, sampler, ray, measurement, active=True, origin=None):
        """Trace camera rays with a plan and a measurement; return the same values as `sample`."""
        origin = ray.o if origin is None else origin
        measured, path = plan.trace(sampler, ray, origin, measurement, mi.Bool(active))
        sees_sky = scene.environment() is not None and not self.hide_emitters
        return to_spectrum(measured.total), path.valid_ray | sees_sky, []

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render with the film and the sampler of the scene. `mi.render` calls this method.

        Args:
            scene: The scene.
            sensor: The sensor or its index.
            seed: Seed of the sampler.
            spp: Samples per pixel, 0 for the `sample_count` of the sampler.
            develop: Whether to develop the film.
            evaluate: False if derivatives may be computed later. Renders without derivatives are
                then refused if parameters track gradients.

        Returns:
            The developed film, `(steady, transient)` for films with time bins. None if `develop`
            is False.
        """
        # Check the scene
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        check_scene(scene, sensor, **follows(self))

        # Prepare the sampler and the film
        film = sensor.film()
        sampler = sensor.sampler().clone()
        if spp:
            sampler.set_sample_count(spp)
        record = self.recording(film)
        if not evaluate:
            self._require_derivatives(scene, sensor, record)
        if develop:
            record.require_memory(sampler.sample_count())

        # Render all steps
        with dr.suspend_grad():
            for _ in steps(self.tracer(scene, sensor, record), record, sensor, sampler, seed):
                pass
            warn_not_finite(record.accumulation.not_finite)
            return film.develop() if develop else None

    def render_forward(self, scene, params, sensor=0, seed=0, spp=0):
        """Return the forward derivative (JVP) of the result of `render`.

        The gradients of the parameters are the direction of the derivative.
        `mi.render(scene, params)` calls this method in forward mode. The errors of `render` may
        be raised.
        """
        self._require_own_derivatives()
        require_changes(params)
        with replaced(params) as fresh:
            return self._differentiated(scene, fresh, sensor, spp).forward(seed, fresh)

    def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
        """Propagate a gradient of the result of `render` to the parameters (VJP).

        Args:
            scene: The scene.
            params: Parameters of the scene, which receive gradients.
            grad_in: Gradient of a loss with respect to the result of `render`.
            sensor: The sensor or its index.
            seed: Seed of the sampler.
            spp: Samples per pixel, 0 for the `sample_count` of the sampler.
        """
        self._require_own_derivatives()
        require_changes(params)
        gradients = grad_in if isinstance(grad_in, tuple) else (grad_in,)
        self._differentiated(scene, params, sensor, spp).reverse(seed, gradients)

    def _differentiated(self, scene, params, sensor, spp) -> Derivative:
        """Return the derivative of a render, or raise an error if it is not supported."""
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        record = self.recording(sensor.film())
        attached = self.gradient_sampling == "attached"
        straight = self._passes_null(scene)
        require_derivatives(scene, sensor, record, tracked(params), straight, attached)
        plan = self.plan(scene, sensor)
        spp = spp or sensor.sampler().sample_count()
        return Derivative(plan, record, sensor, spp, self.gradient_sampling == "detached")

    def _require_derivatives(self, scene: mi.Scene, sensor: mi.Sensor, record: Recording) -> None:
        """Raise an error if parameters track gradients, and the render has no derivatives."""
        parts = [scene, self] if sensor in scene.sensors() else [scene, self, sensor]
        names = [name for part in parts for name in tracked(readable(mi.traverse(part)))]
        if names:
            self._require_own_derivatives()
            attached = self.gradient_sampling == "attached"
            straight = self._passes_null(scene)
            require_derivatives(scene, sensor, record, names, straight, attached)
            warn_of_edges(names)

    def _require_own_derivatives(self) -> None:
        """Raise a RuntimeError: the integrator has no derivatives."""
        if not self.has_derivatives or is_user_defined(self):
            raise RuntimeError(
                f"integrator = {type(self).__name__}: derivatives are not supported. Use another "
                "integrator, for example transient_path, or parameters without gradients"
            )

    def traverse(self, callback):
        """Expose the width of the light's pulse, if the pulse is Gaussian."""
        if type(self.pulse) is GaussianPulse and dr.is_array_v(self.pulse.width):
            kind = mi.ParamFlags.Differentiable
            callback.put("pulse_width_opl", self.pulse.width, kind)

    def parameters_changed(self, keys=()):
        """Update the pulse after its width has changed."""
        if "pulse_width_opl" in keys and isinstance(self.pulse, GaussianPulse):
            self.pulse.take_width()

    def recording(self, film: mi.Film) -> Recording:
        """Return the recording of this integrator on a film, see `films.recording`."""
        return recording(film, self.exposure())

    def tracer(self, scene: mi.Scene, sensor: mi.Sensor, record: Recording) -> Tracer:
        """Return the plan, or for a user-defined subclass a tracer that calls its `sample()`."""
        if is_user_defined(self):
            return UserDefinedTracer(self, scene, record, *self.sample_arguments())
        plan = self.plan(scene, sensor, record.exposure.weight)
        if record.needs_rates and motions_of(scene):
            return plan.with_motion(Velocities(scene, sensor))
        return plan

    def sample_arguments(self) -> tuple[Any, ...]:
        """Return further arguments for the `sample()` of a user-defined subclass."""
        return ()

    def to_string(self) -> str:
        """Return the parameters of the integrator as text."""
        values = ", ".join(f"{name} = {getattr(self, name)!r}" for name in self.shown)
        return f"{type(self).__name__}[{values}]"
