"""Light-cone transform: confocal light is a convolution, which a Wiener filter inverts.

With v = (opl / 2)² and u = z², light from a diffuse hidden scene of albedo ρ obeys

    v^(3/2) H(x', y', 2 √v) = ∫∫∫ ρ(x, y, √u) / (2 √u) δ((x' - x)² + (y' - y)² + u - v) dx dy du.

This is a convolution in (x, y, v). Retroreflective surfaces have v^(1/2) instead. The grid is even
in v and u and has as many bins as the capture. Therefore its steps of depth are proportional to
1 / z. The depth of a surface is wrong by up to half a step, (z_high² - z_low²) / (4 z bins).
M. O'Toole, D. Lindell and G. Wetzstein, Confocal non-line-of-sight imaging based on the light-cone
transform, Nature 555 (2018).
"""

from typing import Any

import numpy as np
from scipy import sparse
from scipy.ndimage import uniform_filter1d

from ...runtime import checks
from ...runtime.progress import ProgressBar
from .fourier import fft, forward, inverse_sides, require_memory
from .volume import VolumeGrid, native_volume
from .wall_capture import Lattice, Measured

SURFACES = {"diffuse": 3, "retroreflective": 1}
"""Power of the distance √v that compensates the decrease of light, by kind of hidden surface."""

# Signal-to-noise ratio of light without noise, which limits the error of the transform itself
SNR = 10.0


def light_cone_transform(
    measured: Measured, surface: str, bar: ProgressBar, snr: float | None = None
) -> tuple[np.ndarray, VolumeGrid]:
    """Reconstruct a confocal capture on a lattice, without legs.

    Args:
        measured: The capture.
        surface: One of SURFACES.
        bar: Progress bar of 4 steps.
        snr: Signal-to-noise ratio that the Wiener filter assumes: the power of the transform at its
            mean frequency over the power of the noise. Smaller values give smoother results. With
            None, `SNR` is used. For photon counts, None also adds the ratio at each frequency along
            v, with the noise from `noise_spectrum`.

    Returns:
        Albedo (z, y, x), at least 0, and the grid of the voxels.
    """
    # Choose the size of the transforms
    grid = native_volume(measured)
    lattice = measured.lattice
    assert lattice is not None
    rows, columns, bins = measured.shape[1:]
    checks.require("capture: bins", bins, bins > 1, "2 or more with lct")
    lines = 2 * bins
    sides = (2 * rows, 2 * columns)
    require_memory("lct", (*sides, bins + 1), copies=3.2)

    # Width of a bin of v. At the middle depth it is half a bin of path length
    low, high = (edge * edge for edge in grid.z[:2])
    width = (high - low) / bins

    # Resample light to bins of v, and transform it and the kernel
    resampling = squared_depth(grid, low + width * np.arange(bins + 1), surface)
    flat = measured.light(0).reshape(-1, bins)
    flat = np.ascontiguousarray((resampling @ np.ascontiguousarray(flat.T)).T)
    spectrum = forward(flat.reshape(rows, columns, bins), (*sides, lines))
    bar.update()
    kernel = _kernel_spectrum(lattice, rows, columns, bins, width)
    bar.update()

    # Apply the Wiener filter, conj(kernel) / (|kernel|² + 1 / snr)
    power = np.square(kernel.real) + np.square(kernel.imag)
    regularization = np.float32(power.mean(dtype=np.float64) / (snr or SNR))
    if snr is None and measured.background is not None:
        noise = noise_spectrum(resampling, measured.background.variance)

        # Subtract the noise to estimate the albedo's power, times the power of the kernel
        mean = np.mean([np.square(abs(row)).mean(axis=0) for row in spectrum], axis=0)
        albedo = np.maximum(uniform_filter1d(mean - noise, 9), 1e-3 * noise)
        ratio = np.divide(noise, albedo, out=np.zeros(len(noise)), where=noise > 0)
        regularization = regularization + (
            power.mean(axis=(0, 1), dtype=np.float64) * ratio
        ).astype(np.float32)

    # Divide in place and free memory early
    power += regularization
    np.conjugate(kernel, out=kernel)
    kernel /= power
    del power
    spectrum *= kernel
    del kernel
    bar.update()

    # Transform back, and interpolate at the depths of the voxels
    field = inverse_sides(spectrum, rows, columns)
    found = fft.irfft(field, lines, axis=2, workers=-1)[..., :bins]
    bar.update()
    return _to_depth(found, grid, low, width), grid


