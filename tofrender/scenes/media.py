# pyright: reportArgumentType=false, reportIndexIssue=false, reportOperatorIssue=false
"""Participating media of a scene: list them, and check their coefficients and boundaries."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.backend import tracing_lock
from .numbers import floats_of, is_spectral_coefficients, is_wavelength, require_all

BOUNDARY = int(mi.BSDFFlags.Null | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide)
"""BSDF flags of an index-matched boundary between media."""

PLATES = ("LinearPolarizer", "LinearRetarder", "CircularPolarizer")
"""Materials with those flags that change the polarisation of transmitted light."""

RAYLEIGH = "RayleighPhaseFunction"  # The phase function that polarises light
FLAKES = "SGGXPhaseFunction"  # The phase function that depends on the orientation of flakes

PROBES = 256
"""Rays that are traced from a sensor to compare its medium with the boundaries around it."""

STEPS = 0.8654415, 0.7489889, 0.6482062, 0.5609843, 0.4854990
"""Steps of a sequence that fills five dimensions evenly (Roberts 2018)."""

BLACK = 0.0, 0.0, -8192.0  # Coefficients of the spectrum of black, as Mitsuba has them

LEAKS = 2  # Number of these rays that may pass between two triangles of a shape
CROSSINGS = 64  # Most boundaries that such a ray passes


def media_of(scene: mi.Scene, sensor: mi.Sensor | None = None) -> list[mi.Medium]:
    """Media inside and around shapes, of emitters and of a sensor, each once."""
    shapes = [node for node in mi.traverse(scene).hierarchy if isinstance(node, mi.Shape)]
    around = [m for shape in shapes for m in (shape.interior_medium(), shape.exterior_medium())]
    around += [emitter.get_medium() for emitter in scene.emitters()]
    around += [None if sensor is None else sensor.get_medium()]
    media: list[mi.Medium] = []
    for medium in around:
        if medium is not None and medium not in media:
            media.append(medium)
    return media


@tracing_lock()
def beyond(scene: mi.Scene, sensors: mi.Medium | None = None) -> mi.Medium | None:
    """The medium infinitely far away, None for vacuum.

    Rays from outside find the exterior medium of the first boundary; without one, it is that of
    the sensor.
    """
    if not media_of(scene):
        return sensors
    sphere = scene.bbox().bounding_sphere()
    sample = (np.arange(1, PROBES + 1)[:, None] * STEPS % 1).T
    on_sphere = mi.Point2f(*map(mi.Float, sample[:2]))
    in_box = mi.Point3f(*map(mi.Float, sample[2:]))
    outwards = mi.warp.square_to_uniform_sphere(on_sphere)
    start = outwards * (2 * float(sphere.radius) + 1) + sphere.center
    box = scene.bbox()
    end = mi.Point3f(box.min) + in_box * mi.Vector3f(box.max - box.min)
    ray, active = mi.Ray3f(mi.Point3f(start), dr.normalize(end - start)), mi.Bool(True)
    for _ in range(CROSSINGS):
        si = scene.ray_intersect(ray, active)
        boundary = active & si.is_valid() & si.is_medium_transition()
        for at in np.asarray(dr.compress(boundary))[:1]:
            return dr.gather(mi.MediumPtr, si.target_medium(-ray.d), int(at))[0]
        active &= si.is_valid()
        ray = si.spawn_ray(ray.d)
        dr.eval(ray, active)
        if not dr.any(active):
            break
    return sensors


def require_sound_media(scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
    """Refuse unphysical media, and a sensor whose medium contradicts the boundaries it sees.

    A medium around the sensor must end where light comes from infinitely far away, and a blend of
    phase functions must not polarise in a polarised variant.
    """
    media = media_of(scene, sensor)
    for medium in media:
        _require_sound(medium)
        if mi.is_polarized:
            _require_depolarising(medium)
    if media and sensor is not None:
        _require_consistent(scene, sensor)


def _require_sound(medium: mi.Medium) -> None:
    for name, value in mi.traverse(medium):
        first = name.split(".")[0]
        if is_spectral_coefficients(value) or is_wavelength(name):
            continue
        called = f"{medium.id() or medium.class_name()}.{name}"
        if (first == "albedo" and "to_world" not in name) or ".weight" in name:
            require_all(called, value, lambda x: (x >= 0) & (x <= 1 + 1e-5), "from 0 to 1")
        elif first in ("sigma_t", "scale") and "to_world" not in name:
            allowed = "finite and 0 or more"
            require_all(called, value, lambda x: np.isfinite(x) & (x >= 0), allowed)


def _require_depolarising(medium: mi.Medium) -> None:
    """Refuse blended phase functions whose light would be polarised."""
    for node in mi.traverse(medium).hierarchy:
        blended = isinstance(node, mi.PhaseFunction) and node is not medium.phase_function()
        if blended and node.class_name() == RAYLEIGH:
            raise ValueError(
                f"{medium.id() or medium.class_name()}.phase = blendphase: must have no rayleigh "
                f"in the variant {mi.variant()}, how that polarises is followed where it is alone"
            )


@tracing_lock()
def _require_consistent(scene: mi.Scene, sensor: mi.Sensor) -> None:
    """Trace rays from a sensor, and compare the current medium with that of each boundary."""
    film, rest = np.arange(1, PROBES + 1)[:, None] * (0.7548777, 0.5698403) % 1, mi.Point2f(0.5)
    across = mi.Point2f(*map(mi.Float, film.T))
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, across, rest, True)
    ray = mi.Ray3f(ray)
    around, active = sensor.get_medium(), mi.Bool(True) & dr.isfinite(ray.o.x)
    medium = dr.full(mi.MediumPtr, around, PROBES) if around else dr.zeros(mi.MediumPtr, PROBES)
    distant = any(mi.has_flag(e.flags(), mi.EmitterFlags.Infinite) for e in scene.emitters())
    for _ in range(CROSSINGS):
        si = scene.ray_intersect(ray, active)
        away = active & ~si.is_valid()
        if distant and dr.count(away & (medium != None))[0] > LEAKS:  # noqa: E711
            raise ValueError(
                f"sensor.medium = {_named(around)}: must end somewhere, at a shape with a null "
                "BSDF; here no light comes through from infinitely far away"
            )
        active &= si.is_valid()
        changes = active & si.is_medium_transition()
        before = si.target_medium(-ray.d)
        wrong = np.asarray(dr.compress(changes & (before != medium)))
        for at in wrong[LEAKS:]:
            shape, expected, current = (
                dr.gather(type(x), x, int(at))[0] for x in (si.shape, before, medium)
            )
            if str(expected) != str(current):  # A description that occurs twice makes two media
                raise ValueError(
                    f"{_named(shape)}: has the medium {_named(expected)} where a ray from the "
                    f"sensor comes through {_named(current)}; must be the same, set sensor.medium "
                    "or the shape's"
                )
        through = active & (si.bsdf().flags() == BOUNDARY)
        medium = dr.select(through & changes, si.target_medium(ray.d), medium)
        ray, active = si.spawn_ray(ray.d), through
        dr.eval(ray, active, medium)
        if not dr.any(active):
            return


def has_flakes(medium: mi.Medium) -> bool:
    """Whether a medium's phase function is an `sggx`, or a blend with one."""
    return any(node.class_name() == FLAKES for node in mi.traverse(medium).hierarchy)


