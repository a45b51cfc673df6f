"""Descriptions of a small room, with parts that are replaced."""

from typing import Any

import mitsuba as mi

FILM = {"type": "transient_hdr_film", "width": 4, "height": 4, "temporal_bins": 8}


def T() -> Any:
    return mi.ScalarTransform4f()


def room(**parts: Any) -> dict[str, Any]:
    look = T().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    camera = {"type": "perspective", "fov": 45.0, "to_world": look, "film": FILM}
    lamp = {"type": "point", "position": [0, 0, 2]}
    made = {"type": "scene", "integrator": {"type": "transient_path"}, "sensor": camera}
    return made | {"floor": {"type": "rectangle"}, "lamp": lamp} | parts


def camera(**changes: Any) -> dict[str, Any]:
    return room() | {"sensor": room()["sensor"] | changes}


def lamp(**changes: Any) -> dict[str, Any]:
    return room() | {"lamp": room()["lamp"] | changes}


def floor(**changes: Any) -> dict[str, Any]:
    return room(floor={"type": "rectangle"} | changes)


def material(**bsdf: Any) -> dict[str, Any]:
    return floor(bsdf=bsdf)
