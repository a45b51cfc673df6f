"""PNG frames and videos of light in flight, with the time below each picture.

Without a given exposure, the exposure grows while the light fades, and shadows are one stop
brighter. The label below a picture contains the change of the exposure in stops.
"""

import errno
import os
import subprocess
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, BinaryIO, cast

import imageio_ffmpeg
import numpy as np
import xarray as xr
from PIL import Image, ImageDraw, ImageFont, PngImagePlugin

from ..labels import FILM, read
from ..runtime import checks
from ..runtime.atomic import check_file, check_writable, replacing
from ..runtime.progress import ProgressBar
from ..vis import Transient, growing_exposure, lit_bins, tonemap
from .files import for_each
from .output import check_output, output_folder

_LONGEST_SIDE = 4096
_PICTURE = 1 << 10  # Least size of a picture [bytes]
_COMPENSATION = 0.5  # Fraction of the fading that the exposure compensates
_LIFT = 1.0  # Brightening of the shadows [stops]
_TEXT = (235, 235, 235)
_BACKGROUND = (16, 16, 16)


def save_png_frames(
    dataset: Annotated[xr.Dataset, FILM],
    path: str | os.PathLike,
    *,
    exposure: float | None = None,
    min_size: int = 384,
    overwrite: bool = False,
    progress: bool = True,
) -> Path:
    """Write a folder of tone-mapped pictures, `frame_0000.png` ..., one for each bin.

    Args:
        dataset: The result of `render`, or a part of it. For Stokes vectors, S0 is shown.
        path: The folder. An incomplete folder never appears at this path.
        exposure: Gain for all frames. By default the 99.5th percentile of the light is white, and
            late light is brighter, see `vis.growing_exposure`.
        min_size: Enlarge smaller images until their shorter side has this number of pixels.
        overwrite: Replace an earlier output of this package; other content is never replaced.
        progress: Show a progress bar after two seconds.

    Raises:
        ValueError: A bad exposure or size.
        OSError: `path` may not be replaced or is not writable, or the disk is full.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     len(list(save_png_frames(dataset, folder + "/pictures").iterdir()))
        20
    """
    checks.boolean("progress", progress)
    frames = _Frames(dataset, exposure, min_size)
    check_output(path, overwrite=overwrite)
    check_writable(path, _PICTURE * frames.count)
    digits = max(4, len(str(frames.count - 1)))
    with output_folder(path, overwrite=overwrite) as folder:

        def write(index: int) -> None:
            _save_png(frames.draw(index), folder / f"frame_{index:0{digits}d}.png")

        for_each(write, range(frames.count), "Writing PNG", progress=progress)
    return Path(path)


def write_png(picture: np.ndarray, path: Path) -> None:
    """Write uint8 (height, width, 3), with the mark that identifies outputs of this package."""
    _save_png(Image.fromarray(picture), path)


def _save_png(picture: Image.Image, path: Path) -> None:
    mark = PngImagePlugin.PngInfo()
    mark.add_text("Software", "tofrender")
    picture.save(path, pnginfo=mark)


def save_video(
    dataset: Annotated[xr.Dataset, FILM],
    path: str | os.PathLike,
    *,
    fps: float = 30,
    exposure: float | None = None,
    min_size: int = 384,
    all_bins: bool = False,
    progress: bool = True,
) -> Path:
    """Write a video with a frame for each bin that is not dark: H.264 in .mp4, or a .gif.

    Args:
        dataset: The result of `render`, or a part of it. For Stokes vectors, S0 is shown.
        path: A file name that ends in .mp4 or .gif. An existing file is replaced when the new one
            is complete.
        fps: Frames per second, above 0 and at most 120; at most 50 for a .gif.
        exposure: As for `save_png_frames`.
        min_size: Enlarge smaller images until their shorter side has this number of pixels.
        all_bins: Also show the dark bins before and after the light, see `vis.lit_bins`.
        progress: Show a progress bar after two seconds.

    Raises:
        ValueError: A bad exposure, size, rate or suffix.
        OSError: `path` is not writable, or the disk is full.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_video(dataset, folder + "/light.mp4").name
        'light.mp4'
    """
    # Check the arguments
    checks.boolean("progress", progress)
    target = check_file(path, ".mp4", ".gif", overwrite=True, needed_bytes=_PICTURE)
    kind = target.suffix.lower()
    fastest = 50 if kind == ".gif" else 120
    fps = checks.number("fps", fps, positive=True, high=fastest)
    checks.boolean("all_bins", all_bins)
    frames = _Frames(dataset, exposure, min_size)

    # Encode the frames with light
    with replacing(path) as temporary:
        bins = slice(0, frames.count) if all_bins else lit_bins(frames.sequence.values)
        indices = range(frames.count)[bins]
        size = frames.canvas_width, frames.canvas_height
        pictures = (frames.draw(index) for index in indices)
        encode_video(pictures, len(indices), size, temporary, kind, fps, progress)
    return target


