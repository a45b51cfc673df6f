"""Conversion of spectra to the channels of films."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..signals.polarization import components


def to_rgb(
    spectrum: mi.UnpolarizedSpectrum, wavelengths: mi.Wavelength, active: mi.Bool | bool = True
) -> mi.Color3f:
    """Convert a spectrum of the active variant to linear RGB.

    Args:
        spectrum: The spectrum.
        wavelengths: Sampled wavelengths [nm], for spectral variants.
        active: Active lanes.
    """
    # The type of spectra depends on the variant
    if mi.is_monochromatic:
        return mi.Color3f(spectrum[0])
    if mi.is_spectral:
        return mi.spectrum_to_srgb(spectrum, wavelengths, active)
    return mi.Color3f(spectrum)


def kept(rgb: mi.Color3f) -> list[mi.Float]:
    """Return the channels of a color that films store: 1 in monochromatic variants, otherwise 3."""
    return [rgb.x] if mi.is_monochromatic else [rgb.x, rgb.y, rgb.z]


def channels_of(
    light: mi.Spectrum, wavelengths: mi.Wavelength, active: mi.Bool | bool = True
) -> list[mi.Float]:
    """Convert light to the channels of a film, for each Stokes component in polarized variants."""
    return [c for each in components(light) for c in kept(to_rgb(each, wavelengths, active))]


def units_of(wavelengths: mi.Wavelength) -> list[mi.Color3f]:
    """Return, for each sampled wavelength [nm], the RGB color of light of 1 at this wavelength."""
    units = np.eye(dr.size_v(mi.UnpolarizedSpectrum), dtype=np.float32).tolist()
    return [to_rgb(mi.UnpolarizedSpectrum(*unit), wavelengths) for unit in units]


def channels_by(units: Sequence[mi.Color3f], light: mi.Spectrum) -> list[mi.Float]:
    """Convert light to channels as `channels_of` does, with units that `units_of` returned."""
    values: list[mi.Float] = []
    for spectrum in components(light):
        rgb = mi.Color3f(0)
        for value, unit in zip(spectrum, units, strict=True):
            rgb = dr.fma(unit, value, rgb)
        values += list(rgb)
    return values


def color_count(image: mi.Film) -> int:
    """Return the number of an image's channels before the weight channel: RGB, and alpha."""
    return 4 if mi.has_flag(image.flags(), mi.FilmFlags.Alpha) else 3
