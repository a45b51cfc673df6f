"""Phasor fields: the wall is the lens of a virtual camera that looks at the hidden scene.

A virtual pulse of wavelength λ illuminates the scene. Each frequency k of the pulse is a phasor
field at the wall, F(s, k) = sum of H exp(i k opl). Rayleigh-Sommerfeld diffraction propagates this
field to the voxels:

    I(v) = |Σ_k P(k) Σ_l e^(-ik|v - l|) Σ_s F(l, s, k) e^(-ik|v - s|)|².

For each k and depth, the innermost sum is a convolution. In a confocal capture l = s, and the
distance is doubled instead. P is Gaussian: `cycles` wavelengths are within three standard
deviations on both sides of the pulse. The factor 1 / |v - s| of the diffraction integral is
omitted, because it makes near voxels brighter and moves the maximum towards the wall.

Without this factor, points have the correct depth. The light of a plane that is parallel to the
wall reaches all points of the wall. More of this light is in phase for deeper voxels: I grows as
z^n before its maximum, with n about 2.5. For the pulse exp(-4 δ² / σ²) with σ = cycles λ / 6, the
maximum is too deep by δ = n σ² / (8 z).

X. Liu et al., Non-line-of-sight imaging using phasor-field virtual wave optics, Nature 572 (2019);
X. Liu, S. Bauer and A. Velten, Phasor field diffraction based reconstruction for fast
non-line-of-sight imaging systems, Nature Communications 11 (2020).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...runtime import checks
from ...runtime.progress import ProgressBar
from .fourier import fft, require_memory
from .volume import VolumeGrid, resample
from .wall_capture import Measured

# Number of complex values of the kernels that are in memory at the same time
_CHUNK = 1 << 22


def default_wavelength(measured: Measured) -> float:
    """Return the shortest wavelength that the capture samples [m].

    Between neighboring points of the wall, the phase may change by at most half a cycle. Therefore
    the wavelength is twice the spacing. In a confocal capture distances are doubled, so that the
    wavelength is four times the spacing. It is at least four bins.
    """
    times = 4 if measured.mode == "confocal" else 2
    return max(times * measured.spacing, 4 * measured.width)


def phasor_field(
    measured: Measured, grid: VolumeGrid, wavelength: float, cycles: float, progress: bool = True
) -> np.ndarray:
    """Reconstruct a capture on a lattice.

    The field is computed on points opposite to the wall's lattice, at the depths of the voxels, as
    far as the voxels reach. Then it is interpolated along x and y.

    Args:
        measured: The capture.
        grid: The voxels.
        wavelength: Wavelength of the pulse [m].
        cycles: Number of wavelengths in the pulse.
        progress: Whether to show a progress bar.

    Returns:
        Intensities (z, y, x).
    """
    # Choose the frequencies of the pulse
    window = _Window(measured, grid)
    sigma = cycles * wavelength / 6
    depths = grid.centers("z")
    wavenumbers, weights = _pulse(measured, window, depths[0], wavelength, sigma)
    require_memory("phasor", (measured.shape[0], len(wavenumbers), *window.padded), copies=2)

    # Transform the fields at the wall, and propagate them to each depth
    spectra = _fields_at_the_wall(measured, wavenumbers, weights, window)
    planes = np.empty((len(depths), *window.shape), np.float32)
    with ProgressBar("phasor field", len(planes), unit="step", enabled=progress) as bar:
        for index, z in enumerate(depths):
            field = _diffract(measured, window, spectra, wavenumbers, z, 3 * sigma)
            planes[index] = np.square(field.real) + np.square(field.imag)
            bar.update()
    return resample(planes, VolumeGrid(window.x.voxels, window.y.voxels, grid.z), grid)


def _pulse(
    measured: Measured, window: _Window, nearest: float, wavelength: float, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return wavenumbers [rad/m] and weights of the virtual pulse.

    Even wavenumbers repeat the pulse after 2π over their distance. The distance is so small that
    each bin meets the pulse only once.
    """
    # Distance of wavenumbers
    shortest, longest = measured.path_range()
    first_legs = [np.ptp(window.distance(laser, nearest)) for laser in _laser_spots(measured)]
    step = 2 * math.pi / (longest - shortest + max(first_legs, default=0.0) + 6 * sigma)

    # All wavenumbers within three standard deviations
    center = 2 * math.pi / wavelength
    low = max(1, math.ceil((center - 3 / sigma) / step))
    high = math.floor(min(center + 3 / sigma, math.pi / measured.width) / step)
    wavenumbers = step * np.arange(low, high + 1)
    allowed = f"above two bins, {2 * measured.width:g} m"
    checks.require("wavelength", float(wavelength), len(wavenumbers), allowed)
    return wavenumbers, np.exp(-(((wavenumbers - center) * sigma) ** 2) / 2)


