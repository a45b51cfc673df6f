"""pyroomacoustics: delays of image sources in rectangular rooms."""

from __future__ import annotations

import numpy as np

INSTALL = "pip install pyroomacoustics"
ABILITIES = frozenset({"delays", "mirror"})


def version() -> str:
    import pyroomacoustics

    return f"pyroomacoustics {pyroomacoustics.__version__}"


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    """Return 1 in bins with the delay of an image source, otherwise 0. The floor absorbs."""
    import pyroomacoustics

    # Describe the room
    walls = dict.fromkeys(("west", "east", "south", "north", "ceiling"), 0.0) | {"floor": 1.0}
    materials = {name: pyroomacoustics.Material(each) for name, each in walls.items()}
    described = scene["room"]
    room = pyroomacoustics.ShoeBox(described["size"], materials=materials, max_order=1)
    room.add_source(described["source"])
    room.add_microphone(described["receiver"])
    room.image_source_model()

    # Find the images that are not absorbed
    source = room.sources[0]
    lengths = np.linalg.norm(source.images.T - described["receiver"], axis=1)
    heard = lengths[source.damping[0] > 0] + described["extra_opl"]
    edges = bins["start"] + bins["width"] * np.arange(bins["count"] + 1)
    return (np.histogram(heard, edges)[0] > 0).astype(float)[None, None]
