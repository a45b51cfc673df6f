"""The course's path tracers for tests: scenes with each of them, and one value for each path."""

import drjit as dr
import mitsuba as mi
import numpy as np

from helpers.parts import area_light, diffuse
from helpers.support import agree, camera, film, load, scene, steady_twin
from tofrender.scenes import BUILT_IN

TRACERS = {
    "mats": {"type": "path_tracer_mats"},
    "nee": {"type": "path_tracer_nee"},
    "reuse": {"type": "path_tracer_mis", "technique": "reuse"},
    "one_sample": {"type": "path_tracer_mis", "technique": "one_sample"},
}
COURSE = {
    **{name: {} for name in ("veach", "small_box")},
    **{f"sphere_light_{size}": {} for size in ("small", "medium", "large")},
    **{f"rectangle_light_{parts}": {} for parts in ("quad", "triangles")},
    "small_box, mirror and glass": {"spheres": "mirror_glass"},
}
DARK = ("flash", "directional")  # Scenes of the gallery whose lights no ray can run into


def course(name: str, *, width: int = 12, height: int = 9, **options) -> dict:
    return BUILT_IN[name.partition(",")[0]](width=width, height=height, **COURSE[name] | options)


def traced(described: dict, tracer: str, **parameters) -> dict:
    """The scene with one of our tracers; it keeps the longest path, as `max_bounces`."""
    depth = steady_twin(described)["integrator"].get("max_depth", -1)
    bounces = {"max_bounces": max(depth - 1, -1)}
    return described | {"integrator": TRACERS[tracer] | bounces | parameters}


def steady(described: dict) -> dict:
    return described | {"sensor": steady_twin(described)["sensor"]}


def picture(described: dict, spp: int = 16, seed: int = 0) -> np.ndarray:
    return np.array(mi.render(load(described), spp=spp, seed=seed), dtype=np.float64)


def paths(loaded: mi.Scene, integrator: dict, ray, seed: int, sampler=None) -> np.ndarray:
    """Radiance along each ray by one path, (paths, channels)."""
    if sampler is None:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, dr.width(ray))
    found, _, _ = mi.load_dict(integrator).sample(
        loaded, sampler, mi.RayDifferential3f(ray), None, mi.Bool(True)
    )
    return np.array(found, dtype=np.float64).T


def through_pixels(loaded: mi.Scene, integrator: dict, spp: int, seed: int) -> np.ndarray:
    """Radiance of each path, mean of its channels, (spp, height, width)."""
    sensor = loaded.sensors()[0]
    width, height = (int(n) for n in sensor.film().size())
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, spp * width * height)
    pixel = dr.arange(mi.UInt32, spp * width * height) % (width * height)
    at = sampler.next_2d() + mi.Point2f(pixel % width, pixel // width)
    ray, _ = sensor.sample_ray(0, 0.5, at / mi.Point2f(width, height), mi.Point2f(0.5))
    found = paths(loaded, integrator, ray, seed, sampler)
    return found.mean(axis=1).reshape(spp, height, width)


def view(loaded: mi.Scene, integrator: dict, count: int, seed: int) -> np.ndarray:
    """Means of 32 batches of paths from each quarter of the picture, (32, quarters, channels)."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    quarter = dr.arange(mi.UInt32, count) % 4
    at = 0.5 * (sampler.next_2d() + mi.Point2f(quarter % 2, quarter // 2))
    ray, _ = loaded.sensors()[0].sample_ray(0, 0.5, at, mi.Point2f(0.5))
    found = paths(loaded, integrator, ray, seed, sampler)
    return found.reshape(32, -1, 4, found.shape[1]).mean(axis=1)


def all_equal(found: dict[str, np.ndarray], reference: np.ndarray) -> bool:
    """Whether each of several estimates, each (batches, ...), agrees with the same reference."""
    return agree(np.stack(list(found.values()), axis=1), np.stack([reference] * len(found), axis=1))


ALBEDO, GLOW = 0.6, 2.0


def furnace(tracer: str, bounces: int, the_film: dict | None = None, **parameters) -> dict:
    """Inside of a sphere of radius 1 that glows and reflects, seen from its center.

    Every surface point sees the radiance L of the whole sphere: L = Le + rho L, or in steps
    L_n = Le + rho L_(n-1). As cos / pi is the density of both ways to sample, no path has noise,
    but for this: Mitsuba takes some of a sphere's own points to be outside of it, and gives a wrong
    density there, which with `mis` makes 0.3 %.
    """
    ball = {"type": "sphere", "flip_normals": True, "bsdf": diffuse(ALBEDO)}
    ball["emitter"] = area_light(GLOW)
    view = camera((0, 0, 0), (0.3, 0.4, 0.5), the_film or film(4, 4), fov=40, near_clip=0.01)
    described = scene({"ball": ball}, view)
    integrator = TRACERS[tracer] | {"max_bounces": bounces, "rr_depth": 200} | parameters
    return described | {"integrator": integrator}
