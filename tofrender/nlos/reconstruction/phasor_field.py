"""Phasor fields: the wall as the lens of a camera that looks at the hidden scene.

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

from .fourier import Steps, fft, require_memory
from .measured import Lattice, Measured
from .volume import VolumeGrid, resample


def default_wavelength(measured: Measured) -> float:
    """The shortest wavelength that the capture can carry [m].

    The phase may turn by half a cycle from one point of the wall to the next: twice the spacing,
    in a confocal capture, where distances are doubled, four times; and never below four bins.
    """
    times = 4 if measured.mode == "confocal" else 2
    return max(times * measured.spacing, 4 * measured.width)


def phasor_field(
    measured: Measured, grid: VolumeGrid, wavelength: float, cycles: float, progress: bool = True
) -> np.ndarray:
    """Intensities (z, y, x) of a capture on a lattice.

    The virtual pulse has `cycles` wavelengths [m]. The field is computed at the depths of the
    voxels, on points of the wall's lattice that reach as far as they do, and interpolated along x
    and y.
    """
    window = _Window.of(measured, grid)
    sigma = cycles * wavelength / 6  # of the pulse [m]
    depths = grid.centres("z")
    wavenumbers, weights = _pulse(measured, window, depths[0], wavelength, sigma)
    require_memory("phasor", (measured.shape[0], len(wavenumbers), *window.padded), copies=2)
    spectra = _fields_at_the_wall(measured, wavenumbers, weights, window)
    planes = np.empty((len(depths), *window.shape), np.float32)
    with Steps("phasor field", len(planes), progress) as steps:
        for index, z in enumerate(depths):
            field = _diffract(measured, window, spectra, wavenumbers, z, 3 * sigma)
            planes[index] = np.square(field.real) + np.square(field.imag)
            steps.done()
    return resample(planes, window.grid(grid), grid)


def _pulse(
    measured: Measured, window: _Window, nearest: float, wavelength: float, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Wavenumbers [rad/m] and weights of the virtual pulse.

    They are so close that the pulse, which repeats after 2π / their distance, meets no bin twice.
    """
    shortest, longest = measured.path_range()
    first_legs = [np.ptp(window.distance(laser, nearest)) for laser in _lit(measured)]
    step = 2 * math.pi / (longest - shortest + max(first_legs, default=0.0) + 6 * sigma)
    centre = 2 * math.pi / wavelength
    low = max(1, math.ceil((centre - 3 / sigma) / step))
    high = math.floor(min(centre + 3 / sigma, math.pi / measured.width) / step)
    wavenumbers = step * np.arange(low, high + 1)
    if not len(wavenumbers):
        raise ValueError(
            f"wavelength = {wavelength:g}: must be above two bins, {2 * measured.width:g} m"
        )
    return wavenumbers, np.exp(-(((wavenumbers - centre) * sigma) ** 2) / 2)


def _lit(measured: Measured) -> np.ndarray:
    """The lit points with a phase of their own, (lasers, 3): none in a confocal capture."""
    return np.zeros((0, 3)) if measured.mode == "confocal" else measured.lasers


def _fields_at_the_wall(
    measured: Measured, wavenumbers: np.ndarray, weights: np.ndarray, window: _Window
) -> np.ndarray:
    """Spectra over the wall of P(k) F(l, s, k), (lasers, wavenumbers, padded rows, columns)."""
    lasers, rows, columns, bins = measured.shape
    opl = measured.start + (np.arange(bins) + 0.5) * measured.width
    turns: Any = np.exp(1j * np.outer(opl, wavenumbers)) * weights
    turns = np.concatenate([turns.real, turns.imag], axis=1).astype(np.float32)
    spectra = np.empty((lasers, len(wavenumbers), *window.padded), np.complex64)
    for index in range(lasers):
        parts: Any = measured.light(index).reshape(-1, bins) @ turns
        field = (parts[:, : len(wavenumbers)] + 1j * parts[:, len(wavenumbers) :]).T
        field = field.reshape(-1, rows, columns)
        if measured.legs.any():
            field = field * np.exp(-1j * wavenumbers[:, None, None] * measured.legs[index])
        spectra[index] = fft.fft2(
            field.astype(np.complex64), window.padded, axes=(1, 2), workers=-1
        )
    return spectra


