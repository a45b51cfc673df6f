"""Parts of a picture that are rendered apart: merged, they are the picture, seams included."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from helpers.support import film, load

WIDTH, HEIGHT = 8, 6
TILES = [(0, 0, 5, 2), (5, 0, 3, 2), (0, 2, 5, 4), (5, 2, 3, 4)]
FILTERS = {"box": {"type": "box"}, "tent": {"type": "tent", "radius": 2.0}}


def centres(rfilter: str, border: bool, **crop) -> dict:
    """A wall that glows in squares, seen at the centres of pixels: no noise, whatever the tile.

    Their light arrives at lengths that differ by a few bins.
    """
    values = np.random.default_rng(3).uniform(0, 1, (HEIGHT, WIDTH, 1)).astype(np.float32)
    texture = {
        "type": "bitmap",
        "data": mi.TensorXf(values),
        "raw": True,
        "filter_type": "nearest",
    }
    window = film(WIDTH, HEIGHT, bins=8, start=1.0, bin_width=0.25, sample_border=border, **crop)
    meter = {
        "type": "nlos_capture_meter",
        "sensor_origin": [0.3, 0.2, 1.2],
        "film": window | {"rfilter": FILTERS[rfilter]},
        "sampler": {"type": "independent", "sample_count": 4},
    }
    wall = {"type": "rectangle", "emitter": {"type": "area", "radiance": texture}, "sensor": meter}
    integrator = {"type": "transient_path", "max_depth": 1, "temporal_filter": "box"}
    return {"type": "scene", "integrator": integrator, "wall": wall}


def developed(target) -> list[np.ndarray]:
    return [np.array(tensor, dtype=float) for tensor in target.develop()]


def merge(rfilter: str, border: bool, tiles: list):
    """Films of the whole picture: rendered at once, and merged of tiles."""
    whole = load(centres(rfilter, border))
    mi.render(whole, spp=4)
    merged = mi.load_dict(centres(rfilter, border)["wall"]["sensor"]["film"], parallel=False)
    merged.prepare([])
    for x, y, width, height in tiles:
        crop = {"crop_offset_x": x, "crop_offset_y": y, "crop_width": width, "crop_height": height}
        part = load(centres(rfilter, border, **crop))
        mi.render(part, spp=4)
        merged.merge_tile(part.sensors()[0].film())
    return whole.sensors()[0].film(), merged


@pytest.mark.parametrize(
    ("rfilter", "border", "tiles"),
    [("box", False, TILES), ("tent", True, TILES), ("tent", False, [(0, 0, WIDTH, HEIGHT)])],
    ids=["box", "tent and border", "as large as the film"],
)
def test_tiles_are_the_whole(rfilter, border, tiles):
    """A tile's pixels are complete if it samples as far beyond its border as its filter reaches."""
    for one, other in zip(*map(developed, merge(rfilter, border, tiles)), strict=True):
        assert one.std() > 0.1 * one.mean()
        assert other == pytest.approx(one, rel=2e-6, abs=2e-6 * one.max())
