"""Mitsuba's steady integrators, which render sums over time."""

from __future__ import annotations

import numpy as np

from . import mitsuba_scenes as scenes

INSTALL = "pip install mitsuba"
ABILITIES = scenes.FEATURES | {"steady", "inside", "half-space"}


def version() -> str:
    import mitsuba

    return f"Mitsuba {mitsuba.__version__}"


@scenes.cached
def _load(scene: dict):
    mi = scenes.start()
    kind = {"type": "volpath" if scenes.has_media(scene) else "path"}
    film = {"type": "hdrfilm", "pixel_format": "rgb", "component_format": "float32"}
    return mi.load_dict(scenes.dictionary(scene, kind, film), parallel=False, optimize=False)


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    mi = scenes.start()
    return np.array(mi.render(_load(scene), spp=samples, seed=seed))[..., :1]
