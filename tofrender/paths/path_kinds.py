"""Kinds of paths. Different techniques render different kinds.

Every path is of exactly one kind. The kind depends on the lobes that scatter the path at its
vertices. In the table, x1 is the first vertex after the camera, and xk is the last vertex before
the emitter.

| kind | lobe at x1 | lobe at xk |
|---|---|---|
| `VISIBLE` | no vertex | no vertex |
| `CHAIN` | delta, as at all other vertices | delta |
| `CAUSTIC` | smooth | delta |
| `CAUSTIC_IN_MIRROR` | delta | delta, with a smooth lobe in between |
| `SMOOTH` | any | smooth |

A path of one of the first four kinds ends where a ray hits an emitter. This ray comes from the
camera or from a delta lobe. Next-event estimation finds paths of the kind `SMOOTH` only.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

import drjit as dr
import mitsuba as mi


class Kind(Enum):
    """Kind of a path, see the table above."""

    # The camera sees an emitter on a surface, not an environment
    VISIBLE = auto()

    # Only delta lobes scatter the path
    CHAIN = auto()

    # The first lobe is smooth, and the last lobe is a delta lobe
    CAUSTIC = auto()

    # A caustic that the camera sees in a mirror or through glass
    CAUSTIC_IN_MIRROR = auto()

    # The last lobe is smooth
    SMOOTH = auto()


@dataclass
class Lobes:
    """Kinds of lobes that have scattered a path. The fields are masks as integers 0 or 1."""

    first_smooth: mi.UInt32  # Whether the lobe at the first vertex is smooth
    any_smooth: mi.UInt32  # Whether the lobe at any vertex is smooth

    @classmethod
    def none(cls, zero: mi.UInt32) -> Lobes:
        """Return the lobes of paths without vertices.

        Args:
            zero: Zeros, one per path.
        """
        return cls(first_smooth=mi.UInt32(zero), any_smooth=mi.UInt32(zero))

    def after(self, specular: mi.Bool, first: mi.Bool) -> Lobes:
        """Return the lobes after one more vertex.

        Args:
            specular: Lanes with a delta lobe at this vertex.
            first: Lanes in which this vertex is the first vertex of the path.
        """
        smooth = dr.select(specular, mi.UInt32(0), 1)
        return Lobes(
            first_smooth=dr.select(first, smooth, self.first_smooth),
            any_smooth=self.any_smooth | smooth,
        )

    def of_kinds(self, kinds: frozenset[Kind], specular: mi.Bool, depth: mi.UInt32) -> mi.Bool:
        """Return lanes in which a path that hits an emitter has one of these kinds.

        The kind `VISIBLE` is ignored.

        Args:
            kinds: Kinds of paths.
            specular: Lanes in which the last ray comes from a delta lobe or from the camera.
            depth: Number of vertices before the emitter.
        """
        # Does the last ray come from a delta lobe?
        delta = specular & (depth > 0)

        # Add the lanes of each kind, by the table above
        found = mi.Bool(False)
        if Kind.CHAIN in kinds:
            found |= delta & (self.any_smooth == 0)
        if Kind.CAUSTIC in kinds:
            found |= delta & (self.first_smooth != 0)
        if Kind.CAUSTIC_IN_MIRROR in kinds:
            found |= delta & (self.any_smooth != 0) & (self.first_smooth == 0)
        if Kind.SMOOTH in kinds:
            found |= ~specular
        return found
