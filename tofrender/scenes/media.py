# pyright: reportArgumentType=false, reportIndexIssue=false, reportOperatorIssue=false
"""List the participating media of a scene, and check their coefficients and boundaries."""

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
"""Materials with the flags `BOUNDARY` that change the polarization of transmitted light."""

RAYLEIGH = "RayleighPhaseFunction"  # The phase function that polarizes light
FLAKES = "SGGXPhaseFunction"  # The phase function that depends on the orientation of flakes

PROBES = 256
"""Number of rays that are traced to find or check media."""

STEPS = 0.8654415, 0.7489889, 0.6482062, 0.5609843, 0.4854990
"""Steps of a quasi-random sequence in five dimensions (Roberts 2018)."""

BLACK = 0.0, 0.0, -8192.0  # Coefficients of the spectrum of black in Mitsuba

LEAKS = 2  # Number of probe rays that may slip between two triangles of a shape
CROSSINGS = 64  # Largest number of boundaries that a ray crosses


def media_of(scene: mi.Scene, sensor: mi.Sensor | None = None) -> list[mi.Medium]:
    """Return the media of shapes, emitters and a sensor, each medium once."""
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
    """Return the medium at infinite distance from the scene, or None for vacuum.

    Rays from outside of the scene find the exterior medium of the first boundary that they hit. If
    the scene has no such boundary, this is the medium around the sensor, `sensors`.
    """
    if not media_of(scene):
        return sensors

    # Rays from a sphere around the scene to points in its bounding box
    sphere = scene.bbox().bounding_sphere()
    sample = (np.arange(1, PROBES + 1)[:, None] * STEPS % 1).T
    on_sphere = mi.Point2f(*map(mi.Float, sample[:2]))
    in_box = mi.Point3f(*map(mi.Float, sample[2:]))
    outwards = mi.warp.square_to_uniform_sphere(on_sphere)
    start = outwards * (2 * float(sphere.radius) + 1) + sphere.center
    box = scene.bbox()
    end = mi.Point3f(box.min) + in_box * mi.Vector3f(box.max - box.min)
    ray = mi.Ray3f(mi.Point3f(start), dr.normalize(end - start))
    active = mi.Bool(True)

    # Follow the rays to the first boundary between media
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
    """Raise a ValueError for unphysical media, and if the sensor's medium contradicts boundaries.

    In scenes with distant emitters, a medium around the sensor must have a boundary. In a polarized
    variant, a blend of phase functions must not contain a phase function that polarizes.
    """
    media = media_of(scene, sensor)
    for medium in media:
        _require_sound(medium)
        if mi.is_polarized:
            _require_depolarizing(medium)
    if media and sensor is not None:
        _require_consistent(scene, sensor)


def _require_sound(medium: mi.Medium) -> None:
    """Raise a ValueError for an albedo or weight outside [0, 1], or a wrong extinction."""
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


def _require_depolarizing(medium: mi.Medium) -> None:
    """Raise a ValueError if a blend of phase functions contains a polarizing phase function."""
    for node in mi.traverse(medium).hierarchy:
        blended = isinstance(node, mi.PhaseFunction) and node is not medium.phase_function()
        if blended and node.class_name() == RAYLEIGH:
            raise ValueError(
                f"{medium.id() or medium.class_name()}.phase = blendphase: rayleigh inside a blend "
                f"is not supported in the variant {mi.variant()}. Use rayleigh alone, or a variant "
                "without polarization"
            )