def squared_depth(grid: VolumeGrid, edges: np.ndarray, surface: str) -> sparse.csr_array:
    """Return the matrix (bins of v, bins) that averages v^(p/2) H(2 √v) over each bin of v.

    Args:
        grid: The voxels.
        edges: Edges of the bins of v [m²].
        surface: One of SURFACES, which determines p.
    """
    # Edges in bins of the capture
    bins = grid.z[2]
    depth = np.sqrt(np.maximum(edges, 0))
    at = (depth - grid.z[0]) / grid.step("z")

    # List the bins of the capture that overlap each bin of v
    first = np.clip(np.floor(at[:-1] + 1e-9), 0, bins - 1).astype(np.int64)
    last = np.clip(np.ceil(at[1:] - 1e-9), 1, bins).astype(np.int64)
    count = np.maximum(last - first, 1)
    row = np.repeat(np.arange(len(count)), count)
    column = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + first[row]
    # Weight them by their overlap
    overlap = np.minimum(at[1:][row], column + 1) - np.maximum(at[:-1][row], column)
    middle = (depth[1:] + depth[:-1]) / 2
    scale = middle ** SURFACES[surface] / np.maximum(at[1:] - at[:-1], 1e-12)
    weights = (np.maximum(overlap, 0) * scale[row]).astype(np.float32)
    return sparse.csr_array((weights, (row, column)), shape=(len(count), bins))


def noise_spectrum(resampling: sparse.csr_array, variance: np.ndarray) -> np.ndarray:
    """Return the power of the noise of counts at each frequency along v.

    Counts of different bins are independent. Therefore the power is a sum over all bins: each bin
    adds its `variance` times the power spectrum of its column of `resampling`. Along the wall, the
    noise is white.
    """
    noise = np.zeros(len(variance) + 1)
    held = np.flatnonzero(variance)
    columns = resampling.T.tocsr()

    # Process a few bins at a time
    for part in np.array_split(held, len(held) // 256 + 1):
        lines = fft.rfft(columns[part].toarray(), 2 * len(variance), axis=1)
        noise += variance[part] @ np.square(abs(lines))
    return noise


def _kernel_spectrum(lattice: Lattice, rows: int, columns: int, bins: int, width: float) -> Any:
    """Return the spectrum of the cone δ(x² + y² - v), with each point divided between two bins."""
    # Position of the cone in bins of v, at the lags of the lattice
    y = (lattice.dy * np.arange(rows + 1))[:, None]
    x = lattice.dx * np.arange(columns + 1)
    at = (x * x + y * y) / width
    below = np.floor(at)

    # Divide each point between two bins
    cone = np.zeros((rows + 1, columns + 1, 2 * bins), np.float32)
    row, column = np.nonzero(below < bins - 1)
    cell = below[row, column].astype(np.int64)
    late = (at - below)[row, column]
    cone[row, column, cell] = 1 - late
    cone[row, column, cell + 1] = late
    # Continue the lags 0 ... count to a transform of length 2 count
    lines = fft.rfft(cone, axis=2, workers=-1)
    mirrored = (np.r_[: count + 1, count - 1 : 0 : -1] for count in (rows, columns))
    lines = lines[np.ix_(*mirrored)]
    return fft.fft2(lines, axes=(0, 1), workers=-1, overwrite_x=True)


def _to_depth(found: np.ndarray, grid: VolumeGrid, low: float, width: float) -> np.ndarray:
    """Interpolate 2 z ρ'(z²) between bins of v, at the depths of the voxels.

    Args:
        found: Values (rows, columns, bins of v).
        grid: The voxels.
        low: Lower edge of the first bin of v [m²].
        width: Width of a bin of v [m²].
    """
    depth = grid.centers("z")
    bins = found.shape[-1]
    at = np.clip((depth * depth - low) / width - 0.5, 0, bins - 1)
    below = np.minimum(np.floor(at).astype(np.int64), max(bins - 2, 0))
    late = (at - below).astype(np.float32)
    above = np.minimum(below + 1, bins - 1)
    values = found[..., below] * (1 - late) + found[..., above] * late
    values *= (2 * depth).astype(np.float32)
    return np.ascontiguousarray(np.maximum(values, 0).transpose(2, 0, 1))
