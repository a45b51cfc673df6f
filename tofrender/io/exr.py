"""EXR files: stacks of an image for each time bin and the steady image, and named layers."""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import OpenEXR

from ..labels import FILM, bins_of
from ..rendering.cubes import Cube
from ..rendering.dataset import DIMS, for_file, plain_attributes, require_finite
from ..runtime import checks, memory
from ..runtime.atomic import check_file, replacing
from ..signals.polarization import STOKES
from .description import describe, parse, restore, warn_not_finite
from .files import for_each, named, reading, seal, seal_file
from .multipart import MultipartWriter
from .output import BYTES_PER_VALUE, check_output, output_folder, stack_bytes

if TYPE_CHECKING:
    import xarray as xr

FORMAT = "tofrender transient stack 1"
LAYERS_FORMAT = "tofrender layers 1"
LAYER = "error."  # Prefix of the channels of standard errors
EXACT_INTEGERS = 1 << 24  # Up to it, float32 holds all integers
LEAST_DIGITS = 4  # Fewest digits of a frame's number in its name
# Names of channels in OpenEXR, which joins R, G and B to "RGB" or to their common prefix
_READ = (("Y",), ("RGB",), tuple(f"{each}.Y" for each in STOKES), STOKES)
# Header names that OpenEXR uses, so that attributes of a Dataset must not use them
_RESERVED = {
    "channels",
    "chunkCount",
    "compression",
    "dataWindow",
    "displayWindow",
    "lineOrder",
    "name",
    "pixelAspectRatio",
    "screenWindowCenter",
    "screenWindowWidth",
    "tiles",
    "type",
    "version",
}


def save_exr_stack(
    dataset: Annotated[xr.Dataset, FILM],
    path: str | os.PathLike,
    *,
    layout: str = "frames",
    precision: str = "float",
    overwrite: bool = False,
    progress: bool = True,
) -> Path:
    """Write a rendered Dataset as OpenEXR images that any viewer opens.

    Each header contains the Dataset's attributes. The header of a frame also contains `bin_index`
    and the bin's `opl_start`, `opl_center` and `opl_stop` in meters (as doubles). For a cropped
    render, the data window is the crop and the display window is the film. Without the attributes
    `film_width` and `film_height`, the display window ends at the last pixel of the crop.
    Monochrome Datasets use the channel Y. Polarized Datasets use S0.R, S0.G, S0.B to S3.B, or S0.Y
    to S3.Y. Files have ZIP compression and a checksum after their end. An incomplete output never
    appears at `path`. See also `load_exr_stack`.

    Args:
        dataset: The result of `render`, or a part of it.
        path: Folder for `frame_0000.exr`, ..., `steady.exr` (`"frames"`), or the name of one .exr
            file (`"multipart"`). The parts of the file have these names, and the steady image is
            the first part.
        layout: `"frames"` or `"multipart"`.
        precision: `"float"` keeps every bit. `"half"` needs about 40 % of the space, rounds to 11
            bits (relative error up to 2^-11), and loses values below 6e-8. Bins of a few
            millimeters have such small values.
        overwrite: Replace an earlier output of this package; other content is never replaced.
        progress: Show a progress bar after two seconds.

    Raises:
        ValueError: Another Dataset, an unknown layout or precision, or a finite value above 65504
            in half precision.
        OSError: `path` may not be replaced or is not writable, or the disk is full.

    Warns:
        UserWarning: A value is NaN or infinite, so that the stack cannot be read again.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     stack = save_exr_stack(dataset, folder + "/stack")
        ...     file = save_exr_stack(dataset, folder + "/stack.exr", layout="multipart")
        ...     len(list(stack.iterdir())), file.name
        (21, 'stack.exr')
    """
    checks.one_of("layout", layout, ("frames", "multipart"))
    checks.boolean("progress", progress)
    checks.one_of("precision", precision, BYTES_PER_VALUE)

    # Can the files be written?
    dataset = for_file(dataset)
    stack = _Stack(dataset, precision)
    shape = dataset["transient"].shape
    target = check_output(path, shape, layout=layout, precision=precision, overwrite=overwrite)
    warn_not_finite(dataset)
    needed = stack_bytes(shape, precision)
    indices = range(-1, stack.bins)

    # Write a file for each frame
    if layout == "frames":
        with output_folder(path, overwrite=overwrite, needed_bytes=needed) as folder:

            def write(index: int) -> None:
                (folder / f"{stack.name(index)}.exr").write_bytes(seal(stack.encode(index)))

            for_each(write, indices, "Writing EXR", progress=progress)
        return target

    # Write one file with all frames as its parts
    with replacing(path, needed_bytes=needed) as temporary:
        with open(temporary, "wb") as file:
            names = [stack.name(index) for index in indices]
            parts = MultipartWriter(file, names, stack.encode(-1), stack.encode(0))

            def add(index: int) -> None:
                parts.add(index + 1, stack.encode(index))

            for_each(add, indices, "Writing EXR", progress=progress)
            parts.finish()
        seal_file(temporary)
    return target


