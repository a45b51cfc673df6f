"""What an explorer's page gets: a header that JSON can hold, and bytes with all numbers."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rendering.cubes import Cube
from ...runtime import checks, memory
from ...runtime.atomic import readable
from ...vis.colours import phase_map
from .codes import Scale
from .reducing import How, Reduction, bands, reductions
from .subjects import Subject, facts, subject_of

MAPS = {"false": "inferno", "distance": "viridis"}
"""Matplotlib's colour maps by what they are for; of phases there is `phase_map`."""

SHARE = 0.12
"""Part of a cube by which its size is estimated."""

_TYPES = {"u1": np.uint8, "f4": np.float32}
_ALIGNED = 8  # Bytes


@dataclass
class Contents:
    """A header, and the bytes of the parts that it names."""

    header: dict[str, Any]
    data: bytes

    def part(self, name: str) -> np.ndarray:
        """The numbers of a part."""
        about = self.header["parts"][name]
        kind = np.dtype(_TYPES[about["type"]])
        return np.frombuffer(self.data, kind, about["length"], about["offset"])

    def layer(self, about: dict[str, Any]) -> np.ndarray:
        """Values of a layer, (pictures, bins, channels, rows, columns)."""
        shape = [about[name] for name in ("pictures", "bins", "channels", "height", "width")]
        codes = self.part(about["part"])
        codes = sums(codes, shape) if about["packed"] else codes.reshape(shape)
        return Scale(about["least"], about["ratio"]).values(codes)


def differences(codes: np.ndarray) -> np.ndarray:
    """Codes (pictures, bins, channels, rows, columns) as deflate packs them best.

    Red and blue are told by how far they are from green, then each bin by how far it is from the
    one before, modulo 256; bins come last.

    Example:
        >>> codes = np.arange(5 * 4 * 3, dtype=np.uint8).reshape(1, 5, 3, 2, 2) ** 2
        >>> bool((sums(differences(codes), codes.shape) == codes).all())
        True
    """
    steps = codes.copy()
    if codes.shape[2] == 3:
        steps[:, :, ::2] -= codes[:, :, 1:2]
    return np.ascontiguousarray(
        np.diff(steps, axis=1, prepend=np.uint8(0)).transpose(0, 2, 3, 4, 1)
    )