@tracing_lock()
def _require_consistent(scene: mi.Scene, sensor: mi.Sensor) -> None:
    """Trace rays from a sensor, and compare the current medium with the media of each boundary."""
    # Rays through evenly distributed points of the film
    film = np.arange(1, PROBES + 1)[:, None] * (0.7548777, 0.5698403) % 1
    aperture = mi.Point2f(0.5)
    position = mi.Point2f(*map(mi.Float, film.T))
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, position, aperture, True)
    ray = mi.Ray3f(ray)

    # The current medium of each ray
    around = sensor.get_medium()
    active = mi.Bool(True) & dr.isfinite(ray.o.x)
    medium = dr.full(mi.MediumPtr, around, PROBES) if around else dr.zeros(mi.MediumPtr, PROBES)
    distant = any(mi.has_flag(e.flags(), mi.EmitterFlags.Infinite) for e in scene.emitters())
    for _ in range(CROSSINGS):
        si = scene.ray_intersect(ray, active)

        # Does a ray leave the scene inside a medium, in a direction with a distant emitter?
        away = active & ~si.is_valid()
        if distant and dr.count(away & (medium != None))[0] > LEAKS:  # noqa: E711
            raise ValueError(
                f"sensor.medium = {_named(around)} is unbounded, so no light of a distant emitter "
                "reaches the sensor. Bound the medium by a shape with a null BSDF"
            )

        # Does the boundary have another medium on the side of the ray?
        active &= si.is_valid()
        changes = active & si.is_medium_transition()
        before = si.target_medium(-ray.d)
        wrong = np.asarray(dr.compress(changes & (before != medium)))
        for at in wrong[LEAKS:]:
            shape, expected, current = (
                dr.gather(type(x), x, int(at))[0] for x in (si.shape, before, medium)
            )
            # Equal descriptions of two media count as the same medium
            if str(expected) != str(current):
                raise ValueError(
                    f"{_named(shape)}: its medium is {_named(expected)} on a side that a ray from "
                    f"the sensor reaches through {_named(current)}. Set sensor.medium or the "
                    "medium of the shape to the same medium"
                )

        # Continue through boundaries that do not refract
        through = active & (si.bsdf().flags() == BOUNDARY)
        medium = dr.select(through & changes, si.target_medium(ray.d), medium)
        ray = si.spawn_ray(ray.d)
        active = through
        dr.eval(ray, active, medium)
        if not dr.any(active):
            return


def has_flakes(medium: mi.Medium) -> bool:
    """Return whether a medium's phase function is an `sggx`, or a blend that contains an `sggx`."""
    return any(node.class_name() == FLAKES for node in mi.traverse(medium).hierarchy)


def scatters(medium: mi.Medium) -> bool:
    """Return whether a medium scatters light, i.e. has an albedo above 0 somewhere."""
    albedos = [
        value
        for name, value in mi.traverse(medium)
        if name.startswith("albedo") and not is_wavelength(name)
    ]
    numbers = [value for value in albedos if any(True for _ in floats_of(value))]
    return not numbers or any(_is_bright(value) for value in numbers)


def _is_bright(albedo: Any) -> bool:
    """Return whether an albedo is above 0 anywhere."""
    if not is_spectral_coefficients(albedo):
        return any(np.any(np.asarray(leaf) > 0) for leaf in floats_of(albedo))

    # Coefficients of spectra: a volume has their scale as fourth channel
    if dr.is_tensor_v(albedo) and albedo.shape[-1] == 4:
        return bool(np.any(np.array(albedo)[..., 3] > 0))
    coefficients = np.array(albedo)
    rows = coefficients.reshape(-1, 3) if dr.is_tensor_v(albedo) else coefficients.reshape(3, -1).T
    return not np.array_equal(np.unique(rows, axis=0), [BLACK])


@tracing_lock()
def scatterer_on(
    scene: mi.Scene, ray: mi.Ray3f, medium: mi.MediumPtr, sensor: mi.Sensor
) -> tuple[mi.Medium | None, mi.MediumPtr]:
    """Find a scattering medium on rays up to their first surface.

    Args:
        scene: The scene.
        ray: The rays.
        medium: The current medium at the origins of the rays.
        sensor: A sensor, which may have a medium.

    Returns:
        A scattering medium that a ray passes through, or None; and the media at the rays' ends.
    """
    scattering = [each for each in media_of(scene, sensor) if scatters(each)]
    found = None
    active = mi.Bool(True) & dr.isfinite(ray.o.x)
    for _ in range(CROSSINGS):
        # Is a ray inside a scattering medium?
        si = scene.ray_intersect(ray, active)
        for each in scattering:
            if found is None and dr.any(active & (medium == mi.MediumPtr(each))):
                found = each

        # Cross boundaries that do not refract
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
    """Return the quoted id of an object, or its class, or "none"."""
    return "none" if thing is None else repr(thing.id() or thing.class_name())
