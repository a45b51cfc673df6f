"""What all integrators of this package share: parameters, paths, and rendering."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from ..paths.camera import CameraSample, behind_emitters, sample_camera
from ..paths.endpoints import EmitterHits, SceneLights
from ..paths.targets import Targets
from ..paths.walk import Radiance, walk
from ..runtime import backend, checks, memory
from . import passes
from .passes import image_channels, to_rgb

if TYPE_CHECKING:
    from ..signals.pulses import Pulse


class TransientIntegrator(mi.SamplingIntegrator):
    """Base of the integrators that know how long each path is.

    A subclass says what is measured along a path, in `measurement`; its `total` is the colour of
    the film's image.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 6 | longest path in segments, camera's included; -1 is unlimited |
    | `rr_depth` | 5 | surface vertices from which on Russian roulette may end a path |
    | `hide_emitters` | false | emitters are invisible to the camera |
    | `camera_unwarp` | false | leave out the segment from the camera to the first surface |
    | `discard_direct_light` | false | drop light that comes straight from an emitter |
    | `emitter_sampling` | true | connect to emitters; if false, paths must run into them |
    """

    def __init__(self, props: mi.Properties) -> None:
        depth, roulette = props.get("max_depth", 6), props.get("rr_depth", 5)
        self.max_depth = checks.depth("max_depth", depth)
        self.rr_depth = checks.integer("rr_depth", roulette, 1, checks.MAX_DEPTH)
        if props.get("timeout", -1.0) > 0:
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

    # ------------------------------------------------------------------ for subclasses

    fills_bins = False
    """Whether a film's bins get the radiance that arrives in each, as `tofrender.render` needs."""

    needs_lights = True
    """Whether a scene without emitters would be black."""

    material: mi.BSDF | None = None
    """What all surfaces are made of, None if each of its own."""

    targets: Targets | None = None
    """Surfaces that paths are sent to on purpose."""

    pulse: Pulse | None = None
    temporal_filter: str = "box"

    def temporal_profile(self, film: Any) -> Any:
        """The pulse that each contribution is spread by, None for an instant.

        Raises:
            ValueError: This film or filter cannot be used; one line.
        """
        return self.pulse

    def prepare(self, film: Any) -> None:
        """Make the film ready, or refuse it.

        Raises:
            TypeError: The film is of the wrong kind; one line with its type and what is allowed.
        """
        film.prepare([])

    def measurement(self, film: Any, camera: CameraSample, spp: int) -> Any:
        """What is done with the light of camera rays; by default it is summed."""
        return Radiance.zero()

    def colour(self, camera: CameraSample, spectrum: Any) -> mi.Color3f:
        """Colour of light that came along camera rays."""
        return to_rgb(spectrum * camera.weight, camera.ray.wavelengths)

    def extra_channels(self, film: Any, camera: CameraSample, measured: Any) -> list[mi.Float]:
        """What of a measurement goes to the image of the film behind the colour of `total`."""
        return []

    # ------------------------------------------------------------------------- paths

    def longest_path(self, lights: Any) -> int:
        """Segments of the longest path that counts, -1 without limit."""
        return self.max_depth

    def last_opl(self) -> Any:
        """Length beyond which paths count for nothing [m], None if all count."""
        return None

    def lights(self, scene: mi.Scene, sensor: mi.Sensor | None = None) -> SceneLights:
        """What paths connect to."""
        return (SceneLights if self.emitter_sampling else EmitterHits)(scene, sensor)

    def trace(self, scene, sampler, ray, origin, measurement, lights, active=True, last_opl=None):
        """Follow camera rays; returns the measurement and the lanes that met a surface."""
        if self.hide_emitters:
            ray = behind_emitters(scene, ray)
        return walk(
            scene,
            sampler,
            ray,
            measurement,
            lights,
            max_depth=self.longest_path(lights),
            rr_depth=self.rr_depth,
            origin=origin,
            unwarp=self.camera_unwarp,
            first_emission=not self.discard_direct_light,
            hide_emitters=self.hide_emitters,
            active=active,
            last_opl=last_opl,
            material=self.material,
            targets=self.targets,
        )

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Steady radiance along rays, as every sampling integrator of Mitsuba returns it.

        Returns:
            Spectrum, lanes that met a surface, and no AOVs.
        """
        radiance, valid = self.trace(
            scene, sampler, ray, ray.o, Radiance.zero(), self.lights(scene), active
        )
        return mi.Spectrum(radiance.total), valid, []

    # --------------------------------------------------------------------- rendering

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render with the scene's own film and sampler; `mi.render` calls this.

        Args:
            scene: The scene.
            sensor: A sensor, or its number in the scene.
            seed: Seed of the random numbers.
            spp: Samples per pixel; 0 takes the sampler's.
            develop: Whether to return the picture.
            evaluate: Accepted for Mitsuba's sake; the film is always evaluated.

        Returns:
            `(steady, transient)` as the film develops them, None if `develop` is false.
        """
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        film, sampler = sensor.film(), sensor.sampler().clone()
        if spp:
            sampler.set_sample_count(spp)
        if develop and hasattr(film, "shape"):  # The bins, and the tensor that is returned
            memory.require_film(*film.shape, 1 + film.shape[3] / memory.stride(film.shape[3]))
        with dr.suspend_grad():
            for _ in self.steps(scene, sensor, film, sampler, seed):
                pass
            return film.develop() if develop else None

    def render_forward(self, *args, **kwargs):
        """Refused: there are no derivatives yet."""
        raise RuntimeError("transient integrators have no derivatives; use mi.render without")

    render_backward = render_forward

    def steps(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        film: Any,
        sampler: mi.Sampler,
        seed: Any,
        first: int = 0,
    ) -> Iterator[int]:
        """Render in steps of about a second, all from one point set.

        Args:
            scene: The scene.
            sensor: The camera.
            film: A film of the same size as the sensor's; it is emptied first.
            sampler: Its `sample_count` is the number of samples per pixel.
            seed: Seed of the random numbers.
            first: As in `passes.steps`.

        Yields:
            Samples per pixel that the film holds so far.

        Raises:
            BackendError: The active variant cannot render in time.
            TypeError: The film is of the wrong kind.
            ValueError: The film and the integrator's parameters do not fit.
            MemoryError: The film does not fit.
        """
        backend.require_vectorised()
        if sensor.class_name() == "BatchSensor":
            raise ValueError(
                "sensor: is a batch of sensors; must be one, e.g. a perspective camera"
            )
        self.prepare(film)
        lights, last_opl = self.lights(scene, sensor), self.last_opl()
        spp = sampler.sample_count()

        def shot(pixel):
            camera = sample_camera(sensor, film, sampler, pixel)
            measured = self.measurement(film, camera, spp)
            measured, covered = self.trace(
                scene, sampler, camera.ray, camera.origin, measured, lights, last_opl=last_opl
            )
            colour = image_channels(film, self.colour(camera, measured.total), covered)
            return camera.position, colour, self.extra_channels(film, camera, measured)

        yield from passes.steps(film, sampler, seed, first, shot)
