"""Film plugin `transient_hdr_film`: a steady image and a histogram of arrival times per pixel."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.settings import parameter
from ..signals.polarisation import stokes_count, to_stokes
from .colours import channels_by, channels_of
from .histogram import Histogram
from .image import box_by_default, image_film, stokes_channels
from .splats import Splats, footprint

if TYPE_CHECKING:
    from .exposure import Exposure
    from .recording import BinRecording

T = TypeVar("T")
TEMPORAL_FILTERS = ("", "box")
WEIGHT = 3  # Number of the channel that has a picture's weights, behind its colours


class TransientHDRFilm(mi.Film):
    r"""A film with time bins (plugin `transient_hdr_film`), interchangeable with mitransient's.

    Bin k collects the light that arrives with an optical path length in
    [start_opl + k w, start_opl + (k + 1) w). Its value is the radiance that arrives within the bin:
    the sum over bins plus what falls outside the window is the steady image.

    | parameter | default | meaning |
    |---|---|---|
    | `temporal_bins` | 2048 | number of bins |
    | `bin_width_opl` | 0.003 | width w of a bin [m] |
    | `start_opl` | 0 | start of the first bin [m] |
    | `width`, `height` | 768, 576 | size [pixels] |
    | `crop_width` ... `crop_offset_y` | whole film | crop window [pixels] |
    | `sample_border` | false | sample beyond the border, by the filter's radius |
    | `rfilter` | box | reconstruction filter, in space; others than box cost time |
    | `temporal_filter` | "" | filter in time by default: "box", or "" for `rfilter` |
    | `pixel_format`, ... | | only what is stored: RGB (or luminance) in float32, OpenEXR |

    `develop()` returns `(steady, transient)`: tensors of shape (height, width, channels) and
    (height, width, temporal_bins, channels), of the crop's size, where channels is 1 in
    monochromatic variants and 3 (RGB) otherwise. Polarised variants have four times as many: those
    of S0, then of S1, S2 and S3 (see `signals.polarisation`); in monochromatic ones, bins are
    mitransient's, whose picture has S0 only, and whose film has S0 only in spectral ones.

    Attributes that an integrator sets after `prepare`:

    - `samples_per_pixel`: Number of samples that `spec` is divided by in `add_transient_data`.
      Needed with filters other than box.
    - `taken`: Fraction of these samples that were taken so far, above 0 and at most 1.
    - `one_writer_per_pixel`: Whether only one thread writes to each pixel, see `Histogram.add`.

    Limitations: no alpha channel in time, no AOVs in time, no exhaustive scan. Pictures are those
    of Mitsuba's JIT variants. Its `scalar_*` variants read filters other than box from a table of
    31 steps and differ from those by up to 1 % in edge rows without `sample_border`.

    Example:
        >>> bins = {"temporal_bins": 8, "start_opl": 1.0, "bin_width_opl": 0.25}
        >>> film = mi.load_dict({"type": "transient_hdr_film", "width": 4, "height": 2} | bins)
        >>> float(film.end_opl())
        3.0
    """

    def __init__(self, props: mi.Properties) -> None:
        box_by_default(props)
        self.temporal_bins: int = parameter(props, "temporal_bins", 2048)
        self.bin_width_opl: float = parameter(props, "bin_width_opl", 0.003)
        self.start_opl: float = parameter(props, "start_opl", 0.0)
        name = props.get("temporal_filter", "")
        self.temporal_filter: str = checks.one_of("temporal_filter", name, TEMPORAL_FILTERS)
        scans = ("exhaustive_scan", False), ("laser_scan_width", 0), ("laser_scan_height", 0)
        for name, only in scans:
            value = props.get(name, only)
            checks.require(name, value, not value, f"{only}, this film has no laser axes")
        stored = {
            "pixel_format": "luminance" if mi.is_monochromatic else "rgb",
            "component_format": "float32",
            "file_format": "openexr",
        }
        for name, only in stored.items():
            checks.one_of(name, props.get(name, only), (only,))
        for side in ("width", "height"):
            parameter(props, side, None)
            if f"crop_{side}" in props:
                checks.integer(f"crop_{side}", props[f"crop_{side}"], 1, checks.MAX_SIZE)
        super().__init__(props)
        self._steady: mi.Film | None = None
        self._bins: Histogram | None = None
        self._splats: Splats | None = None
        self._splats_in_bins = False
        self.samples_per_pixel: float | None = None
        self.taken = 1.0
        self.one_writer_per_pixel = False

    def recording(self, exposure: Exposure) -> BinRecording:
        """Return how an integrator's light is recorded, see `films.recording`."""
        from .recording import BinRecording  # Student editions may not have it

        return BinRecording(self, exposure)

    def end_opl(self) -> float:
        """End of the last bin [m]."""
        return self.start_opl + self.bin_width_opl * self.temporal_bins

    def base_channels_count(self) -> int:
        """Channels of a colour: 1 in monochromatic variants, otherwise 3."""
        return 1 if mi.is_monochromatic else 3

    def prepare(self, aovs: Sequence[str]) -> int:
        """Create an empty steady image, with `aovs` as extra channels, and empty bins.

        Returns the number of the image's channels, weight included. A `MemoryError` says what fits.
        """
        self._bins = self._splats = None  # Free memory before it is allocated again
        self._splats_in_bins = False
        self._bins = Histogram(*self.shape)
        self._steady = image_film(self)
        self.samples_per_pixel, self.taken = None, 1.0
        self.one_writer_per_pixel = False
        return self.steady.prepare([*aovs, *stokes_channels()])

    def clear(self) -> None:
        """Clear all bins and the steady image."""
        if self._steady is not None:
            self._steady.clear()
            expected = self._splats is not None
            self._bins = self._splats = None
            self._bins = Histogram(*self.shape)
            if expected:
                self.expect_splats()

    def expect_splats(self, in_bins: bool = False) -> None:
        """Allocate bins of their own for splats; raises `MemoryError` if they do not fit.

        With `in_bins` and a box filter, the bins of the samples take the splats, too. Kernels that
        add splats must then add no samples.
        """
        self._splats_in_bins = in_bins and self.rfilter().is_box_filter()
        if not self._splats_in_bins:
            self._splats = Splats(self, self.temporal_bins)

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Flush the bins to a second sum, which `develop` adds.

        Single precision loses small numbers that are added to a large one: integrators call this
        every 2^16 samples per pixel, for all pixels, which takes as much memory again, or for some
        by their numbers, row by row in the crop window, which must be the same in every call. With
        another filter than box, those are pixels of the splats.
        """
        if pixels is not None:
            part = "bins" if self.rfilter().is_box_filter() else "splats"
            self._histograms()[part].flush_pixels(pixels)
            return
        for cells in self._histograms().values():
            cells.flush()

    def fold(self, pixels: mi.UInt32 | None = None) -> None:
        """Flush the bins: the deprecated name of `flush`."""
        warnings.warn("fold: is deprecated; must be flush", DeprecationWarning, stacklevel=2)
        self.flush(pixels)

    def add_splat(
        self,
        pos: mi.Point2f,
        distance: mi.Float,
        wavelengths: mi.Spectrum,
        spec: mi.Spectrum,
        active: mi.Bool,
    ) -> None:
        """Add the light of a path from an emitter to the bins of splats, after `expect_splats`.

        Arguments as for `add_transient_data`; `spec` is divided by the light paths per pixel.
        """
        if self._splats is None and not self._splats_in_bins:
            raise RuntimeError("transient_hdr_film: has no room for splats; call expect_splats()")
        k, active = self._bin(distance, active)
        values = channels_of(to_stokes(spec), wavelengths, active)
        if self._splats is not None:
            self._splats.add(pos, [values], k, active)
            return
        for x, y, _ in footprint(self, pos):
            self.bins.add(values, x, y, k, active, private=False)

    def add_transient_data(
        self,
        pos: mi.Point2f,
        distance: mi.Float,
        wavelengths: mi.Spectrum,
        spec: mi.Spectrum,
        ray_weight: mi.Float,
        active: mi.Bool,
        colours: Sequence[mi.Color3f] | None = None,
        **_laser,
    ) -> None:
        """Add a contribution to the bin that its length falls into.

        Args:
            pos: Position on the film [pixels], crop offset included.
            distance: Optical path length [m]; outside of the window it is ignored.
            wavelengths: Sampled wavelengths [nm], for spectral variants.
            spec: Radiance over the number of samples per pixel; in polarised variants a Stokes
                vector (`mi.SpectrumEntry`), or a Mueller matrix whose first column counts.
            ray_weight: Factor of `spec`, from the camera.
            active: Lanes that have a contribution.
            colours: Those of the wavelengths, see `colours.units_of`, if they were looked up.
        """
        k, active = self._bin(distance, active)
        light = to_stokes(spec * ray_weight)
        if colours is None:
            values = channels_of(light, wavelengths, active)
        else:
            values = channels_by(colours, light)
        for x, y, weight in footprint(self, pos):
            weighted = [value * weight for value in values]
            self.bins.add(weighted, x, y, k, active, private=self.one_writer_per_pixel)

    def develop(self, raw: bool = False) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Return the steady image and the bins; `raw` ones are not divided by filter weights.

        Needs `prepare`, and `samples_per_pixel` with filters other than box: else a `RuntimeError`.
        """
        scale = None if raw else self._pixel_scale()
        bins = self.bins.tensor(scale)
        if self._splats is not None:
            bins += self._splats.cells.tensor() * (1.0 if raw else 1 / self.taken)
        return self.steady.develop(raw=raw), bins

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """Develop into float32 arrays without a copy of the bins; the film is then empty."""
        scale = self._pixel_scale()
        steady, transient = np.array(self.steady.develop()), self.bins.take(scale)
        if self._splats is not None:
            splats = self._splats.cells.take()
            splats /= self.taken
            transient += splats
        self._steady = self._bins = self._splats = None
        return steady, transient

    def state(self) -> dict[str, np.ndarray]:
        """Return the content for a checkpoint, see `Histogram.state`."""
        return {
            f"{part}.{name}": array
            for part, cells in self._histograms().items()
            for name, array in cells.state().items()
        }

    def restore(self, state: Mapping[str, np.ndarray], factor: float) -> None:
        """Restore a `state`, multiplied by a factor; call `expect_splats` before if it has some."""
        for part, cells in self._histograms().items():
            prefix = f"{part}."
            own = {n.removeprefix(prefix): state[n] for n in state if n.startswith(prefix)}
            if own:
                cells.restore(own, factor)

    def _histograms(self) -> dict[str, Histogram]:
        splats = {} if self._splats is None else {"splats": self._splats.cells}
        return {"bins": self.bins, **splats}

    @property
    def steady(self) -> mi.Film:
        """The steady image, an `hdrfilm`; raises a `RuntimeError` before `prepare`."""
        return self._prepared(self._steady)

    @property
    def bins(self) -> Histogram:
        """The bins; raises a `RuntimeError` before `prepare`."""
        return self._prepared(self._bins)

    @staticmethod
    def _prepared(part: T | None) -> T:
        if part is None:
            raise RuntimeError("transient_hdr_film: is empty; call prepare() first, or render")
        return part

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(height, width, temporal_bins, channels), of the crop window."""
        width, height = self.crop_size()
        channels = self.base_channels_count() * stokes_count()
        return (int(height), int(width), self.temporal_bins, channels)

    def time_slice(self, k: int) -> mi.TensorXf:
        """Return bin `k`, 0 to `temporal_bins` - 1, as an image (height, width, channels)."""
        k = checks.integer("k", k, 0, self.temporal_bins - 1)
        image = self.bins.slice(k, self._pixel_scale())
        if self._splats is not None:
            image += self._splats.cells.slice(k) / self.taken
        return image

    def merge_tile(self, tile: TransientHDRFilm) -> None:
        """Add the bins and the steady image of a film that was rendered for a part of this one.

        A tile has the same `size`, bins and filter, or else is refused by a `ValueError`. Its crop
        window is its position; tiles must not overlap. With filters other than box, this film and
        its tiles must sample beyond their borders (`sample_border`), or seams would be too dark.
        """
        names = "temporal_bins", "start_opl", "bin_width_opl", "size", "rfilter", "sample_border"
        for name in names:
            values = (getattr(film, name) for film in (self, tile))
            mine, its = (str(value() if callable(value) else value) for value in values)
            if mine != its:
                raise ValueError(f"tile.{name} = {its}: must be {mine}, as in the film")
        x, y = (int(v) for v in tile.crop_offset() - self.crop_offset())
        height, width, _, _ = tile.shape
        if x < 0 or y < 0 or x + width > self.shape[1] or y + height > self.shape[0]:
            raise ValueError(
                f"tile.crop_offset = {tile.crop_offset()}, size {width} x {height}: "
                f"must lie within the film's window of {self.shape[1]} x {self.shape[0]} pixels"
            )
        needs_border = tile.shape != self.shape and not self.rfilter().is_box_filter()
        if needs_border and not tile.sample_border():
            raise ValueError(
                "tile.sample_border = False: must be True with another filter than box, here and "
                "in the film, so that seams get the samples beyond them"
            )
        self.bins.merge(tile.bins, x, y)
        if tile._splats is not None:
            if self._splats is None:
                self.expect_splats()
            self._histograms()["splats"].merge(tile._splats.cells, x, y)
        raw = tile.steady.develop(raw=True)
        self.steady.put_block(mi.ImageBlock(raw, tile.crop_offset()))
        self.samples_per_pixel = tile.samples_per_pixel
        self.taken = min(self.taken, tile.taken)

    def scale(self, factor: float) -> None:
        """Multiply the bins and the steady image by a number."""
        for cells in self._histograms().values():
            cells.scale(factor)
        raw = self.steady.develop(raw=True)
        count = raw.shape[2]
        is_weight = dr.arange(mi.UInt32, dr.width(raw.array)) % count == WEIGHT
        scaled = raw.array * dr.select(is_weight, 1.0, factor)
        self.steady.clear()
        self.steady.put_block(mi.ImageBlock(mi.TensorXf(scaled, raw.shape), self.crop_offset()))

    def to_string(self) -> str:
        """The film's parameters."""
        return (
            f"TransientHDRFilm[\n  size = {self.size()},\n  crop_size = {self.crop_size()},\n"
            f"  crop_offset = {self.crop_offset()},\n  temporal_bins = {self.temporal_bins},\n"
            f"  bin_width_opl = {self.bin_width_opl},\n  start_opl = {self.start_opl},\n"
            f"  filter = {self.rfilter()}\n]"
        )

    def _bin(self, distance: mi.Float, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """Return the bin of a length, and the lanes where there is one."""
        position = (distance - self.start_opl) / self.bin_width_opl
        active = active & (position >= 0) & (position < self.temporal_bins)
        return mi.UInt32(dr.select(active, position, 0)), active

    def _pixel_scale(self) -> mi.Float | None:
        """Samples over the filter's weights at each pixel; None if all are 1."""
        if self.rfilter().is_box_filter() and self.taken == 1:
            return None
        if self.samples_per_pixel is None:
            raise RuntimeError(
                "transient_hdr_film: samples_per_pixel is not set, which a film with a filter "
                f"other than box needs to develop; its filter is {self.rfilter()}"
            )
        raw = self.steady.develop(raw=True)
        pixel = dr.arange(mi.UInt32, raw.shape[0] * raw.shape[1])
        weight = dr.gather(mi.Float, raw.array, pixel * raw.shape[2] + WEIGHT)
        return dr.select(weight != 0, self.samples_per_pixel / weight, 0)