def _laser_spots(measured: Measured) -> np.ndarray:
    """Return laser spots with their own phase, (lasers, 3): none in a confocal capture."""
    return np.zeros((0, 3)) if measured.mode == "confocal" else measured.lasers


def _fields_at_the_wall(
    measured: Measured, wavenumbers: np.ndarray, weights: np.ndarray, window: _Window
) -> np.ndarray:
    """Transform P(k) F(l, s, k) over the wall, (lasers, wavenumbers, padded rows, columns)."""
    # Waves at each bin and frequency, as real and imaginary parts
    lasers, rows, columns, bins = measured.shape
    opl = measured.start + (np.arange(bins) + 0.5) * measured.width
    waves: Any = np.exp(1j * np.outer(opl, wavenumbers)) * weights
    waves = np.concatenate([waves.real, waves.imag], axis=1).astype(np.float32)
    spectra = np.empty((lasers, len(wavenumbers), *window.padded), np.complex64)

    # Transform the field of each laser, without the phases of its legs
    for index in range(lasers):
        parts: Any = measured.light(index).reshape(-1, bins) @ waves
        field = (parts[:, : len(wavenumbers)] + 1j * parts[:, len(wavenumbers) :]).T
        field = field.reshape(-1, rows, columns)
        if measured.legs.any():
            field = field * np.exp(-1j * wavenumbers[:, None, None] * measured.legs[index])
        field = field.astype(np.complex64)
        spectra[index] = fft.fft2(field, window.padded, axes=(1, 2), workers=-1)
    return spectra