def load_exr_stack(path: str | os.PathLike) -> xr.Dataset:
    """Read a folder or a multi-part file that `save_exr_stack` wrote.

    See also `save_exr_stack`.

    Args:
        path: The folder or the .exr file.

    Returns:
        The Dataset, with all attributes and coordinates. Values are float32. They are equal to the
        saved values bit by bit, or rounded if the stack is in half precision.

    Raises:
        FileNotFoundError: The folder or file does not exist.
        ValueError: Not a stack of this package, or frames are missing, damaged or not finite.
        MemoryError: The stack does not fit into memory.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     stack = save_exr_stack(dataset, folder + "/stack")
        ...     load_exr_stack(stack).identical(dataset)
        True
    """
    folder = checks.path("path", path)
    if not folder.is_dir():
        steady, *frames = _read(folder)
        with named(path):
            return _assemble(steady, len(frames), frames.__getitem__)
    if not (folder / "steady.exr").is_file():
        raise ValueError(f"path = {path}: steady.exr is missing; must be a saved stack")
    files = sorted(folder.glob("frame_*.exr"))
    with named(path):
        steady = _read(folder / "steady.exr")[0]
        return _assemble(steady, len(files), lambda number: _read(files[number])[0])


def save_exr_layers(
    path: str | os.PathLike,
    layers: Mapping[str, np.ndarray],
    attrs: Mapping[str, str | float | int] | None = None,
    *,
    first_pixel: Sequence[int] = (0, 0),
) -> Path:
    """Write pictures of one size as the layers of an EXR file, in single precision.

    Args:
        path: File name; an existing file is replaced.
        layers: Pictures by name, shape (height, width, channels) with 1 or 3 channels. The
            channels of the layer "" are R, G, B or Y, which every viewer shows.
        attrs: Attributes of the header.
        first_pixel: Column and row of the first pixel of a crop, at least 0.

    Raises:
        ValueError: Layers are missing, their sizes differ, the name of an attribute is reserved,
            or a value is beyond the range of single precision or is an integer above 2^24.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = save_exr_layers(folder + "/a.exr", {"I": np.zeros((2, 3, 3))})
        ...     file.name
        'a.exr'
    """
    # Check attributes and layers
    attrs = checks.mapping("attrs", attrs)
    for name in sorted({"format", *_RESERVED} & set(attrs)):
        raise ValueError(f"attrs: EXR headers reserve {name!r}; it must have another name")
    arrays: dict[str, np.ndarray] = {}
    for name, values in checks.mapping("layers", layers).items():
        array = arrays[name] = _as_float32(f"layers[{name!r}]", values)
        valid = array.ndim == 3 and array.shape[2] in (1, 3) and 0 not in array.shape
        allowed = "(height, width, channels) with 1 or 3 channels"
        checks.shape(f"layers[{name!r}]", array, valid, allowed)
    ends = checks.items("first_pixel", first_pixel, 2, "column and row")
    column, row = (checks.integer("first_pixel", each, 0, checks.MAX_SIZE) for each in ends)
    sizes = {array.shape[:2] for array in arrays.values()}
    if len(sizes) != 1:
        given = checks.quote(layers)
        raise ValueError(f"layers = {given}: have the sizes {sorted(sizes)}; must be one size")
    needed = sum(array.nbytes for array in arrays.values())
    target = check_file(path, overwrite=True, needed_bytes=needed)

    # Name the channels of each layer
    channels = {}
    for name, array in arrays.items():
        letters = "RGB" if array.shape[2] == 3 else "Y"
        channels |= _by_channel(array, [f"{name}.{c}" if name else c for c in letters])
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {"format": LAYERS_FORMAT, **{k: str(value) for k, value in attrs.items()}}

    # Place a crop on its film
    if (column, row) != (0, 0):
        ((height, width),) = sizes
        first = np.array([column, row], np.int32)
        last = first + np.array([width - 1, height - 1], np.int32)
        header |= {"dataWindow": (first, last), "displayWindow": (0 * first, last)}
    with replacing(target) as temporary:
        OpenEXR.File(header, channels).write(str(temporary))
    return target


