"""Floating-point numbers that the parameters of a scene consist of."""

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

SHOWN = 16  # Most numbers of a parameter that a message shows


def floats_of(value: Any) -> Iterator[Any]:
    """Arrays of floating-point numbers that a parameter consists of."""
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
    """Whether a parameter is a transform of Mitsuba's."""
    return "Transform" in type(value).__name__


def is_spectral_coefficients(value: Any) -> bool:
    """Whether a parameter consists of coefficients of spectra, which may be negative.

    Spectral variants convert RGB colors into three coefficients of a smooth spectrum. Environment
    maps and volumes have a scale as their fourth channel.
    """
    if not mi.is_spectral:
        return False
    if dr.is_tensor_v(value):
        return len(value.shape) > 2 and value.shape[-1] in (3, 4)
    return isinstance(value, mi.Color3f)


def is_wavelength(name: str) -> bool:
    """Whether a parameter, by its whole name, has the wavelengths [nm] of a spectrum."""
    return name.rpartition(".")[2] in ("wavelengths", "range")


def require_all(
    name: str, value: Any, good: Callable[[np.ndarray], np.ndarray], allowed: str
) -> None:
    """Refuse a parameter that has a wrong number; shows all numbers if they are few."""
    flat = np.concatenate([np.ravel(np.asarray(leaf)) for leaf in floats_of(value)] or [[]])
    wrong = np.flatnonzero(~good(flat))
    if wrong.size:
        shown = f"[{wrong[0]}] = {flat[wrong[0]]:g}"
        if flat.size == 1:
            shown = f" = {flat[0]:g}"
        elif flat.size <= SHOWN:
            shown = f" = [{', '.join(f'{x:g}' for x in flat)}]"
        raise ValueError(f"{name}{shown}: must be {allowed}")
