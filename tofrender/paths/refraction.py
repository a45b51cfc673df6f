"""Indices of refraction: behind rough glass, which connections pass, and around a sensor."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import backend, variants
from ..scenes.media import CROSSINGS, LEAKS, PROBES, STEPS
from .surfaces import bsdfs_in, has_lobes, materials, name_of, number_of, spawn_ray

HAIR = "Hair"
ROUGH = mi.BSDFFlags.GlossyTransmission
LOBES = (ROUGH, mi.BSDFFlags.DeltaTransmission)
DRAWS = 256  # BSDF samples that find the index of a material which transmits only part of its light
RAYS = 4 * PROBES  # straight rays that find the medium around a sensor


class Glass:
    """Table of relative indices of a scene's glass: of BSDFs with some lobes, by default rough.

    Mitsuba returns an index with a BSDF sample only, and a mixture of BSDFs may hide it from any
    one sample. So the parts of each BSDF are sampled once, before the render.
    """

    def __init__(
        self,
        scene: mi.Scene,
        index_of: Callable[[mi.BSDF], float | mi.Float] | None = None,
        lobes: tuple[mi.BSDFFlags, ...] = (ROUGH,),
    ) -> None:
        found = {
            int(number_of(mi.BSDFPtr(bsdf))[0]): (index_of or partial(_index, scene))(bsdf)
            for bsdf in dict.fromkeys(materials(scene))
            if any(_parts(bsdf, lobe) for lobe in lobes)
        }
        self.exists = bool(found)
        indices = [found.get(k, 1.0) for k in range(max(found, default=0) + 1)]
        tracked = any(dr.grad_enabled(index) for index in indices)
        self.table = dr.concat(list(map(mi.Float, indices))) if tracked else mi.Float(indices)
        dr.eval(self.table)

    def index_behind(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Return the index on the side that `wo` points to, over that on the side of `si.wi`."""
        number = number_of(bsdf)
        crossing = active & (si.wi.z * wo.z < 0) & (number < dr.width(self.table))
        η = dr.gather(mi.Float, self.table, number, crossing)
        return dr.select(crossing, dr.select(si.wi.z > 0, η, dr.rcp(η)), 1)


def _index(scene: mi.Scene, bsdf: mi.BSDF) -> float | mi.Float:
    """Return the index behind a rough material over that before it."""
    parts = _parts(bsdf, ROUGH)
    tracked = [mi.traverse(part)["eta"] for part in parts if "eta" in mi.traverse(part)]
    if len(parts) == 1 and dr.grad_enabled(tracked):
        return tracked[0]
    indices = _indices(bsdf, ROUGH)
    if len(indices) > 1:
        listed = ", ".join(f"{index:g}" for index in indices)
        raise ValueError(
            f"{name_of(scene, bsdf)} mixes rough glass of the indices {listed}. Use one index, so "
            "that light which passes it has an optical length"
        )
    return round(indices[0], 5)


def _parts(bsdf: mi.BSDF, lobe: mi.BSDFFlags) -> list[mi.BSDF]:
    """Return the plain BSDFs with a lobe that a BSDF is made of, without `hair`.

    Light that passes a hair is in air again.
    """
    single = [part for part in bsdfs_in(bsdf) if len(bsdfs_in(part)) == 1]
    has_lobe = [part for part in single if mi.has_flag(part.flags(), lobe)]
    return [part for part in has_lobe if part.class_name() != HAIR]


def _indices(bsdf: mi.BSDF, lobe: mi.BSDFFlags) -> list[float]:
    """Return the different indices of the parts of a BSDF."""
    found = [_index_of_part(part, lobe) for part in _parts(bsdf, lobe)]
    return sorted({round(index, 5): index for index in found}.values())


def _index_of_part(bsdf: mi.BSDF, lobe: mi.BSDFFlags) -> float:
    """Return the relative index of a plain BSDF, by samples along its normal."""
    si = dr.zeros(mi.SurfaceInteraction3f, DRAWS)
    si.wi, si.n = mi.Vector3f(0, 0, 1), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    ctx = mi.BSDFContext(mi.TransportMode.Radiance, int(lobe))
    xi = (dr.arange(mi.Float, DRAWS) + 0.5) / DRAWS
    sample, _ = bsdf.sample(ctx, si, xi, mi.Point2f(0.5))
    through = (sample.wo.z < 0) & (sample.pdf > 0)
    found = dr.max(dr.select(through, sample.eta, 0))[0]
    parameters = mi.traverse(bsdf)
    if found == 0 and "eta" in parameters:  # A texture lets no light through there
        found = parameters["eta"]
    return float(found) or 1.0


@backend.tracing_lock()
def index_around(scene: mi.Scene, sensor: mi.Sensor) -> float:
    """Return the index of refraction around a sensor, 1 in vacuum and air.

    Materials have ratios of indices only. Of all media where straight rays from the sensor end, the
    optically thinnest is air.
    """
    if not has_lobes(scene, *LOBES):
        return 1.0
    variants.require_vectorized()

    # Trace straight rays from the sensor in all directions, by a Kronecker sequence
    u = np.arange(1, RAYS + 1)[:, None] * STEPS % 1
    film, out = (mi.Point2f(*map(mi.Float, u.T[k : k + 2])) for k in (0, 2))
    ray = mi.Ray3f(sensor.sample_ray(sensor.shutter_open(), 0.5, film, mi.Point2f(0.5))[0])
    ray.d, ray.maxt = mi.warp.square_to_uniform_sphere(out), mi.Float(dr.inf)
    ends = np.array(
        _straight(scene, Glass(scene, lambda bsdf: _all_indices(bsdf)[0], LOBES), ray), dtype=float
    )

    # The thinnest medium that more than a few of them reach is air
    found, counts = np.unique(ends.round(4), return_counts=True)
    thinnest = min(found[counts > LEAKS], default=1.0)
    if thinnest >= 1:
        return 1.0
    index = 1 / ends[ends.round(4) == thinnest].mean()
    for bsdf in materials(scene):
        if len(set(_all_indices(bsdf))) > 1:
            raise ValueError(
                f"{name_of(scene, bsdf)} mixes glass of several indices, and the sensor is in "
                f"glass of index {index:g}. Use one index, so that light has an optical length"
            )
    return round(float(index), 6)


@dr.syntax
def _straight(scene: mi.Scene, glass: Glass, ray: mi.Ray3f) -> mi.Float:
    """Return the index where straight rays end, over that where they start."""
    index, crossed, active = mi.Float(1), mi.UInt32(0), dr.isfinite(ray.o.x)
    while active & (crossed < CROSSINGS):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        index *= glass.index_behind(bsdf, si, -si.wi, active)
        active &= mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission)
        ray = dr.select(active, spawn_ray(si, ray.d, mi.Bool(True)), ray)
        crossed += 1
    return index


def _all_indices(bsdf: mi.BSDF) -> list[float]:
    """Return the relative indices of a BSDF's parts, rough or smooth."""
    return [index for lobe in LOBES for index in _indices(bsdf, lobe)]
