"""Colours of light, as the channels of a film hold them."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..signals.polarisation import components


def to_rgb(
    spectrum: mi.UnpolarizedSpectrum, wavelengths: mi.Wavelength, active: mi.Bool | bool = True
) -> mi.Color3f:
    """Colour of a spectrum, in whatever way the variant stores it."""
    if mi.is_monochromatic:
        return mi.Color3f(spectrum[0])
    if mi.is_spectral:
        return mi.spectrum_to_srgb(spectrum, wavelengths, active)
    return mi.Color3f(spectrum)


def kept(rgb: mi.Color3f) -> list[mi.Float]:
    """Return the channels of a colour that films store: 1 in monochromatic variants, else 3."""
    return [rgb.x] if mi.is_monochromatic else [rgb.x, rgb.y, rgb.z]


def channels_of(
    light: mi.Spectrum, wavelengths: mi.Wavelength, active: mi.Bool | bool = True
) -> list[mi.Float]:
    """The channels of light: those of its colour, or of each Stokes component."""
    return [c for each in components(light) for c in kept(to_rgb(each, wavelengths, active))]


def units_of(wavelengths: mi.Wavelength) -> list[mi.Color3f]:
    """RGB of light that is 1 at one of the sampled wavelengths [nm], for each of them."""
    units = np.eye(dr.size_v(mi.UnpolarizedSpectrum), dtype=np.float32).tolist()
    return [to_rgb(mi.UnpolarizedSpectrum(*unit), wavelengths) for unit in units]


def channels_by(units: Sequence[mi.Color3f], light: mi.Spectrum) -> list[mi.Float]:
    """Return the channels of light by the colours of its wavelengths, see `units_of`."""
    values: list[mi.Float] = []
    for spectrum in components(light):
        rgb = mi.Color3f(0)
        for value, colour in zip(spectrum, units, strict=True):
            rgb = dr.fma(colour, value, rgb)
        values += list(rgb)
    return values


def colour_count(image: mi.Film) -> int:
    """Channels of an image before its weight."""
    return 4 if mi.has_flag(image.flags(), mi.FilmFlags.Alpha) else 3
