"""The relay wall by a table: which of the wall's shapes each lane is on, if any."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi


def is_on_relay_wall(si: mi.SurfaceInteraction3f, relay_wall_shapes: Sequence[mi.Shape]) -> mi.Bool:
    """Count the shapes that each lane is on; shapes are numbered in Dr.Jit's registry, from 1."""
    number = dr.reinterpret_array(mi.UInt32, si.shape)
    matches = mi.UInt32(0)
    for shape in relay_wall_shapes:
        matches += dr.select(number == dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)), 1, 0)
    return si.is_valid() & (matches != 0)
