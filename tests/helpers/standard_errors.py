"""Do standard errors cover the truth as often as they should?"""

import numpy as np
from scipy.stats import t as student

from tofrender.rendering.errors import BATCHES

SIGMAS = 4.5
"""Distance of a mean from what is expected that right code exceeds 7 times in a million."""

SLACK = 0.01  # What means of 16 batches are off from Student's t, as they are not quite normal


def covered(values, errors, expected) -> np.ndarray:
    """Whether the truth is within one, and within two, errors; on a last axis."""
    off = np.abs(np.asarray(values, float) - expected)
    errors = np.asarray(errors, float) * (1 + 1e-6)
    return np.stack([off <= errors, off <= 2 * errors], axis=-1)


def is_calibrated(found: np.ndarray, freedom: int = BATCHES - 1) -> bool:
    """Whether shares are Student's; `found` has pixels, which are independent, first."""
    by_pixel = found.reshape(len(found), -1, 2).mean(axis=1)
    noise = by_pixel.std(axis=0, ddof=1) / np.sqrt(len(by_pixel))
    expected = 2 * student.cdf([1.0, 2.0], freedom) - 1
    return bool((np.abs(by_pixel.mean(axis=0) - expected) <= SIGMAS * noise + SLACK).all())


def bins_of(film, name: str = "transient") -> np.ndarray:
    """The first channel, pixels first; all channels are the same in these scenes."""
    values = film[name].values[..., 0]
    return values.reshape(values.shape[0] * values.shape[1], -1)
