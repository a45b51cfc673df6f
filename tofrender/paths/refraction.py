"""Indices of refraction behind rough glass and around a sensor."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import backend, variants
from ..scenes.media import CROSSINGS, LEAKS, PROBES, STEPS
from .surfaces import bsdfs_in, has_lobes, materials, name_of, number_of, spawn_ray

# Class name of the BSDF of hair
HAIR = "Hair"

# Lobes of rough glass, and of all glass
ROUGH = mi.BSDFFlags.GlossyTransmission
LOBES = (ROUGH, mi.BSDFFlags.DeltaTransmission)

# Number of BSDF samples to find an index of refraction. Some samples are reflected or absorbed
DRAWS = 256

# Number of straight rays to find the medium around a sensor
RAYS = 4 * PROBES


class Glass:
    """Table of the relative indices of refraction of the BSDFs in a scene.

    Mitsuba reports an index with a BSDF sample only. A sample of a blend may come from a part that
    is not glass. Therefore the glass parts of each BSDF are sampled once, before the render.

    Args:
        scene: The scene.
        index_of: Function that returns the index of a BSDF. The default requires that all rough
            glass in a BSDF has the same index.
        lobes: Lobes of the glass. The default is rough glass only.

    Attributes:
        exists: Whether the scene has such glass.
        table: Index of refraction on the back side over the index on the front side, by the
            registry index of the BSDF.
    """

    def __init__(
        self,
        scene: mi.Scene,
        index_of: Callable[[mi.BSDF], float | mi.Float] | None = None,
        lobes: tuple[mi.BSDFFlags, ...] = (ROUGH,),
    ) -> None:
        # Find the index of each BSDF with glass
        found = {
            int(number_of(mi.BSDFPtr(bsdf))[0]): (index_of or partial(_index, scene))(bsdf)
            for bsdf in dict.fromkeys(materials(scene))
            if any(_parts(bsdf, lobe) for lobe in lobes)
        }
        self.exists = bool(found)

        # Create the table. Indices with derivatives stay attached
        indices = [found.get(k, 1.0) for k in range(max(found, default=0) + 1)]
        tracked = any(dr.grad_enabled(index) for index in indices)
        self.table = dr.concat(list(map(mi.Float, indices))) if tracked else mi.Float(indices)
        dr.eval(self.table)

    def index_behind(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Return the index on the side of `wo`, relative to the index on the side of `si.wi`.

        The result is 1 if both directions are on the same side, and for BSDFs without glass.

        Args:
            bsdf: The BSDF of each lane.
            si: Surface interaction.
            wo: Unit vector in the local frame.
            active: Active lanes.
        """
        number = number_of(bsdf)
        crossing = active & (si.wi.z * wo.z < 0) & (number < dr.width(self.table))
        η = dr.gather(mi.Float, self.table, number, crossing)
        return dr.select(crossing, dr.select(si.wi.z > 0, η, dr.rcp(η)), 1)


def _index(scene: mi.Scene, bsdf: mi.BSDF) -> float | mi.Float:
    """Return the relative index of rough glass: the back side over the front side.

    Raises:
        ValueError: The BSDF contains rough glass of different indices.
    """
    # An index with derivatives is the parameter itself
    parts = _parts(bsdf, ROUGH)
    tracked = [mi.traverse(part)["eta"] for part in parts if "eta" in mi.traverse(part)]
    if len(parts) == 1 and dr.grad_enabled(tracked):
        return tracked[0]

    # Otherwise, find the index by BSDF samples
    indices = _indices(bsdf, ROUGH)
    if len(indices) > 1:
        listed = ", ".join(f"{index:g}" for index in indices)
        raise ValueError(
            f"{name_of(scene, bsdf)} mixes rough glass of the indices {listed}, so that the path "
            "length behind it is ambiguous. Use the same index for all parts"
        )
    return round(indices[0], 5)


def _parts(bsdf: mi.BSDF, lobe: mi.BSDFFlags) -> list[mi.BSDF]:
    """Return the parts of a BSDF that have a lobe, as plain BSDFs.

    The BSDF `hair` is left out: behind a hair, light is in air again.
    """
    single = [part for part in bsdfs_in(bsdf) if len(bsdfs_in(part)) == 1]
    has_lobe = [part for part in single if mi.has_flag(part.flags(), lobe)]
    return [part for part in has_lobe if part.class_name() != HAIR]


