# pyright: reportArgumentType=false, reportIndexIssue=false, reportOperatorIssue=false
"""Participating media of a scene: which there are, and what must hold of them."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.backend import tracing_lock
from .numbers import first_wrong, floats_of

BOUNDARY = int(mi.BSDFFlags.Null | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide)
"""Flags of a material that is nothing but the boundary between media of equal index."""

PLATES = ("LinearPolarizer", "LinearRetarder", "CircularPolarizer")
"""Materials with those flags that are more than that: they change the light that goes through."""

RAYLEIGH = "RayleighPhaseFunction"
"""The phase function that polarises light."""

FLAKES = "SGGXPhaseFunction"
"""The phase function that depends on more than the angle."""

PROBES = 256
"""Rays of a sensor that look what is around it."""

STEPS = 0.8654415, 0.7489889, 0.6482062, 0.5609843, 0.4854990
"""Steps of a sequence that fills five dimensions evenly (Roberts 2018)."""

LEAKS = 2
"""How many of them may slip between two triangles of a shape."""

CROSSINGS = 64
"""Boundaries that such a ray passes."""


def media_of(scene: mi.Scene, sensor: mi.Sensor | None = None) -> list[mi.Medium]:
    """The media that shapes, emitters and a sensor are in, each once.

    Example:
        >>> media_of(mi.load_dict({"type": "scene"}))
        []
    """
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

    It is what the first shape that has a medium says on its outer side; where no shape has one, it
    is the sensor's.

    Args:
        scene: The scene.
        sensors: What is around the sensor.

    Example:
        >>> beyond(mi.load_dict({"type": "scene"})) is None
        True
    """
    if not media_of(scene):
        return sensors
    sphere = scene.bbox().bounding_sphere()
    share = np.arange(1, PROBES + 1)[:, None] * STEPS % 1
    from_, across = mi.Point2f(*map(mi.Float, share.T[:2])), mi.Point3f(*map(mi.Float, share.T[2:]))
    start = mi.warp.square_to_uniform_sphere(from_) * (2 * float(sphere.radius) + 1) + sphere.center
    box = scene.bbox()
    end = mi.Point3f(box.min) + across * mi.Vector3f(box.max - box.min)
    ray, active = mi.Ray3f(mi.Point3f(start), dr.normalize(end - start)), mi.Bool(True)
    for _ in range(CROSSINGS):
        si = scene.ray_intersect(ray, active)
        tells = active & si.is_valid() & si.is_medium_transition()
        for at in np.asarray(dr.compress(tells))[:1]:
            return dr.gather(mi.MediumPtr, si.target_medium(-ray.d), int(at))[0]
        active &= si.is_valid()
        ray = si.spawn_ray(ray.d)
        dr.eval(ray, active)
        if not dr.any(active):
            break
    return sensors


def require_sound_media(scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
    """Refuse media that cannot be, and a sensor that is in another one than it says.

    Raises:
        ValueError: A coefficient is negative or not finite, an albedo above 1, a weight of a blend
            outside of 0 to 1; the sensor's medium is not what the shapes say that it sees; or it
            has no end where light comes from infinitely far away; or a blend polarises
            what it scatters, in a variant where that counts. One line.
    """
    media = media_of(scene, sensor)
    for medium in media:
        _require_sound(medium)
        if mi.is_polarized:
            _require_depolarising(medium)
    if media and sensor is not None:
        _require_place(scene, sensor)


def _require_sound(medium: mi.Medium) -> None:
    parameters: Any = mi.traverse(medium)
    for name in parameters.keys():  # noqa: SIM118, Mitsuba's parameters are no dict
        first, value = name.split(".")[0], parameters[name]
        if mi.is_spectral and isinstance(value, mi.Color3f):  # Coefficients, of either sign
            continue
        arrays = [np.asarray(leaf) for leaf in floats_of(value)]
        text = f"{medium.id() or medium.class_name()}.{name}"
        if first in ("sigma_t", "scale", "albedo") and "to_world" not in name:
            most = 1 + 1e-5 if first == "albedo" else np.inf
            what = "from 0 to 1" if first == "albedo" else "finite and 0 or more"
        elif ".weight" in name:
            most, what = 1 + 1e-5, "from 0 to 1"
        else:
            continue

        def good(x: np.ndarray, most: float = most) -> np.ndarray:
            return np.isfinite(x) & (x >= 0) & (x <= most)

        if not all(good(each).all() for each in arrays):
            raise ValueError(f"{first_wrong(text, arrays, good)}: must be {what}")


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
def _require_place(scene: mi.Scene, sensor: mi.Sensor) -> None:
    """Look from a sensor, and compare the media on the way with what each surface says."""
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
            shape, there, here = (
                dr.gather(type(x), x, int(at))[0] for x in (si.shape, before, medium)
            )
            if str(there) != str(here):  # A description that occurs twice makes two media
                raise ValueError(
                    f"{_named(shape)}: has the medium {_named(there)} where a ray from the sensor "
                    f"comes through {_named(here)}; must be the same, set sensor.medium or the "
                    "shape's"
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
    parameters: Any = mi.traverse(medium)
    names = [name for name in parameters.keys() if name.startswith("albedo")]  # noqa: SIM118
    leaves = [leaf for name in names for leaf in floats_of(parameters[name])]
    return not leaves or any(np.any(np.asarray(leaf) > 0) for leaf in leaves)


@tracing_lock()
def scatterer_on(
    scene: mi.Scene, ray: mi.Ray3f, medium: mi.MediumPtr, sensor: mi.Sensor
) -> tuple[mi.Medium | None, mi.MediumPtr]:
    """A medium that scatters light on rays that start in a medium, up to their first surface.

    The sensor's is one of those that there may be.

    Returns:
        One of them, None if there is none; and the media that the rays end in.
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
