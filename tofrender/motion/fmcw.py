"""FMCW lidar: beat spectra of chirped light, and estimates of range and velocity.

During an up chirp of duration T, the frequency of the laser rises by the bandwidth B. During the
following down chirp it falls by B. Light with the path length L and its rate of change V beats with
the laser at the frequencies

    f_up = γ L / c + V / λ,    f_down = γ L / c - V / λ,    γ = B / T.

Therefore L = c (f_up + f_down) / (2γ) with the resolution c / B, and V = λ (f_up - f_down) / 2 with
the resolution λ / T.
"""

import math
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..films.rate_bins import Axis
from ..labels import RANGE_RATES, SPECTRA, even_axis, read, with_energy
from ..runtime import checks, memory
from ..signals.units import SPEED_OF_LIGHT
from .choices import MAX_LOOKS, WINDOWS

FINE = 8  # Number of steps of the frequency grid in one bin of a spectrum
MAX_SAMPLES = 1 << 20  # Largest number of samples of a chirp
CHUNK = 1 << 22  # Number of grid steps that are transformed together


@dataclass(frozen=True, kw_only=True)
class Fmcw:
    """FMCW lidar with a receiver for I and Q, so that the sign of a beat is measured.

    Each cell of a film of `range_rate` is a rough scatterer. Its amplitude is a complex Gaussian
    random number, and its mean power is the cell's radiance. A look consists of an up chirp and a
    down chirp. Within a look, the amplitudes of all cells add up, which gives speckle of contrast
    1. Looks are independent, and averaging their spectra reduces the contrast to 1 / √looks.
    Between the centers of the two chirps, the phase of a cell changes by 2π V T / λ.

    Args:
        bandwidth_hz: Bandwidth B of a chirp [Hz].
        chirp_s: Duration T of a chirp [s].
        wavelength_m: Wavelength λ of the laser [m].
        window: Window that the samples are multiplied by: "hann", "rectangular", "hamming" or
            "blackman".
        looks: Number of looks to average, up to 10,000, or 0 for the expected spectrum.
        photons: Number of detected photons per chirp, averaged over pixels. Spectra are then in
            photons and contain the shot noise of the local oscillator, with a mean of 1 in each
            bin. None for spectra in the units of the film, without noise.
        excess_noise: Noise in units of shot noise, from 1 to 100.
        sample_rate_hz: Number of samples of I and Q per second. The default is determined by the
            film's highest beat.

    Raises:
        ValueError: If an argument is out of range.

    Example:
        >>> lidar = Fmcw(bandwidth_hz=1e9, chirp_s=1e-5, wavelength_m=1.55e-6)
        >>> [round(step, 3) for step in lidar.resolution]
        [0.3, 0.155]
    """

    bandwidth_hz: float
    chirp_s: float
    wavelength_m: float
    window: str = "hann"
    looks: int = 0
    photons: float | None = None
    excess_noise: float = 1.0
    sample_rate_hz: float | None = None

    def __post_init__(self) -> None:
        checks.number("bandwidth_hz", self.bandwidth_hz, unit="hertz", positive=True, high=1e15)
        checks.number("chirp_s", self.chirp_s, unit="seconds", positive=True, high=1e3)
        checks.number("wavelength_m", self.wavelength_m, unit="meters", positive=True, high=1)
        checks.one_of("window", self.window, WINDOWS)
        checks.integer("looks", self.looks, 0, MAX_LOOKS)
        if self.photons is not None:
            checks.number("photons", self.photons, positive=True, high=1e15)
        checks.number("excess_noise", self.excess_noise, low=1, high=100)
        noise = self.excess_noise
        checks.require("excess_noise", noise, noise == 1 or self.photons, "1 without photons")
        if self.sample_rate_hz is not None:
            rate = checks.number("sample_rate_hz", self.sample_rate_hz, unit="hertz", positive=True)
            enough = 8 <= rate * self.chirp_s <= MAX_SAMPLES
            allowed = f"so high that a chirp has 8 to {MAX_SAMPLES} samples"
            checks.require("sample_rate_hz", rate, enough, allowed)

    @property
    def resolution(self) -> tuple[float, float]:
        """Resolution of path lengths c / B [m] and of rates λ / T [m/s]."""
        return SPEED_OF_LIGHT / self.bandwidth_hz, self.wavelength_m / self.chirp_s

    def samples(self, opl: Axis, rate: Axis) -> int:
        """Return the number of samples of a chirp for a film.

        Args:
            opl: The film's bins of path length [m].
            rate: The film's bins of rate [m/s].

        Raises:
            ValueError: If the film's bins are too wide, or its highest beat is too high.
        """
        # Are the bins at most as wide as the resolution?
        for name, axis, finest in zip(("opl", "rate"), (opl, rate), self.resolution, strict=True):
            if axis.width > finest * (1 + 1e-6):
                raise ValueError(
                    f"film with bins of {name} {axis.width:.4g} wide: must be at most as wide as "
                    f"the lidar's resolution, {finest:.4g}"
                )

        # The highest beat of the film, in periods per chirp
        of_opl, of_rate = (
            max(abs(axis.start), abs(axis.start + axis.count * axis.width)) / finest
            for axis, finest in zip((opl, rate), self.resolution, strict=True)
        )
        highest = of_opl + of_rate

        # A given sampling rate must be at least twice the highest beat
        if self.sample_rate_hz is not None:
            count = 2 * int(self.sample_rate_hz * self.chirp_s / 2)
            least = 2 * highest / self.chirp_s
            allowed = f"at least {least:.6g}, twice the film's highest beat"
            checks.require("sample_rate_hz", self.sample_rate_hz, count >= 2 * highest, allowed)
            return count

        # Choose a number of samples with a fast Fourier transform
        if 2 * highest > MAX_SAMPLES - 8:
            raise ValueError(
                f"film with beats up to {highest / self.chirp_s:.4g} Hz: must be at most "
                f"{(MAX_SAMPLES / 2 - 4) / self.chirp_s:.4g} Hz"
            )
        from scipy.fft import next_fast_len

        enough: Any = next_fast_len(math.ceil(highest) + 4)
        return 2 * int(enough)

    def spectra(self, film: Annotated[xr.Dataset, RANGE_RATES], seed: int = 0) -> xr.Dataset:
        """Compute the spectra of up and down chirps.

        Args:
            film: A Dataset of `range_rate` with bins up to the width of the resolution. Its
                channels are summed.
            seed: Seed of speckle and noise.

        Returns:
            A Dataset with `up` and `down` (y, x, beat), the power in each frequency bin. `beat`
            [Hz] ranges from minus to plus half the sampling rate, and its sign is that of the
            formulas of f_up and f_down. The number of samples in a chirp is rounded to an even
            number.

        Raises:
            ValueError: If the film has another kind, or its bins or beats do not fit the lidar.
            MemoryError: If the spectra do not fit into memory.

        Example:
            >>> import xarray as xr
            >>> axes = {"opl": 5 + np.arange(3) / 10, "rate": [-0.1, 0.0, 0.1], "channel": ["L"]}
            >>> light = np.zeros((1, 1, 3, 3, 1))
            >>> light[0, 0, 1, 2] = 1.0
            >>> film = xr.Dataset({"radiance": (("y", "x", *axes), light)}, axes)
            >>> lidar = Fmcw(bandwidth_hz=1e9, chirp_s=1e-5, wavelength_m=1.55e-6)
            >>> found = lidar.estimates(lidar.spectra(film))
            >>> round(found["opl"].item(), 2), round(found["rate"].item(), 2)
            (5.1, 0.1)
        """
        # Check the arguments and the memory
        seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
        film = with_energy(read(film, RANGE_RATES, "film"), "film")
        light, opl, rate = checked_film(film)
        count = self.samples(opl, rate)
        height, width = light.shape[:2]
        memory.require_free("film", 8 * height * width * count + 64 * FINE * max(CHUNK, count))

        # Convert radiance to photons
        scale = 1.0
        if self.photons is not None:
            mean = float(light.sum(dtype=float)) / (height * width)
            scale = self.photons / mean if mean else 0.0

        # Compute the spectra of each row, with a separate random generator, in chunks
        beats = self._beats(opl, rate)
        spectra = np.empty((2, height, width, count), np.float32)
        step = max(1, CHUNK // (FINE * count))
        for row in range(height):
            random = np.random.default_rng([seed, row])
            for first in range(0, width, step):
                part = light[row, first : first + step].reshape(-1, opl.count * rate.count)
                pixel, cell = np.nonzero(part)
                power = part[pixel, cell].astype(float) * scale
                cells = pixel, beats[:, cell], power
                spectrum = self._power((len(part), count), cells, random)
                spectra[:, row, first : first + step] = np.fft.fftshift(spectrum, axes=-1)

        # Label the result
        beat = (np.arange(count) - count // 2) / self.chirp_s
        parameters = {k: v for k, v in asdict(self).items() if v is not None}
        units = {"units": "photons" if self.photons else film["radiance"].attrs.get("units", "1")}
        return xr.Dataset(
            {
                name: (("y", "x", "beat"), spectra[k], units)
                for k, name in enumerate(("up", "down"))
            },
            {axis: film[axis].values for axis in "yx" if axis in film.coords}
            | {"beat": ("beat", beat, {"units": "Hz", "long_name": "frequency of the beat"})},
            {**film.attrs, **parameters, "seed_of_spectra": seed, "quantity": "up"},
        )

    def estimates(self, spectra: Annotated[xr.Dataset, SPECTRA]) -> xr.Dataset:
        """Estimate path lengths and rates from the highest peaks of spectra.

        The frequency of a peak is the vertex of a parabola through the logarithms of three bins.

        Args:
            spectra: A Dataset of `spectra`.

        Returns:
            A Dataset with `opl` [m] and `rate` [m/s], which are NaN without light, and `peak`, the
            mean height of both peaks. The dimensions are (y, x).

        Raises:
            ValueError: If the spectra were not computed with the parameters of this lidar.
        """
        # Do the spectra belong to this lidar?
        spectra = read(spectra, SPECTRA, "spectra")
        is_own = all(
            spectra.attrs.get(name) == getattr(self, name)
            for name in ("bandwidth_hz", "chirp_s", "wavelength_m")
        )
        beat = (np.arange(spectra["beat"].size) - spectra["beat"].size // 2) / self.chirp_s
        is_own &= np.allclose(spectra["beat"], beat)
        allowed = "a Dataset of this lidar's spectra, with all beats"
        checks.require("spectra", list(spectra), is_own, allowed)

        # Convert the frequencies of the peaks to path length and rate
        up, up_height = self._peak(spectra["up"].values)
        down, down_height = self._peak(spectra["down"].values)
        finest_opl, finest_rate = self.resolution
        units = str(spectra["up"].attrs.get("units", "1"))
        meaning = "change of path length of the material"
        return xr.Dataset(
            {
                "opl": (("y", "x"), finest_opl * (up + down) / 2, {"units": "m"}),
                "rate": (
                    ("y", "x"),
                    finest_rate * (up - down) / 2,
                    {"units": "m/s", "long_name": meaning},
                ),
                "peak": (("y", "x"), (up_height + down_height) / 2, {"units": units}),
            },
            {axis: spectra[axis].values for axis in "yx" if axis in spectra.coords},
            spectra.attrs | {"quantity": "rate"},
        )

    def _beats(self, opl: Axis, rate: Axis) -> np.ndarray:
        """Return the beats of all cells of a film, in periods per up and down chirp, (2, cells)."""
        of_opl, of_rate = (
            (axis.start + (np.arange(axis.count) + 0.5) * axis.width) / finest
            for axis, finest in zip((opl, rate), self.resolution, strict=True)
        )
        return np.stack([np.add.outer(of_opl, sign * of_rate).ravel() for sign in (1, -1)])

    def _power(
        self, shape: tuple[int, int], cells: tuple[np.ndarray, ...], random: np.random.Generator
    ) -> np.ndarray:
        """Return power spectra of up and down chirps, (2, pixels, count), frequency 0 first.

        Each cell is distributed over two steps of a fine grid of frequencies. The expected spectrum
        is the Fourier transform of autocorrelations.

        Args:
            shape: Number of pixels and number of samples.
            cells: Pixel, beats (2, cells) and power of all cells with light.
            random: Random generator.
        """
        from scipy.signal import get_window

        # Window, grid and noise
        pixels, count = shape
        pixel, beats, power = cells
        window: Any = get_window(WINDOWS[self.window], count)
        total = float(np.sum(window**2))
        steps = FINE * count
        noise = 0.0 if self.photons is None else self.excess_noise
        middle = np.arange(-(count // 2), count - count // 2)

        # Distribute the cells over the grid. Amplitudes are distributed so that the mean power over
        # the chirp does not change
        near = 1.0
        if self.looks:
            near = float(np.sum(window**2 * np.cos(2 * np.pi * middle / steps))) / total
        split = [_splitter(pixel, each, (pixels, steps), near) for each in beats]

        # The expected spectrum: multiply the autocorrelations of light and window
        if not self.looks:
            of_window = np.correlate(window, window, "full")[count - 1 :]
            grid = np.stack([each @ power for each in split]).reshape(2, pixels, steps)
            of_light = steps * np.fft.ifft(grid)
            lag = of_window * of_light[..., :count]
            lag[..., 1:] += of_window[:0:-1] * of_light[..., steps - count + 1 :]
            return np.maximum(np.fft.fft(lag).real, 0) / (count * total) + noise

        # The mean of independent looks with random amplitudes of up and down chirps
        turn = np.exp(-1j * np.pi * (beats[0] - beats[1]))
        mean = np.zeros((2, pixels, count))
        size = np.sqrt(power / (2 * count))
        for _ in range(self.looks):
            up = size * _gaussian(random, power.shape)
            grid = np.stack([split[0] @ up, split[1] @ (up.conj() * turn)])
            signal = steps * np.fft.ifft(grid.reshape(2, pixels, steps))[..., middle]
            if noise:
                signal += math.sqrt(noise / 2) * _gaussian(random, signal.shape)
            mean += abs(np.fft.fft(window * signal)) ** 2
        return mean / (self.looks * total)

    def _peak(self, spectra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the frequencies of the highest peaks, in periods per chirp, and their heights."""
        # The highest bin and its neighbors
        count = spectra.shape[-1]
        place = spectra.argmax(axis=-1)[..., None]
        three = np.take_along_axis(spectra, (place + np.arange(-1, 2)) % count, axis=-1)
        height = three[..., 1].astype(float)

        # The vertex of a parabola through the logarithms
        with np.errstate(divide="ignore", invalid="ignore"):
            left, middle, right = np.log(np.maximum(three / height[..., None], 1e-12)).T
            bend = left - 2 * middle + right
            offset = np.where(bend < 0, 0.5 * (left - right) / bend, 0.0).T
        frequency = place[..., 0] - count // 2 + offset
        return np.where(height > 0, frequency, np.nan), height


def _gaussian(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Return complex Gaussian random numbers with mean power 2."""
    return random.standard_normal((*shape, 2)).view(complex)[..., 0]


def _splitter(pixel: np.ndarray, beats: np.ndarray, shape: tuple[int, int], near: float) -> Any:
    """Return a sparse matrix that distributes each cell over two steps of its pixel's grid.

    Args:
        pixel: Pixel of each cell.
        beats: Beat of each cell, in periods per chirp.
        shape: Number of pixels and number of steps.
        near: Mean correlation of two neighboring steps over the chirp; 1 to distribute power.
    """
    from scipy.sparse import csc_array

    # Linear interpolation between the two neighboring steps
    pixels, steps = shape
    lower = np.floor(FINE * beats)
    upper = FINE * beats - lower
    places = (lower[:, None].astype(int) + np.arange(2)) % steps + steps * pixel[:, None]

    # Normalize the power, and build the matrix column by column
    size = np.sqrt(1 - 2 * upper * (1 - upper) * (1 - near))
    parts = np.stack([1 - upper, upper], axis=1) / size[:, None]
    columns = np.arange(0, parts.size + 1, 2)
    return csc_array((parts.ravel(), places.ravel(), columns), (pixels * steps, len(beats)))


def checked_film(film: Any, name: str = "film") -> tuple[np.ndarray, Axis, Axis]:
    """Check a Dataset of `range_rate`, and return its radiance and axes.

    Args:
        film: The Dataset.
        name: Name of the argument for error messages.

    Returns:
        The radiance (y, x, opl, rate), summed over channels, and the axes of path length and rate.
    """
    film = read(film, RANGE_RATES, name)
    values = checks.real_array(name, film["radiance"].values)
    light = values.sum(axis=-1, dtype=np.float32)
    is_valid = np.isfinite(light).all() and light.min() >= 0
    checks.require(name, light, is_valid, "finite and at least 0")
    return light, axis_of(film, "opl", name), axis_of(film, "rate", name)


def axis_of(film: xr.Dataset, axis: str, name: str = "film") -> Axis:
    """Return the bins along an axis of a film, computed from the coordinate of their centers.

    The attributes of a film of `range_rate` contain the widths of its bins. Therefore gaps are
    found.
    """
    start, width = even_axis(film, axis, name, stated=f"bin_width_{axis}")
    return Axis(count=film.sizes[axis], start=start, width=width)
