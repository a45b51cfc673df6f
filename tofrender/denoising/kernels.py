"""Fixed linear filters of a film, over pixels by first-hit features, and over bins.

Each is a residual Q = I - S with a symmetric S ≥ 0 whose rows sum to 1: removing Q x from x keeps
the sum, and never looks at the light itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from .blocks import PIXELS, Blocks

SIDE, CENTRE = 0.25, 0.5  # Taps of the binomial filter, in space and in time
PLANE, ALBEDO, NORMAL = 2.0, 0.2, 4  # Pixels off the tangent plane, albedo, power of the cosine
NEAR = 8.0  # Greatest distance of neighbours, in pixels times the step
LEAST = 1e-3  # Smallest weight that is kept, of the largest one

NEIGHBOURS = ((0, 1), (1, -1), (1, 0), (1, 1), (0, -1), (-1, 1), (-1, 0), (-1, -1))
"""Rows and columns from a pixel to its neighbours; the last four are the opposites of the first."""

Tap = tuple[mi.UInt32, mi.Float, mi.Bool]
"""Number of another cell, its weight, and whether there is one."""


def over_bins(blocks: Blocks, step: int) -> Iterator[Tap]:
    """Taps of a binomial filter of three bins `step` apart; nothing leaves the window."""
    y, x, t, inside = blocks.lanes()
    _, width, bins = blocks.size
    cell = (y * width + x) * bins + t
    yield cell - step, mi.Float(SIDE), inside & (t >= step)
    yield cell + step, mi.Float(SIDE), inside & (t + step < bins)


def over_pixels(blocks: Blocks, step: int, weights: np.ndarray, ways: mi.UInt32) -> Iterator[Tap]:
    """Taps of a filter of 3 x 3 pixels `step` apart, by `weights` of `pixel_weights`.

    `ways` has a number for each block, as `open_ways` makes it.
    """
    y, x, t, inside = blocks.lanes()
    _, width, bins = blocks.size
    pixel, source = y * width + x, mi.Float(np.ravel(weights))
    found = dr.gather(mi.ArrayXf, source, pixel, inside, shape=(len(NEIGHBOURS), dr.width(pixel)))
    own = dr.gather(mi.UInt32, ways, blocks.of(y, x, t), inside)
    for number, (down, right) in enumerate(NEIGHBOURS):
        j, i = y + (PIXELS + step * down), x + (PIXELS + step * right)  # A block further
        way = (j // PIXELS - y // PIXELS) * 3 + (i // PIXELS - x // PIXELS)
        weight = found[number]
        there = inside & (weight > 0) & ((own >> way) & 1 != 0)
        yield ((j - PIXELS) * width + i - PIXELS) * bins + t, weight, there


def open_ways(crossed: np.ndarray) -> np.ndarray:
    """Bits that say to which of the nine blocks around each, itself included, light may cross.

    `crossed` (rows, columns, times) says whether it may cross a block's border at all.
    """
    padded = np.pad(crossed, ((1, 1), (1, 1), (0, 0)))
    rows, columns, _ = crossed.shape
    ways = np.zeros(crossed.shape, np.uint32)
    for way in range(9):
        y, x = divmod(way, 3)
        to = padded[y : y + rows, x : x + columns]
        ways |= ((crossed & to) | (way == 4)).astype(np.uint32) << way
    return ways


def pixel_weights(features: Mapping[str, np.ndarray], step: int) -> np.ndarray:
    """Weights (height, width, 8) of each pixel's `NEIGHBOURS`, `step` pixels apart.

    It is the edge-avoiding à-trous filter (Dammertz et al., HPG 2010) with weights from features
    alone: binomial, times how much two first hits are alike in position, normal and albedo. Pixels
    of a `kind` other than 0 have none.
    """
    height, width = features["distance"].shape
    size = _pixel_size(features["position"], features["distance"])
    weights = np.zeros((height, width, len(NEIGHBOURS)), np.float32)
    for number, (down, right) in enumerate(NEIGHBOURS[:4]):
        y, x = step * down, step * right
        if y >= height or abs(x) >= width:
            continue
        near = np.s_[: height - y, max(0, -x) : width - max(0, x)]
        far = np.s_[y:, max(0, x) : width - max(0, -x)]
        a, b = ({name: array[s] for name, array in features.items()} for s in (near, far))
        between, pixel = b["position"] - a["position"], size[near] + size[far]
        off = sum(np.abs(np.sum(between * each["normal"], axis=-1)) for each in (a, b)) / pixel
        colour = np.sum((a["albedo"] - b["albedo"]) ** 2, axis=-1) / ALBEDO**2
        cosine = np.clip(np.sum(a["normal"] * b["normal"], axis=-1), 0, 1)
        binomial = SIDE * (SIDE if x and y else CENTRE)
        weight = binomial * np.exp(-((off / PLANE) ** 2) - colour) * cosine**NORMAL
        kept = (a["kind"] == 0) & (b["kind"] == 0) & (weight > LEAST * SIDE * CENTRE)
        kept &= np.linalg.norm(between, axis=-1) < NEAR * step * pixel
        weights[near][..., number] = weights[far][..., number + 4] = np.where(kept, weight, 0)
    return weights


def _pixel_size(position: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Distance between first hits of neighbouring pixels [m], as of a sphere around the camera."""
    apart = np.linalg.norm(np.diff(position, axis=1), axis=-1)
    nearer = np.minimum(distance[:, 1:], distance[:, :-1])
    angles = apart[nearer > 0] / nearer[nearer > 0]
    return np.maximum((np.median(angles) if angles.size else 0) * distance, 1e-12)
