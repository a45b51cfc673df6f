"""Techniques for light that mirrors and clear glass reflect or refract.

`Caustics.of` chooses a technique for each kind of paths with a delta lobe before the emitter (see
`paths.path_kinds`), and excludes these kinds from the main paths. If no technique supports a kind,
the main paths find it when a BSDF sample hits an emitter.

| kind | technique | fallback |
|---|---|---|
| `CAUSTIC` | aimed photons, `bidirectional.caustic_photons` | caustic rays, then main paths |
| `CAUSTIC_IN_MIRROR` | caustic rays, `paths.caustic_rays` | main paths |
| `CHAIN` | rays in pixels that may see delta lobes, `extra_rays` | main paths |
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mitsuba as mi

from ..bidirectional.emission import allowed_kinds
from ..bidirectional.photons import trace_photons
from ..paths.camera import Tile
from ..paths.caustic_rays import CausticRays
from ..paths.endpoints import EmitterHits, SceneLights
from ..paths.guiding import DirectionTable, GuidedMaterials
from ..paths.path_kinds import Kind
from ..paths.scattering import Materials
from ..paths.sensor_window import KINDS
from ..paths.space import Vacuum
from ..paths.surfaces import has_lobes
from ..runtime.editions import LeftOut
from .pilots import Pilots
from .plan import Plan
from .user_defined import Tracer

if TYPE_CHECKING:
    from ..bidirectional.caustic_photons import CausticPhotons

# Number of photons of the pilot, which guides caustic rays
PILOT = 1 << 16

# Irradiance without caustics, relative to the emitted power divided by the area of the scene's box
OTHER_LIGHT = 0.3

# Number of segments of the shortest caustic path: a smooth lobe, then a delta lobe
SHORTEST = 3


@dataclass
class Caustics:
    """Techniques of a render for caustics."""

    # The main paths, with caustic rays if caustic rays are used
    tracer: Tracer

    # Aimed photons, None if photons are not used
    photons: CausticPhotons | None = None

    @classmethod
    def of(cls, tracer: Tracer, sensor: mi.Sensor, tile: Tile | None = None) -> Caustics:
        """Choose the techniques for a film or a tile.

        Pilots trace photons with the same random numbers for all seeds of the render, and their
        results are kept for later renders (see `pilots`). The expected value of the picture does
        not depend on the pilots.

        Args:
            tracer: Tracer of the main paths.
            sensor: The sensor.
            tile: Position of the film in a larger film, None for a whole film.
        """
        if not isinstance(tracer, Plan) or not _has_caustics(tracer):
            return cls(tracer)
        pilots = Pilots(tracer.scene, sensor)
        photons = _photons(tracer, sensor, tile, pilots)
        plan = tracer if photons is None else tracer.without(Kind.CAUSTIC)
        return cls(_with_rays(plan, sensor, pilots), photons)


def _has_caustics(plan: Plan) -> bool:
    """Return whether caustics exist in the scene and are supported by the techniques."""
    # The techniques support ordinary materials and emitters, in scenes without media and motion
    if type(plan.scattering) is not Materials or not isinstance(plan.endpoint, SceneLights):
        return False
    if type(plan.space) is not Vacuum or plan.motion is not None:
        return False

    # Are the paths long enough?
    if plan.limits.bounded and plan.limits.max_depth < SHORTEST:
        return False

    # Does the scene contain delta lobes, and only emitters of known kinds that can be hit?
    lobes = (mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission)
    emitters = plan.scene.emitters()
    known = {emitter.class_name() for emitter in emitters} <= allowed_kinds().keys()
    can_be_hit = any(not mi.has_flag(each.flags(), mi.EmitterFlags.Delta) for each in emitters)
    return has_lobes(plan.scene, *lobes) and known and can_be_hit


def _photons(
    plan: Plan, sensor: mi.Sensor, tile: Tile | None, pilots: Pilots
) -> CausticPhotons | None:
    """Return photons that are aimed at mirrors and clear glass, None if they are not supported.

    Photons reach all pixels of a film. Tiles are not supported, because each tile would trace the
    photons of all tiles. Environments are not supported, because paths from the camera find them
    more easily.
    """
    supported = sensor.class_name() in KINDS and plan.scene.environment() is None
    if not plan.techniques.caustic_photons or tile is not None or not supported or mi.is_polarized:
        return None

    # Some editions of the package do not contain the module. Then caustic rays find caustics
    try:
        from ..bidirectional.caustic_photons import CausticPhotons
    except LeftOut:
        return None
    photons = CausticPhotons(
        scene=plan.scene,
        sensor=sensor,
        space=plan.space,
        limits=plan.limits,
        hide_emitters=plan.endpoint.hide_emitters,
    )

    # Aim the photons. Photons are not used if no light of the pilot arrives
    limits = plan.limits
    light = pilots.result(
        photons.trace_pilot,
        "caustic photons",
        plan.space.index,
        limits.max_depth,
        limits.min_depth,
        plan.endpoint.hide_emitters,
    )
    return photons if photons.aim(light) else None


def _with_rays(plan: Plan, sensor: mi.Sensor, pilots: Pilots) -> Plan:
    """Return the plan with caustic rays, for the kinds of caustics that photons do not find."""
    if not plan.techniques.caustic_rays:
        return plan

    # Caustic rays are not used if no photon of the pilot arrives through a delta lobe
    scene = plan.scene
    table = pilots.result(lambda: _directions(scene, sensor), "caustic rays")
    if table is None:
        return plan

    # Guide rays from smooth lobes to emitters
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


def _directions(scene: mi.Scene, sensor: mi.Sensor) -> DirectionTable | None:
    """Trace a pilot of caustic rays, and return directions of photons. None without photons."""
    pilot = trace_photons(scene, sensor, PILOT)
    if not len(pilot.power):
        return None

    # Learn a table of directions from the photons
    box = scene.bbox()
    irradiance = OTHER_LIGHT * pilot.emitted / float(box.surface_area())
    return DirectionTable.of_photons(box, pilot.p, pilot.n, pilot.d, pilot.power, irradiance)
