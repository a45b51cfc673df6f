"""Film plugin `transient_hdr_film`: a steady image and a histogram of arrival times per pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.settings import parameter
from ..signals.polarization import stokes_count, to_stokes
from .channels import channels_by, channels_of
from .histogram import Histogram
from .image import box_by_default, image_film, stokes_channels
from .splats import Splats, footprint

if TYPE_CHECKING:
    from .exposure import Exposure
    from .recording import BinRecording

T = TypeVar("T")
TEMPORAL_FILTERS = ("", "box")
WEIGHT = 3  # Index of the picture's weight channel, after RGB


class TransientHDRFilm(mi.Film):
    r"""A film with time bins (plugin `transient_hdr_film`), interchangeable with mitransient's.

    Bin k collects the light that arrives with an optical path length in
    [start_opl + k w, start_opl + (k + 1) w). Its value is the radiance that arrives within the bin.
    The sum over all bins, plus the light outside the window, is the steady image.

    | parameter | default | meaning |
    |---|---|---|
    | `temporal_bins` | 2048 | number of bins |
    | `bin_width_opl` | 0.003 | width w of a bin [m] |
    | `start_opl` | 0 | start of the first bin [m] |
    | `width`, `height` | 768, 576 | size [pixels] |
    | `crop_width` ... `crop_offset_y` | whole film | crop window [pixels] |
    | `sample_border` | false | sample beyond the border, by the filter's radius |
    | `rfilter` | box | reconstruction filter in space; filters other than box are slower |
    | `temporal_filter` | "" | default filter in time: "box", or "" for `rfilter` |
    | `pixel_format`, ... | | only RGB (or luminance), float32 and OpenEXR are supported |

    `develop()` returns `(steady, transient)`: tensors of shape (height, width, channels) and
    (height, width, temporal_bins, channels) of the crop window. `channels` is 1 in monochromatic
    variants and 3 (RGB) otherwise. In polarized variants, the number is four times larger: the
    channels of S0 are followed by S1, S2 and S3 (see `signals.polarization`). The bins equal
    mitransient's in monochromatic polarized variants. mitransient's picture has S0 only, and its
    spectral polarized films have S0 only.

    Integrators call `prepare`, `add_transient_data`, and then `count_samples`. Only films with a
    box filter, and with all samples, do not need `count_samples`.

    Limitations: alpha channels and AOVs in time and exhaustive scans are not supported. Pictures
    equal those of Mitsuba's JIT variants. Mitsuba's `scalar_*` variants read filters other than box
    from a table with 31 steps, and differ by up to 1 % in rows at the edge without `sample_border`.

    Example:
        >>> bins = {"temporal_bins": 8, "start_opl": 1.0, "bin_width_opl": 0.25}
        >>> film = mi.load_dict({"type": "transient_hdr_film", "width": 4, "height": 2} | bins)
        >>> float(film.end_opl())
        3.0
    """

    def __init__(self, props: mi.Properties) -> None:
        # Time bins and filters
        box_by_default(props)
        self.temporal_bins: int = parameter(props, "temporal_bins", 2048)
        self.bin_width_opl: float = parameter(props, "bin_width_opl", 0.003)
        self.start_opl: float = parameter(props, "start_opl", 0.0)
        name = props.get("temporal_filter", "")
        self.temporal_filter: str = checks.one_of("temporal_filter", name, TEMPORAL_FILTERS)

        # Refuse mitransient's parameters of exhaustive scans, and other formats
        scans = ("exhaustive_scan", False), ("laser_scan_width", 0), ("laser_scan_height", 0)
        for name, only in scans:
            value = props.get(name, only)
            checks.require(name, value, not value, f"{only}, exhaustive scans are not supported")
        stored = {
            "pixel_format": "luminance" if mi.is_monochromatic else "rgb",
            "component_format": "float32",
            "file_format": "openexr",
        }
        for name, only in stored.items():
            checks.one_of(name, props.get(name, only), (only,))

        # Size and crop window
        for side in ("width", "height"):
            parameter(props, side, None)
            if f"crop_{side}" in props:
                checks.integer(f"crop_{side}", props[f"crop_{side}"], 1, checks.MAX_SIZE)
        super().__init__(props)

        # Content, created by `prepare` and `expect_splats`
        self._steady: mi.Film | None = None
        self._bins: Histogram | None = None
        self._splats: Splats | None = None
        self._splats_in_bins = False

        # Planned samples per pixel of a render, and the fraction of these that have been taken
        self._samples_per_pixel: int | None = None
        self._taken = 1.0

    def recording(self, exposure: Exposure) -> BinRecording:
        """Return the recording of an integrator's light on this film, see `films.recording`."""
        from .recording import BinRecording  # Editions may leave it out

        return BinRecording(self, exposure)

    # --------------------- Interface of films ---------------------

    def end_opl(self) -> float:
        """Return the end of the last bin [m]."""
        return self.start_opl + self.bin_width_opl * self.temporal_bins

    def base_channels_count(self) -> int:
        """Return the number of channels of a color: 1 in monochromatic variants, otherwise 3."""
        return 1 if mi.is_monochromatic else 3

    def prepare(self, aovs: Sequence[str]) -> int:
        """Create an empty steady image, with `aovs` as extra channels, and empty bins.

        Returns:
            The number of the image's channels, including the weight channel.

        Raises:
            MemoryError: If the bins do not fit into memory. The message names sizes that fit.
        """
        # Release the old bins before new bins are allocated
        self._bins = self._splats = None
        self._splats_in_bins = False
        self._bins = Histogram(*self.shape)
        self._steady = image_film(self)
        self._samples_per_pixel = None
        self._taken = 1.0
        return self.steady.prepare([*aovs, *stokes_channels()])

    def clear(self) -> None:
        """Clear all bins and the steady image."""
        if self._steady is not None:
            self._steady.clear()
            has_splats = self._splats is not None
            self._bins = self._splats = None
            self._bins = Histogram(*self.shape)
            if has_splats:
                self.expect_splats()

    def expect_splats(self, in_bins: bool = False) -> None:
        """Allocate separate bins for splats.

        Args:
            in_bins: Whether the bins of samples may contain the splats as well, which saves memory.
                Kernels that add splats must then not add samples. Requires a box filter.

        Raises:
            MemoryError: If the bins do not fit into memory.
        """
        self._splats_in_bins = in_bins and self.rfilter().is_box_filter()
        if not self._splats_in_bins:
            self._splats = Splats(self, self.temporal_bins)

    def count_samples(self, taken: int, planned: int) -> None:
        """Set the number of samples per pixel that the film contains.

        Args:
            taken: Samples per pixel that have been taken, at least 1 and at most `planned`.
            planned: Planned samples per pixel. `add_transient_data` expects `spec` divided by this
                number.
        """
        self._samples_per_pixel = planned
        self._taken = taken / planned

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Move the sums in bins to a second array, which `develop` adds.

        Single precision loses small numbers that are added to a large sum. Therefore integrators
        call this method every 2^16 samples per pixel.

        Args:
            pixels: Indices of the pixels in the crop window, row by row. All calls must pass the
                same pixels. None selects all pixels, which needs twice the memory of the bins. With
                filters other than box, the pixels select bins of splats instead of samples.
        """
        # Some pixels
        if pixels is not None:
            part = "bins" if self.rfilter().is_box_filter() else "splats"
            self._histograms()[part].flush_pixels(pixels)
            return

        # All pixels
        for cells in self._histograms().values():
            cells.flush()

    # --------------------- Adding light ---------------------

    def add_splat(
        self,
        pos: mi.Point2f,
        distance: mi.Float,
        wavelengths: mi.Spectrum,
        spec: mi.Spectrum,
        active: mi.Bool,
    ) -> None:
        """Add the light of a path from an emitter to the bins of splats.

        Args:
            pos: Position on the film [pixels].
            distance: Optical path length [m].
            wavelengths: Sampled wavelengths [nm].
            spec: Radiance over the number of light paths per pixel.
            active: Lanes with a contribution.

        Raises:
            RuntimeError: If `expect_splats` has not been called.
        """
        if self._splats is None and not self._splats_in_bins:
            raise RuntimeError(
                "transient_hdr_film: the bins of splats are missing. Call expect_splats() first"
            )
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
        colors: Sequence[mi.Color3f] | None = None,
        one_writer: bool = False,
        **_laser,
    ) -> None:
        """Add a contribution to the bin of its path length.

        Args:
            pos: Position on the film [pixels], including the crop offset.
            distance: Optical path length [m]. Light outside of the window is ignored.
            wavelengths: Sampled wavelengths [nm], for spectral variants.
            spec: Radiance over the number of samples per pixel. In polarized variants, a Stokes
                vector (`mi.SpectrumEntry`), or a Mueller matrix with this vector as first column.
            ray_weight: Weight of the camera ray, a factor of `spec`.
            active: Lanes with a contribution.
            colors: Colors of the wavelengths from `colors.units_of`, if they are known.
            one_writer: Whether only one thread writes to each pixel, see `Histogram.add`.
            **_laser: Arguments of mitransient's integrators for laser scans, which are ignored.
        """
        # Convert the light to channels
        k, active = self._bin(distance, active)
        light = to_stokes(spec * ray_weight)
        if colors is None:
            values = channels_of(light, wavelengths, active)
        else:
            values = channels_by(colors, light)

        # Distribute the light over the pixels of the reconstruction filter
        private = one_writer and self.rfilter().is_box_filter()
        for x, y, weight in footprint(self, pos):
            weighted = [value * weight for value in values]
            self.bins.add(weighted, x, y, k, active, private=private)

    # --------------------- Results ---------------------

    def develop(self, raw: bool = False) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Return the steady image and the bins.

        Args:
            raw: Whether the sums are not divided by the weights of the reconstruction filter.

        Raises:
            RuntimeError: If `prepare` has not been called, or if `count_samples` has not been
                called and the filter is not box.
        """
        # Bins of samples
        scale = None if raw else self._pixel_scale()
        bins = self.bins.tensor(scale)

        # Bins of splats
        if self._splats is not None:
            bins += self._splats.cells.tensor() * (1.0 if raw else 1 / self._taken)
        return self.steady.develop(raw=raw), bins

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the developed film as float32 arrays without copying the bins.

        The film is empty afterwards.
        """
        scale = self._pixel_scale()
        steady = np.array(self.steady.develop())
        transient = self.bins.take(scale)
        if self._splats is not None:
            splats = self._splats.cells.take()
            splats /= self._taken
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
        """Restore the content from a `state`, multiplied by a factor.

        If the state contains splats, `expect_splats` must be called first.
        """
        for part, cells in self._histograms().items():
            prefix = f"{part}."
            arrays = {n.removeprefix(prefix): state[n] for n in state if n.startswith(prefix)}
            if arrays:
                cells.restore(arrays, factor)

    def _histograms(self) -> dict[str, Histogram]:
        """Return the histograms of the film: "bins" for samples, and "splats" if splats exist."""
        splats = {} if self._splats is None else {"splats": self._splats.cells}
        return {"bins": self.bins, **splats}

    @property
    def steady(self) -> mi.Film:
        """The steady image, an `hdrfilm`. Before `prepare`, this raises a `RuntimeError`."""
        return self._prepared(self._steady)

    @property
    def bins(self) -> Histogram:
        """The bins. Before `prepare`, this raises a `RuntimeError`."""
        return self._prepared(self._bins)

    @staticmethod
    def _prepared(part: T | None) -> T:
        """Return a part of the film. Raise an error for a film that is not prepared."""
        if part is None:
            raise RuntimeError(
                "transient_hdr_film: the film is empty. Call prepare() or render first"
            )
        return part

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the bins of the crop window: (height, width, temporal_bins, channels)."""
        width, height = self.crop_size()
        channels = self.base_channels_count() * stokes_count()
        return (int(height), int(width), self.temporal_bins, channels)

    def time_slice(self, k: int) -> mi.TensorXf:
        """Return bin `k` (0 to `temporal_bins` - 1) as an image (height, width, channels)."""
        k = checks.integer("k", k, 0, self.temporal_bins - 1)
        image = self.bins.slice(k, self._pixel_scale())
        if self._splats is not None:
            image += self._splats.cells.slice(k) / self._taken
        return image

    def merge_tile(self, tile: TransientHDRFilm) -> None:
        """Add the bins and the steady image of a tile.

        Args:
            tile: A film with the same `size`, bins and filter. Its crop window is the position of
                the tile. Tiles must not overlap. With filters other than box, this film and the
                tiles must set `sample_border`, because seams would otherwise be too dark.

        Raises:
            ValueError: If the tile does not fit.
        """
        # Is the tile a part of this film?
        names = "temporal_bins", "start_opl", "bin_width_opl", "size", "rfilter", "sample_border"
        for name in names:
            values = (getattr(film, name) for film in (self, tile))
            of_film, of_tile = (str(value() if callable(value) else value) for value in values)
            if of_film != of_tile:
                raise ValueError(f"tile.{name} = {of_tile}: must be {of_film}, as in the film")
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
                "tile.sample_border = False: must be True in tile and film if the filter is not "
                "box, because seams would otherwise be too dark"
            )

        # Add bins, splats and the steady image
        self.bins.merge(tile.bins, x, y)
        if tile._splats is not None:
            if self._splats is None:
                self.expect_splats()
            self._histograms()["splats"].merge(tile._splats.cells, x, y)
        raw = tile.steady.develop(raw=True)
        self.steady.put_block(mi.ImageBlock(raw, tile.crop_offset()))
        self._samples_per_pixel = tile._samples_per_pixel
        self._taken = min(self._taken, tile._taken)

    def scale(self, factor: float) -> None:
        """Multiply the bins and the steady image by a number."""
        # The bins
        for cells in self._histograms().values():
            cells.scale(factor)

        # The steady image except for its weight channel
        raw = self.steady.develop(raw=True)
        count = raw.shape[2]
        is_weight = dr.arange(mi.UInt32, dr.width(raw.array)) % count == WEIGHT
        scaled = raw.array * dr.select(is_weight, 1.0, factor)
        self.steady.clear()
        self.steady.put_block(mi.ImageBlock(mi.TensorXf(scaled, raw.shape), self.crop_offset()))

    def to_string(self) -> str:
        """Return the film's parameters as text."""
        return (
            f"TransientHDRFilm[\n  size = {self.size()},\n  crop_size = {self.crop_size()},\n"
            f"  crop_offset = {self.crop_offset()},\n  temporal_bins = {self.temporal_bins},\n"
            f"  bin_width_opl = {self.bin_width_opl},\n  start_opl = {self.start_opl},\n"
            f"  filter = {self.rfilter()}\n]"
        )

    def _bin(self, distance: mi.Float, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """Return the index of the bin of a path length [m], and the lanes inside of the window."""
        position = (distance - self.start_opl) / self.bin_width_opl
        active = active & (position >= 0) & (position < self.temporal_bins)
        return mi.UInt32(dr.select(active, position, 0)), active

    def _pixel_scale(self) -> mi.Float | None:
        """Return, for each pixel, the number of samples over the sum of filter weights.

        Returns:
            The ratios, or None if all ratios are 1.
        """
        if self.rfilter().is_box_filter() and self._taken == 1:
            return None
        if self._samples_per_pixel is None:
            raise RuntimeError(
                f"transient_hdr_film: the filter {self.rfilter()} needs the number of samples. "
                "Call count_samples() before develop()"
            )

        # Read the weight channel of the steady image
        raw = self.steady.develop(raw=True)
        pixel = dr.arange(mi.UInt32, raw.shape[0] * raw.shape[1])
        weight = dr.gather(mi.Float, raw.array, pixel * raw.shape[2] + WEIGHT)
        return dr.select(weight != 0, self._samples_per_pixel / weight, 0)