def load_exr_layers(
    path: str | os.PathLike,
) -> tuple[dict[str, np.ndarray], dict[str, str], tuple[int, int]]:
    """Read a file that `save_exr_layers` wrote.

    Returns:
        (layers, attributes, first pixel): the layers by name, (height, width, channels), and column
        and row of the first pixel.

    Raises:
        ValueError: The file is damaged, or `save_exr_layers` did not write it.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = save_exr_layers(folder + "/a.exr", {"I": np.zeros((2, 3, 3))}, {"opl": 0.5})
        ...     layers, attrs, first_pixel = load_exr_layers(file)
        >>> layers["I"].shape, attrs["opl"], first_pixel
        ((2, 3, 3), '0.5', (0, 0))
    """
    part = _read(Path(path), separate_channels=True)[0]
    if part.header.get("format") != LAYERS_FORMAT:
        raise ValueError(f"path = {path}: must be what `save_exr_layers` wrote")
    found: dict[str, dict[str, np.ndarray]] = {}
    for name, channel in part.channels.items():
        found.setdefault(name[:-2], {})[name[-1]] = channel.pixels  # Named "layer.R" or "R"
    layers = {name: np.stack([c[k] for k in "RGBY" if k in c], -1) for name, c in found.items()}
    column, row = (int(each) for each in part.header["dataWindow"][0])
    return layers, {k: v for k, v in part.header.items() if isinstance(v, str)}, (column, row)


def _as_float32(name: str, values: Any) -> np.ndarray:
    """Convert real numbers to float32. Raise an error for numbers that float32 cannot hold."""
    array = checks.real_array(name, values)
    with np.errstate(over="ignore"):
        converted = array.astype(np.float32)
    if array.dtype.kind == "f":
        fits = np.array_equal(np.isfinite(converted), np.isfinite(array))
        checks.require(name, array, fits, "below 3.4e38, the largest number of an EXR file")
    else:
        fits = not array.size or max(-int(array.min()), int(array.max())) <= EXACT_INTEGERS
        checks.require(name, array, fits, "integers up to 2^24, or converted to float32")
    return converted


def _by_channel(image: np.ndarray, names: list[str]) -> dict[str, np.ndarray]:
    """Return contiguous channels of an image (height, width, channels) by name."""
    # OpenEXR writes strided arrays wrongly
    return {name: np.ascontiguousarray(image[..., k]) for k, name in enumerate(names)}


