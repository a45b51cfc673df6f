"""Color maps that color-blind readers can read too."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.colors import LinearSegmentedColormap, ListedColormap

# OKLab, an approximately perceptually uniform space (B. Ottosson, 2020)
_LMS = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


@functools.cache
def phase_map() -> ListedColormap:
    """Return a cyclic color map with equal steps, for angles.

    The map is an ellipse in OKLab, across lightness and from yellow to blue. Readers with red-green
    blindness can distinguish these colors. If phases differ by more than an eighth of a turn, the
    distance of their colors in OKLab is at least 0.14, with or without deuteranopia. In
    Matplotlib's map "twilight", the smallest such distance is 0.03.
    """
    return _ellipse("phase", (0.526, 0.077, -0.046), (0.245, 0.033, 0.148))


@functools.cache
def hue_map() -> ListedColormap:
    """Return a cyclic map of light colors, which are multiplied by the brightness of a picture."""
    return _ellipse("hue", (0.78, -0.044, 0.025), (0.145, 0.064, 0.11))


def _ellipse(name: str, center: Sequence[float], reach: Sequence[float]) -> ListedColormap:
    """Return 512 colors in equal steps on an ellipse in OKLab.

    The lightest color is at both ends of the map. L and a (green to red) follow the cosine, b (blue
    to yellow) the sine.
    """
    from matplotlib.colors import ListedColormap

    # Find angles with equal steps along the ellipse
    angle = np.linspace(0, 2 * math.pi, 4097)
    waves = np.stack([np.cos(angle), np.cos(angle), np.sin(angle)], axis=1)
    lab = np.add(center, np.multiply(reach, waves))
    steps = np.linalg.norm(np.diff(lab, axis=0), axis=1)
    arc_length = np.concatenate([[0], np.cumsum(steps)]) / steps.sum()
    angles = np.interp(np.arange(512) / 512, arc_length, angle)

    # Convert their colors from OKLab to sRGB
    even = np.stack([np.interp(angles, angle, part) for part in lab.T], axis=1)
    linear = np.clip((even @ np.linalg.inv(_LAB).T) ** 3 @ np.linalg.inv(_LMS).T, 0, 1)
    return ListedColormap(to_srgb(linear).tolist(), name=name)


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Encode linear values in [0, 1] by the sRGB curve (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def from_srgb(srgb: np.ndarray) -> np.ndarray:
    """Decode sRGB values in [0, 1] to linear values."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


@functools.cache
def time_map() -> LinearSegmentedColormap:
    """Return a map from blue (early) to orange (late), with full brightness everywhere."""
    from matplotlib.colors import LinearSegmentedColormap

    stops = [(0.15, 0.4, 1), (0.35, 0.8, 1), (0.7, 1, 0.6), (1, 0.85, 0.2), (1, 0.45, 0)]
    positions = np.linspace(0, len(stops) - 1, 1021)
    channels = [np.interp(positions, range(len(stops)), part) for part in zip(*stops, strict=True)]
    colors = np.stack(channels, axis=1)
    colors /= colors.max(axis=1, keepdims=True)
    return LinearSegmentedColormap.from_list("early to late", colors.tolist(), N=1021)
