"""Bidirectional path tracing: the plan, and the base class of the integrators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..bidirectional.emission import Emission, Emitted
from ..bidirectional.lens import Lens
from ..bidirectional.lens_connections import LensEndpoint, LightPathHistory
from ..bidirectional.light_paths import LightPaths
from ..bidirectional.mis import BidirectionalMIS
from ..films.contribution import Contribution
from ..films.exposure import BINS, PHASORS, PICTURE, Exposure
from ..paths.protocols import Parts, Space
from ..paths.records import Limits, Path
from ..paths.scattering import Materials
from ..paths.space import transmittance_between
from ..paths.walk import accumulate, walk
from ..runtime import checks
from ..runtime.backend import tracing_lock
from ..signals.polarization import unpolarized
from .plan import M, Plan
from .time_gated import Gate
from .transient_path import TransientPath


class BidirectionalPlan(Plan):
    """Plan for light paths and camera paths, which are connected to each other.

    Strategies are named (s, t), with s vertices from the light and t vertices from the lens.

    Args:
        scene: The scene.
        sensor: The sensor.
        space: Vacuum or participating media.
        limits: Limits of the complete paths.
        mis: Strategies and their MIS weights.
        hide_emitters: Whether the sensor does not see emitters directly.
        discard_direct_light: Whether emitters that the sensor sees directly are ignored.
        from_camera: Whether camera paths are traced, for strategies with t > 1.
    """

    splats = True

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        space: Space,
        limits: Limits,
        mis: BidirectionalMIS,
        hide_emitters: bool,
        discard_direct_light: bool,
        from_camera: bool,
    ) -> None:
        # Create the scattering of camera paths and of light paths
        both_ways = mis.exponent > 0
        media = {"both_ways": both_ways, "connects": True}
        scattering = space.with_phase_functions(Materials(scene, both_ways=both_ways), **media)
        adjoint = Materials(scene, importance=True)
        self.adjoint = space.with_phase_functions(adjoint, importance=True, **media)

        # Create the endpoint of camera paths
        self.lens = Lens(sensor)
        self.emission = Emission(scene, sensor)
        self.mis = mis
        self.hide_emitters = hide_emitters
        self.from_camera = from_camera
        self.shows_emitters = not (hide_emitters or discard_direct_light)
        self.light_paths = LightPaths(
            scene,
            sensor,
            self.lens,
            self.emission,
            self.adjoint,
            mis,
            limits.max_depth,
            hide_emitters,
            discard_direct_light,
        )
        super().__init__(
            scene=scene,
            space=space,
            endpoint=self.light_paths,
            scattering=scattering,
            limits=limits,
        )

        # Choose which paths the strategies need. Without a single strategy, (2, 2) needs all paths
        only = mis.only or (2, 2)
        self.splats = mis.camera_connections and (mis.only is None or only[1] == 1)
        stores = from_camera and mis.inner and min(only) > 1
        self.stored_vertices = max(limits.max_depth - 2, 0) if stores else 0
        self.from_camera &= mis.only is None or only[1] > 1

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """Return an empty sequence, because connections to the lens also find visible emitters."""
        return ()

    @tracing_lock()
    def trace(self, sampler, ray, origin, measurement, active=True, frame=None):
        """Trace light paths, and then camera paths that connect to the vertices of light paths.

        Arguments and results are the same as for `Plan.trace`.
        """
        light = None
        weight = None
        not_finite = mi.UInt32(0)

        # Connect emitters to the lens: strategy (1, 1)
        if self.splats:
            measurement, not_finite = self._connect_emitters(
                sampler, ray, origin, measurement, active
            )

        # Trace light paths: strategies (s, 1)
        if self.splats or self.stored_vertices:
            emitted = self.emission.sample(sampler, ray)
            measurement, path = self._trace_light(sampler, emitted, measurement, active)
            not_finite += path.not_finite
            weight = emitted.weight
            light = path.history if self.stored_vertices else None

        # Trace camera paths: strategies (s, t) with t > 1
        if self.from_camera:
            endpoint = self.light_paths.for_paths(ray.d, light, weight)
            camera_plan = Plan(
                scene=self.scene,
                space=self.space,
                endpoint=endpoint,
                scattering=self.scattering,
                limits=self.limits,
            )
            camera_plan = camera_plan.with_motion(self.motion)
            measurement, path = camera_plan.trace(sampler, ray, origin, measurement, active, frame)
        else:
            path = Path.start(ray, origin, False)
        path.not_finite += not_finite
        return measurement, path

    def _trace_light(
        self, sampler: mi.Sampler, emitted: Emitted, measurement: M, active: mi.Bool | bool
    ) -> tuple[M, Path]:
        """Trace light paths, and connect their vertices to the lens.

        Args:
            sampler: The sampler.
            emitted: Samples of the emission, one per path.
            measurement: Measurement that light is added to.
            active: Active lanes.

        Returns:
            The measurement, and the final state of the light paths.
        """
        # Create the endpoint of light paths, and the storage of their vertices
        history = LightPathHistory(
            scene=self.scene,
            emission=self.emission,
            emitted=emitted,
            scattering=self.adjoint,
            mis=self.mis,
            capacity=self.stored_vertices,
            in_media=self.space.scatters,
            moves=self.motion is not None,
        )
        camera = LensEndpoint(
            scene=self.scene,
            lens=self.lens,
            emitted=emitted,
            mis=self.mis,
            history=history,
            connects=self.splats,
            camera_unwarp=self.limits.camera_unwarp,
            hide_emitters=self.hide_emitters,
        )
        limits = Limits(self.limits.max_depth, self.limits.rr_depth)

        # Start the paths at the emitters
        active = mi.Bool(active) & emitted.active
        medium = self.space.medium_at(emitted.ray)
        velocity = None
        if self.motion is not None:
            velocity = self.motion.at_lamp(emitted.emitter, emitted.origin)
        path = Path.start(
            ray=emitted.ray,
            origin=emitted.origin,
            active=active,
            history=history.start(),
            medium=medium,
            velocity=velocity,
        )

        # Trace the paths
        parts = Parts(
            space=self.space, endpoint=camera, scattering=self.adjoint, limits=limits
        ).with_motion(self.motion)
        return walk(sampler, path, parts, measurement)

    def _connect_emitters(self, sampler, ray, origin, measurement, active):
        """Connect points on emitters to the lens: strategy (1, 1).

        Emitters without extent are not visible directly.

        Args:
            sampler: The sampler.
            ray: Camera rays, for their time and wavelengths.
            origin: Points on the lens [m].
            measurement: Measurement that light is added to.
            active: Active lanes.

        Returns:
            The measurement, and the number of contributions that are not finite.
        """
        if not self.shows_emitters:
            return measurement, mi.UInt32(0)

        # Sample a point on an emitter from the lens. MIS weights need the same density as
        # next-event estimation
        at = dr.zeros(mi.Interaction3f, dr.width(ray))
        at.p = mi.Point3f(origin)
        at.time = ray.time
        at.wavelengths = ray.wavelengths
        u = sampler.next_2d()
        if self.mis.exponent:
            ds, radiance = self.emission.samples.sample_direction(at, u)
        else:
            ds, radiance = self.emission.sample_direction(at, u)

        # Find the position on the film, and the path length
        distant = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
        lens_sample = self.lens.arrive(ds.p, at.p, distant)
        active = mi.Bool(active) & lens_sample.seen & (ds.pdf > 0) & ~ds.delta
        length = dr.select(distant, self.emission.sphere.length(at.p, ds.d), lens_sample.distance)

        # Compute the transmittance
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
        si.p = ds.p
        si.n = ds.n
        si.time = ray.time
        si.wavelengths = ray.wavelengths
        transmittance = transmittance_between(
            self.space, si, lens_sample.near, sampler, active, lens_sample.distance
        )

        # Compute the MIS weight
        ratio = lens_sample.density / ds.pdf
        x = self.mis.power(ratio) if self.mis.exponent else mi.Float(0)
        mis_weight = self.mis.weight(x, 1, 1)
        weight = lens_sample.density * mis_weight * transmittance

        # Compute the rate of change of the path length
        rate = None
        if self.motion is not None:
            between = self.motion.at_lamp(ds.emitter, ds.p) - self.motion.at_sensor(at.p)
            rate = dr.dot(between, ds.d) * (0.0 if self.limits.camera_unwarp else self.space.index)

        # Add the contribution
        contribution = Contribution(
            spectrum=unpolarized(mi.unpolarized_spectrum(radiance) * weight),
            opl=mi.Float(0) if self.limits.camera_unwarp else length * self.space.index,
            active=active & (mis_weight > 0),
            position=lens_sample.position,
            rate=rate,
        )
        return measurement, accumulate(measurement, contribution)


class BothEnds(TransientPath):
    """Base class of integrators that trace paths from emitters and connect them to the camera.

    The parameters are the parameters of `TransientPath` except `emitter_sampling` and
    `light_samples`. All films of tofrender and Mitsuba's `hdrfilm` are supported. The camera must
    be a `perspective` or a `thinlens`.

    | parameter | default | meaning |
    |---|---|---|
    | `target_time` | none | path length of a time gate for a steady picture [m] |
    """

    starts_at_lights = True
    has_derivatives = False
    has_gates = True
    takes_light_samples = False

    # Whether camera paths are traced
    from_camera = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if not self.emitter_sampling:
            raise ValueError(
                "emitter_sampling = False: must be left out, because paths start at emitters"
            )
        allowed = "2 or more, because light must reach a surface before the camera"
        checks.require("max_depth", self.max_depth, self.max_depth not in (0, 1), allowed)
        target = props.get("target_time", None)
        self.target_time = None if target is None else checks.meters("target_time", target)

    def mis_strategies(self) -> BidirectionalMIS:
        """Return the strategies and their MIS weights."""
        raise TypeError(f"{type(self).__name__} must define mis_strategies")

    def gate(self, target_time: mi.Float | float | None) -> Gate:
        """Return a time gate with the shape of the pulse.

        Args:
            target_time: Path length of the gate [m].

        Raises:
            ValueError: The pulse or the path length is missing.
        """
        if target_time is not None and self.pulse is None:
            raise ValueError("pulse_width_opl is missing. Set pulse_width_opl for a time gate")
        return Gate(self.pulse, target_time)

    def exposure(self, target_time: float | None = None) -> Exposure:
        """Return the weighting of light. A steady picture shows all light, or one time gate."""
        target = self.target_time if target_time is None else target_time
        weight = None if target is None else self.gate(target)
        return replace(super().exposure(), supported_films=(BINS, PHASORS, PICTURE), weight=weight)

    def plan(self, scene, sensor=None, weight=None) -> BidirectionalPlan:
        """Return the plan for light paths and camera paths."""
        if sensor is None:
            raise TypeError(
                f"{type(self).__name__} does not support sample(), because its paths start at "
                "emitters. Use mi.render or tofrender.render"
            )
        return BidirectionalPlan(
            scene=scene,
            sensor=sensor,
            space=self.space(scene, sensor),
            limits=self.limits(),
            mis=self.mis_strategies(),
            hide_emitters=self.hide_emitters,
            discard_direct_light=self.discard_direct_light,
            from_camera=self.from_camera,
        )
