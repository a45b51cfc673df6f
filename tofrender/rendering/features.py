"""First-hit features of a camera's pixels: what a denoiser may look at besides the light."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..paths.camera import sample_camera, sampled_size
from ..runtime import plugins

FEATURE_RAYS = 8
"""Camera rays per pixel."""


def render_features(
    scene: mi.Scene, sensor: mi.Sensor, film: mi.Film, seed: int = 0
) -> dict[str, np.ndarray]:
    """Average position, normal, albedo and distance of the first surface over each pixel.

    Rays are those of a render, lens and shutter included, but the pixel's filter is a box. They
    have random numbers of their own: filters made from features are independent of the light.

    Returns:
        Arrays float32: `position` [m] and `normal` (height, width, 3), `albedo` (height, width, 3)
        in [0, 1] of diffuse surfaces and 1 of others, `distance` (height, width) [m], and `kind`
        (height, width) uint8: 0 where all rays hit surfaces that scatter, 1 where one hits an
        emitter, a mirror, clear glass or nothing.
    """
    width, height = (int(n) for n in film.crop_size())
    own = sampled_size(film)
    sampler = mi.load_dict(
        {"type": plugins.qualified_name("padded_sobol"), "sample_count": FEATURE_RAYS}
    )
    sampler.set_samples_per_wavefront(FEATURE_RAYS)
    lanes = own[0] * own[1] * FEATURE_RAYS
    sampler.seed(seed, lanes)
    pixel = dr.arange(mi.UInt32, lanes) // FEATURE_RAYS
    camera = sample_camera(sensor, film, sampler, pixel)
    si = _first_surface(scene, mi.Ray3f(camera.ray))
    bsdf, hit = si.bsdf(), si.is_valid()
    flags = bsdf.flags()
    odd = hit & (si.shape.is_emitter() | _is_specular(flags))
    plain = hit & ~odd
    albedo = mi.Color3f(1.0)
    diffuse = plain & mi.has_flag(flags, mi.BSDFFlags.DiffuseReflection)
    albedo[diffuse] = mi.unpolarized_spectrum(bsdf.eval_diffuse_reflectance(si, diffuse))
    distance = dr.select(hit, dr.norm(si.p - camera.origin), 0.0)
    columns = [*(si.p & hit), *(si.sh_frame.n & hit), *albedo, distance, odd, hit & si.shape.is_emitter()]
    values = [mi.Float(c) if not isinstance(c, mi.Bool) else dr.select(c, mi.Float(1), 0) for c in columns]
    dr.eval(values)
    table = np.stack([np.array(v) for v in values], -1)
    border = (own[0] - width) // 2
    mean = table.reshape(own[1], own[0], FEATURE_RAYS, -1).mean(2)
    mean = mean[border : border + height, border : border + width]
    return {
        "position": mean[..., 0:3],
        "normal": mean[..., 3:6],
        "albedo": mean[..., 6:9],
        "distance": mean[..., 9],
        "kind": (mean[..., 10] > 0).astype(np.uint8),
        "emitter": mean[..., 11] > 0,
    }


@dr.syntax
def _first_surface(scene: mi.Scene, ray: mi.Ray3f) -> mi.SurfaceInteraction3f:
    """Intersect rays with the first surface that is no mere boundary of a medium."""
    si = scene.ray_intersect(ray)
    passing = _is_boundary(si)
    while passing:
        ray[passing] = si.spawn_ray(ray.d)
        si[passing] = scene.ray_intersect(ray, passing)
        passing &= _is_boundary(si)
    return si


def _is_boundary(si: mi.SurfaceInteraction3f) -> mi.Bool:
    flags = si.bsdf().flags()
    smooth = mi.has_flag(flags, mi.BSDFFlags.Smooth)
    return si.is_valid() & mi.has_flag(flags, mi.BSDFFlags.Null) & ~smooth & ~_is_specular(flags)


def _is_specular(flags: mi.UInt32) -> mi.Bool:
    reflection = mi.has_flag(flags, mi.BSDFFlags.DeltaReflection)
    return reflection | mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission)