def _diffract(
    measured: Measured,
    window: _Window,
    spectra: np.ndarray,
    wavenumbers: np.ndarray,
    z: float,
    reach: float,
) -> Any:
    """Sum the field at depth z over frequencies and lasers.

    Paths are omitted if they are longer or shorter than the paths of the window by more than the
    reach of the pulse. Therefore few frequencies are enough.

    Args:
        measured: The capture.
        window: Points at which the field is computed.
        spectra: Transformed fields at the wall.
        wavenumbers: Wavenumbers of the pulse [rad/m].
        z: Depth [m].
        reach: Reach of the pulse [m].

    Returns:
        The complex field, (rows, columns) of the window.
    """
    # Find the paths that the window contains
    shortest, longest = measured.path_range()
    to_lasers = [window.distance(laser, z) for laser in _laser_spots(measured)]
    last_leg = window.lags(z)
    path = last_leg * (1 if to_lasers else 2)
    nearest = np.min([np.min(d) for d in to_lasers] or [0.0])
    farthest = np.max([np.max(d) for d in to_lasers] or [0.0])
    possible = (path > shortest - farthest - reach) & (path < longest - nearest + reach)

    # Convolve the fields, some frequencies at a time
    total = np.zeros(window.shape if to_lasers else window.padded, np.complex64)
    chunk = max(1, _CHUNK // math.prod(window.padded))
    for first in range(0, len(wavenumbers), chunk):
        some = wavenumbers[first : first + chunk]
        kernels = fft.fft2(_phase_factors(path, some, possible), workers=-1, overwrite_x=True)
        for index, spectrum in enumerate(spectra[:, first : first + chunk]):
            # Confocal: the sum over frequencies can be transformed once
            if not to_lasers:
                total += np.einsum("kyx,kyx->yx", spectrum, kernels)
                continue

            # Other captures: multiply by the phase of the leg from the laser
            fields = fft.ifft2(spectrum * kernels, workers=-1, overwrite_x=True)
            factors = _phase_factors(to_lasers[index], some, np.ones(window.shape))
            total += np.einsum("kyx,kyx->yx", window.crop(fields), factors)
    return total if to_lasers else window.crop(fft.ifft2(total, workers=-1))


def _phase_factors(path: np.ndarray, wavenumbers: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    """Return amplitude e^(-ik path) for even steps of k, (k, *path.shape), by multiplication."""
    step = wavenumbers[1] - wavenumbers[0] if len(wavenumbers) > 1 else 0.0
    factor = np.exp(-1j * step * path).astype(np.complex64)
    result = np.empty((len(wavenumbers), *path.shape), np.complex64)
    result[0] = amplitude * np.exp(-1j * wavenumbers[0] * path)
    for index in range(1, len(wavenumbers)):
        np.multiply(result[index - 1], factor, out=result[index])
    return result


@dataclass(frozen=True)
class _Axis:
    """Rows or columns of the wall's lattice, and of a window opposite to the voxels."""

    # Coordinate of point 0 of the lattice [m]
    zero: float

    # Distance of neighboring points [m]
    step: float

    # Number of points of the wall
    count: int

    # Index of the window's first point on the lattice
    first: int

    # Number of points of the window
    size: int

    # Length of the transforms
    padded: int

    @classmethod
    def of(cls, zero: float, step: float, count: int, centers: np.ndarray) -> _Axis:
        """Create the window that covers the centers of voxels [m]."""
        low, high = (centers[[0, -1]] - zero) / step
        first = math.floor(low + 1e-6)
        size = math.ceil(high - 1e-6) - first + 1
        return cls(
            zero=zero,
            step=step,
            count=count,
            first=first,
            size=size,
            padded=fft.next_fast_len(count + size - 1),
        )

    @property
    def points(self) -> np.ndarray:
        """Return the coordinates of the window's points [m]."""
        return self.zero + self.step * (self.first + np.arange(self.size))

    @property
    def voxels(self) -> tuple[float, float, int]:
        """Return the axis of a volume with one voxel around each point of the window."""
        return self.points[0] - self.step / 2, self.points[-1] + self.step / 2, self.size

    @property
    def lags(self) -> np.ndarray:
        """Return the distances of window point n and wall point m, in the order of n - m [m].

        The first lag has n - m = first - (count - 1). Then index count - 1 + n of a
        convolution is the sum over the wall for the window's point n.
        """
        return self.step * (self.first - (self.count - 1) + np.arange(self.padded))


class _Window:
    """Points opposite to the wall's lattice at which fields are computed.

    Args:
        measured: The capture, on a lattice.
        grid: The voxels that the window covers.
    """

    def __init__(self, measured: Measured, grid: VolumeGrid) -> None:
        lattice = measured.lattice
        assert lattice is not None
        rows, columns = measured.sensors.shape[:2]
        self.y = _Axis.of(lattice.y0, lattice.dy, rows, grid.centers("y"))
        self.x = _Axis.of(lattice.x0, lattice.dx, columns, grid.centers("x"))
        self.shape = self.y.size, self.x.size
        self.padded = self.y.padded, self.x.padded

    def distance(self, point: np.ndarray, z: float) -> np.ndarray:
        """Return the distances of the window's points at depth z from a point [m]."""
        y = self.y.points[:, None] - point[1]
        x = self.x.points - point[0]
        return np.sqrt(y**2 + x**2 + (z - point[2]) ** 2)

    def lags(self, z: float) -> np.ndarray:
        """Return the distances of window points at depth z from wall points, by their lag [m]."""
        y = self.y.lags[:, None]
        x = self.x.lags
        return np.sqrt(y**2 + x * x + z * z)

    def crop(self, fields: np.ndarray) -> np.ndarray:
        """Crop padded planes (..., rows, columns) to the window."""
        rows = slice(self.y.count - 1, self.y.count - 1 + self.y.size)
        columns = slice(self.x.count - 1, self.x.count - 1 + self.x.size)
        return fields[..., rows, columns]
