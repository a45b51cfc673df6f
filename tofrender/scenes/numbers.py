"""Extract and check the floating-point numbers of scene parameters."""

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

SHOWN = 16  # Largest number of values that a message shows


def floats_of(value: Any) -> Iterator[Any]:
    """Yield the arrays of floating-point numbers in a parameter, e.g. the channels of a color."""
    if is_transform(value):
        value = value.matrix
    if dr.is_tensor_v(value):
        value = value.array
    if dr.depth_v(value) > 1 or (dr.depth_v(value) == 1 and not dr.is_jit_v(value)):
        for each in value:
            yield from floats_of(each)
    elif isinstance(value, float) or (dr.is_array_v(value) and dr.is_float_v(value)):
        yield value


def is_transform(value: Any) -> bool:
    """Return whether a parameter is a transform of Mitsuba."""
    return "Transform" in type(value).__name__


def is_spectral_coefficients(value: Any) -> bool:
    """Return whether a parameter contains coefficients of spectra, which may be negative.

    Spectral variants convert an RGB color to three coefficients of a smooth spectrum. In
    environment maps and volumes, a scale follows as fourth channel.
    """
    if not mi.is_spectral:
        return False
    if dr.is_tensor_v(value):
        return len(value.shape) > 2 and value.shape[-1] in (3, 4)
    return isinstance(value, mi.Color3f)


def is_wavelength(name: str) -> bool:
    """Return whether a parameter with this full name contains wavelengths [nm] of a spectrum."""
    return name.rpartition(".")[2] in ("wavelengths", "range")


def require_all(
    name: str, value: Any, good: Callable[[np.ndarray], np.ndarray], allowed: str
) -> None:
    """Raise a ValueError if a parameter has a wrong number. The message shows a few numbers.

    Args:
        name: Name of the parameter.
        value: Value of the parameter.
        good: Function that returns which numbers of an array are allowed.
        allowed: Description of allowed numbers, for the message.
    """
    flat = np.concatenate([np.ravel(np.asarray(leaf)) for leaf in floats_of(value)] or [[]])
    wrong = np.flatnonzero(~good(flat))
    if wrong.size:
        shown = f"[{wrong[0]}] = {flat[wrong[0]]:g}"
        if flat.size == 1:
            shown = f" = {flat[0]:g}"
        elif flat.size <= SHOWN:
            shown = f" = [{', '.join(f'{x:g}' for x in flat)}]"
        raise ValueError(f"{name}{shown}: must be {allowed}")