def _diffract(
    measured: Measured,
    window: _Window,
    spectra: np.ndarray,
    wavenumbers: np.ndarray,
    z: float,
    reach: float,
) -> Any:
    """The field at depth z, (rows, columns) of the window, summed over frequencies and lasers.

    Ways that no light of the capture can have gone, nor its pulse, which reaches so far [m], are
    left out. Without them, few frequencies are enough.
    """
    shortest, longest = measured.path_range()
    to_lasers = [window.distance(laser, z) for laser in _lit(measured)]
    last_leg = window.lags(z)
    path = last_leg * (1 if to_lasers else 2)
    nearest, farthest = (f([f(d) for d in to_lasers] or [0.0]) for f in (np.min, np.max))
    possible = (path > shortest - farthest - reach) & (path < longest - nearest + reach)
    total = np.zeros(window.shape if to_lasers else window.padded, np.complex64)
    chunk = max(1, _CHUNK // math.prod(window.padded))
    for first in range(0, len(wavenumbers), chunk):
        some = wavenumbers[first : first + chunk]
        kernels = fft.fft2(_turning(path, some, possible), workers=-1, overwrite_x=True)
        for index, spectrum in enumerate(spectra[:, first : first + chunk]):
            if not to_lasers:
                total += np.einsum("kyx,kyx->yx", spectrum, kernels)
                continue
            fields = fft.ifft2(spectrum * kernels, workers=-1, overwrite_x=True)
            turns = _turning(to_lasers[index], some, np.ones(window.shape))
            total += np.einsum("kyx,kyx->yx", window.of_padded(fields), turns)
    return total if to_lasers else window.of_padded(fft.ifft2(total, workers=-1))


_CHUNK = 1 << 22
"""Complex numbers of the kernels that are held at a time."""


def _turning(path: np.ndarray, wavenumbers: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    """For evenly spaced k, amplitude e^(-ik path): (k, *path.shape), each from the one before."""
    step = wavenumbers[1] - wavenumbers[0] if len(wavenumbers) > 1 else 0.0
    turn = np.exp(-1j * step * path).astype(np.complex64)
    result = np.empty((len(wavenumbers), *path.shape), np.complex64)
    result[0] = amplitude * np.exp(-1j * wavenumbers[0] * path)
    for index in range(1, len(wavenumbers)):
        np.multiply(result[index - 1], turn, out=result[index])
    return result


@dataclass(frozen=True)
class _Window:
    """Points opposite to the wall's lattice where fields are computed, as indices on it.

    Attributes:
        lattice: The wall's.
        counts: Rows and columns of the wall's points.
        first: Row and column of the window's first point, on the lattice.
        shape: Rows and columns of the window.
        padded: Rows and columns of the transforms.
    """

    lattice: Lattice
    counts: tuple[int, int]
    first: tuple[int, int]
    shape: tuple[int, int]
    padded: tuple[int, int]

    @classmethod
    def of(cls, measured: Measured, grid: VolumeGrid) -> _Window:
        """The window that holds all voxels."""
        lattice = measured.lattice
        assert lattice is not None
        counts, first, shape, padded = measured.sensors.shape[:2], [], [], []
        for axis, count, zero, step in zip(
            "yx", counts, (lattice.y0, lattice.x0), (lattice.dy, lattice.dx), strict=True
        ):
            low, high = (grid.centres(axis)[[0, -1]] - zero) / step
            first.append(math.floor(low + 1e-6))
            shape.append(math.ceil(high - 1e-6) - first[-1] + 1)
            padded.append(fft.next_fast_len(count + shape[-1] - 1))
        return cls(lattice, counts, tuple(first), tuple(shape), tuple(padded))

    def _axes(self) -> list[np.ndarray]:
        """Coordinates y and x of the window's points [m]."""
        zeros, steps = (self.lattice.y0, self.lattice.x0), (self.lattice.dy, self.lattice.dx)
        return [
            zero + step * (first + np.arange(size))
            for zero, step, first, size in zip(zeros, steps, self.first, self.shape, strict=True)
        ]

    def grid(self, wanted: VolumeGrid) -> VolumeGrid:
        """The window as voxels around its points, with the wanted depths."""
        axes = []
        for points, step in zip(self._axes(), (self.lattice.dy, self.lattice.dx), strict=True):
            axes.append((points[0] - step / 2, points[-1] + step / 2, len(points)))
        return VolumeGrid(axes[1], axes[0], wanted.z)

    def distance(self, point: np.ndarray, z: float) -> np.ndarray:
        """From the window's points at depth z to a point [m]."""
        y, x = self._axes()
        return np.sqrt((y[:, None] - point[1]) ** 2 + (x - point[0]) ** 2 + (z - point[2]) ** 2)

    def lags(self, z: float) -> np.ndarray:
        """Distances of window point n at depth z from wall point m, by n - m [m].

        Lags run from first - (count - 1) up, so that index count - 1 + n of a product of transforms
        is the sum over the wall at the window's point n.
        """
        y, x = (
            step * (first - (count - 1) + np.arange(size))
            for step, first, count, size in zip(
                (self.lattice.dy, self.lattice.dx),
                self.first,
                self.counts,
                self.padded,
                strict=True,
            )
        )
        return np.sqrt(y[:, None] ** 2 + x * x + z * z)

    def of_padded(self, fields: np.ndarray) -> np.ndarray:
        """The window's part of padded planes (..., rows, columns)."""
        (rows, columns), (height, width) = self.counts, self.shape
        return fields[..., rows - 1 : rows - 1 + height, columns - 1 : columns - 1 + width]
