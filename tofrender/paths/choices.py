"""Derivatives of the choice between delta lobes, such as reflection or refraction.

A material that chooses with the chance p weights what it has chosen by f/p. A derivative needs that
of f alone, as the choice itself stays. Mitsuba's materials differ: some hand out a p whose change
they have left in the weight, some have left it out of both. The weight times p, over what p was, is
right for all but masks, whose weight has the change of f and whose p has it again.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import drjit as dr
import mitsuba as mi

from .surfaces import changing, materials

MASK, BLEND = "MaskBSDF", "BlendBSDF"

CHOOSERS = ("ThinDielectric", "SmoothPlastic", BLEND)
"""Materials that hand out p with its change, which a mask over them mixes with its own."""


class Choices:
    """Derivatives that the BSDFs of a scene leave out of their sample weights.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: mi.Scene) -> None:
        masks = [bsdf for bsdf in materials(scene) if MASK in {*map(kind, parts(bsdf))}]
        self._whole = [bsdf for k, bsdf in enumerate(masks) if bsdf not in masks[:k]]

    def change(self, bsdf: Any, pdf: mi.Float, specular: mi.Bool) -> Any:
        """1, with the change that a weight lacks."""
        whole = reduce(lambda found, mask: found | (bsdf == mi.BSDFPtr(mask)), self._whole, False)
        return dr.replace_grad(mi.Float(1), changing(pdf, specular & ~mi.Bool(whole)))


def undifferentiated(bsdf: mi.BSDF) -> str:
    """Name the part of a BSDF that has no derivatives, "" if there is none.

    Example:
        >>> pane = {"type": "thindielectric"}
        >>> undifferentiated(mi.load_dict({"type": "mask", "opacity": 0.5, "pane": pane}))
        'mask over a thindielectric, a plastic or a blendbsdf'
        >>> undifferentiated(mi.load_dict(pane))
        ''
    """
    single = [part for part in parts(bsdf) if mi.has_flag(part.flags(), mi.BSDFFlags.Delta)]
    blends = [part for part in single if kind(part) == BLEND]
    masked = MASK in map(kind, single)
    if masked and any(kind(part) in CHOOSERS for part in single):
        return "mask over a thindielectric, a plastic or a blendbsdf"
    if any(mi.has_flag(part.flags(), mi.BSDFFlags.Smooth) for part in blends):
        return "blendbsdf of single directions and others"
    return ""


def parts(bsdf: mi.BSDF) -> list[mi.BSDF]:
    """A material, and those that it is made of."""
    return [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]


def kind(bsdf: mi.BSDF) -> str:
    """The name of its class."""
    return bsdf.class_name()
