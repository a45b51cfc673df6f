"""Contents of an explorer: a header for JSON, and bytes with all arrays."""

import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rendering.cubes import Cube
from ...runtime import checks, memory
from ...runtime.atomic import readable
from ...signals.color import LUMINANCE
from ...vis.color_maps import phase_map
from .compression import Mode, Reduction, Scale, bands, reductions
from .data import ExplorerData, explorer_data, facts, wall_of
from .paths import path_lists

MAPS = {"false": "inferno", "distance": "viridis", "signed": "coolwarm"}
"""Color maps of Matplotlib by their use. Phases use `phase_map`."""

SAMPLED_BANDS = 8  # The size of a large cube is estimated from one of eight bands of rows
SAMPLED_BYTES = 100e6
ALIGNMENT = 8  # Alignment of arrays in the bytes


@dataclass
class PageContents:
    """Contents of an explorer page: a header for JSON, and one block of bytes with all arrays.

    `header["parts"]` contains the type, length and position of each array in the bytes.
    """

    header: dict[str, Any]
    data: bytes

    def part(self, name: str) -> np.ndarray:
        """Return an array of the bytes, with one axis."""
        about = self.header["parts"][name]
        return np.frombuffer(self.data, about["type"], about["length"], about["offset"])

    def layer(self, about: dict[str, Any]) -> np.ndarray:
        """Return the values of a layer, (pictures, bins, channels, rows, columns)."""
        shape = [about[name] for name in ("pictures", "bins", "channels", "height", "width")]
        codes = self.part(about["part"])
        if about["packed"]:
            # Undo `differences`
            pictures, bins, *picture = shape
            steps = codes.reshape(pictures, *picture, bins).transpose(0, 4, 1, 2, 3)
            codes = np.cumsum(steps, axis=1, dtype=np.uint8)
            if codes.shape[2] == 3:
                codes[:, :, ::2] += codes[:, :, 1:2]
        return Scale(about["least"], about["ratio"], about["signed"]).values(codes.reshape(shape))


def differences(codes: np.ndarray) -> np.ndarray:
    """Convert codes (pictures, bins, channels, rows, columns) to differences, which pack well.

    Red and blue become differences from green. Then each bin becomes the difference from the bin
    before, modulo 256. The bins become the last axis.
    """
    steps = codes.copy()
    if codes.shape[2] == 3:
        steps[:, :, ::2] -= codes[:, :, 1:2]
    return np.ascontiguousarray(
        np.diff(steps, axis=1, prepend=np.uint8(0)).transpose(0, 2, 3, 4, 1)
    )


