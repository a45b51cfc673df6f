"""The index of refraction behind rough glass, which connections pass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .surfaces import materials

ROUGH = mi.BSDFFlags.GlossyTransmission
DRAWS = (0.5, 1e-3, 1 - 1e-3, *((k + 0.5) / 8 for k in range(8)))
"""Numbers by which a mixture of materials chooses among its parts; plain glass needs the first."""


class RoughGlass:
    """The rough glass of a scene.

    Args:
        scene: The scene.

    Attributes:
        exists: Whether there is any.

    Raises:
        ValueError: Rough glasses of different index share a surface, so that what lies behind it
            has none; one line that names the material.
    """

    def __init__(self, scene: mi.Scene) -> None:
        found = [bsdf for bsdf in materials(scene) if mi.has_flag(bsdf.flags(), ROUGH)]
        self.exists = bool(found)
        for bsdf in found:
            parts = _parts(bsdf)
            indices = sorted({_index(part) for part in parts}) if len(parts) > 1 else []
            if len(indices) > 1:
                raise ValueError(
                    f"bsdf {bsdf.id()!r}: mixes rough glasses of the relative indices {indices}; "
                    "must have one, the light behind it would have no optical length"
                )
        plain = all(each.class_name() == "RoughDielectric" for each in found)
        self.draws = DRAWS[:1] if plain else DRAWS

    def index_behind(
        self, bsdf: Any, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
    ) -> mi.Float:
        """Index of refraction on the side that `wo` points to, over that on the side of `si.wi`.

        Mitsuba tells it with a sample only. Those that are drawn here come along the normal, where
        nothing is totally reflected.
        """
        through = mi.SurfaceInteraction3f(si)
        through.wi = mi.Vector3f(0, 0, dr.sign(si.wi.z))
        crossing = active & (si.wi.z * wo.z < 0)
        return _index_along_normal(bsdf, through, self.draws, crossing)


def _index_along_normal(
    bsdf: Any, si: mi.SurfaceInteraction3f, draws: tuple[float, ...], active: mi.Bool
) -> mi.Float:
    """Relative index of rough glass for light along the normal, 1 where there is none."""
    ctx = mi.BSDFContext(mi.TransportMode.Radiance, int(ROUGH) | int(mi.BSDFFlags.Null))
    η = mi.Float(1)
    for xi in draws:
        sample, _ = bsdf.sample(ctx, si, xi, mi.Point2f(0.5), active)
        through_glass = mi.has_flag(sample.sampled_type, ROUGH) & (sample.eta > 0)
        η = dr.select(active & through_glass, sample.eta, η)
    return η


def _parts(bsdf: mi.BSDF) -> list[mi.BSDF]:
    """The rough glasses that a material is made of, itself if it is one."""
    nodes = [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]
    rough = [node for node in nodes if mi.has_flag(node.flags(), ROUGH)]
    inner = {id(node): [n for n in rough if n in mi.traverse(node).hierarchy] for node in rough}
    return [node for node in rough if len(inner[id(node)]) == 1]


def _index(bsdf: mi.BSDF) -> float:
    """Index of a single rough glass, on the side away from its normal over that on the normal's."""
    si: Any = dr.zeros(mi.SurfaceInteraction3f)
    si.wi, si.n = mi.Vector3f(0, 0, 1), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    return round(float(_index_along_normal(bsdf, si, DRAWS, mi.Bool(True))[0]), 5)
