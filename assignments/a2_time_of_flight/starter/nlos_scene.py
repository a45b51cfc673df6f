"""Given: a corner of a room as relay wall, and a letter that is visible from it."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from tofrender.scenes import nlos_z


def corner_scene(
    width: int = 16,
    height: int = 16,
    temporal_bins: int = 240,
    start_opl: float = 1.5,
    bin_width_opl: float = 0.03,
    use_nlos_only: bool = False,
) -> dict[str, Any]:
    """A wall and a floor, both relay walls, and a letter Z 1 m in front of the wall.

    The wall is 2 m x 2 m at z = 0 and faces +z; the floor is 2 m x 2 m at y = -1. Laser and camera
    scan the wall from (-0.5, 0, 0.25). The window holds all paths of three segments.

    Args:
        width: Points of the wall from left to right.
        height: Points of the wall from bottom to top.
        temporal_bins: Number of time bins.
        start_opl: Start of the first bin [m].
        bin_width_opl: Width of a bin [m].
        use_nlos_only: Count only paths with a vertex that is not on the relay walls.

    Returns:
        A dict for `mi.load_dict(..., optimize=False)`. Without this option, Mitsuba merges the
        wall and the floor.
    """
    scene = nlos_z(
        width=width,
        height=height,
        temporal_bins=temporal_bins,
        start_opl=start_opl,
        bin_width_opl=bin_width_opl,
    )
    del scene["laser"]
    scene["integrator"] = {
        "type": "confocal_transient_path",
        "max_depth": 3,
        "relay_wall": "relay_wall, floor",
        "use_nlos_only": use_nlos_only,
    }
    to_world = mi.ScalarTransform4f().translate([0, -1, 1]).rotate([1, 0, 0], -90)
    scene["floor"] = {
        "type": "rectangle",
        "to_world": to_world,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6] * 3}},
    }
    return scene