def contents_of(
    data: Any,
    *,
    capture: Any = None,
    orders: Any = None,
    distance_m: Any = None,
    title: Any = None,
    paths: Any = None,
    most_bytes: int | None = None,
    packed: bool = False,
) -> PageContents:
    """Make the contents of an explorer of at most `most_bytes`, after compression if `packed`.

    `explore` describes the other arguments and the errors.
    """
    from matplotlib import colormaps

    checks.text("title", title)
    if capture is not None:
        options = {"orders": orders, "distance_m": distance_m, "title": title, "packed": packed}
        options |= {"paths": paths}
        return _with_capture(data, capture, most_bytes, **options)
    found = explorer_data(data, orders, distance_m)

    # Find the finest reduction that fits
    layers = {"light": (found.light, found.mode), **found.layers}
    *spots, height, width, bins, channels = found.light.shape
    is_fine = most_bytes is None or 16 * height * width * channels < most_bytes
    for by in reductions(0 if "frequencies" in found.header else bins):
        fine = Reduction() if is_fine else by  # Reduction of pictures of all bins
        if most_bytes is None or _fits(layers, by, fine, most_bytes, packed):
            break
    else:
        raise ValueError("megabytes: must be larger; the coarsest page of these data is larger")

    # Describe the data
    arrays = _Arrays()
    axis = {"width": found.axis["width"] * by.time, "count": math.ceil(bins / by.time)}
    header: dict[str, Any] = {
        "version": 1,
        "perMeter": False,
        "depth": "",
        "geometry": {},
        "orders": [],
        "stokes": [],
        "counts": False,
        "hatched": found.hatched,
        "warnings": found.warnings,
        "paths": path_lists(paths, found.header["kind"]),
        **found.header,
        "title": str(title or data.attrs.get("scene", "") or found.header["kind"]),
        "facts": facts(data, found),
        "weights": LUMINANCE.tolist() if channels == 3 else [1.0],
        "axis": found.axis | axis,
        "grid": {
            "first": found.first,
            "down": found.down,
            "step": by.space,
            "height": height,
            "width": width,
        },
        "lasers": math.prod(spots),
    }

    # Add the light of each layer
    for name, (cube, mode) in layers.items():
        if name == "steady":
            layer = _layer(arrays, name, cube, fine, mode, packed, None)
        else:
            layer = _layer(arrays, name, cube, by, mode, packed, most_bytes)
        group, _, part = name.partition(" ")
        if part:
            header[group].append(layer)
        else:
            header[name] = layer

    # Add numbers of the pixels, and the color maps
    for name, values in found.arrays.items():
        if name == "distance":
            values = _middles(values, by.space)
        elif name == "peaks":
            values = np.stack([_middles(each, fine.space) for each in values])
            header["peaks"] = values.shape[1:]
        elif name in "IQ":
            cube = Cube(np.moveaxis(values, 0, -1)[..., None])
            blocks = np.concatenate([block for _, block in bands(cube, by, "mean")])
            values = np.moveaxis(blocks[..., 0], -1, 0)
        arrays.add(name, values, "u1" if name == "hatch" else "f4")
    maps = {name: colormaps[of] for name, of in MAPS.items()} | {"phase": phase_map()}
    for name, colors in maps.items():
        arrays.add(f"map {name}", np.rint(255 * colors(np.arange(256) / 255)[:, :3]), "u1")
    header["notes"] = [*_notes(header, found, by, is_fine), *found.notes]
    header["parts"] = arrays.parts
    return PageContents(header, b"".join(arrays.pieces))


def _with_capture(
    volume: Any, capture: Any, most_bytes: int | None, **options: Any
) -> PageContents:
    """Return the contents of a capture, which include the contents of its volume."""
    # Compute both
    title = options["title"]
    packed = options["packed"]
    half = most_bytes and most_bytes // 2
    below = contents_of(volume, **options, most_bytes=half)
    kind = below.header["kind"]
    checks.require("capture", capture, kind == "volume", f"None for a {kind}")
    arrays = _Arrays()
    for name, values in wall_of(volume, capture).items():
        arrays.add(name, values, "f4")
    whole = contents_of(capture, title=title, packed=packed, most_bytes=half)

    # Join their bytes, and move the positions of their arrays
    pieces = [*arrays.pieces, whole.data, below.data]
    ahead = arrays.size
    for each in (whole, below):
        for part in each.header["parts"].values():
            part["offset"] += ahead
        ahead += len(each.data)
    parts = arrays.parts | whole.header["parts"]
    return PageContents(whole.header | {"parts": parts, "volume": below.header}, b"".join(pieces))