def sums(steps: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """Codes of the differences of them."""
    pictures, bins, *picture = shape
    steps = steps.reshape(pictures, *picture, bins).transpose(0, 4, 1, 2, 3)
    codes = np.cumsum(steps, axis=1, dtype=np.uint8)
    if codes.shape[2] == 3:
        codes[:, :, ::2] += codes[:, :, 1:2]
    return codes


def contents_of(
    data: Any,
    *,
    orders: Any = None,
    distance_m: Any = None,
    title: Any = None,
    most_bytes: int | None = None,
    packed: bool = False,
) -> Contents:
    """Make the contents of a page.

    Args:
        data: A Dataset of `render`, `capture`, `strategy_pyramid` or `reconstruct`.
        orders: Parts of a render's light by name, Datasets of the same pixels and bins.
        distance_m: (y, x) from the camera to what each pixel of a render sees [m].
        title: Above everything; by default the scene.
        most_bytes: What the bytes may take; None for all that there are.
        packed: Whether `most_bytes` counts them after compression.

    Raises:
        ValueError: An argument is wrong, or no reduction is small enough; one line.
        MemoryError: The codes do not fit into memory.
    """
    checks.text("title", title)
    subject = subject_of(data, orders, distance_m)
    layers = _layers(subject)
    for by in reductions(subject.light.shape[-2]):
        if most_bytes is None or _fits(layers, by, most_bytes, packed):
            break
    else:
        raise ValueError("megabytes: must be more, the coarsest page of these data takes more")
    packing = _Packing(packed)
    header: dict[str, Any] = {
        "version": 1,
        "kind": subject.kind,
        "title": str(title or data.attrs.get("scene", "") or subject.kind),
        "facts": facts(data, subject),
        "quantity": subject.quantity,
        "perMetre": subject.how == "mean" and subject.kind == "transient",
        "weights": subject.weights,
        "axis": {
            "start": subject.start,
            "width": subject.width * by.time,
            "count": math.ceil(subject.light.shape[-2] / by.time),
            "what": subject.what,
        },
        "grid": {
            "first": subject.first,
            "step": by.space,
            "height": subject.light.shape[-4],
            "width": subject.light.shape[-3],
        },
        "lasers": math.prod(subject.light.shape[:-4]),
        "peaks": subject.peaks.shape[1:],
        "depth": subject.depth,
        "geometry": subject.geometry,
    }
    for name, (cube, how) in layers.items():
        own = Reduction() if name == "steady" else by
        if name.startswith("order "):
            header.setdefault("orders", []).append(packing.layer(name, cube, own, how))
        else:
            header[name] = packing.layer(name, cube, own, how)
    header.setdefault("orders", [])
    packing.maps(subject, by.space)
    header["notes"] = [*_notes(header, subject, by), *subject.notes]
    header["parts"] = packing.parts
    return Contents(header, b"".join(packing.pieces))


def _layers(subject: Subject) -> dict[str, tuple[Cube, How]]:
    layers: dict[str, tuple[Cube, How]] = {"light": (subject.light, subject.how)}
    if subject.errors is not None:
        how: How = "error" if subject.how == "sum" else "mean error"
        layers["errors"] = subject.errors, how
    layers |= {f"order {name}": (cube, subject.how) for name, cube in subject.orders.items()}
    if subject.steady is not None:
        layers["steady"] = subject.steady, "mean"
    return layers


class _Packing:
    """Parts one behind the other."""

    def __init__(self, packed: bool) -> None:
        self.packed = packed
        self.parts: dict[str, dict[str, Any]] = {}
        self.pieces: list[bytes] = []
        self.size = 0

    def add(self, name: str, values: np.ndarray, kind: str) -> None:
        raw = np.ascontiguousarray(values, _TYPES[kind]).tobytes()
        raw += bytes(-len(raw) % _ALIGNED)
        self.parts[name] = {"type": kind, "offset": self.size, "length": values.size}
        self.pieces.append(raw)
        self.size += len(raw)

    def layer(self, name: str, cube: Cube, by: Reduction, how: How) -> dict[str, Any]:
        """Add the codes of a cube; what the header says of them."""
        scale = Scale.of(values for _, values in bands(cube, by, how))
        rows, columns, bins, channels = by.shape(cube)
        pictures = math.prod(cube.shape[:-4])
        size = pictures * bins * channels * rows * columns
        memory.require_free("data", 3 * size)
        codes = np.zeros((pictures, bins, channels, rows, columns), np.uint8)
        for (number, place), values in bands(cube, by, how):
            codes[number, :, :, place] = scale.codes(values).transpose(2, 3, 0, 1)
        self.add(name, differences(codes) if self.packed else codes, "u1")
        about = {"name": name.removeprefix("order "), "part": name, "bins": bins}
        about |= {"channels": channels, "height": rows, "width": columns}
        about |= {"pictures": pictures, "packed": self.packed}
        return about | {"least": scale.least, "ratio": scale.ratio}

    def maps(self, subject: Subject, step: int) -> None:
        """Add what is there of pictures that do not change in time, and of colour maps."""
        self.add("peaks", subject.peaks, "f4")
        middle = np.s_[step // 2 :: step, step // 2 :: step]
        if subject.distance is not None:
            rows, columns = (-(-side // step) for side in subject.distance.shape)
            padded = np.pad(subject.distance, (0, step), mode="edge")
            self.add("distance", padded[middle][:rows, :columns], "f4")
        if subject.points is not None:
            self.add("points", subject.points, "f4")
        if subject.hatch is not None:
            self.add("hatch", subject.hatch, "u1")
        from matplotlib import colormaps

        maps = {name: colormaps[of] for name, of in MAPS.items()} | {"phase": phase_map()}
        for name, of in maps.items():
            colours = of(np.arange(256) / 255)[:, :3]
            self.add(f"map {name}", np.rint(255 * colours), "u1")


def _fits(
    layers: dict[str, tuple[Cube, How]], by: Reduction, most_bytes: int, packed: bool
) -> bool:
    """Whether codes take `most_bytes` at the most, by those of a few bands where compressed."""
    total = 0.0
    for name, (cube, how) in layers.items():
        if name == "steady":
            total += math.prod(cube.shape)
            continue
        size = math.prod(cube.shape[:-4]) * math.prod(by.shape(cube))
        if not packed or size <= most_bytes / 50:
            total += size
            continue
        some = [values for _, values in bands(cube, by, how, SHARE)]
        scale = Scale.of(some)
        codes = [differences(scale.codes(each).transpose(2, 3, 0, 1)[None]) for each in some]
        share = size / sum(each.size for each in codes)
        total += share * sum(len(zlib.compress(each.tobytes(), 6)) for each in codes)
    return total <= most_bytes


def _notes(header: dict[str, Any], subject: Subject, by: Reduction) -> list[str]:
    """What was reduced, and how right values are."""
    light = header["light"]
    scale = Scale(light["least"], light["ratio"])
    notes = [
        "Values are kept as one byte on a logarithmic scale: right to "
        f"{100 * scale.tolerance:.2g} % from {scale.least:.3g} on; smaller ones are off by less "
        "than that, and may be 0."
    ]
    words = []
    if by.space > 1:
        words.append(f"{by.space} x {by.space} pixels are averaged")
    if by.time > 1:
        are = "summed" if subject.how == "sum" else "averaged"
        words.append(f"{by.time} bins are {are}")
    if words:
        full = f"{subject.light.shape[-3]} x {subject.light.shape[-4]} x {subject.light.shape[-2]}"
        fine = "all time and peak are" if subject.steady is not None else "the peak is"
        notes.append(
            f"To keep it small, {' and '.join(words)} (of {full}); the pictures of {fine} as fine "
            "as rendered."
        )
    else:
        notes.append("All pixels and bins are there.")
    size = math.prod(light[name] for name in ("pictures", "bins", "channels", "height", "width"))
    notes[-1] += f" {readable(size)} of codes."
    return notes
