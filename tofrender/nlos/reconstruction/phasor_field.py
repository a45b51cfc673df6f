"""Phasor fields: the wall as the lens of a virtual camera that looks at the hidden scene.

A virtual pulse of wavelength λ lights the scene. Each of its frequencies is a phasor field at the
wall, F(s, k) = sum of H exp(i k opl), which Rayleigh-Sommerfeld diffraction carries to the voxels:

    I(v) = |Σ_k P(k) Σ_l e^(-ik|v - l|) Σ_s F(l, s, k) e^(-ik|v - s|)|².

For each k and depth the innermost sum is a convolution. In a confocal capture l = s, and the
distance is doubled instead. P is Gaussian: `cycles` wavelengths lie within three standard
deviations to each side of the pulse. The diffraction integral's 1 / |v - s| is left out: it makes
near voxels brighter, which pulls the maximum of a pulse of some decimetres towards the wall.
Without it a point is found where it is. A plane that is parallel to the wall sends light to all of
it, the more of it in phase the deeper the voxel is: with I growing as z^n before its maximum, the
pulse exp(-4 δ² / σ²) of σ = cycles λ / 6 has it δ = n σ² / (8 z) too deep, and n is about 2.5.
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
from .measured import Measured
from .volume import VolumeGrid, resample

_CHUNK = 1 << 22  # complex numbers of the kernels in memory at a time


def default_wavelength(measured: Measured) -> float:
    """Shortest wavelength that the capture samples [m].

    The phase may change by half a cycle from one point of the wall to the next: twice the spacing,
    in a confocal capture, where distances are doubled, four times; and never below four bins.
    """
    times = 4 if measured.mode == "confocal" else 2
    return max(times * measured.spacing, 4 * measured.width)


def phasor_field(
    measured: Measured, grid: VolumeGrid, wavelength: float, cycles: float, progress: bool = True
) -> np.ndarray:
    """Intensities (z, y, x) of a capture on a lattice, with a pulse of `cycles` wavelengths [m].

    The field is computed at the depths of the voxels, on points opposite to the wall's lattice that
    reach as far as they do, and interpolated along x and y.
    """
    window = _Window(measured, grid)
    sigma = cycles * wavelength / 6  # of the pulse [m]
    depths = grid.centres("z")
    wavenumbers, weights = _pulse(measured, window, depths[0], wavelength, sigma)
    require_memory("phasor", (measured.shape[0], len(wavenumbers), *window.padded), copies=2)
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
    """Wavenumbers [rad/m] and weights of the virtual pulse.

    Their distance is so small that the pulse, which repeats after 2π over it, meets no bin twice.
    """
    shortest, longest = measured.path_range()
    first_legs = [np.ptp(window.distance(laser, nearest)) for laser in _laser_spots(measured)]
    step = 2 * math.pi / (longest - shortest + max(first_legs, default=0.0) + 6 * sigma)
    centre = 2 * math.pi / wavelength
    low = max(1, math.ceil((centre - 3 / sigma) / step))
    high = math.floor(min(centre + 3 / sigma, math.pi / measured.width) / step)
    wavenumbers = step * np.arange(low, high + 1)
    allowed = f"above two bins, {2 * measured.width:g} m"
    checks.require("wavelength", float(wavelength), len(wavenumbers), allowed)
    return wavenumbers, np.exp(-(((wavenumbers - centre) * sigma) ** 2) / 2)


def _laser_spots(measured: Measured) -> np.ndarray:
    """Laser spots with a phase of their own, (lasers, 3): none in a confocal capture."""
    return np.zeros((0, 3)) if measured.mode == "confocal" else measured.lasers


def _fields_at_the_wall(
    measured: Measured, wavenumbers: np.ndarray, weights: np.ndarray, window: _Window
) -> np.ndarray:
    """Transform P(k) F(l, s, k) over the wall, (lasers, wavenumbers, padded rows, columns)."""
    lasers, rows, columns, bins = measured.shape
    opl = measured.start + (np.arange(bins) + 0.5) * measured.width
    waves: Any = np.exp(1j * np.outer(opl, wavenumbers)) * weights
    waves = np.concatenate([waves.real, waves.imag], axis=1).astype(np.float32)
    spectra = np.empty((lasers, len(wavenumbers), *window.padded), np.complex64)
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
    """Sum the field at depth z over frequencies and lasers, (rows, columns) of the window.

    Paths longer or shorter than those of the window by more than the `reach` of the pulse [m] are
    left out, so that few frequencies are enough.
    """
    shortest, longest = measured.path_range()
    to_lasers = [window.distance(laser, z) for laser in _laser_spots(measured)]
    last_leg = window.lags(z)
    path = last_leg * (1 if to_lasers else 2)
    nearest, farthest = (f([f(d) for d in to_lasers] or [0.0]) for f in (np.min, np.max))
    possible = (path > shortest - farthest - reach) & (path < longest - nearest + reach)
    total = np.zeros(window.shape if to_lasers else window.padded, np.complex64)
    chunk = max(1, _CHUNK // math.prod(window.padded))
    for first in range(0, len(wavenumbers), chunk):
        some = wavenumbers[first : first + chunk]
        kernels = fft.fft2(_phase_factors(path, some, possible), workers=-1, overwrite_x=True)
        for index, spectrum in enumerate(spectra[:, first : first + chunk]):
            if not to_lasers:
                total += np.einsum("kyx,kyx->yx", spectrum, kernels)
                continue
            fields = fft.ifft2(spectrum * kernels, workers=-1, overwrite_x=True)
            factors = _phase_factors(to_lasers[index], some, np.ones(window.shape))
            total += np.einsum("kyx,kyx->yx", window.crop(fields), factors)
    return total if to_lasers else window.crop(fft.ifft2(total, workers=-1))


def _phase_factors(path: np.ndarray, wavenumbers: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    """Compute amplitude e^(-ik path) for even steps of k, (k, *path.shape), by products."""
    step = wavenumbers[1] - wavenumbers[0] if len(wavenumbers) > 1 else 0.0
    factor = np.exp(-1j * step * path).astype(np.complex64)
    result = np.empty((len(wavenumbers), *path.shape), np.complex64)
    result[0] = amplitude * np.exp(-1j * wavenumbers[0] * path)
    for index in range(1, len(wavenumbers)):
        np.multiply(result[index - 1], factor, out=result[index])
    return result


@dataclass(frozen=True)
class _Axis:
    """Rows or columns of the wall's lattice, and of a window of it opposite to the voxels."""

    zero: float  # coordinate of the lattice's point 0 [m]
    step: float  # distance of neighbouring points [m]
    count: int  # number of the wall's points
    first: int  # index of the window's first point on the lattice
    size: int  # number of the window's points
    padded: int  # length of the transforms

    @classmethod
    def of(cls, zero: float, step: float, count: int, centres: np.ndarray) -> _Axis:
        """Make the window that holds voxels of some centres [m]."""
        low, high = (centres[[0, -1]] - zero) / step
        first = math.floor(low + 1e-6)
        size = math.ceil(high - 1e-6) - first + 1
        return cls(zero, step, count, first, size, fft.next_fast_len(count + size - 1))

    @property
    def points(self) -> np.ndarray:
        """Coordinates of the window's points [m]."""
        return self.zero + self.step * (self.first + np.arange(self.size))

    @property
    def voxels(self) -> tuple[float, float, int]:
        """Axis of a volume with one voxel around each of the window's points."""
        return self.points[0] - self.step / 2, self.points[-1] + self.step / 2, self.size

    @property
    def lags(self) -> np.ndarray:
        """Differences of window point n and wall point m, by n - m [m].

        From first - (count - 1) up, so that index count - 1 + n of a product of transforms is the
        sum over the wall at the window's point n.
        """
        return self.step * (self.first - (self.count - 1) + np.arange(self.padded))


