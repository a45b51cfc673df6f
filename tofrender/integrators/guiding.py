"""Guiding of camera paths towards caustics, in scenes with mirrors or clear glass."""

from __future__ import annotations

from copy import copy
from typing import TypeVar

import mitsuba as mi

from ..bidirectional.emission import allowed_kinds
from ..bidirectional.photons import trace_photons
from ..paths.endpoints import SceneLights
from ..paths.guiding import DirectionTable, GuidedMaterials
from ..paths.scattering import Materials
from ..paths.surfaces import has_lobes
from .plan import Plan

T = TypeVar("T")
PHOTONS = 1 << 16
OTHER_LIGHT = 0.3  # Other irradiance over the emitters' power by area of the scene's box


def guided(tracer: T, sensor: mi.Sensor) -> T:
    """Return a plan that samples the directions of caustics, or the tracer where there are none.

    A pilot traces photons, the same for all seeds: the picture's expectation does not depend on
    them. Tracers other than a `Plan` with `guiding` are returned unchanged, and so are those of
    media, and of lights other than a scene's emitters.
    """
    if not isinstance(tracer, Plan) or not (tracer.guiding and _has_caustics(tracer)):
        return tracer
    scene = tracer.scene
    photons, box = trace_photons(scene, sensor, PHOTONS), scene.bbox()
    irradiance = OTHER_LIGHT * photons.emitted / float(box.surface_area())
    if not len(photons.power):
        return tracer
    table = DirectionTable.of_photons(
        box, photons.p, photons.n, photons.d, photons.power, irradiance
    )
    if not len(table.α):
        return tracer
    plan = copy(tracer)
    plan.scattering = GuidedMaterials(tracer.scattering, table)
    return plan


def _has_caustics(plan: Plan) -> bool:
    """Whether emitters' light may reach a surface by delta lobes, in a plan that can be guided."""
    if type(plan.scattering) is not Materials or not isinstance(plan.endpoint, SceneLights):
        return False
    lobes = mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission
    kinds = {emitter.class_name() for emitter in plan.scene.emitters()}
    return has_lobes(plan.scene, *lobes) and kinds <= allowed_kinds().keys()
