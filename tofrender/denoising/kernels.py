"""Fixed linear filters of a film, over pixels with similar first hits and over neighboring bins.

Each filter computes the residual Q x of a film x, with Q = I - S and a symmetric smoothing S ≥ 0.
The rows of S sum to 1, so subtracting Q x preserves the sum of the film. The weights depend on the
features of first hits only, not on the light.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from .blocks import PIXELS, Blocks

SIDE = 0.25  # Outer tap of the binomial filter, in space and in time
CENTER = 0.5  # Central tap of the binomial filter
PLANE = 2.0  # Scale of the distance to the tangent plane [pixels]
ALBEDO = 0.2  # Scale of the difference of albedos
NORMAL = 4  # Exponent of the cosine between normals
NEAR = 8.0  # Largest distance between first hits of neighbors [pixels], per pixel of the step
LEAST = 1e-3  # Smallest weight that is kept, relative to the largest weight

NEIGHBORS = ((0, 1), (1, -1), (1, 0), (1, 1), (0, -1), (-1, 1), (-1, 0), (-1, -1))
"""Row and column offsets of neighbors. The last four are the opposites of the first four."""

Tap = tuple[mi.UInt32, mi.Float, mi.Bool]
"""Index of another cell, its weight, and whether the cell exists."""


def over_bins(blocks: Blocks, step: int) -> Iterator[Tap]:
    """Yield the outer taps of a binomial filter of three bins with a distance of `step` bins.

    Taps outside of the time window do not exist, so no light leaves the window.
    """
    y, x, t, inside = blocks.lanes()
    _, width, bins = blocks.size
    cell = (y * width + x) * bins + t
    yield cell - step, mi.Float(SIDE), inside & (t >= step)
    yield cell + step, mi.Float(SIDE), inside & (t + step < bins)


def over_pixels(blocks: Blocks, step: int, weights: np.ndarray, ways: mi.UInt32) -> Iterator[Tap]:
    """Yield the outer taps of a filter of 3 x 3 pixels with a distance of `step` pixels.

    Args:
        blocks: Blocks of the film.
        step: Distance between the taps [pixels].
        weights: Weights of the neighbors from `pixel_weights`.
        ways: Bits of each block from `open_ways`.
    """
    # Read the weights of the pixel, and the bits of its block
    y, x, t, inside = blocks.lanes()
    _, width, bins = blocks.size
    pixel = y * width + x
    source = mi.Float(np.ravel(weights))
    shape = (len(NEIGHBORS), dr.width(pixel))
    of_pixel = dr.gather(mi.ArrayXf, source, pixel, inside, shape=shape)
    open_from_here = dr.gather(mi.UInt32, ways, blocks.of(y, x, t), inside)

    for number, (down, right) in enumerate(NEIGHBORS):
        # Find the neighbor's block; one block is added so that the indices are not negative
        j = y + (PIXELS + step * down)
        i = x + (PIXELS + step * right)
        way = (j // PIXELS - y // PIXELS) * 3 + (i // PIXELS - x // PIXELS)

        # Does the neighbor exist, and may light cross to its block?
        weight = of_pixel[number]
        there = inside & (weight > 0) & ((open_from_here >> way) & 1 != 0)
        yield ((j - PIXELS) * width + i - PIXELS) * bins + t, weight, there


def open_ways(crossed: np.ndarray) -> np.ndarray:
    """Return a number for each block, with a bit for each of the 3 x 3 blocks around it.

    A bit is set if light may cross between the two blocks, or if both are the same block.

    Args:
        crossed: Whether light may cross the border of a block, bool (rows, columns, times).
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
    """Return weights (height, width, 8) of the `NEIGHBORS` of each pixel.

    This is the edge-avoiding à-trous filter (Dammertz et al., HPG 2010) with weights that depend on
    features only. A weight is the product of the binomial filter and of the similarity of two first
    hits in position, normal and albedo. Weights of pixels with a `kind` other than 0 are 0.

    Args:
        features: Features of the first hits.
        step: Distance between a pixel and its neighbors [pixels].
    """
    height, width = features["distance"].shape
    size = _pixel_size(features["position"], features["distance"])
    weights = np.zeros((height, width, len(NEIGHBORS)), np.float32)
    for number, (down, right) in enumerate(NEIGHBORS[:4]):
        y = step * down
        x = step * right
        if y >= height or abs(x) >= width:
            continue

        # Features of all pairs of pixels with this offset
        near = np.s_[: height - y, max(0, -x) : width - max(0, x)]
        far = np.s_[y:, max(0, x) : width - max(0, -x)]
        a, b = ({name: array[s] for name, array in features.items()} for s in (near, far))

        # Similarity of the two hits: distance to the tangent planes, albedo, normal
        between = b["position"] - a["position"]
        pixel = size[near] + size[far]
        off = sum(np.abs(np.sum(between * each["normal"], axis=-1)) for each in (a, b)) / pixel
        color = np.sum((a["albedo"] - b["albedo"]) ** 2, axis=-1) / ALBEDO**2
        cosine = np.clip(np.sum(a["normal"] * b["normal"], axis=-1), 0, 1)
        binomial = SIDE * (SIDE if x and y else CENTER)
        weight = binomial * np.exp(-((off / PLANE) ** 2) - color) * cosine**NORMAL

        # Remove small weights, and hits of other kinds or at a large distance
        kept = (a["kind"] == 0) & (b["kind"] == 0) & (weight > LEAST * SIDE * CENTER)
        kept &= np.linalg.norm(between, axis=-1) < NEAR * step * pixel
        weights[near][..., number] = weights[far][..., number + 4] = np.where(kept, weight, 0)
    return weights


def _pixel_size(position: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Return the distance of neighboring first hits [m] on a sphere around the camera.

    The angle between neighboring pixels is the median over the picture.

    Args:
        position: Positions of the first hits [m], (height, width, 3).
        distance: Distances of the first hits from the camera [m], (height, width).
    """
    apart = np.linalg.norm(np.diff(position, axis=1), axis=-1)
    nearer = np.minimum(distance[:, 1:], distance[:, :-1])
    angles = apart[nearer > 0] / nearer[nearer > 0]
    return np.maximum((np.median(angles) if angles.size else 0) * distance, 1e-12)