class _Window:
    """Points opposite to the wall's lattice where fields are computed."""

    def __init__(self, measured: Measured, grid: VolumeGrid) -> None:
        lattice = measured.lattice
        assert lattice is not None
        rows, columns = measured.sensors.shape[:2]
        self.y = _Axis.of(lattice.y0, lattice.dy, rows, grid.centres("y"))
        self.x = _Axis.of(lattice.x0, lattice.dx, columns, grid.centres("x"))
        self.shape = self.y.size, self.x.size
        self.padded = self.y.padded, self.x.padded

    def distance(self, point: np.ndarray, z: float) -> np.ndarray:
        """Distances of the window's points at depth z from a point [m]."""
        y, x = self.y.points[:, None] - point[1], self.x.points - point[0]
        return np.sqrt(y**2 + x**2 + (z - point[2]) ** 2)

    def lags(self, z: float) -> np.ndarray:
        """Distances of the window's points at depth z from the wall's, by differences [m]."""
        y, x = self.y.lags[:, None], self.x.lags
        return np.sqrt(y**2 + x * x + z * z)

    def crop(self, fields: np.ndarray) -> np.ndarray:
        """Crop padded planes (..., rows, columns) to the window."""
        rows, columns = (slice(a.count - 1, a.count - 1 + a.size) for a in (self.y, self.x))
        return fields[..., rows, columns]
