"""Arrays of a data set: what they are called, their axes, their sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np

from ..films.image import time_bins
from ..rendering.window import windowed_film
from ..runtime import atomic
from ..scenes.loading import require_sensor
from .config import Config
from .scene import load, scene_of

CAPTURE_AXES = ("wall_y", "wall_x")
LASER_AXES = ("laser_y", "laser_x")
GEOMETRY = ("sensor_grid", "sensor_normals", "laser_grid", "laser_normals")
ORIGINS = ("sensor_origin", "laser_origin")

UNITS = {
    "transient": "W m^-2 sr^-1",
    "steady": "W m^-2 sr^-1",
    "noisy": "W m^-2 sr^-1",
    "phasor": "W m^-2 sr^-1",
    "capture": "W m^-2 sr^-1",
    "depth": "m",
    "hidden_depth": "m",
}
MEANS = {
    "transient": "radiance per bin",
    "steady": "radiance of all time",
    "noisy": "radiance per bin, with fewer samples of its own",
    "phasor": "sum of L exp(+i 2 pi f opl / c): I, Q",
    "capture": "radiance per bin at points of the relay wall",
    "depth": "distance from the sensor to the first surface",
    "hidden_depth": "distance of what is hidden from the relay wall",
    "normals": "unit normal of the first surface, on the side seen, in world space",
}


@dataclass(frozen=True)
class Array:
    """An array, of which each record has a part.

    Attributes:
        name: What it is called.
        axes: Axes of a record's part.
        shape: Its shape.
        dtype: Type of its numbers.
    """

    name: str
    axes: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: str = "float32"

    @property
    def bytes(self) -> int:
        """Size of a record's part."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Layout:
    """All arrays of a data set.

    Attributes:
        arrays: The arrays.
        axes: Coordinates of axes, by name.
        window: Start and width of the time bins [m], None where there are none.
        attrs: Attributes that all records share.
        scene: What identifies the first scene, with the bytes of its files.
    """

    arrays: tuple[Array, ...]
    axes: dict[str, np.ndarray] = field(repr=False)
    window: tuple[float, float] | None
    attrs: dict[str, Any]
    scene: str = ""

    @property
    def bytes(self) -> int:
        """Size of a record."""
        return sum(array.bytes for array in self.arrays)

    def check(self, made: Mapping[str, np.ndarray]) -> None:
        """Refuse a record whose arrays are not those of the others.

        Raises:
            ValueError: One line with the array and both shapes.
        """
        for array in self.arrays:
            if made[array.name].shape != array.shape:
                raise ValueError(
                    f"{array.name} has the shape {made[array.name].shape}, those of other records "
                    f"{array.shape}; must be the same in all"
                )


