"""Mirrors and glass of a laser scan."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi

from ...paths.delta_lobes import DeltaLobes
from ...paths.protocols import Space
from ...paths.surfaces import bsdfs_in, groups_of, is_boundary
from .guided import Targets


@dataclass
class Specular:
    """Mirrors and glass of a scan."""

    # Delta lobes of these surfaces
    lobes: DeltaLobes

    # The surfaces, for sampling by area
    targets: Targets

    @classmethod
    def of(cls, scene: mi.Scene, space: Space) -> Specular | None:
        """Find the mirrors and glass of a scene. Return None if all surfaces are rough.

        Raises:
            ValueError: A mirror or glass is not supported, e.g. as an instance.
        """

        def is_specular(bsdf: mi.BSDF | None) -> bool:
            passes = space.scatters and is_boundary(bsdf)
            return bsdf is not None and not passes and DeltaLobes.set_of(bsdf) != 0

        # Instances are not supported, because they do not report the BSDFs of their shape group
        for group in groups_of(scene):
            if any(is_specular(bsdf) for bsdf in bsdfs_in(group)):
                raise ValueError(
                    f"shape {group.id()!r}: an instance of a mirror or glass is not supported. "
                    "Add the shape to the scene directly"
                )

        # Collect the surfaces
        shapes = [shape for shape in scene.shapes() if is_specular(shape.bsdf())]
        if not shapes:
            return None
        for shape in shapes:
            DeltaLobes.require_supported(shape)
        return cls(DeltaLobes(scene), Targets(scene, shapes))