def _middles(values: np.ndarray, size: int) -> np.ndarray:
    """Return the values (rows, columns) at the middles of blocks."""
    rows, columns = (-(-side // size) for side in values.shape)
    padded = np.pad(values, (0, size), mode="edge") if values.size else values
    return padded[size // 2 :: size, size // 2 :: size][:rows, :columns]


class _Arrays:
    """Arrays that are joined to bytes, and their positions."""

    def __init__(self) -> None:
        self.parts: dict[str, dict[str, Any]] = {}
        self.pieces: list[bytes] = []
        self.size = 0

    def add(self, name: str, values: np.ndarray, dtype: str) -> None:
        raw = np.ascontiguousarray(values, dtype).tobytes()
        raw += bytes(-len(raw) % ALIGNMENT)
        self.parts[name] = {"type": dtype, "offset": self.size, "length": values.size}
        self.pieces.append(raw)
        self.size += len(raw)


def _layer(
    arrays: _Arrays,
    name: str,
    cube: Cube,
    by: Reduction,
    mode: Mode,
    packed: bool,
    most_bytes: int | None,
) -> dict[str, Any]:
    """Add the codes of a cube, and return its part of the header."""
    # Choose the scale
    group, _, part = name.partition(" ")
    signed = group == "stokes"
    scale = Scale.of((values for _, values in bands(cube, by, mode)), signed, most_bytes)

    # Encode the values
    rows, columns, bins, channels = by.shape(cube)
    pictures = math.prod(cube.shape[:-4])
    memory.require_free("data", 3 * pictures * bins * channels * rows * columns)
    codes = np.zeros((pictures, bins, channels, rows, columns), np.uint8)
    for (number, band), values in bands(cube, by, mode):
        codes[number, :, :, band] = scale.codes(values).transpose(2, 3, 0, 1)
    arrays.add(name, differences(codes) if packed else codes, "u1")
    about: dict[str, Any] = {"name": part or name, "part": name, "bins": bins, "signed": signed}
    about |= {"channels": channels, "height": rows, "width": columns}
    about |= {"pictures": pictures, "packed": packed}
    return about | {"least": scale.least, "ratio": scale.ratio}


def _fits(
    layers: dict[str, tuple[Cube, Mode]],
    by: Reduction,
    fine: Reduction,
    most_bytes: int,
    packed: bool,
) -> bool:
    """Return whether codes fit into `most_bytes`. Packed sizes are estimated from a few bands."""
    total = 0.0
    for name, (cube, mode) in layers.items():
        if name == "steady":
            total += math.prod(cube.shape[:-4]) * math.prod(fine.shape(cube))
            continue
        size = math.prod(cube.shape[:-4]) * math.prod(by.shape(cube))
        if not packed or size <= most_bytes / 50:
            total += size
            continue
        every = SAMPLED_BANDS if cube.nbytes > SAMPLED_BYTES else 1
        some = np.concatenate([values for _, values in bands(cube, by, mode, every)])
        scale = Scale.of([some], name.startswith("stokes "), most_bytes)
        codes = differences(scale.codes(some).transpose(2, 3, 0, 1)[None])
        total += size / codes.size * len(zlib.compress(codes.tobytes(), 6))
    return total <= most_bytes


def _notes(header: dict[str, Any], found: ExplorerData, by: Reduction, is_fine: bool) -> list[str]:
    """Return sentences about the precision of values and about reduced axes."""
    # Precision
    light = header["light"]
    scale = Scale(light["least"], light["ratio"])
    precision = (
        "Values are kept as one byte on a logarithmic scale: right to "
        f"{100 * scale.tolerance:.2g} % from {scale.least:.3g} on; smaller ones are off by less "
        "than that, and may be 0."
    )
    if header["stokes"]:
        scales = [Scale(each["least"], each["ratio"]) for each in header["stokes"]]
        precision += f" S1 to S3 are right to {100 * max(s.tolerance for s in scales):.2g} %."

    # Reduced axes
    reduced = []
    if by.space > 1:
        reduced.append(f"{by.space} x {by.space} pixels are averaged")
    if by.time > 1:
        reduced.append(f"{by.time} bins are {'summed' if found.mode == 'sum' else 'averaged'}")
    note = "" if found.warnings else "All pixels and bins are there."
    if reduced:
        height, width, bins, _ = found.light.shape[-4:]
        full = f"{width} x {height} x {bins}"
        fine = "all time and peak are" if "steady" in found.layers else "the peak is"
        fine = f"; the pictures of {fine} at full resolution" if is_fine else ""
        note = f"To limit its size, {' and '.join(reduced)} (of {full}){fine}."
    size = math.prod(light[name] for name in ("pictures", "bins", "channels", "height", "width"))
    return [precision, f"{note} {readable(size)} of codes.".strip()]
