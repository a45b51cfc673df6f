"""Indices of refraction: behind rough glass, which connections pass, and around a sensor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import backend
from ..scenes.media import CROSSINGS, LEAKS, PROBES, STEPS
from .surfaces import materials, number_of, spawn_ray, transmits

ROUGH = mi.BSDFFlags.GlossyTransmission
WAYS = (ROUGH, mi.BSDFFlags.DeltaTransmission)
DRAWS = 256
"""Samples that look for the index of a material that transmits only part of its light."""

RAYS = 4 * PROBES
"""Straight rays that look what is around a sensor."""


class Glass:
    """The glass of a scene, by default rough glass: a table of relative indices of materials.

    Mitsuba tells an index with a sample only, and a mixture of materials may hide it from any one
    sample. So the parts of each material are asked once, before the render.

    Args:
        scene: The scene.
        index_of: Gives the relative index of a material.
        ways: Ways of transmission that make a material glass.

    Attributes:
        exists: Whether there is any.

    Raises:
        ValueError: Rough glasses of different index share a surface, so that what lies behind it
            has none; one line that names the material.
    """

    def __init__(
        self,
        scene: mi.Scene,
        index_of: Callable[[mi.BSDF], Any] | None = None,
        ways: tuple[mi.BSDFFlags, ...] = (ROUGH,),
    ) -> None:
        found = {
            int(number_of(mi.BSDFPtr(bsdf))[0]): (index_of or _index)(bsdf)
            for bsdf in dict.fromkeys(materials(scene))
            if any(mi.has_flag(bsdf.flags(), way) for way in ways)
        }
        self.exists = bool(found)
        indices = [found.get(k, 1.0) for k in range(max(found, default=0) + 1)]
        tracked = any(dr.grad_enabled(index) for index in indices)
        self.table = dr.concat(list(map(mi.Float, indices))) if tracked else mi.Float(indices)
        dr.eval(self.table)

    def index_behind(
        self, bsdf: Any, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Index of refraction on the side that `wo` points to, over that on the side of `si.wi`."""
        number = number_of(bsdf)
        crossing = active & (si.wi.z * wo.z < 0) & (number < dr.width(self.table))
        η = dr.gather(mi.Float, self.table, number, crossing)
        return dr.select(crossing, dr.select(si.wi.z > 0, η, dr.rcp(η)), 1)


def _index(bsdf: mi.BSDF) -> Any:
    """Index behind a rough material for light that comes along its normal, over that before it."""
    parts = _parts(bsdf, ROUGH)
    tracked = [mi.traverse(part)["eta"] for part in parts if "eta" in mi.traverse(part)]
    if len(parts) == 1 and dr.grad_enabled(tracked):
        return tracked[0]
    indices = _indices(bsdf, ROUGH)
    if len(indices) > 1:
        listed = ", ".join(f"{index:g}" for index in indices)
        raise ValueError(
            f"bsdf {bsdf.id()!r}: mixes rough glass of the indices {listed}; must have one index, "
            "light that passes it would have no optical length"
        )
    return round(indices[0], 5)


def _parts(bsdf: mi.BSDF, way: mi.BSDFFlags) -> list[mi.BSDF]:
    """The materials that a material is made of which transmit light in a way."""
    nodes = [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]
    return [node for node in nodes if mi.has_flag(node.flags(), way) and not _mixes(node)]


def _indices(bsdf: mi.BSDF, way: mi.BSDFFlags) -> list[float]:
    """The different indices of its parts."""
    found = [_index_of_part(part, way) for part in _parts(bsdf, way)]
    return sorted({round(index, 5): index for index in found}.values())


def _mixes(bsdf: mi.BSDF) -> bool:
    """Whether a material is made of others."""
    return sum(isinstance(node, mi.BSDF) for node in mi.traverse(bsdf).hierarchy) > 1


def _index_of_part(bsdf: mi.BSDF, way: mi.BSDFFlags) -> float:
    """The relative index of a single material, by samples along its normal."""
    si: Any = dr.zeros(mi.SurfaceInteraction3f, DRAWS)
    si.wi, si.n = mi.Vector3f(0, 0, 1), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    ctx = mi.BSDFContext(mi.TransportMode.Radiance, int(way))
    xi = (dr.arange(mi.Float, DRAWS) + 0.5) / DRAWS
    sample, _ = bsdf.sample(ctx, si, xi, mi.Point2f(0.5))
    through = (sample.wo.z < 0) & (sample.pdf > 0)
    found: Any = dr.max(dr.select(through, sample.eta, 0))[0]
    parameters = mi.traverse(bsdf)
    if found == 0 and "eta" in parameters:  # A texture lets no light through there
        found = parameters["eta"]
    return float(found) or 1.0


@backend.tracing_lock()
def index_around(scene: mi.Scene, sensor: mi.Sensor) -> float:
    """Index of refraction of what a sensor is in, 1 in vacuum and air.

    Materials tell ratios of indices only. Of all that lies where straight rays from the sensor end
    that have passed glass, the thinnest is air.

    Raises:
        ValueError: A material of the scene has several indices, so that there is none; one line.
    """
    if not transmits(scene, *WAYS):
        return 1.0
    backend.require_vectorised()
    share = np.arange(1, RAYS + 1)[:, None] * STEPS % 1
    film, out = (mi.Point2f(*map(mi.Float, share.T[k : k + 2])) for k in (0, 2))
    ray: Any = mi.Ray3f(sensor.sample_ray(sensor.shutter_open(), 0.5, film, mi.Point2f(0.5))[0])
    ray.d, ray.maxt = mi.warp.square_to_uniform_sphere(out), mi.Float(dr.inf)
    ends = np.array(_straight(scene, Glass(scene, _first_index, WAYS), ray), dtype=float)
    kinds, counts = np.unique(ends.round(4), return_counts=True)
    thinnest = min(kinds[counts > LEAKS], default=1.0)
    if thinnest >= 1:
        return 1.0
    index = 1 / ends[ends.round(4) == thinnest].mean()
    for bsdf in materials(scene):
        if len(set(_all_indices(bsdf))) > 1:
            raise ValueError(
                f"bsdf {bsdf.id()!r}: mixes glass of several indices, and the sensor is in glass "
                f"of index {index:g}; must have one index, lengths would have none"
            )
    return round(float(index), 6)


@dr.syntax
def _straight(scene: mi.Scene, glass: Glass, ray: mi.Ray3f) -> mi.Float:
    """Index where straight rays end, over that where they start."""
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


def _first_index(bsdf: mi.BSDF) -> float:
    """The relative index of a material that transmits, or one of several."""
    return _all_indices(bsdf)[0]


def _all_indices(bsdf: mi.BSDF) -> list[float]:
    """The relative indices of a material's parts, rough or smooth."""
    return [index for way in WAYS for index in _indices(bsdf, way)]
