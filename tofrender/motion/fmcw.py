"""FMCW lidar: beat spectra of chirped light, and the range and velocity that they tell.

The frequency of the laser rises by B within the duration T of a chirp, and falls in the next. Light
of the path length L, which grows at the rate V, beats with the laser at

    f_up = γ L / c + V / λ,    f_down = γ L / c - V / λ,    γ = B / T.

L = c (f_up + f_down) / (2γ) and V = λ (f_up - f_down) / 2 have the resolution c / B and λ / T.
"""

import math
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..films.rates import Axis
from ..labels import RANGE_RATES, SPECTRA, read
from ..runtime import checks, memory
from ..signals.units import SPEED_OF_LIGHT
from .choices import MAX_LOOKS, WINDOWS

FINE = 8  # Steps of the grid of frequencies in one bin of a spectrum
MAX_SAMPLES = 1 << 20
CHUNK = 1 << 22  # Steps of the grid that are transformed at once


@dataclass(frozen=True, kw_only=True)
class Fmcw:
    """FMCW lidar with a receiver for I and Q, which tells the sign of a beat.

    Every cell of a film of `range_rate` is a rough scatterer: its amplitude is complex Gaussian, of
    the cell's radiance as mean power. In a look, that is an up and a down chirp, amplitudes add up
    (speckle of contrast 1); looks are independent, and their spectra averaged (1 / √looks). Between
    the middles of both chirps, phases turn by 2π V T / λ.

    Args:
        bandwidth_hz: Bandwidth B of a chirp [Hz].
        chirp_s: Duration T of a chirp [s].
        wavelength_m: Wavelength λ of the laser [m].
        window: "hann", "rectangular", "hamming" or "blackman", by which samples are multiplied.
        looks: Number of looks to average, up to 10,000; 0 for the expectation.
        photons: Detected photons of a chirp in the mean over pixels, for spectra in photons with
            the shot noise of the local oscillator, of which each bin has 1 in the mean; None for
            spectra in the units of the film, without noise.
        excess_noise: Noise in units of shot noise, from 1 to 100.
        sample_rate_hz: Samples of I and Q per second; by default as many as the film's beats need.

    Raises:
        ValueError: An argument is out of range.

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
        checks.number("wavelength_m", self.wavelength_m, unit="metres", positive=True, high=1)
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
        """Resolution of path lengths c / B [m] and of their rates λ / T [m/s]."""
        return SPEED_OF_LIGHT / self.bandwidth_hz, self.wavelength_m / self.chirp_s

    def samples(self, opl: Axis, rate: Axis) -> int:
        """Return the number of samples of a chirp, if that and the lidar suit a film's bins."""
        for name, axis, finest in zip(("opl", "rate"), (opl, rate), self.resolution, strict=True):
            if axis.width > finest * (1 + 1e-6):
                raise ValueError(
                    f"film with bins of {name} {axis.width:.4g} wide: must be at most as wide as "
                    f"the lidar's resolution, {finest:.4g}"
                )
        along, across = (
            max(abs(axis.start), abs(axis.start + axis.count * axis.width)) / finest
            for axis, finest in zip((opl, rate), self.resolution, strict=True)
        )
        highest = along + across  # Periods in a chirp
        if self.sample_rate_hz is not None:
            count = 2 * int(self.sample_rate_hz * self.chirp_s / 2)
            least = 2 * highest / self.chirp_s
            allowed = f"at least {least:.6g}, twice the film's highest beat"
            checks.require("sample_rate_hz", self.sample_rate_hz, count >= 2 * highest, allowed)
            return count
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
            film: A Dataset of `range_rate`, with bins no wider than the resolution; its channels
                are added.
            seed: Of speckle and noise.

        Returns:
            A Dataset with `up` and `down (y, x, beat)`, the power in each frequency bin, and `beat`
            [Hz] from minus to plus half the sampling rate, which is rounded to an even number of
            samples in a chirp; f_down has the sign of the formula.

        Raises:
            ValueError: The film is of another kind, or its bins or beats do not suit the lidar.
            MemoryError: The spectra do not fit.

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
        seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
        film = read(film, RANGE_RATES, "film")
        light, opl, rate = checked_film(film)
        count = self.samples(opl, rate)
        height, width = light.shape[:2]
        memory.require_free("film", 8 * height * width * count + 64 * FINE * max(CHUNK, count))
        scale = 1.0
        if self.photons is not None:
            mean = float(light.sum(dtype=float)) / (height * width)
            scale = self.photons / mean if mean else 0.0
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
                found = self._power((len(part), count), cells, random)
                spectra[:, row, first : first + step] = np.fft.fftshift(found, axes=-1)
        beat = (np.arange(count) - count // 2) / self.chirp_s
        about = {k: v for k, v in asdict(self).items() if v is not None}
        units = {"units": "photons" if self.photons else film["radiance"].attrs.get("units", "1")}
        return xr.Dataset(
            {
                name: (("y", "x", "beat"), spectra[k], units)
                for k, name in enumerate(("up", "down"))
            },
            {axis: film[axis].values for axis in "yx" if axis in film.coords}
            | {"beat": ("beat", beat, {"units": "Hz", "long_name": "frequency of the beat"})},
            {**film.attrs, **about, "seed_of_spectra": seed, "quantity": "up"},
        )

    def estimates(self, spectra: Annotated[xr.Dataset, SPECTRA]) -> xr.Dataset:
        """Estimate path lengths and rates from the highest peaks of spectra.

        A parabola through the logarithms of three bins finds a peak's frequency.

        Returns:
            A Dataset with `opl` [m] and `rate` [m/s], NaN without light, and `peak`, the mean
            height of both peaks, (y, x).

        Raises:
            ValueError: `spectra` are not from this lidar's `spectra`.
        """
        spectra = read(spectra, SPECTRA, "spectra")
        own = all(
            spectra.attrs.get(name) == getattr(self, name)
            for name in ("bandwidth_hz", "chirp_s", "wavelength_m")
        )
        beat = (np.arange(spectra["beat"].size) - spectra["beat"].size // 2) / self.chirp_s
        own &= np.allclose(spectra["beat"], beat)
        allowed = "a Dataset of this lidar's spectra, with all beats"
        checks.require("spectra", list(spectra), own, allowed)
        (up, high), (down, other) = (self._peak(spectra[name].values) for name in ("up", "down"))
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
                "peak": (("y", "x"), (high + other) / 2, {"units": units}),
            },
            {axis: spectra[axis].values for axis in "yx" if axis in spectra.coords},
            spectra.attrs | {"quantity": "rate"},
        )

    def _beats(self, opl: Axis, rate: Axis) -> np.ndarray:
        """Return periods within an up and a down chirp, (2, cells), of all cells of a film."""
        along, across = (
            (axis.start + (np.arange(axis.count) + 0.5) * axis.width) / finest
            for axis, finest in zip((opl, rate), self.resolution, strict=True)
        )
        return np.stack([np.add.outer(along, sign * across).ravel() for sign in (1, -1)])

    def _power(
        self, shape: tuple[int, int], cells: tuple[np.ndarray, ...], random: np.random.Generator
    ) -> np.ndarray:
        """Return power spectra (2, pixels, count) of the pixel, beats and power of lit cells.

        Cells are split onto two steps of a grid of frequencies each; frequency 0 is first. The
        spectrum of the expectation is the transform of autocorrelations.
        """
        from scipy.signal import get_window

        (pixels, count), (pixel, beats, power) = shape, cells
        window: Any = get_window(WINDOWS[self.window], count)
        total, steps = float(np.sum(window**2)), FINE * count
        noise = 0.0 if self.photons is None else self.excess_noise
        middle = np.arange(-(count // 2), count - count // 2)
        near = 1.0
        if self.looks:  # Amplitudes are split so that power is kept in the mean over the chirp
            near = float(np.sum(window**2 * np.cos(2 * np.pi * middle / steps))) / total
        split = [_splitter(pixel, each, (pixels, steps), near) for each in beats]
        if not self.looks:
            lags = np.correlate(window, window, "full")[count - 1 :]
            grid = np.stack([each @ power for each in split]).reshape(2, pixels, steps)
            own = steps * np.fft.ifft(grid)
            lag = lags * own[..., :count]
            lag[..., 1:] += lags[:0:-1] * own[..., steps - count + 1 :]
            return np.maximum(np.fft.fft(lag).real, 0) / (count * total) + noise
        turn = np.exp(-1j * np.pi * (beats[0] - beats[1]))
        mean, size = np.zeros((2, pixels, count)), np.sqrt(power / (2 * count))
        for _ in range(self.looks):
            up = size * _gaussian(random, power.shape)
            grid = np.stack([split[0] @ up, split[1] @ (up.conj() * turn)])
            signal = steps * np.fft.ifft(grid.reshape(2, pixels, steps))[..., middle]
            if noise:
                signal += math.sqrt(noise / 2) * _gaussian(random, signal.shape)
            mean += abs(np.fft.fft(window * signal)) ** 2
        return mean / (self.looks * total)

    def _peak(self, spectra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the frequencies of peaks, in periods of a chirp, and their heights."""
        count = spectra.shape[-1]
        place = spectra.argmax(axis=-1)[..., None]
        three = np.take_along_axis(spectra, (place + np.arange(-1, 2)) % count, axis=-1)
        height = three[..., 1].astype(float)
        with np.errstate(divide="ignore", invalid="ignore"):
            left, middle, right = np.log(np.maximum(three / height[..., None], 1e-12)).T
            bend = left - 2 * middle + right
            offset = np.where(bend < 0, 0.5 * (left - right) / bend, 0.0).T
        found = place[..., 0] - count // 2 + offset
        return np.where(height > 0, found, np.nan), height


def _gaussian(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Return complex Gaussian numbers of mean power 2."""
    return random.standard_normal((*shape, 2)).view(complex)[..., 0]


def _splitter(pixel: np.ndarray, beats: np.ndarray, shape: tuple[int, int], near: float) -> Any:
    """Return the matrix that splits cells onto two steps each of their pixels' grids.

    `near` is the mean correlation of two neighbouring steps over the chirp, 1 to split power.
    """
    from scipy.sparse import csc_array

    pixels, steps = shape
    lower = np.floor(FINE * beats)
    upper = FINE * beats - lower
    places = (lower[:, None].astype(int) + np.arange(2)) % steps + steps * pixel[:, None]
    size = np.sqrt(1 - 2 * upper * (1 - upper) * (1 - near))
    parts = np.stack([1 - upper, upper], axis=1) / size[:, None]
    columns = np.arange(0, parts.size + 1, 2)
    return csc_array((parts.ravel(), places.ravel(), columns), (pixels * steps, len(beats)))


def checked_film(film: Any, name: str = "film") -> tuple[np.ndarray, Axis, Axis]:
    """Return radiance (y, x, opl, rate) and the axes of a Dataset of `range_rate`."""
    film = read(film, RANGE_RATES, name)
    values = checks.real_array(name, film["radiance"].values)
    light = values.sum(axis=-1, dtype=np.float32)
    whole = np.isfinite(light).all() and light.min() >= 0
    checks.require(name, light, whole, "finite and at least 0")
    return light, axis_of(film, "opl", name), axis_of(film, "rate", name)


def axis_of(film: xr.Dataset, axis: str, name: str = "film") -> Axis:
    """Return the bins along an axis of a film, from their centers.

    Films of `range_rate` state the width of their bins, so that gaps are found.
    """
    centers = np.asarray(film[axis].values, float)
    widths = np.diff(centers)
    even = widths.size > 0 and widths[0] > 0 and np.allclose(widths, widths[0], rtol=1e-3, atol=0)
    allowed = "the centers of at least 2 bins of equal width without gaps"
    checks.require(f"{name}: {axis}", centers, even, allowed)
    width = float(centers[-1] - centers[0]) / (centers.size - 1)
    stated = film.attrs.get(f"bin_width_{axis}", width)
    if not np.isclose(width, stated, rtol=1e-3, atol=0):
        raise ValueError(
            f"{name}: the bins of {axis} are {width:g} apart, but {stated:g} wide. Render fewer "
            "bins instead of coarsen; do not skip bins"
        )
    return Axis(centers.size, float(centers[0]) - width / 2, width)
