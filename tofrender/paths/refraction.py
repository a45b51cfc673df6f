# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false
"""The index of refraction behind rough glass, which connections pass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .surfaces import materials

ROUGH = mi.BSDFFlags.GlossyTransmission
DRAWS = 256
"""Samples that look for the index of a material that transmits only part of its light."""


class RoughGlass:
    """The rough glass of a scene: a table of relative indices, one for each material.

    Mitsuba tells an index with a sample only, and a mixture of materials may hide it from any one
    sample. So the parts of each material are asked once, before the render.

    Args:
        scene: The scene.

    Attributes:
        exists: Whether there is any.

    Raises:
        ValueError: Rough glasses of different index share a surface, so that what lies behind it
            has none; one line that names the material.
    """

    def __init__(self, scene: mi.Scene) -> None:
        found = {
            int(_number(mi.BSDFPtr(bsdf))[0]): _index(bsdf)
            for bsdf in dict.fromkeys(materials(scene))
            if mi.has_flag(bsdf.flags(), ROUGH)
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
        number = _number(bsdf)
        crossing = active & (si.wi.z * wo.z < 0) & (number < dr.width(self.table))
        η = dr.gather(mi.Float, self.table, number, crossing)
        return dr.select(crossing, dr.select(si.wi.z > 0, η, dr.rcp(η)), 1)


def _number(bsdf: Any) -> mi.UInt32:
    """The number by which Dr.Jit knows a material."""
    return dr.reinterpret_array(mi.UInt32, bsdf)


def _index(bsdf: mi.BSDF) -> Any:
    """Index behind a material for light that comes along its normal, over that before it."""
    nodes = [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]
    rough = [node for node in nodes if mi.has_flag(node.flags(), ROUGH)]
    parts = [node for node in rough if not _mixes(node)]
    tracked = [mi.traverse(part)["eta"] for part in parts if "eta" in mi.traverse(part)]
    if len(parts) == 1 and dr.grad_enabled(tracked):
        return tracked[0]
    indices = sorted({round(_index_of_part(part), 5) for part in parts})
    if len(indices) > 1:
        listed = ", ".join(f"{index:g}" for index in indices)
        raise ValueError(
            f"bsdf {bsdf.id()!r}: mixes rough glass of the indices {listed}; must have one index, "
            "light that passes it would have no optical length"
        )
    return indices[0]


def _mixes(bsdf: mi.BSDF) -> bool:
    """Whether a material is made of others."""
    return sum(isinstance(node, mi.BSDF) for node in mi.traverse(bsdf).hierarchy) > 1


def _index_of_part(bsdf: mi.BSDF) -> float:
    """The relative index of a single material, by samples along its normal."""
    si: Any = dr.zeros(mi.SurfaceInteraction3f, DRAWS)
    si.wi, si.n = mi.Vector3f(0, 0, 1), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    ctx = mi.BSDFContext(mi.TransportMode.Radiance, int(ROUGH))
    xi = (dr.arange(mi.Float, DRAWS) + 0.5) / DRAWS
    sample, _ = bsdf.sample(ctx, si, xi, mi.Point2f(0.5))
    through = (sample.wo.z < 0) & (sample.pdf > 0)
    found: Any = dr.max(dr.select(through, sample.eta, 0))[0]
    parameters = mi.traverse(bsdf)
    if found == 0 and "eta" in parameters:  # A texture lets no light through there
        found = parameters["eta"]
    return float(found) or 1.0