def scatters(medium: mi.Medium) -> bool:
    """Whether a medium does more than absorb."""
    albedos = [
        value
        for name, value in mi.traverse(medium)
        if name.startswith("albedo") and not is_wavelength(name)
    ]
    numbers = [value for value in albedos if any(True for _ in floats_of(value))]
    return not numbers or any(_is_bright(value) for value in numbers)


def _is_bright(albedo: Any) -> bool:
    """Whether an albedo is above 0 anywhere."""
    if not is_spectral_coefficients(albedo):
        return any(np.any(np.asarray(leaf) > 0) for leaf in floats_of(albedo))
    if dr.is_tensor_v(albedo) and albedo.shape[-1] == 4:
        return bool(np.any(np.array(albedo)[..., 3] > 0))
    coefficients = np.array(albedo)
    rows = coefficients.reshape(-1, 3) if dr.is_tensor_v(albedo) else coefficients.reshape(3, -1).T
    return not np.array_equal(np.unique(rows, axis=0), [BLACK])


@tracing_lock()
def scatterer_on(
    scene: mi.Scene, ray: mi.Ray3f, medium: mi.MediumPtr, sensor: mi.Sensor
) -> tuple[mi.Medium | None, mi.MediumPtr]:
    """A scattering medium on rays up to their first surface, or None; and the media at their ends.

    `medium` is the current medium at the rays' origins.
    """
    known = [each for each in media_of(scene, sensor) if scatters(each)]
    found, active = None, mi.Bool(True) & dr.isfinite(ray.o.x)
    for _ in range(CROSSINGS):
        si = scene.ray_intersect(ray, active)
        for each in known:
            if found is None and dr.any(active & (medium == mi.MediumPtr(each))):
                found = each
        active &= si.is_valid() & (si.bsdf().flags() == BOUNDARY)
        changes = active & si.is_medium_transition()
        medium = dr.select(changes, si.target_medium(ray.d), medium)
        onwards = si.spawn_ray(ray.d)
        onwards.maxt = ray.maxt - si.t
        ray = dr.select(active, onwards, ray)
        dr.eval(ray, active, medium)
        if not dr.any(active):
            break
    return found, medium


def _named(thing: Any) -> str:
    return "none" if thing is None else repr(thing.id() or thing.class_name())
