"""Pictures of one size that are compared, or films with a common clock."""

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


class PictureSet:
    """Pictures of one size. If all are films, they have a common `clock` and a common `quantity`.

    Films with different bin widths, or different quantities, are compared as radiance per meter.

    Args:
        pictures: Two pictures or more.

    Raises:
        ValueError: Sizes or first pixels differ, or bins of films do not overlap in time.

    Example:
        >>> films = [Transient(np.ones((2, 3, 8)), 1.0 + k, 0.5) for k in range(2)]
        >>> both = PictureSet(*(Picture("ab"[k], np.ones((2, 3, 1)), films[k]) for k in range(2)))
        >>> both.clock
        Clock(start=2.0, width=0.5, count=6)
    """

    def __init__(self, *pictures: Picture) -> None:
        # Do all have the same pixels?
        first, *others = pictures
        size = _size(first)
        for other in others:
            if _size(other) != size:
                problem = f"{_size(other)} pixels; must be {size}, as {first.name}"
                raise ValueError(f"{other.name}: {problem}")
            known = None not in (first.first_pixel, other.first_pixel)
            if known and first.first_pixel != other.first_pixel:
                raise ValueError(
                    f"{other.name} begins at the pixel {other.first_pixel}, and {first.name} at "
                    f"{first.first_pixel}. Compare the same crop of both"
                )

        # Find the common clock of films
        self.pictures = pictures
        self.clock: Clock | None = None
        self.quantity = ""
        self._factors = [1.0] * len(pictures)
        self._films = [each.film for each in pictures if each.film is not None]
        if len(self._films) == len(pictures):
            self.clock = self._common_clock()

    def _common_clock(self) -> Clock:
        # Bins that all films contain
        films = self._films
        width = min(film.bin_width_opl for film in films)
        start, stop = _ends(films[0])
        for picture, film in zip(self.pictures[1:], films[1:], strict=True):
            own_start, own_stop = _ends(film)
            if min(stop, own_stop) - max(start, own_start) < width * (1 - 1e-6):
                raise ValueError(
                    f"{picture.name}: bins from {own_start:.4g} to {own_stop:.4g} m; must overlap "
                    f"with {start:.4g} to {stop:.4g} m in time"
                )
            start = max(start, own_start)
            stop = min(stop, own_stop)
        count = math.floor((stop - start) / width + 1e-6)

        # Quantity that all films can be converted to
        self.quantity = films[0].quantity
        is_light = [film.quantity.startswith(LIGHT) for film in films]
        for picture, film in zip(self.pictures, films, strict=True):
            if not all(is_light) and film.quantity != self.quantity:
                problem = f"{film.quantity}; must be {self.quantity}, as the first film"
                raise ValueError(f"{picture.name}: {problem}")
        equal_widths = all(math.isclose(film.bin_width_opl, width) for film in films)
        if not equal_widths or any(film.quantity != self.quantity for film in films):
            self.quantity = DENSITY if is_light[0] else f"{self.quantity} per meter"
            dense = [film.quantity.startswith(DENSITY) for film in films]
            self._factors = [d or 1 / f.bin_width_opl for d, f in zip(dense, films, strict=True)]
        return Clock(start, width, count)

    def frames(self, step: int | None) -> list[np.ndarray]:
        """Return all pictures (height, width, channels), at a step of the clock or as a whole."""
        if step is None or self.clock is None:
            return alike([each.pixels for each in self.pictures])
        opl = self.clock.start + (step + 0.5) * self.clock.width
        bins = (self._bins(film, np.array([opl]))[0] for film in self._films)
        frames = (film.values.frame(k) for film, k in zip(self._films, bins, strict=True))
        return alike([f * np.float32(c) for f, c in zip(frames, self._factors, strict=True)])

    def responses(self, x: int, y: int) -> list[np.ndarray]:
        """Return the luminance of a pixel over the clock, for each film."""
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


def _size(picture: Picture) -> str:
    height, width = picture.pixels.shape[:2]
    return f"{width} x {height}"


def _ends(film: Transient) -> tuple[float, float]:
    """Return start and end of a film's bins [m]."""
    return film.start_opl, film.start_opl + film.bins * film.bin_width_opl


def alike(pictures: list[np.ndarray]) -> list[np.ndarray]:
    """Return pictures with equal channels. The channel of a gray picture is repeated."""
    channels = max(each.shape[-1] for each in pictures)
    return [np.repeat(p, channels, -1) if p.shape[-1] < channels else p for p in pictures]


def difference(one: np.ndarray, other: np.ndarray) -> tuple[float, float, float, float]:
    """Return root mean square and largest difference, and both means, of finite values."""
    a, b = _known(one, other)
    if not a.size:
        return math.nan, math.nan, math.nan, math.nan
    off = np.abs(b - a)
    return float(np.sqrt(np.mean(off**2))), float(off.max()), float(a.mean()), float(b.mean())


def relative_errors(reference: np.ndarray, picture: np.ndarray) -> tuple[float, float]:
    """Return relMSE and SMAPE of a picture.

        relMSE = mean((x - r)^2 / (r^2 + eps))      SMAPE = mean(2 |x - r| / (|x| + |r|))

    x are the values of the picture, and r the values of the reference. eps is 1 % of the mean of
    r^2, so that dark pixels do not dominate, and no unit of light matters. Values that are 0 in
    both pictures have no error. Only values that are finite in both pictures count.

    Args:
        reference: Values, any shape.
        picture: Values of the same shape.

    Returns:
        relMSE, 0 or more; and SMAPE, from 0 to 2. Both are NaN without a finite value.

    Example:
        >>> relative_errors(np.array([1.0, 1.0]), np.array([1.0, 3.0]))
        (1.9801980198019802, 0.5)
    """
    r, x = _known(reference, picture)
    if not r.size:
        return math.nan, math.nan
    off = np.abs(x - r)
    scale = r**2 + 0.01 * np.mean(r**2)
    total = np.abs(x) + np.abs(r)
    rel_mse = np.divide(off**2, scale, out=np.full_like(off, math.inf), where=scale > 0)
    smape = np.divide(2 * off, total, out=np.zeros_like(off), where=total > 0)
    return float(np.where(off > 0, rel_mse, 0.0).mean()), float(smape.mean())


def _known(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the values that are finite in both pictures, as float64."""
    known = np.isfinite(one) & np.isfinite(other)
    return one[known].astype(np.float64), other[known].astype(np.float64)
