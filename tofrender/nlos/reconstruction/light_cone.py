"""Light-cone transform: confocal light as a convolution, inverted by a Wiener filter.

With v = (opl / 2)² and u = z², light from a diffuse hidden scene of albedo ρ obeys

    v^(3/2) H(x', y', 2 √v) = ∫∫∫ ρ(x, y, √u) / (2 √u) δ((x' - x)² + (y' - y)² + u - v) dx dy du,

a convolution in (x, y, v); retroreflective surfaces have v^(1/2). The grid is even in v and u, with
as many bins as the capture, so that its steps of depth grow towards the wall as 1 / z: a surface is
off by up to half of one, (z_high² - z_low²) / (4 z bins).
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
from .measured import Lattice, Measured
from .volume import VolumeGrid, native_volume

SURFACES = {"diffuse": 3, "retroreflective": 1}
"""Power of the distance in √v that undoes the falloff with it, by kind of hidden surface."""

SNR = 10.0  # Signal-to-noise ratio of light without noise: what the transform itself leaves out


def light_cone_transform(
    measured: Measured, surface: str, bar: ProgressBar, snr: float | None = None
) -> tuple[np.ndarray, VolumeGrid]:
    """Albedo >= 0 (z, y, x) of a confocal capture on a lattice, without legs, and its grid.

    `snr` is the signal-to-noise ratio that the Wiener filter assumes: power of the mean frequency
    of the transform over that of the noise. Less is smoother. None is `SNR`, and of photon counts
    also the ratio at each frequency along v, of which `noise_spectrum` is the noise.
    """
    grid = native_volume(measured)
    lattice = measured.lattice
    assert lattice is not None
    rows, columns, bins = measured.shape[1:]
    checks.require("capture: bins", bins, bins > 1, "2 or more with lct")
    lines, sides = 2 * bins, (2 * rows, 2 * columns)
    require_memory("lct", (*sides, bins + 1), copies=3.2)
    low, high = (edge * edge for edge in grid.z[:2])
    width = (high - low) / bins  # of a bin of v: half a bin of path length at mid-depth

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
    rest = np.float32(power.mean(dtype=np.float64) / (snr or SNR))
    if snr is None and measured.background is not None:
        noise = noise_spectrum(resampling, measured.background.variance)
        mean = np.mean([np.square(abs(row)).mean(axis=0) for row in spectrum], axis=0)
        albedo = np.maximum(uniform_filter1d(mean - noise, 9), 1e-3 * noise)  # Times the kernel's
        ratio = np.divide(noise, albedo, out=np.zeros(len(noise)), where=noise > 0)
        rest = rest + (power.mean(axis=(0, 1), dtype=np.float64) * ratio).astype(np.float32)
    power += rest
    np.conjugate(kernel, out=kernel)
    kernel /= power
    del power
    spectrum *= kernel
    del kernel
    bar.update()

    # Transform back, and interpolate at the voxels' depths
    field = inverse_sides(spectrum, rows, columns)
    found = fft.irfft(field, lines, axis=2, workers=-1)[..., :bins]
    bar.update()
    return _to_depth(found, grid, low, width), grid


def squared_depth(grid: VolumeGrid, edges: np.ndarray, surface: str) -> sparse.csr_array:
    """Matrix (bins of v, bins) that averages v^(p/2) H(2 √v) over each bin of v."""
    bins = grid.z[2]
    depth = np.sqrt(np.maximum(edges, 0))
    at = (depth - grid.z[0]) / grid.step("z")  # in bins of the capture
    first = np.clip(np.floor(at[:-1] + 1e-9), 0, bins - 1).astype(np.int64)
    last = np.clip(np.ceil(at[1:] - 1e-9), 1, bins).astype(np.int64)
    count = np.maximum(last - first, 1)
    row = np.repeat(np.arange(len(count)), count)
    column = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + first[row]
    overlap = np.minimum(at[1:][row], column + 1) - np.maximum(at[:-1][row], column)
    middle = (depth[1:] + depth[:-1]) / 2
    scale = middle ** SURFACES[surface] / np.maximum(at[1:] - at[:-1], 1e-12)
    weights = (np.maximum(overlap, 0) * scale[row]).astype(np.float32)
    return sparse.csr_array((weights, (row, column)), shape=(len(count), bins))


def noise_spectrum(resampling: sparse.csr_array, variance: np.ndarray) -> np.ndarray:
    """Power of the noise of counts by frequency along v; along the wall it is white.

    Counts are independent: the sum of bins' `variance` times the power spectra of the columns of
    `resampling`.
    """
    noise, held = np.zeros(len(variance) + 1), np.flatnonzero(variance)
    columns = resampling.T.tocsr()
    for part in np.array_split(held, len(held) // 256 + 1):
        lines = fft.rfft(columns[part].toarray(), 2 * len(variance), axis=1)
        noise += variance[part] @ np.square(abs(lines))
    return noise


def _kernel_spectrum(lattice: Lattice, rows: int, columns: int, bins: int, width: float) -> Any:
    """Spectrum of the cone: δ(x² + y² - v) on lags of the lattice, divided between two bins."""
    y, x = (lattice.dy * np.arange(rows + 1))[:, None], lattice.dx * np.arange(columns + 1)
    at = (x * x + y * y) / width
    below = np.floor(at)
    cone = np.zeros((rows + 1, columns + 1, 2 * bins), np.float32)
    row, column = np.nonzero(below < bins - 1)
    cell = below[row, column].astype(np.int64)
    late = (at - below)[row, column]
    cone[row, column, cell] = 1 - late
    cone[row, column, cell + 1] = late
    lines = fft.rfft(cone, axis=2, workers=-1)
    mirrored = (np.r_[: count + 1, count - 1 : 0 : -1] for count in (rows, columns))
    lines = lines[np.ix_(*mirrored)]  # Lags 0 ... count to those of a transform of 2 count
    return fft.fft2(lines, axes=(0, 1), workers=-1, overwrite_x=True)


def _to_depth(found: np.ndarray, grid: VolumeGrid, low: float, width: float) -> np.ndarray:
    """Interpolate 2 z ρ'(z²) of (rows, columns, bins) at the voxels' depths, between bins of v."""
    depth = grid.centres("z")
    bins = found.shape[-1]
    at = np.clip((depth * depth - low) / width - 0.5, 0, bins - 1)
    below = np.minimum(np.floor(at).astype(np.int64), max(bins - 2, 0))
    late = (at - below).astype(np.float32)
    above = np.minimum(below + 1, bins - 1)
    values = found[..., below] * (1 - late) + found[..., above] * late
    values *= (2 * depth).astype(np.float32)
    return np.ascontiguousarray(np.maximum(values, 0).transpose(2, 0, 1))
