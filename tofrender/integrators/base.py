"""Base class of all integrators: parameters, plans, and rendering."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.exposure import Exposure, Weight
from ..films.recording import Recording, recording, warn_not_finite
from ..films.sums import Radiance
from ..paths.endpoints import EmitterHits, SceneLights
from ..paths.endpoints.scene_lights import checked_count
from ..paths.media import Media
from ..paths.protocols import Endpoint, Scattering, Space
from ..paths.records import Limits, Path
from ..paths.refraction import index_around
from ..paths.scattering import Materials
from ..paths.space import Vacuum
from ..paths.surfaces import has_lobes
from ..runtime import checks
from ..scenes.checking import check_scene
from ..scenes.media import beyond, media_of
from ..signals.polarisation import as_spectrum
from ..signals.pulses import GaussianPulse, Pulse
from .derivatives import Derivative, replaced
from .differentiable import require_changes, require_derivatives, tracked, warn_of_edges
from .passes import WHOLE, Part, steps
from .plan import Plan, Tracer
from .user_defined import UserDefinedTracer, is_user_defined

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
    | `gradient_sampling` | "detached" | or "attached", for derivatives: see `paths.attached` |
    """

    def __init__(self, props: mi.Properties) -> None:
        depth, roulette = props.get("max_depth", 6), props.get("rr_depth", 5)
        self.max_depth = checks.depth("max_depth", depth)
        self.rr_depth = checks.integer("rr_depth", roulette, 1, checks.MAX_DEPTH)
        if checks.number("timeout", props.get("timeout", -1.0)) > 0:
            raise ValueError(
                f"timeout = {props['timeout']}: must be left out; Ctrl-C stops a render"
            )
        super().__init__(props)
        self.camera_unwarp, self.discard_direct_light, self.emitter_sampling = (
            checks.boolean(name, props.get(name, default))
            for name, default in (
                ("camera_unwarp", False),
                ("discard_direct_light", False),
                ("emitter_sampling", True),
            )
        )
        if "gradient_sampling" in props and not self.has_derivatives:
            raise ValueError(
                f"gradient_sampling = {checks.shown(props['gradient_sampling'])}: must be left "
                f"out; {type(self).__name__} has no derivatives"
            )
        sampling = props.get("gradient_sampling", "detached")
        self.gradient_sampling = checks.one_of("gradient_sampling", sampling, GRADIENT_SAMPLINGS)
        points: Any = props.get("light_samples", None)
        self.light_samples: str | int = 1
        if self.takes_light_samples and self.emitter_sampling:
            self.light_samples = checked_count("auto" if points is None else points)
        elif points is not None:
            raise ValueError(
                f"light_samples = {checks.shown(points)}: must be left out; here vertices "
                "connect to one light point or none"
            )

    @property
    def traits(self) -> dict[str, Any]:
        """Parameters that say which paths are followed, and where their lengths start."""
        names = (
            *("max_depth", "rr_depth", "hide_emitters"),
            *("camera_unwarp", "discard_direct_light", "emitter_sampling"),
        )
        return {name: getattr(self, name) for name in names}

    # ------------------------------------------------------------------ for subclasses

    fills_bins = False
    """Whether a film's bins get the radiance that arrives in each, as `tofrender.render` needs."""

    needs_lights = True
    """Whether a scene without emitters would be black."""

    follows_media = True
    """Whether paths go through media, and are scattered there."""

    follows_polarisation = True
    """Whether paths carry polarised light in variants that have it."""

    goes_straight = False
    """Whether connections go through surfaces that let light straight through, as in `volpath`."""

    starts_at_lights = False
    """Whether there are paths that come from lights."""

    has_derivatives = True
    """Whether derivatives can be asked for."""

    takes_light_samples = False
    """Whether a vertex may connect to several points of the scene's emitters."""

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

    def limits(self, max_opl: Any = None) -> Limits:
        """Return the limits of paths; `max_opl` [m] is the greatest length, None for any."""
        return Limits(self.max_depth, self.rr_depth, max_opl, self.camera_unwarp)

    def emitters(
        self, kind: Any, scene: mi.Scene, sensor: mi.Sensor | None, *more: Any, **named: Any
    ) -> Any:
        """An endpoint of the scene's emitters that shows those which the sensor shall see."""
        shown = self.hide_emitters, self.discard_direct_light
        return kind(scene, sensor, *more, *shown, **named)

    # ------------------------------------------------------------------------- paths

    def plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None = None, weight: Weight | None = None
    ) -> Plan:
        """Return the parts of the path loop for the rays of a sensor.

        Args:
            scene: The scene.
            sensor: The sensor, None where only rays are known.
            weight: Weight of light by its length, if that is all that counts.
        """
        space = self.space(scene, sensor)
        scattering = space.with_phase_functions(self.scattering(scene))
        return Plan(scene, space, self.endpoint(scene, sensor), scattering, self.limits())

    def space(self, scene: mi.Scene, sensor: mi.Sensor | None) -> Space:
        """Vacuum or media of a scene; without a sensor, indices are relative to the rays' start."""
        index = 1.0 if sensor is None else index_around(scene, sensor)
        straight = self._passes_null(scene)
        if straight or (self.follows_media and media_of(scene, sensor)):
            outside = None if sensor is None else sensor.get_medium()
            afar = beyond(scene, outside) if self.starts_at_lights else None
            return Media(scene, outside, afar, self.hide_emitters, straight, index)
        return Vacuum(scene, index)

    def _passes_null(self, scene: mi.Scene) -> bool:
        """Whether there are surfaces that connections go straight through, boundaries included."""
        return self.goes_straight and has_lobes(scene, mi.BSDFFlags.Null)

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Steady radiance along rays, as every sampling integrator of Mitsuba returns it.

        Returns:
            Spectrum, lanes that see a surface or an environment, and no AOVs.
        """
        plan = self.plan(scene)
        radiance, path = plan.trace(sampler, ray, ray.o, Radiance.zero(), mi.Bool(active))
        return as_spectrum(radiance.total), self.sees(scene, path), []

    def sees(self, scene: mi.Scene, path: Path) -> mi.Bool:
        """Lanes that see something, as Mitsuba's `path` says: a surface or an environment."""
        return path.valid_ray | (scene.environment() is not None and not self.hide_emitters)

    # --------------------------------------------------------------------- rendering

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render with the scene's own film and sampler; `mi.render` calls this.

        Args:
            scene: The scene.
            sensor: A sensor, or its number in the scene.
            seed: Seed of the random numbers.
            spp: Samples per pixel; 0 takes the sampler's.
            develop: Whether to return the picture.
            evaluate: Mitsuba's word, false in `mi.render`: then derivatives may be asked for.

        Returns:
            `(steady, transient)` as the film develops them, None if `develop` is false.

        Raises:
            RuntimeError: Parameters track gradients, and the integrator has no derivatives.
            ValueError: They do, and something of the render has none.
        """
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        follows = {"media": self.follows_media, "polarisation": self.follows_polarisation}
        check_scene(scene, sensor, **follows)
        film, sampler = sensor.film(), sensor.sampler().clone()
        if spp:
            sampler.set_sample_count(spp)
        record = self.recording(film)
        if not evaluate:  # As `mi.render` says, which may ask for derivatives later
            self._require_derivatives(scene, sensor, record)
        if develop:
            record.require_memory(sampler.sample_count())
        with dr.suspend_grad():
            for _ in self.steps(scene, sensor, record, sampler, seed):
                pass
            warn_not_finite(record.not_finite)
            return film.develop() if develop else None

    def render_forward(self, scene, params, sensor=0, seed=0, spp=0):
        """The change of what `render` returns; `mi.render(scene, params)` calls this.

        Args:
            scene: The scene.
            params: Its parameters, as of `mi.traverse`, some of which change at a rate.
            sensor: A sensor, or its number in the scene.
            seed: Seed of the random numbers.
            spp: Samples per pixel; 0 takes the sampler's.

        Returns:
            As `render`.

        Raises:
            RuntimeError: The integrator has no derivatives; one line.
            ValueError: Something of the render has none; one line.
        """
        self._require_own_derivatives()
        require_changes(params)
        with replaced(params) as fresh:
            return self._differentiated(scene, fresh, sensor, spp).forward(seed, fresh)

    def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
        """Propagate a gradient to parameters; `mi.render(scene, params)` calls this.

        Args:
            scene: The scene.
            params: As for `render_forward`; some of them track gradients.
            grad_in: Gradient by what `render` returns.
            sensor: As for `render_forward`.
            seed: As for `render_forward`.
            spp: As for `render_forward`.

        Raises:
            RuntimeError: The integrator has no derivatives; one line.
            ValueError: Something of the render has none; one line.
        """
        self._require_own_derivatives()
        require_changes(params)
        gradients = grad_in if isinstance(grad_in, tuple) else (grad_in,)
        self._differentiated(scene, params, sensor, spp).reverse(seed, gradients)

    def _differentiated(self, scene, params, sensor, spp) -> Derivative:
        """A render whose derivative is asked for."""
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        record = self.recording(sensor.film())
        self._require_known(scene, sensor, record, tracked(params))
        plan = self.plan(scene, sensor)
        spp = spp or sensor.sampler().sample_count()
        return Derivative(plan, scene, record, sensor, spp, self.gradient_sampling == "detached")

    def _require_derivatives(self, scene: mi.Scene, sensor: mi.Sensor, record: Recording) -> None:
        """Refuse a render that has no derivatives, if parameters track gradients."""
        parts = [scene, self] if sensor in scene.sensors() else [scene, self, sensor]
        names = [name for part in parts for name in tracked(mi.traverse(part))]
        if not names:
            return
        self._require_own_derivatives()
        self._require_known(scene, sensor, record, names)
        warn_of_edges(names)

    def _require_known(self, scene, sensor, record, names) -> None:
        """Refuse derivatives by parameters of some names that are not known."""
        require_derivatives(scene, sensor, record, names, self._passes_null(scene))

    def _require_own_derivatives(self) -> None:
        """Refuse an integrator without derivatives."""
        if not self.has_derivatives or is_user_defined(self):
            raise RuntimeError(
                f"integrator = {type(self).__name__}: has no derivatives; must be one that has, "
                "e.g. transient_path, or parameters must not track gradients"
            )

    def traverse(self, callback):
        """Show Mitsuba the width of the light's pulse, if that is Gaussian."""
        if type(self.pulse) is GaussianPulse and dr.is_array_v(self.pulse.width):
            kind = mi.ParamFlags.Differentiable
            callback.put("pulse_width_opl", self.pulse.width, kind)

    def parameters_changed(self, keys=()):
        """Take the width that was set."""
        if "pulse_width_opl" in keys and isinstance(self.pulse, GaussianPulse):
            self.pulse.take_width()

    def recording(self, film: Any) -> Recording:
        """Return the recording of this integrator's light on a film.

        Raises:
            TypeError: The film is of the wrong kind; one line.
            ValueError: The film and the integrator's parameters do not fit; one line.
        """
        return recording(film, self.exposure())

    def tracer(self, scene: mi.Scene, sensor: mi.Sensor, record: Recording) -> Tracer:
        """Return the plan, or a tracer that calls the `sample` of a user-defined subclass."""
        if is_user_defined(self):
            return UserDefinedTracer(self, scene, record, *self.sample_arguments())
        return self.plan(scene, sensor, record.weight)

    def sample_arguments(self) -> tuple[Any, ...]:
        """Return further arguments of a user-defined subclass's `sample`."""
        return ()

    def steps(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        record: Recording,
        sampler: mi.Sampler,
        seed: Any,
        part: Part = WHOLE,
    ) -> Iterator[int]:
        """Render in steps of about a second, see `passes.steps`."""
        return steps(self.tracer(scene, sensor, record), record, sensor, sampler, seed, part)
