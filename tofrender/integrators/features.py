"""Features of the first surfaces that the pixels of a camera see, for the denoiser."""

from __future__ import annotations

from functools import reduce
from operator import or_

import drjit as dr
import mitsuba as mi
import numpy as np

from ..denoising.filtering import FEATURES, KINDS
from ..paths.camera import sample_camera, sampled_size
from ..paths.surfaces import first_surface
from ..runtime import plugins

RAYS = 8  # Number of camera rays per pixel

SEED = 0x5EED
SPECULAR = ("DeltaReflection", "DeltaTransmission")


def render_features(scene: mi.Scene, sensor: mi.Sensor, film: mi.Film) -> np.ndarray:
    """Compute features of the first surfaces that camera rays hit, averaged over each pixel.

    The rays sample the lens and the shutter like the rays of a render. They use other random
    numbers, so that filters from these features do not depend on the noise of the render. Rays pass
    index-matched boundaries of media.

    Args:
        scene: The scene.
        sensor: The sensor.
        film: The film, which defines size, crop and reconstruction filter.

    Returns:
        Float32 array of shape (height, width, 11). The channels are ordered as in `FEATURES`:
        position [m], normal, albedo of diffuse reflection (1 for other surfaces), distance [m], and
        kind. The kind of a pixel is the largest number of `KINDS` among its rays.
    """
    # Sample the camera rays
    width, height = (int(n) for n in film.crop_size())
    columns, rows = sampled_size(film)
    sampler = mi.load_dict({"type": plugins.qualified_name("padded_sobol"), "sample_count": RAYS})
    sampler.set_samples_per_wavefront(RAYS)
    lanes = columns * rows * RAYS
    sampler.seed(SEED, lanes)
    pixel = dr.arange(mi.UInt32, lanes) // RAYS
    camera = sample_camera(sensor, film, sampler, pixel, scene=scene)

    # Find the first surfaces, and their kinds
    si = first_surface(scene, mi.Ray3f(camera.ray))
    bsdf = si.bsdf()
    hit = si.is_valid()
    emitter = hit & si.shape.is_emitter()
    kind = dr.select(emitter, KINDS["emitter"], mi.Float(KINDS["scattering"]))
    kind[hit & ~emitter & _has(si, *SPECULAR)] = KINDS["specular"]

    # Compute the albedo, the position, the normal and the distance
    diffuse = hit & ~emitter & _has(si, "DiffuseReflection")
    albedo = mi.unpolarized_spectrum(bsdf.eval_diffuse_reflectance(si, diffuse))
    albedo = dr.select(diffuse, mi.Color3f(albedo if mi.is_rgb else dr.mean(albedo)), 1.0)
    position = dr.select(hit, mi.Vector3f(si.p), 0.0)
    normal = dr.select(hit, mi.Vector3f(si.sh_frame.n), 0.0)
    distance = dr.select(hit, dr.norm(si.p - camera.origin), 0.0)

    # Average over the rays of each pixel, except the kind. Remove the border of the sampled area
    channels = [*position, *normal, *albedo, distance, kind]
    dr.eval(channels)
    rays = np.stack([np.array(channel) for channel in channels], axis=-1)
    rays = rays.reshape(rows, columns, RAYS, len(channels))
    features = np.concatenate([rays[..., :-1].mean(axis=2), rays[..., -1:].max(axis=2)], axis=-1)
    border = (columns - width) // 2
    return features[border : border + height, border : border + width].astype(np.float32)


def by_name(features: np.ndarray) -> dict[str, np.ndarray]:
    """Return the features by name, from the channels of `render_features`."""
    ends = np.cumsum(list(FEATURES.values()))
    parts = np.split(features, ends[:-1], axis=-1)
    return {
        name: part[..., 0] if part.shape[-1] == 1 else part
        for name, part in zip(FEATURES, parts, strict=True)
    }


def _has(si: mi.SurfaceInteraction3f, *flags: str) -> mi.Bool:
    """Return whether the BSDF at an interaction has at least one of several flags."""
    bsdf_flags = si.bsdf().flags()
    return reduce(or_, (mi.has_flag(bsdf_flags, getattr(mi.BSDFFlags, flag)) for flag in flags))