def _indices(bsdf: mi.BSDF, lobe: mi.BSDFFlags) -> list[float]:
    """Return the distinct indices of a BSDF's parts, in ascending order."""
    found = [_index_of_part(part, lobe) for part in _parts(bsdf, lobe)]
    return sorted({round(index, 5): index for index in found}.values())


def _index_of_part(bsdf: mi.BSDF, lobe: mi.BSDFFlags) -> float:
    """Return the relative index of a BSDF without nested BSDFs, 1 if all of its samples fail."""
    # Create surface interactions with perpendicular incidence
    si = dr.zeros(mi.SurfaceInteraction3f, DRAWS)
    si.wi = mi.Vector3f(0, 0, 1)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)

    # Sample the BSDF, and select the samples that pass through the surface
    ctx = mi.BSDFContext(mi.TransportMode.Radiance, int(lobe))
    xi = (dr.arange(mi.Float, DRAWS) + 0.5) / DRAWS
    sample, _ = bsdf.sample(ctx, si, xi, mi.Point2f(0.5))
    through = (sample.wo.z < 0) & (sample.pdf > 0)
    found = dr.max(dr.select(through, sample.eta, 0))[0]

    # A texture may block all light at this point. Use the parameter instead
    parameters = mi.traverse(bsdf)
    if found == 0 and "eta" in parameters:
        found = parameters["eta"]
    return float(found) or 1.0


@backend.tracing_lock()
def index_around(scene: mi.Scene, sensor: mi.Sensor) -> float:
    """Return the index of refraction around a sensor, 1 in vacuum and air.

    Materials contain ratios of indices only. Straight rays from the sensor show the media of the
    scene. The medium with the smallest index counts as air.

    Raises:
        ValueError: The sensor is in glass, and a BSDF contains glass of different indices.
    """
    if not has_lobes(scene, *LOBES):
        return 1.0
    variants.require_vectorized()

    # Trace straight rays from the sensor in all directions, by a Kronecker sequence
    u = np.arange(1, RAYS + 1)[:, None] * STEPS % 1
    film = mi.Point2f(*map(mi.Float, u.T[0:2]))
    out = mi.Point2f(*map(mi.Float, u.T[2:4]))
    ray = mi.Ray3f(sensor.sample_ray(sensor.shutter_open(), 0.5, film, mi.Point2f(0.5))[0])
    ray.d = mi.warp.square_to_uniform_sphere(out)
    ray.maxt = mi.Float(dr.inf)
    glass = Glass(scene, lambda bsdf: _all_indices(bsdf)[0], LOBES)
    ends = np.array(_straight(scene, glass, ray), dtype=float)

    # Air is the medium with the smallest index. Ignore media with few rays, because a few rays may
    # slip between two triangles
    found, counts = np.unique(ends.round(4), return_counts=True)
    thinnest = min(found[counts > LEAKS], default=1.0)
    if thinnest >= 1:
        return 1.0

    # The sensor is in glass, so that the index of all glass must be known
    index = 1 / ends[ends.round(4) == thinnest].mean()
    for bsdf in materials(scene):
        if len(set(_all_indices(bsdf))) > 1:
            raise ValueError(
                f"{name_of(scene, bsdf)} mixes glass of several indices, but the sensor is in "
                f"glass of index {index:g}. Use the same index for all parts"
            )
    return round(float(index), 6)


@dr.syntax
def _straight(scene: mi.Scene, glass: Glass, ray: mi.Ray3f) -> mi.Float:
    """Return the index where straight rays end, relative to the index where they start.

    A ray ends at infinity, at an opaque surface, or after `CROSSINGS` surfaces.
    """
    index = mi.Float(1)
    crossed = mi.UInt32(0)
    active = dr.isfinite(ray.o.x)
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
    """Return the relative indices of all glass in a BSDF, rough and smooth."""
    return [index for lobe in LOBES for index in _indices(bsdf, lobe)]
