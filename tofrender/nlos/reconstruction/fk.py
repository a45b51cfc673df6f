"""f-k migration: confocal light is treated as a wave that leaves the hidden scene at time zero.

Light travels from a wall point to a surface and back. A wave of half the speed needs the same time
from the surface to the wall. With τ = opl / 2, this wave obeys f² = kx² + ky² + kz². Therefore its
spectrum at the wall, Ψ(kx, ky, f), yields the spectrum of the scene at time 0 after Stolt's change
of variables:

    Φ(kx, ky, kz) = kz / f  Ψ(kx, ky, f = √(kx² + ky² + kz²)),      intensity = |φ(x, y, z)|².

The amplitude of the wave is √(H τ^p). p is 4 for diffuse and 2 for retroreflective surfaces.
D. Lindell, G. Wetzstein and M. O'Toole, Wave-based non-line-of-sight imaging using fast f-k
migration, ACM Transactions on Graphics 38 (2019).
"""

import math

import numpy as np

from ...runtime.progress import ProgressBar
from .fourier import fft, forward, inverse_sides, require_memory
from .volume import VolumeGrid, native_volume
from .wall_capture import Measured

SURFACES = {"diffuse": 4, "retroreflective": 2}


def fk_migration(
    measured: Measured, surface: str, bar: ProgressBar
) -> tuple[np.ndarray, VolumeGrid]:
    """Reconstruct a confocal capture on a lattice, without legs.

    Args:
        measured: The capture.
        surface: One of SURFACES.
        bar: Progress bar of 3 steps.

    Returns:
        Intensities (z, y, x), and the grid of their voxels.
    """
    # Choose the size of the transforms
    grid = native_volume(measured)
    lattice = measured.lattice
    assert lattice is not None
    rows, columns, bins = measured.shape[1:]
    lines = _padded_bins(measured, grid)
    sides = (fft.next_fast_len(2 * rows), fft.next_fast_len(2 * columns))
    require_memory("fk", (*sides, lines // 2 + 1), copies=2.4)

    # Transform the amplitude of the wave
    depth = grid.centers("z")
    light = np.maximum(measured.light(0), 0) * (depth ** SURFACES[surface]).astype(np.float32)
    spectrum = forward(np.sqrt(light, out=light), (*sides, lines))
    bar.update()
    # Change variables from f to kz
    frequencies = (fft.fftfreq(sides[0], lattice.dy), fft.fftfreq(sides[1], lattice.dx))
    _stolt(spectrum, frequencies, grid, lines)
    bar.update()

    # Transform back
    field = inverse_sides(spectrum, rows, columns)
    field = fft.ifft(field, lines, axis=2, workers=-1, overwrite_x=True)[..., :bins]
    bar.update()
    values = np.square(field.real) + np.square(field.imag)
    return np.ascontiguousarray(values.transpose(2, 0, 1)), grid


def _padded_bins(measured: Measured, grid: VolumeGrid) -> int:
    """Return the length of the transform along z.

    The transform is periodic. It is so long that light before the first voxel does not reach the
    last voxel.
    """
    low, high, bins = grid.z
    points = measured.sensors.reshape(-1, 3)
    across = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
    nearest = math.sqrt(max(0.0, low * low - across * across))
    wanted = max(2 * bins, math.ceil((high - nearest) / grid.step("z")))
    return fft.next_fast_len(wanted + wanted % 2, real=True)


def _stolt(
    spectrum: np.ndarray, frequencies: tuple[np.ndarray, np.ndarray], grid: VolumeGrid, lines: int
) -> None:
    """Change variables from f to kz, in place.

    The spectrum must be smooth, because it is interpolated linearly. Therefore the origin of time
    is moved to the middle of the window. The phases of this shift are removed exactly.

    Args:
        spectrum: Spectrum of the wave at the wall.
        frequencies: Spatial frequencies along rows and columns [1/m].
        grid: The voxels.
        lines: Length of the transform along z.
    """
    low, high, bins = grid.z
    step = grid.step("z")
    kz = np.arange(lines // 2 + 1) / (lines * step)
    middle = (low + high) / 2
    # Distance from the center of the first bin to the middle. Samples start at 0 in the transform
    # and at low + step / 2 in the world
    inside = (bins - 1) / 2 * step
    centered = np.exp(2j * math.pi * kz * inside).astype(np.complex64)
    back = np.conjugate(centered)

    # Process a frequency together with its negative, which has the same f
    by_kx = _mirrored(frequencies[1])
    for rows in _mirrored(frequencies[0]):
        ky = frequencies[0][rows[0]]
        spectrum[rows] *= centered
        for columns in by_kx:
            # Position of f in the spectrum
            kx = frequencies[1][columns[0]]
            f = np.sqrt(kx * kx + ky * ky + kz * kz)
            at = f * (lines * step)
            below = np.minimum(at.astype(np.int64), len(kz) - 2)
            late = (at - below).astype(np.float32)

            # Jacobian kz / f, and the phases of the shift
            ratio = np.divide(kz, f, out=np.zeros(len(kz)), where=f > 0)
            factor = ratio * (at <= len(kz) - 1) * np.exp(2j * math.pi * (kz - f) * middle)
            factor = factor.astype(np.complex64) * back

            # Interpolate the spectrum
            here = np.ix_(rows, columns)
            old = spectrum[here]
            spectrum[here] = factor * (old[..., below] * (1 - late) + old[..., below + 1] * late)


def _mirrored(frequencies: np.ndarray) -> list[list[int]]:
    """Return the indices of each frequency and its negative."""
    count = len(frequencies)
    return [sorted({index, -index % count}) for index in range(count // 2 + 1)]
