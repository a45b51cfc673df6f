"""Luminance of colours."""

import numpy as np

from ..runtime import checks

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Weights of linear R, G and B (ITU-R BT.709), with the digits of `mi.luminance`."""


def luminance(values: np.ndarray) -> np.ndarray:
    """Luminance (...) of linear values (..., 3); of (..., 1), the values.

    Example:
        >>> luminance(np.array([[2.0, 2.0, 2.0], [0.0, 1.0, 0.0]]))
        array([2.     , 0.71516])
    """
    values = checks.real_array("values", values)
    if values.shape[-1:] not in ((1,), (3,)):
        raise ValueError(f"values with shape {values.shape}: must have 1 or 3 channels last")
    if values.shape[-1] == 1:
        return values[..., 0]
    red, green, blue = (values[..., c] * weight for c, weight in enumerate(LUMINANCE.tolist()))
    return red + green + blue  # A matrix product may warn of infinities