class _Stack:
    """A Dataset as EXR parts: headers and pixels at the chosen precision."""

    def __init__(self, dataset: xr.Dataset, precision: str):
        self.dataset = dataset
        self.films = {"": (Cube(dataset["transient"]), dataset["steady"])}
        if "transient_error" in dataset:
            self.films[LAYER] = Cube(dataset["transient_error"]), dataset["steady_error"]
        self.dtype = np.float16 if precision == "half" else np.float32

        # Name the channels as viewers expect them
        names = [str(name) for name in dataset["channel"].values]
        colors = list(dict.fromkeys(name.rpartition(".")[2] for name in names))
        if len(colors) == 1:  # Viewers show Y as gray
            names = [name.removesuffix(colors[0]) + "Y" for name in names]
        elif colors != ["R", "G", "B"]:
            raise ValueError(
                f"dataset: the axis channel has {', '.join(colors)}. EXR files have one channel, "
                "or R, G and B; select one with isel(channel=[0])"
            )
        self.channels = names

        # Prepare the numbers and attributes of the headers
        self.opl = dataset["opl"].values
        self.edges_opl = bins_of(dataset, "dataset").edges_opl
        self.bins = len(self.opl)
        self.digits = max(LEAST_DIGITS, len(str(self.bins - 1)))
        attributes = plain_attributes(dataset)
        self.header = {k: _native(v) for k, v in attributes.items() if k not in _RESERVED}
        self.header |= {**_windows(dataset), "format": FORMAT}

    def name(self, index: int) -> str:
        return "steady" if index < 0 else f"frame_{index:0{self.digits}d}"

    def part(self, index: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return header and channels of frame `index`, or of the steady image (-1)."""
        header = self.header | {"compression": OpenEXR.ZIP_COMPRESSION}
        header["type"] = OpenEXR.scanlineimage
        if index < 0:
            header["dataset"] = json.dumps(describe(self.dataset))
        else:
            header["bin_index"] = index
            header["opl_center"] = _double(self.opl[index])
            header["opl_start"] = _double(self.edges_opl[index])
            header["opl_stop"] = _double(self.edges_opl[index + 1])
        channels = {}
        for layer, (transient, steady) in self.films.items():
            values = self._round(steady.values if index < 0 else transient.frame(index))
            channels |= _by_channel(values, [f"{layer}{name}" for name in self.channels])
        return header, channels

    def encode(self, index: int) -> bytes:
        """Encode frame `index` (-1: the steady image) as the bytes of an EXR file.

        The part is encoded in memory. OpenEXR hides errors, such as a full disk, when it closes a
        file.
        """
        stream = io.BytesIO()
        OpenEXR.File(*self.part(index), num_threads=0).write(stream)
        return stream.getvalue()

    def _round(self, values: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):
            rounded = values.astype(self.dtype)
        lost = np.isinf(rounded) & np.isfinite(values)
        if lost.any():
            problem = f"{values[lost].flat[0]:g} is beyond the range of half, +-65504"
            raise ValueError(f"precision = 'half': {problem}; must be 'float' for these values")
        return rounded


def _native(value: str | int | float) -> Any:
    """Convert to an EXR attribute: int (32 bits), double or text."""
    if isinstance(value, float):
        return _double(value)
    return value if isinstance(value, int) and abs(value) < 1 << 31 else str(value)


def _double(value: float) -> np.ndarray:
    return np.array([value], dtype=np.float64)  # a plain float would become a 32-bit attribute


def _windows(dataset: xr.Dataset) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    first, last = ([int(dataset[axis].values[end]) for axis in "xy"] for end in (0, -1))
    film = [math.ceil(dataset.attrs.get(f"film_{side}", 0)) - 1 for side in ("width", "height")]
    origin = np.minimum(first, 0)
    return {
        "dataWindow": (np.array(first, dtype=np.int32), np.array(last, dtype=np.int32)),
        "displayWindow": (origin.astype(np.int32), np.maximum(last, film).astype(np.int32)),
    }


def _read(file: Path, separate_channels: bool = False) -> list[Any]:
    """Read all parts of an EXR file."""
    with reading(file, "a readable EXR file as it was saved"):
        parts = OpenEXR.File(str(file), header_only=True).parts
        memory.require_free(f"path = {file}", sum(map(_size, parts)))
        read = OpenEXR.File(str(file), separate_channels, num_threads=0).parts
        if len(read) != len(parts) or not parts:
            raise ValueError("is cut short")
        return read


def _size(part: Any) -> int:
    """Return the bytes of a part's pixels as float32."""
    (left, top), (right, bottom) = part.header["dataWindow"]
    return (int(right) - int(left) + 1) * (int(bottom) - int(top) + 1) * 4 * len(part.channels)


def _assemble(steady: Any, count: int, frame: Callable[[int], Any]) -> xr.Dataset:
    """Make a Dataset of the steady image and of frames, which are read in any order."""
    if steady.header.get("format") != FORMAT or "dataset" not in steady.header:
        raise ValueError("contains other EXR images; must be a saved stack")

    # Compare the number and the sizes of images with the description
    description = parse(steady.header["dataset"])
    height, width, bins, colors = sizes = [description["sizes"][a] for a in DIMS["transient"]]
    if count != bins:
        raise ValueError(f"{count} of {bins} frames exist; must be complete")
    image = _pixels(steady)
    checks.shape("steady", image, image.shape == (height, width, colors), f"of {sizes}")

    # Allocate the arrays
    has_errors = "transient_error" in description["variables"]
    memory.require_free("transient", 4 * (1 + has_errors) * math.prod(sizes))
    arrays = {"transient": np.empty(sizes, np.float32), "steady": image}
    if has_errors:
        arrays["transient_error"] = np.empty(sizes, np.float32)
        arrays["steady_error"] = _pixels(steady, LAYER)
    arrays["opl"] = np.full(bins, np.nan)

    def read_frame(number: int) -> None:
        part = frame(number)
        pixels = _pixels(part)
        index = part.header.get("bin_index", -1)
        center = np.ravel(part.header.get("opl_center", ()))
        known = isinstance(index, int) and 0 <= index < bins
        known = known and len(center) == 1 and center.dtype.kind == "f"
        if not known or pixels.shape != image.shape:
            raise ValueError(f"frame {number} does not belong to this stack; must be as saved")
        arrays["transient"][:, :, index] = pixels
        if has_errors:
            arrays["transient_error"][:, :, index] = _pixels(part, LAYER)
        arrays["opl"][index] = center[0]

    # Read the frames, in any order
    for_each(read_frame, range(bins), "Reading EXR", progress=True)
    if np.isnan(arrays["opl"]).any():
        raise ValueError("two frames have the same bin_index; each must be saved once")

    # Make the Dataset
    x, y = (int(first) for first in steady.header["dataWindow"][0])
    arrays |= {"y": y + np.arange(height), "x": x + np.arange(width)}
    dataset = restore(description, arrays)
    require_finite(dataset)
    return dataset


def _pixels(part: Any, layer: str = "") -> np.ndarray:
    """Return an image, or its standard errors, (height, width, channels)."""
    channels = part.channels
    read = [[_name(layer, kind) for kind in kinds] for kinds in _READ]
    names = [each for each in read if each[0] in channels]
    known = ({_name(each, kind) for each in ("", LAYER) for kind in kinds} for kinds in _READ)
    if len(names) != 1 or not any({*names[0]} <= {*channels} <= kinds for kinds in known):
        shown = ", ".join(channels)
        raise ValueError(f"has the channels {shown}; must be RGB or Y, or RGB or Y of S0 to S3")
    images = [np.atleast_3d(channels[name].pixels) for name in names[0]]
    pixels = images[0] if len(images) == 1 else np.concatenate(images, axis=-1)
    return pixels.astype(np.float32, copy=False)


def _name(layer: str, kind: str) -> str:
    """Return OpenEXR's name for channels of a layer. R, G and B have the name of their layer."""
    return layer.rstrip(".") if layer and kind == "RGB" else f"{layer}{kind}"
