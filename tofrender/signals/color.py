"""Luminance of colors."""

import numpy as np

from ..runtime import checks

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Weights of linear R, G and B (ITU-R BT.709), equal to those in `mi.luminance`."""


def luminance(values: np.ndarray) -> np.ndarray:
    """Return the luminance (...) of linear RGB values (..., 3).

    Values with one channel (..., 1) are returned without the last axis.

    Raises:
        ValueError: If the last axis has another length than 1 or 3.

    Example:
        >>> luminance(np.array([[2.0, 2.0, 2.0], [0.0, 1.0, 0.0]]))
        array([2.     , 0.71516])
    """
    values = checks.real_array("values", values)
    if values.shape[-1:] not in ((1,), (3,)):
        raise ValueError(
            f"values with shape {values.shape}: the last axis must have 1 or 3 channels"
        )
    if values.shape[-1] == 1:
        return values[..., 0]

    # A matrix product would warn of infinite values
    red, green, blue = (values[..., c] * weight for c, weight in enumerate(LUMINANCE.tolist()))
    return red + green + blue
