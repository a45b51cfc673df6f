"""Animation of a transient, and plot of a pixel's response."""

import base64
import io
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.animation import FFMpegWriter, FuncAnimation
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ..labels import TRANSIENT
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from ..signals.units import opl_to_ns
from .tone import auto_exposure, tonemap
from .transient_figures import Transient, picture_aspect, pixel_axes, read_light, time_axes

_INTERVAL_MS = 50
_PLAYER_FRAMES = 100
_PLAYER_DPI = 108


@in_style()
def visualize_transient(
    data: Annotated[Any, TRANSIENT],
    start_opl: float | None = None,
    bin_width_opl: float | None = None,
) -> FuncAnimation:
    """Animate light moving through the scene; the title shows the time of each bin's center.

    A notebook shows the animation as a video of at most 100 frames. With more bins, the video
    contains every second or third bin, and so on. Before the video plays, the brightest bin is
    shown. `animation.save("light.gif")` writes a file with all bins; `save_video` is faster. See
    also `explore`, `save_video`.

    Args:
        data: Array (height, width, bins) or (height, width, bins, channels), or a Dataset.
            For Stokes vectors, S0 is shown.
        start_opl: Start of the first bin [m]. By default the start of the Dataset.
        bin_width_opl: Width of a bin [m], above 0. By default the width of the Dataset.

    Returns:
        A `matplotlib.animation.FuncAnimation` with a frame for each bin and 20 frames per second.
        All frames have the same exposure.

    Raises:
        ValueError: Another shape, or a time axis that is missing or not positive.

    Example:
        >>> animation = visualize_transient(np.ones((4, 6, 10)), 3.5, 0.02)
        >>> animation._repr_html_()[:15]
        '<video controls'
    """
    # Choose one exposure for all frames
    sequence = Transient.of(data, start_opl, bin_width_opl)
    exposure = auto_exposure(sequence.values)

    # Make an empty figure
    wide = figure_width(4.0)
    figure = new_figure(wide, wide * picture_aspect(*sequence.size, 0.5, 2.0) + 0.3, layout=None)
    axes = figure.add_subplot()

    def picture(index: int) -> np.ndarray:
        return tonemap(sequence.values.frame(index), exposure=exposure)

    # Draw the brightest bin
    brightest = _brightest_frame(sequence, exposure)
    image = axes.imshow(picture(brightest), extent=sequence.extent, interpolation="nearest")
    title = axes.set_title(sequence.label(brightest))
    pixel_axes(axes)
    ConstrainedLayoutEngine().execute(figure)  # Once, so that the axes stay at their place

    def update(index: int) -> list[Any]:
        image.set_data(picture(index))
        title.set_text(sequence.label(index))
        return [image, title]

    return _playback(figure, update, sequence.bins, brightest)


def _brightest_frame(sequence: Transient, exposure: float) -> int:
    """Return the bin with the brightest picture, with values clipped to white."""
    shown = np.zeros(sequence.bins)
    for (*_, bins), values in sequence.lights():
        shown[bins] += np.sqrt(np.minimum(values * np.float32(exposure), 1)).sum(axis=(0, 1))
    return int(shown.argmax())


def _playback(figure: Figure, update: Any, bins: int, first: int) -> FuncAnimation:
    """Return an animation of `bins` frames. A notebook shows the `first` frame, then a video."""

    class Playback(FuncAnimation):
        stride = 1
        html = ""

        def new_saved_frame_seq(self):
            return iter(range(0, bins, self.stride))

        def _repr_html_(self) -> str:
            if not self.html:
                from imageio_ffmpeg import get_ffmpeg_exe

                # Encode the video
                self.stride = -(-bins // _PLAYER_FRAMES)
                fps: Any = 1000 / _INTERVAL_MS / self.stride  # May be a fraction
                program: Any = {"animation.ffmpeg_path": get_ffmpeg_exe()}
                try:
                    with TemporaryDirectory() as folder, rc_context(program):
                        path = Path(folder, "light.mp4")
                        writer = FFMpegWriter(fps=fps, codec="h264")
                        self.save(str(path), writer=writer, dpi=_PLAYER_DPI)
                        video = path.read_bytes()
                finally:
                    self.stride = 1

                # Draw the frame that is shown before the video plays
                update(first)
                figure.savefig(poster := io.BytesIO(), format="jpeg", dpi=_PLAYER_DPI)
                self.html = (
                    '<video controls loop muted playsinline style="max-width: 100%" '
                    f'poster="{_inlined("image/jpeg", poster.getvalue())}" '
                    f'src="{_inlined("video/mp4", video)}"></video>'
                )
            return self.html

    return Playback(figure, update, frames=bins, interval=_INTERVAL_MS, blit=False)


def _inlined(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


@in_style()
def plot_pixel_transient(
    data: Annotated[Any, TRANSIENT],
    x: int,
    y: int,
    start_opl: float | None = None,
    bin_width_opl: float | None = None,
    *,
    quantity: str | None = None,
) -> Figure:
    """Plot the response of one pixel over time [ns], a line for each channel.

    A band shows the standard errors of a Dataset.

    Args:
        data: Array (height, width, bins) or (height, width, bins, channels), or a Dataset.
            For Stokes vectors, S0 is shown.
        x: Column. For a cropped Dataset, a label of the coordinate x.
        y: Row. For a cropped Dataset, a label of the coordinate y.
        start_opl: Start of the first bin [m]. By default the start of the Dataset.
        bin_width_opl: Width of a bin [m], above 0. By default the width of the Dataset.
        quantity: "radiance per bin", or "radiance per meter" for a result of `render_transient`. By
            default the quantity of the Dataset, and "radiance per bin" for an array.

    Raises:
        ValueError: Another shape or quantity, a pixel outside, or a time axis that is missing or
            not positive.

    Example:
        >>> figure = plot_pixel_transient(
        ...     np.ones((4, 6, 10)), 5, 3, start_opl=3.5, bin_width_opl=0.02
        ... )
        >>> figure.axes[0].get_xlabel()
        'time [ns]'
    """
    # Read the response of the pixel
    data = read_light(data) if isinstance(data, xr.Dataset) else data
    sequence = Transient.of(data, start_opl, bin_width_opl, quantity)
    response = sequence.pixel(x, y)
    width = figure_width(5.5)
    figure = new_figure(width, 1.2 + 0.33 * width)
    axes = figure.add_subplot()

    # Draw a line for each channel, with a band of standard errors
    styles = [(palette().ink, "L", "-")]
    if response.shape[1] == 3:
        styles = list(zip(palette().channels, "RGB", ("-", "--", ":"), strict=True))
    errors = np.zeros_like(response)
    has_errors = isinstance(data, xr.Dataset) and "transient_error" in data
    if has_errors:
        errors = data["transient_error"].sel(x=int(x), y=int(y)).values
    time_ns = opl_to_ns(sequence.opl)
    for (color, name, dashes), line, error in zip(styles, response.T, errors.T, strict=True):
        axes.plot(time_ns, line, color=color, linestyle=dashes, label=name)
        if has_errors:
            axes.fill_between(time_ns, line - error, line + error, color=color, alpha=0.25, lw=0)
    if response.shape[1] == 3:
        axes.legend(frameon=False)
    axes.set_title(f"pixel ({x}, {y})")
    time_axes(axes, sequence)
    return figure
