"""Colours of lights that are no emitters of Mitsuba's: numbers, RGB, or spectra under D65."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def white(wavelengths: Any) -> Any:
    """Light that looks like the colour (1, 1, 1), as of an emitter of that colour.

    Args:
        wavelengths: Sampled wavelengths of the rays [nm]; only spectral variants look at them.

    Returns:
        An `mi.UnpolarizedSpectrum`: 1, in spectral variants the standard illuminant D65 of
        luminance 1. (Equal energy at all wavelengths has the colour (1.21, .95, .91).)

    Example:
        >>> float(white(mi.Color0f())[0][0])
        1.0
    """
    if not mi.is_spectral:
        return mi.UnpolarizedSpectrum(1)
    lanes: list[Any] = [mi.Float(each) for each in wavelengths]
    return mi.UnpolarizedSpectrum(*map(mi.cie_d65, lanes))


class Colours:
    """A table of colours of lights, as what the variant calculates with.

    Args:
        rgb: Red, green and blue, 0 or more, shape (n, 3).

    Example:
        >>> table = Colours(np.array([[1.0, 0.5, 0.25], [2.0, 2.0, 2.0]]))
        >>> mi.Color3f(table.at(mi.UInt32(1), mi.Color0f())).y.numpy().tolist()
        [2.0]
    """

    def __init__(self, rgb: np.ndarray) -> None:
        rgb = np.asarray(rgb, dtype=np.float64)
        if mi.is_monochromatic:
            self._values: Any = mi.luminance(mi.Color3f(rgb.T.copy()))
        elif mi.is_spectral:
            # As Mitsuba makes emitters of colours: D65 times twice the largest component, times a
            # smooth reflectance of which that component is one half
            unique, place = np.unique(rgb, axis=0, return_inverse=True)
            scale = 2 * unique.max(axis=1)
            reflectances = unique / np.where(scale > 0, scale, 1)[:, None]
            fetched = [mi.srgb_model_fetch(mi.ScalarColor3f(c)) for c in reflectances.tolist()]
            place = place.ravel()
            self._values = mi.Vector3f(np.array(fetched)[place].reshape(-1, 3).T.copy())
            self._scale = mi.Float(scale[place].tolist())
            dr.eval(self._scale)
        else:
            self._values = mi.Color3f(rgb.T.copy())
        dr.eval(self._values)

    def at(self, index: mi.UInt32, wavelengths: Any, active: mi.Bool | bool = True) -> Any:
        """The colour with a number, an `mi.UnpolarizedSpectrum`; wavelengths are as for `white`."""
        values = dr.gather(type(self._values), self._values, index, active)
        if not mi.is_spectral:
            return mi.UnpolarizedSpectrum(values)
        scale: Any = dr.gather(mi.Float, self._scale, index, active)
        shape = mi.srgb_model_eval(values, mi.UnpolarizedSpectrum(wavelengths))
        return scale * mi.UnpolarizedSpectrum(shape) * white(wavelengths)
