"""Colors of light sources that are not Mitsuba emitters, in any variant."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def white(wavelengths: Any) -> Any:
    """Return the spectrum of an emitter with the color (1, 1, 1).

    In spectral variants, this is the standard illuminant D65 with luminance 1 at the sampled
    wavelengths [nm]. A spectrum with equal energy at all wavelengths would have the color
    (1.21, 0.95, 0.91).
    """
    if not mi.is_spectral:
        return mi.UnpolarizedSpectrum(1)
    lanes: list[Any] = [mi.Float(each) for each in wavelengths]
    return mi.UnpolarizedSpectrum(*map(mi.cie_d65, lanes))


class Colors:
    """Table of the colors of light sources, which can be evaluated as spectra.

    Args:
        rgb: Linear RGB colors of shape (n, 3), 0 or more.
    """

    def __init__(self, rgb: np.ndarray) -> None:
        rgb = np.asarray(rgb, dtype=np.float64)
        if mi.is_monochromatic:
            self._values: Any = mi.luminance(mi.Color3f(rgb.T.copy()))
        elif mi.is_spectral:
            # Mitsuba's emitters are D65 times a scale times a smooth reflectance. The scale is
            # twice the largest component, so that the reflectance is at most one half.
            unique, index = np.unique(rgb, axis=0, return_inverse=True)
            scale = 2 * unique.max(axis=1)
            reflectances = unique / np.where(scale > 0, scale, 1)[:, None]
            fetched = [mi.srgb_model_fetch(mi.ScalarColor3f(c)) for c in reflectances.tolist()]
            index = index.ravel()
            self._values = mi.Vector3f(np.array(fetched)[index].reshape(-1, 3).T.copy())
            self._scale = mi.Float(scale[index].tolist())
            dr.eval(self._scale)
        else:
            self._values = mi.Color3f(rgb.T.copy())
        dr.eval(self._values)

    def at(self, index: mi.UInt32, wavelengths: Any, active: mi.Bool | bool = True) -> Any:
        """Return the spectrum of the color with an index, an `mi.UnpolarizedSpectrum`."""
        values = dr.gather(type(self._values), self._values, index, active)
        if not mi.is_spectral:
            return mi.UnpolarizedSpectrum(values)
        scale: Any = dr.gather(mi.Float, self._scale, index, active)
        shape = mi.srgb_model_eval(values, mi.UnpolarizedSpectrum(wavelengths))
        return scale * mi.UnpolarizedSpectrum(shape) * white(wavelengths)
