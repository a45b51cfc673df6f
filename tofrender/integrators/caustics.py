"""Techniques for light that arrives by mirrors and clear glass.

`Caustics.of` chooses a technique for each kind of paths (see `paths.kinds`) that ends with a delta
lobe, and leaves these kinds out of the main paths. Paths that no technique renders stay with the
main paths, which find them when a BSDF sample runs into an emitter.

| kind | technique | fallback |
|---|---|---|
| `CAUSTIC` | aimed photons, `bidirectional.caustic_photons` | caustic rays, then main paths |
| `CAUSTIC_IN_MIRROR` | caustic rays, `paths.caustic_rays` | main paths |
| `CHAIN` | rays in pixels that may see delta lobes, `extra_rays` | main paths |
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import mitsuba as mi

from ..bidirectional.caustic_photons import CausticPhotons
from ..bidirectional.emission import allowed_kinds
from ..bidirectional.photons import trace_photons
from ..paths.camera import Tile
from ..paths.caustic_rays import CausticRays
from ..paths.endpoints import EmitterHits, SceneLights
from ..paths.guiding import DirectionTable, GuidedMaterials
from ..paths.kinds import Kind
from ..paths.scattering import Materials
from ..paths.space import Vacuum
from ..paths.surfaces import has_lobes
from ..paths.window import KINDS
from .plan import Plan
from .user_defined import Tracer

PILOT = 1 << 16  # photons that guide caustic rays
OTHER_LIGHT = 0.3  # Other irradiance over the emitters' power by area of the scene's box
SHORTEST = 3  # segments of the shortest path with a smooth lobe first and a delta lobe last


@dataclass
class Caustics:
    """The techniques that a render uses for caustics."""

    tracer: Tracer  # the main paths, with caustic rays if these are used
    photons: CausticPhotons | None = None

    @classmethod
    def of(cls, tracer: Tracer, sensor: mi.Sensor, tile: Tile | None = None) -> Caustics:
        """Choose the techniques for a film, or for a tile of one.

        Pilots trace photons with the same random numbers for all seeds. The expectation of the
        picture does not depend on them.
        """
        if not isinstance(tracer, Plan) or not _has_caustics(tracer):
            return cls(tracer)
        photons = _photons(tracer, sensor, tile)
        plan = tracer if photons is None else tracer.without(Kind.CAUSTIC)
        return cls(_with_rays(plan, sensor), photons)


def _has_caustics(plan: Plan) -> bool:
    """Whether paths from emitters by delta lobes exist, and whether the techniques support them."""
    if type(plan.scattering) is not Materials or not isinstance(plan.endpoint, SceneLights):
        return False
    if type(plan.space) is not Vacuum or plan.motion is not None:
        return False
    if plan.limits.bounded and plan.limits.max_depth < SHORTEST:
        return False
    lobes = mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission
    emitters = plan.scene.emitters()
    known = {emitter.class_name() for emitter in emitters} <= allowed_kinds().keys()
    can_be_hit = any(not mi.has_flag(each.flags(), mi.EmitterFlags.Delta) for each in emitters)
    return has_lobes(plan.scene, *lobes) and known and can_be_hit


def _photons(plan: Plan, sensor: mi.Sensor, tile: Tile | None) -> CausticPhotons | None:
    """Return photons that are aimed at mirrors and clear glass, None if they are not supported.

    Photons land on all pixels of a film, so that each tile would trace the photons of all tiles.
    Paths from the camera find an environment more easily than photons find the camera.
    """
    supported = sensor.class_name() in KINDS and plan.scene.environment() is None
    if not plan.techniques.caustic_photons or tile is not None or not supported or mi.is_polarized:
        return None
    hides = plan.endpoint.hide_emitters
    photons = CausticPhotons(plan.scene, sensor, plan.space, plan.limits, hides)
    return photons if photons.aim() else None


def _with_rays(plan: Plan, sensor: mi.Sensor) -> Plan:
    """Return the plan with caustic rays for the kinds that photons leave to its paths."""
    if not plan.techniques.caustic_rays:
        return plan
    scene = plan.scene
    pilot = trace_photons(scene, sensor, PILOT)
    if not len(pilot.power):
        return plan
    box = scene.bbox()
    irradiance = OTHER_LIGHT * pilot.emitted / float(box.surface_area())
    table = DirectionTable.of_photons(box, pilot.p, pilot.n, pilot.d, pilot.power, irradiance)
    kinds = frozenset({Kind.CAUSTIC, Kind.CAUSTIC_IN_MIRROR}) - plan.limits.left_out
    smooth = Materials(scene, lobes=mi.BSDFFlags.Smooth)
    emitters = EmitterHits(scene, sensor, plan.endpoint.hide_emitters)
    guided = copy(plan.without(*kinds))
    guided.caustic_rays = CausticRays(
        scene=scene,
        space=plan.space,
        emitters=emitters,
        guided=GuidedMaterials(smooth, table),
        limits=plan.limits,
        kinds=kinds,
    )
    return guided
