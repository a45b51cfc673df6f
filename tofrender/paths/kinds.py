"""Kinds of paths, which different techniques render.

The lobes that scatter a path decide on its kind: x1 is the first vertex after the camera, xk the
last one before the emitter. Every path is of one kind.

| kind | lobe at x1 | lobe at xk |
|---|---|---|
| `VISIBLE` | no vertex | no vertex |
| `CHAIN` | delta, as at all other vertices | delta |
| `CAUSTIC` | smooth | delta |
| `CAUSTIC_IN_MIRROR` | delta | delta, with a smooth lobe in between |
| `SMOOTH` | any | smooth |

A path of one of the first four kinds ends where a ray runs into an emitter, and this ray comes from
the camera or from a delta lobe. Connections make paths of the kind `SMOOTH` only.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

import drjit as dr
import mitsuba as mi


class Kind(Enum):
    """A kind of paths."""

    VISIBLE = auto()  # the camera sees an emitter, not an environment
    CHAIN = auto()  # delta lobes alone lead to the emitter
    CAUSTIC = auto()
    CAUSTIC_IN_MIRROR = auto()
    SMOOTH = auto()


@dataclass
class Lobes:
    """Lobes that have scattered a path, as integers that are 0 or 1."""

    first_smooth: mi.UInt32  # whether the lobe at the first vertex is smooth
    any_smooth: mi.UInt32  # whether the lobe at some vertex is smooth

    @classmethod
    def none(cls, zero: mi.UInt32) -> Lobes:
        """Return the lobes of a path without vertices; `zero` has the width of the paths."""
        return cls(mi.UInt32(zero), mi.UInt32(zero))

    def after(self, specular: mi.Bool, first: mi.Bool) -> Lobes:
        """Return the lobes after one more vertex, which is the path's first one or not."""
        smooth = dr.select(specular, mi.UInt32(0), 1)
        return Lobes(
            first_smooth=dr.select(first, smooth, self.first_smooth),
            any_smooth=self.any_smooth | smooth,
        )

    def of_kinds(self, kinds: frozenset[Kind], specular: mi.Bool, depth: mi.UInt32) -> mi.Bool:
        """Return lanes in which a path that runs into an emitter is of one of some kinds.

        `specular` says that its last ray comes from a delta lobe or the camera, `depth` is the
        number of its vertices. `VISIBLE` is not among the kinds that are looked for.
        """
        delta = specular & (depth > 0)
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
