# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""Paths from both ends: what is done with camera rays and with light, and the integrators' base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.contribution import Contribution
from ..films.exposure import BINS, PHASORS, PICTURE, Exposure, Weight
from ..paths.between import arriving
from ..paths.emission import Emission
from ..paths.endpoints.camera import Camera
from ..paths.endpoints.light_paths import LightPaths
from ..paths.lens import Lens
from ..paths.protocols import Space
from ..paths.records import Limits, Path
from ..paths.scattering import Materials
from ..paths.sharing import Sharing
from ..paths.walk import deliver, walk
from ..runtime import checks
from ..runtime.backend import tracing_lock
from ..signals.polarisation import unpolarised
from .plan import Plan
from .time_gated import NO_TARGET, Gate
from .transient_path import TransientPath


class BidirectionalPlan(Plan):
    """What is done with camera rays, and with as many paths from lights.

    Args:
        scene: The scene.
        sensor: The camera.
        space: What paths go through.
        limits: Which paths count.
        sharing: Which strategies count.
        hide_emitters: Whether the camera sees through area lights.
        discard_direct_light: Whether light does not count that comes straight from an emitter.
        from_camera: Whether there are paths from the camera, t > 1.
    """

    splats = True

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        space: Space,
        limits: Limits,
        sharing: Sharing,
        hide_emitters: bool,
        discard_direct_light: bool,
        from_camera: bool,
    ) -> None:
        both_ways = sharing.exponent > 0
        media = {"both_ways": both_ways, "connects": True}
        scattering = space.scattering(Materials(scene, both_ways=both_ways), **media)
        adjoint = Materials(scene, importance=True)
        self.adjoint = space.scattering(adjoint, importance=True, **media)
        self.lens, self.emission, self.sharing = Lens(sensor), Emission(scene, sensor), sharing
        self.scene, self.hide_emitters, self.from_camera = scene, hide_emitters, from_camera
        self.shows_emitters = not (hide_emitters or discard_direct_light)
        shown = hide_emitters, discard_direct_light
        self.connections = LightPaths(
            *(scene, sensor, self.lens, self.emission, self.adjoint, sharing),
            *(limits.max_depth, *shown),
        )
        super().__init__(space, self.connections, scattering, limits)
        only = sharing.only or (2, 2)  # Stands for all
        self.splats = sharing.camera_connections and (sharing.only is None or only[1] == 1)
        keeps = from_camera and sharing.inner and min(only) > 1
        self.kept = max(limits.max_depth - 2, 0) if keeps else 0
        self.from_camera &= sharing.only is None or only[1] > 1

    def in_view(self) -> Sequence[mi.Emitter]:
        """None: connections of the lens find their light, too."""
        return ()

    @tracing_lock()
    def trace(
        self,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        origin: Any,
        measurement: Any,
        active: Any = True,
        frame: Any = None,
    ) -> tuple[Any, Path]:
        """Follow light, and then camera rays, which connect to its vertices."""
        light, weight, not_finite = None, None, mi.UInt32(0)
        if self.splats:
            measurement, not_finite = self._see_emitters(sampler, ray, origin, measurement, active)
        if self.splats or self.kept:
            emitted = self.emission.sample(sampler, ray)
            limits = Limits(self.limits.max_depth, self.limits.rr_depth)
            lens = Camera(
                *(self.scene, self.lens, self.emission, emitted, self.adjoint, self.sharing),
                *(self.kept, self.splats, self.limits.unwarp, self.hide_emitters),
                in_media=self.space.scatters,
            )
            start, place = mi.Bool(active) & emitted.active, self.space.around(emitted.ray)
            path = Path.start(emitted.ray, emitted.origin, start, lens.memory(), place=place)
            measurement, path = walk(
                sampler, path, self.space, lens, self.adjoint, measurement, limits
            )
            not_finite += path.not_finite
            weight = emitted.weight
            light = path.memory if self.kept else None
        if self.from_camera:
            beside = Plan(
                self.space,
                self.connections.beside(ray.d, light, weight),
                self.scattering,
                self.limits,
            )
            measurement, path = beside.trace(sampler, ray, origin, measurement, active, frame)
        else:
            path = Path.start(ray, origin, False)
        path.not_finite += not_finite
        return measurement, path

    def _see_emitters(self, sampler, ray, origin, measurement, active) -> tuple[Any, mi.UInt32]:
        """Connect the lens to emitters that it sees: the strategy (1, 1).

        A light of no extent is not seen, as in a path tracer.
        """
        if not self.shows_emitters:
            return measurement, mi.UInt32(0)
        at: Any = dr.zeros(mi.Interaction3f, dr.width(ray))
        at.p, at.time, at.wavelengths = mi.Point3f(origin), ray.time, ray.wavelengths
        u = sampler.next_2d()
        if self.sharing.exponent:  # Of which hits know the density
            ds, radiance = self.emission.normals.sample_direction(at, u)
        else:
            ds, radiance = self.emission.sample_direction(at, u)
        distant = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
        arrival = self.lens.arrive(ds.p, at.p, distant)
        active = mi.Bool(active) & arrival.seen & (ds.pdf > 0) & ~ds.delta
        length = dr.select(distant, self.emission.sphere.length(at.p, ds.d), arrival.distance)
        si: Any = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
        si.p, si.n, si.time, si.wavelengths = ds.p, ds.n, ray.time, ray.wavelengths
        arrives = arriving(self.space, si, arrival.near, sampler, active, arrival.distance)
        x = self.sharing.power(arrival.density / ds.pdf) if self.sharing.exponent else mi.Float(0)
        share = self.sharing.share(x, 1, 1)
        seen = Contribution(
            spectrum=unpolarised(
                mi.unpolarized_spectrum(radiance) * (arrival.density * share * arrives)
            ),
            opl=mi.Float(0) if self.limits.unwarp else length * self.space.index,
            active=active & (share > 0),
            position=arrival.position,
        )
        return measurement, deliver(measurement, seen)


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
    has_derivatives = False
    takes_light_samples = False

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if not self.emitter_sampling:
            raise ValueError("emitter_sampling = False: must be left out; light starts at emitters")
        if self.max_depth in (0, 1):
            raise ValueError(
                f"max_depth = {self.max_depth}: must be 2 or more, light meets a surface first"
            )
        target = props.get("target_time", None)
        self.target_time = None if target is None else checks.metres("target_time", target)

    def sharing(self) -> Sharing:
        """Which strategies count."""
        raise TypeError(f"{type(self).__name__}: must define sharing, which strategies count")

    from_camera = True
    """Whether there are paths from the camera."""

    def gate(self, target_time: Any) -> Gate:
        """The gate at a path length [m], of the light's pulse.

        Raises:
            ValueError: There is no length, or no pulse; one line.
        """
        if target_time is None:
            raise ValueError(NO_TARGET)
        if self.pulse is None:
            raise ValueError("pulse_width_opl: must be given, a gate sees a pulse")
        is_array = isinstance(target_time, mi.Float)
        return Gate(self.pulse, target_time if is_array else dr.opaque(mi.Float, target_time))

    def exposure(self, target_time: Any = None) -> Exposure:
        """As for a path tracer; a picture shows all light, or one gate's."""
        target = self.target_time if target_time is None else target_time
        weight = None if target is None else self.gate(target)
        return replace(super().exposure(), onto=(BINS, PHASORS, PICTURE), weight=weight)

    def plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None = None, weight: Weight | None = None
    ) -> BidirectionalPlan:
        """Paths from both ends."""
        if sensor is None:
            raise TypeError(
                f"{type(self).__name__}: has no answer for rays alone, light finds the camera; "
                "must render, by mi.render or tofrender.render"
            )
        return BidirectionalPlan(
            *(scene, sensor, self.space(scene, sensor), self.limits(), self.sharing()),
            *(self.hide_emitters, self.discard_direct_light, self.from_camera),
        )