class _Frames:
    """Pictures of bins: tone-mapped, enlarged, with the time in a strip below."""

    def __init__(self, dataset: xr.Dataset, exposure: float | None, min_size: int):
        checks.integer("min_size", min_size, 1, _LONGEST_SIDE)
        self.sequence = Transient.of(read(dataset, FILM, "dataset"))
        height, width = self.sequence.size
        self.count = self.sequence.bins

        # Choose the exposure
        if exposure is None:
            self.gains = growing_exposure(self.sequence.values, share=_COMPENSATION)
            self.lift = _LIFT
        else:
            gain = checks.number("exposure", exposure, positive=True)
            self.gains = np.full(self.count, gain)
            self.lift = 0.0

        # Enlarge the pictures by a whole number
        scale = -(-min_size // min(height, width))
        self.scale = max(1, min(scale, _LONGEST_SIDE // max(height, width)))
        self.height = height * self.scale
        self.width = width * self.scale

        # Make space for the longest label. Videos need even sides
        size = max(15, min(self.height, self.width) // 22)
        self.font = ImageFont.load_default(size)
        label = max((self._label(index) for index in (0, self.count - 1)), key=len)
        sides = max(self.width, int(self.font.getlength(label)) + size), self.height + 2 * size
        self.canvas_width, self.canvas_height = (side + side % 2 for side in sides)

    def draw(self, index: int) -> Image.Image:
        """Draw frame `index`, in color and with even sides."""
        # Tone-map and enlarge the picture
        linear = self.sequence.values.frame(index)
        picture = tonemap(linear, exposure=self.gains[index], shadows=self.lift)
        size = (self.width, self.height)
        enlarged = Image.fromarray(picture).resize(size, Image.Resampling.NEAREST)

        # Place it above its label
        image = Image.new("RGB", (self.canvas_width, self.canvas_height), _BACKGROUND)
        image.paste(enlarged, ((self.canvas_width - self.width) // 2, 0))
        middle = (self.canvas_width // 2, (self.height + self.canvas_height) // 2)
        label = self._label(index)
        ImageDraw.Draw(image).text(middle, label, fill=_TEXT, font=self.font, anchor="mm")
        return image

    def _label(self, index: int) -> str:
        """Return the time of a bin, and the exposure relative to the first frame."""
        label = self.sequence.label(index)
        if self.gains[-1] == self.gains[0]:
            return label
        return f"{label}   +{np.log2(self.gains[index] / self.gains[0]):.1f} stops"


def encode_video(
    pictures: Iterable[Image.Image | np.ndarray],
    count: int,
    size: tuple[int, int],
    target: Path,
    kind: str,
    fps: float,
    progress: bool = True,
) -> None:
    """Pipe color pictures with an even width and height to ffmpeg.

    `kind` is ".mp4" or ".gif". A full disk is an OSError.
    """
    # Describe the input and the output
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-loglevel", "error", "-nostdin"]
    width, height = size
    command += f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {fps} -i pipe:0".split()
    command += _FORMATS[kind] + ["-y", str(target)]
    with tempfile.TemporaryFile() as log:
        # A new session, so that Ctrl-C reaches this process and not ffmpeg
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True
        )
        pipe = cast(BinaryIO, process.stdin)
        try:
            with ProgressBar("Writing video", count, enabled=progress) as bar:
                for picture in pictures:
                    pipe.write(picture.tobytes())
                    bar.update()
        except BrokenPipeError:
            pass  # ffmpeg has stopped; its log contains the reason
        except BaseException:
            process.kill()
            raise
        finally:
            with suppress(BrokenPipeError):
                pipe.close()
            status = process.wait()
        log.seek(0)
        message = " ".join(log.read().decode(errors="replace").split())
    if status:
        if os.strerror(errno.ENOSPC) in message:
            raise OSError(errno.ENOSPC, "disk full")
        raise RuntimeError(f"ffmpeg failed with status {status}: {message}")


_MP4 = (
    "-c:v libx264 -preset superfast -crf 18 -pix_fmt yuv420p "
    "-vf scale=out_color_matrix=bt709:out_range=tv -movflags +faststart "
    "-colorspace bt709 -color_primaries bt709 -color_trc iec61966-2-1 -f mp4"
)
_GIF = (
    "-filter_complex split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=sierra2_4a -loop 0 -f gif"
)
_FORMATS = {".mp4": _MP4.split(), ".gif": _GIF.split()}
"""Options of ffmpeg for each suffix."""