def layout_of(config: Config, records: list[int]) -> Layout:
    """The arrays of a data set, by the first of its scenes that can be loaded.

    Raises:
        ValueError: The scene cannot be loaded, or lacks what an output needs; one line.
    """
    scene = _first_scene(config, records)
    require_sensor(scene)
    sensors = scene.sensors()
    if config.sensor >= len(sensors):
        raise ValueError(
            f"render.sensor = {config.sensor}: must be an integer from 0 to {len(sensors) - 1}"
        )
    film: Any = sensors[config.sensor].film()
    outputs = config.outputs
    width, height = (int(v) for v in film.crop_size())
    channels = 1 if mi.is_monochromatic else 3
    window, bins = None, 0
    if outputs.rendered or outputs.noisy or outputs.capture:
        if time_bins(film) is None:
            raise ValueError(
                "render.temporal_bins: must be given, and window, as the scene has no time bins"
            )
        timed = windowed_film(film, None, None)
        height, width, bins, channels = timed.shape
        window = float(timed.start_opl), float(timed.bin_width_opl)
    rgb, xyz = np.array(["R", "G", "B"]), np.array(["x", "y", "z"])
    axes: dict[str, np.ndarray] = {}
    x, y = (int(v) for v in film.crop_offset())
    pixels, opl = ("y", "x"), np.zeros(0)
    if window is not None:
        opl = window[0] + (np.arange(bins) + 0.5) * window[1]
    known = {"y": np.arange(y, y + height), "x": np.arange(x, x + width), "opl": opl}
    known |= {"channel": rgb if channels == 3 else np.array(["L"]), "xyz": xyz}
    known |= {"frequency": np.array(outputs.phasor, float), "part": np.array(["I", "Q"])}
    known |= {name: np.arange(height) for name in ("wall_y", "laser_y")}
    known |= {name: np.arange(width) for name in ("wall_x", "laser_x")}
    known["capture_opl"] = opl
    wanted = {
        "transient": (outputs.transient, (*pixels, "opl", "channel")),
        "steady": (outputs.steady, (*pixels, "channel")),
        "noisy": (outputs.noisy, (*pixels, "opl", "channel")),
        "phasor": (outputs.phasor, ("frequency", *pixels, "part", "channel")),
        "depth": (outputs.depth, pixels),
        "normals": (outputs.normals, (*pixels, "xyz")),
        **_of_capture(config),
    }
    if outputs.capture is not None and outputs.capture.mode == "single":
        known |= {name: np.arange(1) for name in LASER_AXES}
    arrays = []
    for name, (is_wanted, its) in wanted.items():
        if is_wanted:
            shape = tuple(len(known[axis]) for axis in its)
            kind = "bool" if name == "capture_on_wall" else "float32"
            arrays.append(Array(name, its, shape, kind))
            axes |= {axis: known[axis] for axis in its}
    return Layout(tuple(arrays), axes, window, {"variant": mi.variant()}, scene.id())


def _of_capture(config: Config) -> dict[str, tuple[bool, tuple[str, ...]]]:
    """Axes of a capture and of its geometry."""
    capture = config.outputs.capture
    if capture is None:
        return {}
    lasers = LASER_AXES if capture.mode == "exhaustive" else ()
    found: dict[str, tuple[bool, tuple[str, ...]]] = {
        "capture": (True, (*lasers, *CAPTURE_AXES, "capture_opl", "channel")),
        "hidden_depth": (capture.hidden_depth, CAPTURE_AXES),
        "capture_on_wall": (True, CAPTURE_AXES),
    }
    for name in GEOMETRY:
        of_laser = name.startswith("laser")
        its = LASER_AXES if of_laser else CAPTURE_AXES
        found[f"capture_{name}"] = (not of_laser or capture.mode != "confocal", (*its, "xyz"))
    return found | {f"capture_{name}": (True, ("xyz",)) for name in ORIGINS}


def _first_scene(config: Config, records: list[int]) -> mi.Scene:
    for attempt in range(config.retry + 1):
        drawn = config.draw(records[0], attempt)
        try:
            return load(scene_of(config, drawn), config)
        except ValueError:
            if attempt == config.retry:
                raise
    raise AssertionError


@dataclass(frozen=True)
class Plan:
    """What a data set will be, before any work.

    Attributes:
        config: What was asked for.
        records: Numbers of the records.
        layout: Their arrays.

    Printing it shows arrays, shapes and sizes.
    """

    config: Config
    records: list[int]
    layout: Layout

    @property
    def bytes(self) -> int:
        """Size of all arrays."""
        return len(self.records) * self.layout.bytes

    def __str__(self) -> str:
        count = len(self.records)
        varied = ", ".join(self.config.varied) or "nothing"
        scene = self.config.plain["scene"]
        some = f"{count} record{'s' * (count != 1)} of {scene}"
        some += f" (of {self.config.records})" if count != self.config.records else ""
        rows = [("array", "axes", "shape", "size")] + [
            (
                array.name,
                ", ".join(("record", *array.axes)),
                " x ".join(map(str, (count, *array.shape))),
                atomic.readable(count * array.bytes),
            )
            for array in self.layout.arrays
        ]
        widths = [max(len(row[column]) for row in rows) for column in range(4)]
        table = [
            "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        lines = [f"{some}; varied: {varied}", *table, f"in all {atomic.readable(self.bytes)}"]
        return "\n".join(lines)
