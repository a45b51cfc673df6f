"""Comparison of two pictures, or of two films with a common clock."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ...labels import TRANSIENT, intensity, read
from ...runtime import checks
from ...signals.color import luminance
from ...vis.transient_figures import Transient
from ..explorer.measurements import film_of, is_film, picture_of_taps

if TYPE_CHECKING:
    import xarray as xr

LIGHT = "radiance"  # Start of the quantities of renders
DENSITY = "radiance per meter"
WHITE = 0.995  # Part of all lit values that are not brighter than white
FILMS = (".npz", ".zarr", ".exr", ".nc")  # Suffixes of films and measurements
LOOKED_AT = 16  # Number of bins of a film for the estimate of its brightness


@dataclass(frozen=True)
class Picture:
    """A picture and its label. The picture of a film contains the light of all times."""

    name: str
    pixels: np.ndarray  # Linear values, float32 (height, width, 1 or 3)
    film: Transient | None = None
    first_pixel: tuple[int, int] | None = None  # Column and row on the whole film, if known


@dataclass(frozen=True)
class Clock:
    """Common bins of two films. Their width is the smaller width of both films."""

    start: float  # [m]
    width: float  # [m]
    count: int


def load(path: Any, load_film: "Callable[[Path], xr.Dataset]") -> Picture:
    """Load an exr, png or jpg file, or a result of `tofrender render` or `sense`.

    The mean of the taps of an iToF camera is shown. For a folder of frames, the first frame is
    shown.
    """
    # Is it a film or a measurement?
    path = checks.path("picture", path)
    if path.is_dir() or path.suffix.lower() in FILMS:
        try:
            return _from_film(path.name, load_film(path))
        except ValueError:
            if path.suffix.lower() != ".exr" or path.is_dir():
                raise
    if not path.is_file():
        raise FileNotFoundError(f"picture = {checks.quote(str(path))}: must be a file that exists")

    # Read a picture
    try:
        bitmap = mi.Bitmap(str(path))
        linear = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    except RuntimeError:
        kinds = "an EXR, PNG or JPEG, or a film of `tofrender render`"
        raise ValueError(f"picture = {checks.quote(str(path))}: must be {kinds}") from None
    return Picture(path.name, np.array(linear))


def _from_film(name: str, data: "xr.Dataset") -> Picture:
    if "taps" in data:
        first = int(data["x"].min()), int(data["y"].min())
        return Picture(f"{name}, mean of taps", picture_of_taps(data), first_pixel=first)
    if "frame" in data.dims:
        name = f"{name}, frame 1 of {data.sizes['frame']}"
        data = data.isel(frame=0, drop=True)
    if is_film(data):
        measured = film_of(data)
        data = measured.film
        film = replace(Transient.of(data), quantity=measured.quantity)
    else:
        data = intensity(read(data, TRANSIENT, "data"), "data")
        film = Transient.of(data)
    steady = data["steady"] if "steady" in data else data["transient"].sum("opl")
    return Picture(name, np.asarray(steady, np.float32), film, (film.x0, film.y0))


class Pair:
    """Two pictures of one size. Two films also have a common `clock` and a common `quantity`.

    Films with different bin widths, or different quantities, are compared as radiance per meter.

    Raises:
        ValueError: Sizes differ, or bins of films do not overlap in time.

    Example:
        >>> films = [Transient(np.ones((2, 3, 8)), 1.0 + k, 0.5) for k in range(2)]
        >>> pair = Pair(*(Picture("ab"[k], np.ones((2, 3, 1)), films[k]) for k in range(2)))
        >>> pair.clock
        Clock(start=2.0, width=0.5, count=6)
    """

    def __init__(self, one: Picture, other: Picture) -> None:
        # Do both have the same pixels?
        sizes = [f"{each.pixels.shape[1]} x {each.pixels.shape[0]}" for each in (one, other)]
        if sizes[0] != sizes[1]:
            raise ValueError(f"{other.name}: {sizes[1]} pixels; must be {sizes[0]}, as {one.name}")
        known = None not in (one.first_pixel, other.first_pixel)
        if known and one.first_pixel != other.first_pixel:
            raise ValueError(
                f"{other.name} begins at the pixel {other.first_pixel}, and {one.name} at "
                f"{one.first_pixel}. Compare the same crop of both"
            )

        # Find the common clock of films
        self.pictures = (one, other)
        self.clock: Clock | None = None
        self.quantity = ""
        self._factors = [1.0, 1.0]
        self._films = [each.film for each in self.pictures if each.film is not None]
        if len(self._films) == 2:
            self.clock = self._common_clock(*self._films)

    def _common_clock(self, a: Transient, b: Transient) -> Clock:
        # Bins that both films contain
        stops = [film.start_opl + film.bins * film.bin_width_opl for film in (a, b)]
        start = max(a.start_opl, b.start_opl)
        width = min(a.bin_width_opl, b.bin_width_opl)
        count = math.floor((min(stops) - start) / width + 1e-6)
        if count < 1:
            bins = f"bins from {b.start_opl:.4g} to {stops[1]:.4g} m"
            others = f"{a.start_opl:.4g} to {stops[0]:.4g} m"
            raise ValueError(f"{self.pictures[1].name}: {bins}; must overlap with {others} in time")

        # Quantity that both films can be converted to
        self.quantity = a.quantity
        is_light = [film.quantity.startswith(LIGHT) for film in (a, b)]
        if not all(is_light) and a.quantity != b.quantity:
            name = self.pictures[1].name
            raise ValueError(f"{name}: {b.quantity}; must be {a.quantity}, as the other film")
        if a.quantity != b.quantity or not math.isclose(a.bin_width_opl, b.bin_width_opl):
            self.quantity = DENSITY if is_light[0] else f"{a.quantity} per meter"
            dense = [film.quantity.startswith(DENSITY) for film in (a, b)]
            self._factors = [d or 1 / f.bin_width_opl for d, f in zip(dense, (a, b), strict=True)]
        return Clock(start, width, count)

    def frames(self, step: int | None) -> list[np.ndarray]:
        """Return both pictures (height, width, channels), at a step of the clock or as a whole."""
        if step is None or self.clock is None:
            return alike([each.pixels for each in self.pictures])
        opl = self.clock.start + (step + 0.5) * self.clock.width
        bins = (self._bins(film, np.array([opl]))[0] for film in self._films)
        frames = (film.values.frame(k) for film, k in zip(self._films, bins, strict=True))
        return alike([f * np.float32(c) for f, c in zip(frames, self._factors, strict=True)])

    def responses(self, x: int, y: int) -> list[np.ndarray]:
        """Return the luminance of a pixel over the clock, for both films."""
        if self.clock is None:
            return []
        opl = self.clock.start + (np.arange(self.clock.count) + 0.5) * self.clock.width
        films = zip(self._films, self._factors, strict=True)
        return [
            np.float32(factor) * luminance(film.values.read((y, x)))[self._bins(film, opl)]
            for film, factor in films
        ]

    def look(self) -> tuple[float, int]:
        """Return the value that is shown as white, and the brightest of a few steps."""
        assert self.clock is not None

        # Read a few steps and pixels
        steps = np.linspace(0, self.clock.count - 1, LOOKED_AT).astype(int).tolist()
        every = max(1, max(self.pictures[0].pixels.shape) // 256)
        some = [[each[::every, ::every] for each in self.frames(step)] for step in steps]
        frames = [np.nan_to_num(np.stack(each)) for each in some]
        lit = np.concatenate([each[each > 0] for each in frames])
        white = float(np.quantile(lit, WHITE)) if lit.size else 1.0
        return white, steps[np.argmax([np.minimum(each, white).sum() for each in frames])]

    @staticmethod
    def _bins(film: Transient, opl: np.ndarray) -> np.ndarray:
        found = np.floor((opl - film.start_opl) / film.bin_width_opl).astype(int)
        return np.clip(found, 0, film.bins - 1)


def alike(pictures: list[np.ndarray]) -> list[np.ndarray]:
    """Return pictures with equal channels. The channel of a gray picture is repeated."""
    channels = max(each.shape[-1] for each in pictures)
    return [np.repeat(p, channels, -1) if p.shape[-1] < channels else p for p in pictures]


def numbers(one: np.ndarray, other: np.ndarray) -> tuple[float, float, float, float]:
    """Return root mean square and largest difference, and both means, of finite values."""
    known = np.isfinite(one) & np.isfinite(other)
    a, b = (each[known].astype(np.float64) for each in (one, other))
    if not a.size:
        return math.nan, math.nan, math.nan, math.nan
    off = np.abs(b - a)
    return float(np.sqrt(np.mean(off**2))), float(off.max()), float(a.mean()), float(b.mean())
