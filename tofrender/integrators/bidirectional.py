"""Bidirectional path tracing: the plan, and the base of its integrators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..bidirectional.camera import Camera, LightPathHistory
from ..bidirectional.emission import Emission, Emitted
from ..bidirectional.lens import Lens
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
from ..signals.polarisation import unpolarised
from .plan import M, Plan
from .time_gated import Gate
from .transient_path import TransientPath


class BidirectionalPlan(Plan):
    """Traces camera rays if `from_camera` (t > 1), and as many light paths."""

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
        both_ways = mis.exponent > 0
        media = {"both_ways": both_ways, "connects": True}
        scattering = space.with_phase_functions(Materials(scene, both_ways=both_ways), **media)
        adjoint = Materials(scene, importance=True)
        self.adjoint = space.with_phase_functions(adjoint, importance=True, **media)
        self.lens, self.emission, self.mis = Lens(sensor), Emission(scene, sensor), mis
        self.hide_emitters, self.from_camera = hide_emitters, from_camera
        self.shows_emitters = not (hide_emitters or discard_direct_light)
        self.light_paths = LightPaths(
            *(scene, sensor, self.lens, self.emission, self.adjoint, mis),
            *(limits.max_depth, hide_emitters, discard_direct_light),
        )
        super().__init__(scene, space, self.light_paths, scattering, limits)
        only = mis.only or (2, 2)  # Stands for all
        self.splats = mis.camera_connections and (mis.only is None or only[1] == 1)
        stores = from_camera and mis.inner and min(only) > 1
        self.stored_vertices = max(limits.max_depth - 2, 0) if stores else 0
        self.from_camera &= mis.only is None or only[1] > 1

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """Return none: connections of the lens find their light, too."""
        return ()

    @tracing_lock()
    def trace(self, sampler, ray, origin, measurement, active=True, frame=None):
        """Trace light paths, and then camera paths, which connect to their vertices."""
        light, weight, not_finite = None, None, mi.UInt32(0)

        # Strategy (1, 1), and light paths: strategies (s, 1)
        if self.splats:
            measurement, not_finite = self._connect_emitters(
                sampler, ray, origin, measurement, active
            )
        if self.splats or self.stored_vertices:
            emitted = self.emission.sample(sampler, ray)
            measurement, path = self._trace_light(sampler, emitted, measurement, active)
            not_finite += path.not_finite
            weight = emitted.weight
            light = path.history if self.stored_vertices else None

        # Camera paths: strategies (s, t) with t > 1
        if self.from_camera:
            endpoint = self.light_paths.for_paths(ray.d, light, weight)
            camera_plan = Plan(self.scene, self.space, endpoint, self.scattering, self.limits)
            camera_plan = camera_plan.with_motion(self.motion)
            measurement, path = camera_plan.trace(sampler, ray, origin, measurement, active, frame)
        else:
            path = Path.start(ray, origin, False)
        path.not_finite += not_finite
        return measurement, path

    def _trace_light(
        self, sampler: mi.Sampler, emitted: Emitted, measurement: M, active: mi.Bool | bool
    ) -> tuple[M, Path]:
        """Trace light paths, and connect their vertices to the lens."""
        history = LightPathHistory(
            *(self.scene, self.emission, emitted, self.adjoint, self.mis),
            *(self.stored_vertices, self.space.scatters, self.motion is not None),
        )
        camera = Camera(
            *(self.scene, self.lens, emitted, self.mis, history, self.splats),
            *(self.limits.camera_unwarp, self.hide_emitters),
        )
        limits = Limits(self.limits.max_depth, self.limits.rr_depth)
        active, medium = mi.Bool(active) & emitted.active, self.space.medium_at(emitted.ray)
        velocity = None
        if self.motion is not None:
            velocity = self.motion.at_lamp(emitted.emitter, emitted.origin)
        path = Path.start(
            *(emitted.ray, emitted.origin, active, history.start()),
            medium=medium,
            velocity=velocity,
        )
        parts = Parts(self.space, camera, self.adjoint, limits).with_motion(self.motion)
        return walk(sampler, path, parts, measurement)

    def _connect_emitters(self, sampler, ray, origin, measurement, active):
        """Connect the lens to emitters of some extent: the strategy (1, 1)."""
        if not self.shows_emitters:
            return measurement, mi.UInt32(0)
        at = dr.zeros(mi.Interaction3f, dr.width(ray))
        at.p, at.time, at.wavelengths = mi.Point3f(origin), ray.time, ray.wavelengths
        u = sampler.next_2d()
        if self.mis.exponent:  # The density of hits is that of next-event estimation
            ds, radiance = self.emission.samples.sample_direction(at, u)
        else:
            ds, radiance = self.emission.sample_direction(at, u)
        distant = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
        lens_sample = self.lens.arrive(ds.p, at.p, distant)
        active = mi.Bool(active) & lens_sample.seen & (ds.pdf > 0) & ~ds.delta
        length = dr.select(distant, self.emission.sphere.length(at.p, ds.d), lens_sample.distance)
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
        si.p, si.n, si.time, si.wavelengths = ds.p, ds.n, ray.time, ray.wavelengths
        to_lens = lens_sample.near, sampler, active, lens_sample.distance
        transmittance = transmittance_between(self.space, si, *to_lens)
        ratio = lens_sample.density / ds.pdf
        x = self.mis.power(ratio) if self.mis.exponent else mi.Float(0)
        mis_weight = self.mis.weight(x, 1, 1)
        weight = lens_sample.density * mis_weight * transmittance
        rate = None
        if self.motion is not None:
            between = self.motion.at_lamp(ds.emitter, ds.p) - self.motion.at_sensor(at.p)
            rate = dr.dot(between, ds.d) * (0.0 if self.limits.camera_unwarp else self.space.index)
        contribution = Contribution(
            spectrum=unpolarised(mi.unpolarized_spectrum(radiance) * weight),
            opl=mi.Float(0) if self.limits.camera_unwarp else length * self.space.index,
            active=active & (mis_weight > 0),
            position=lens_sample.position,
            rate=rate,
        )
        return measurement, accumulate(measurement, contribution)


class BothEnds(TransientPath):
    """Base of the integrators whose light finds the camera.

    They take the parameters of `TransientPath` but `emitter_sampling` and `light_samples`, fill
    every film of this package and Mitsuba's `hdrfilm`, and need a `perspective` or `thinlens`
    camera.

    | parameter | default | meaning |
    |---|---|---|
    | `target_time` | none | path length of a gate [m]: a picture then shows what it sees |
    """

    starts_at_lights = True
    has_derivatives = takes_light_samples = False
    from_camera = True  # There are paths from the camera

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if not self.emitter_sampling:
            raise ValueError("emitter_sampling = False: must be left out; light starts at emitters")
        allowed = "2 or more, light meets a surface first"
        checks.require("max_depth", self.max_depth, self.max_depth not in (0, 1), allowed)
        target = props.get("target_time", None)
        self.target_time = None if target is None else checks.metres("target_time", target)

    def mis_strategies(self) -> BidirectionalMIS:
        """Return which strategies count, and their weights."""
        raise TypeError(f"{type(self).__name__}: must define mis_strategies")

    def gate(self, target_time: mi.Float | float | None) -> Gate:
        """Return the gate of the light's pulse at a path length [m]; both must be given."""
        if target_time is not None and self.pulse is None:
            raise ValueError("pulse_width_opl: must be given, a gate sees a pulse")
        return Gate(self.pulse, target_time)

    def exposure(self, target_time: float | None = None) -> Exposure:
        """Return how light counts: on a picture all of it, or that of one gate."""
        target = self.target_time if target_time is None else target_time
        weight = None if target is None else self.gate(target)
        return replace(super().exposure(), supported_films=(BINS, PHASORS, PICTURE), weight=weight)

    def plan(self, scene, sensor=None, weight=None) -> BidirectionalPlan:
        """Return the plan for paths from both ends."""
        if sensor is None:
            raise TypeError(
                f"{type(self).__name__}: has no answer for rays alone, light finds the camera; "
                "must render, by mi.render or tofrender.render"
            )
        parts = self.space(scene, sensor), self.limits(), self.mis_strategies()
        visible = self.hide_emitters, self.discard_direct_light
        return BidirectionalPlan(scene, sensor, *parts, *visible, self.from_camera)
