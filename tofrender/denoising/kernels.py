"""Fixed linear filters of a film, over pixels by first-hit features, and over bins.

Each is a residual Q = I - S with a symmetric S ≥ 0 whose rows sum to 1: removing Q x from x keeps
the sum, and never looks at the light itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from scipy import sparse

from .blocks import PIXELS

SIDE, CENTRE = 0.25, 0.5  # Taps of the binomial filter, in space and in time
PLANE, ALBEDO, NORMAL = 2.0, 0.2, 4  # Pixels off the tangent plane, albedo, power of the cosine
NEAR = 8.0  # Greatest distance of neighbours, in pixels times the step
LEAST = 1e-3  # Smallest weight that is kept, of the largest one

Residuals = Callable[[np.ndarray, np.ndarray], Iterator[np.ndarray]]
"""Residuals of values (pixels, channels, bins), part by part; the second array (pixels, bins) is 1
where light may cross to another block, else 0."""


def over_pixels(features: Mapping[str, np.ndarray], step: int, parts: Sequence[slice]) -> Residuals:
    """Residuals of a cross-bilateral filter of 3 x 3 pixels `step` apart.

    It is the edge-avoiding à-trous filter (Dammertz et al., HPG 2010) with weights from features
    alone: binomial, times how much two first hits are alike in position, normal and albedo. What
    unlike neighbours do not get stays in the pixel. Pixels of a `kind` other than 0 are not mixed.
    """
    height, width = features["distance"].shape
    number = np.arange(height * width).reshape(height, width)
    size = _pixel_size(features["position"], features["distance"])
    rows, columns, values = [number[:0, 0]], [number[:0, 0]], [size[:0, 0]]
    for y, x in ((0, step), (step, -step), (step, 0), (step, step)):
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
        rows.append(number[near][kept])
        columns.append(number[far][kept])
        values.append(weight[kept])
    pairs = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    one_way = sparse.csr_matrix(pairs, (number.size, number.size), dtype=np.float32)
    both = one_way + one_way.T
    block = (number // width // PIXELS * width + number % width // PIXELS).ravel()
    ends = both.tocoo()
    inside = block[ends.row] == block[ends.col]
    within, across = (
        sparse.csr_matrix((ends.data[own], (ends.row[own], ends.col[own])), both.shape)
        for own in (inside, ~inside)
    )
    within = sparse.csr_matrix(sparse.diags_array(np.ravel(within.sum(axis=1))) - within)
    matrices = [(part, within[part], across[part]) for part in parts]

    def residuals(values: np.ndarray, crossed: np.ndarray) -> Iterator[np.ndarray]:
        flat = values.reshape(len(values), -1)
        masked = (values * crossed[:, None]).reshape(flat.shape)
        for part, inner, outer in matrices:
            own = values[part]
            found = (inner @ flat).reshape(own.shape)
            others = (outer @ masked).reshape(own.shape)
            others -= own * (outer @ crossed)[:, None]
            others *= crossed[part, None]
            found -= others
            yield found

    return residuals


def over_bins(step: int, parts: Sequence[slice]) -> Residuals:
    """Residuals of a binomial filter of three bins `step` apart; nothing leaves the window."""

    def residuals(values: np.ndarray, crossed: np.ndarray) -> Iterator[np.ndarray]:
        for part in parts:
            own = values[part]
            found = np.zeros_like(own)
            if step < own.shape[-1]:
                slope = own[..., step:] - own[..., :-step]
                slope *= np.float32(SIDE)
                found[..., step:] = slope
                found[..., :-step] -= slope
            yield found

    return residuals


def _pixel_size(position: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Distance between first hits of neighbouring pixels [m], as of a sphere around the camera."""
    angles = [np.zeros(0)]
    for axis in (0, 1):
        nearer = np.minimum(*(np.delete(distance, end, axis) for end in (0, -1)))
        apart = np.linalg.norm(np.diff(position, axis=axis), axis=-1)
        angles.append(apart[nearer > 0] / nearer[nearer > 0])
    angle = np.median(np.concatenate(angles)) if sum(map(len, angles)) else 0.0
    return np.maximum(angle * distance, 1e-12)
