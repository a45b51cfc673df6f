"""Problem a2.relay_wall: points on the relay wall."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi


def is_on_relay_wall(si: mi.SurfaceInteraction3f, relay_wall_shapes: Sequence[mi.Shape]) -> mi.Bool:
    """Whether surface points are on the relay wall.

    `si.shape` contains one shape for each lane, but Python's `in` gives a single result for all
    lanes. Compare `si.shape` with each of the wall's shapes instead.

    Args:
        si: Surface interactions, of any number. Rays that hit nothing are not on the wall.
        relay_wall_shapes: The shapes that make up the wall, in any order; at least one.

    Returns:
        A mask, one entry for each interaction.
    """
    raise NotImplementedError("a2.relay_wall: is_on_relay_wall")
