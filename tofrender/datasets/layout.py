"""Names, axes and sizes of the arrays of a data set."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np

from ..films.image import time_bins
from ..nlos.setup import capture_mode
from ..rendering.dataset import pixels_and_channels, transient_dataset
from ..rendering.time_window import windowed_film
from ..runtime import atomic
from ..scenes.loading import require_sensor
from ..sensors import sense
from .dataset_config import Config, Outputs
from .scene import load, scene_of

PIXELS = ("y", "x")
WALL = ("wall_y", "wall_x")
LASERS = ("laser_y", "laser_x")
GEOMETRY = ("sensor_grid", "sensor_normals", "laser_grid", "laser_normals")
ORIGINS = ("sensor_origin", "laser_origin")
RADIANCE = "W m^-2 sr^-1"


class ArrayKind(NamedTuple):
    """Properties of an array, for one record."""

    axes: tuple[str, ...]  # without the axis `record`
    units: str = ""  # as in the CF conventions
    long_name: str = ""  # as in the CF conventions
    dtype: str = "float32"


NOISY = "radiance per bin, with fewer samples of its own"
PHASOR = "sum of L exp(+i 2 pi f opl / c): I, Q"
NORMALS = "unit normal of the first surface, on the side seen, in world space"
CAPTURE = "radiance per bin at points of the relay wall"
HIDDEN = "distance of what is hidden from the relay wall"
KINDS = {
    "transient": ArrayKind((*PIXELS, "opl", "channel"), RADIANCE, "radiance per bin"),
    "steady": ArrayKind((*PIXELS, "channel"), RADIANCE, "radiance of all time"),
    "noisy": ArrayKind((*PIXELS, "opl", "channel"), RADIANCE, NOISY),
    "phasor": ArrayKind(("frequency", *PIXELS, "part", "channel"), RADIANCE, PHASOR),
    "depth": ArrayKind(PIXELS, "m", "distance from the sensor to the first surface"),
    "normals": ArrayKind((*PIXELS, "xyz"), "", NORMALS),
    "capture": ArrayKind((*WALL, "capture_opl", "channel"), RADIANCE, CAPTURE),
    "hidden_depth": ArrayKind(WALL, "m", HIDDEN),
    "capture_on_wall": ArrayKind(WALL, dtype="bool"),
    **{f"capture_sensor_{name}": ArrayKind((*WALL, "xyz")) for name in ("grid", "normals")},
    **{f"capture_laser_{name}": ArrayKind((*LASERS, "xyz")) for name in ("grid", "normals")},
    **{f"capture_{name}": ArrayKind(("xyz",)) for name in ORIGINS},
}
"""All arrays that a data set may have."""


@dataclass(frozen=True)
class Array:
    """Array of a data set."""

    name: str
    axes: tuple[str, ...]  # without the axis `record`
    shape: tuple[int, ...]  # of one record
    dtype: str = "float32"

    @property
    def bytes(self) -> int:
        """Size of one record [bytes]."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class DatasetLayout:
    """All arrays of a data set, and their axes."""

    arrays: tuple[Array, ...]
    axes: dict[str, np.ndarray] = field(repr=False)  # coordinates by name
    window: tuple[float, float] | None  # start and width of the time bins [m]
    scene: str = ""  # fingerprint of the first scene, with the bytes of its files
    capture_mode: str | None = None  # mode of the captures; None without captures

    @property
    def bytes(self) -> int:
        """Size of all arrays of one record [bytes]."""
        return sum(array.bytes for array in self.arrays)

    def check(self, made: Mapping[str, np.ndarray]) -> None:
        """Raise a ValueError if an array of a record has another shape than in other records."""
        for array in self.arrays:
            if made[array.name].shape != array.shape:
                raise ValueError(
                    f"{array.name} has the shape {made[array.name].shape}, but {array.shape} in "
                    "other records. All records must have the same shape"
                )


def layout_of(config: Config, records: list[int]) -> DatasetLayout:
    """Determine the names, axes and shapes of the arrays of a data set from its first record.

    The scene of this record is loaded. If loading fails, the values of the record are drawn again,
    up to `config.retry` times. All other records must have the same shapes.

    Args:
        config: Description of the data set.
        records: Numbers of the records. Only the first is used.

    Raises:
        ValueError: No draw of the first record can be loaded, or the scene has no time bins
            although the data set needs them.
    """
    # Load the scene
    scene = _first_scene(config, records)
    camera: Any = require_sensor(scene, config.sensor, "render.sensor")
    film = camera.film()
    outputs = config.outputs
    capture = config.outputs.capture
    width, height = (int(v) for v in film.crop_size())
    channels = 1 if mi.is_monochromatic else 3

    # Find the time bins
    window = None
    opl = np.zeros(0)
    if outputs.rendered or outputs.noisy or capture or config.sense is not None:
        if time_bins(film) is None:
            raise ValueError(
                "render.temporal_bins: must be given, and window, since the scene has no time bins"
            )
        timed = windowed_film(film, None, None)
        height, width, bins, channels = timed.shape
        window = float(timed.start_opl), float(timed.bin_width_opl)
        opl = window[0] + (np.arange(bins) + 0.5) * window[1]

    # Find the coordinates of each axis
    mode = None
    if capture is not None:
        mode = capture_mode(scene, camera, capture.mode)
    single = mode == "single"
    coordinates = {
        **pixels_and_channels(film, channels),
        **{"opl": opl, "capture_opl": opl},
        "xyz": np.array(["x", "y", "z"]),
        "frequency": np.array(outputs.phasor, float),
        "part": np.array(["I", "Q"]),
        **{"wall_y": np.arange(height), "wall_x": np.arange(width)},
        "laser_y": np.arange(1 if single else height),
        "laser_x": np.arange(1 if single else width),
    }

    # List the arrays of the outputs
    arrays = []
    axes = {}
    for name in _names(outputs, mode):
        kind = KINDS[name]
        its = kind.axes
        if name == "capture" and mode == "exhaustive":
            its = (*LASERS, *its)
        arrays.append(Array(name, its, tuple(len(coordinates[axis]) for axis in its), kind.dtype))
        axes |= {axis: coordinates[axis] for axis in its}

    # Measure a dim film to find the arrays of the sensor
    if config.sense is not None:
        dim = np.full(timed.shape, 1e-12, np.float32)
        attrs = {"quantity": "radiance per bin"}
        attrs |= {"start_opl": timed.start_opl, "bin_width_opl": timed.bin_width_opl}
        film = transient_dataset({"transient": dim, "steady": dim[:, :, 0]}, timed, attrs)
        measured = sense(film, config.sense).drop_vars(
            "cycles"
        )  # The configuration contains the cycles
        for name, values in measured.items():
            its = tuple(f"sensor_{axis}" for axis in values.dims)
            dtype = "bool" if values.dtype == bool else "float32"
            arrays.append(Array(f"sensor_{name}", its, values.shape, dtype))
            places = {axis: measured["opl" if axis == "bin" else axis] for axis in values.dims}
            axes |= {f"sensor_{axis}": each.values for axis, each in places.items()}
    return DatasetLayout(tuple(arrays), axes, window, scene.id(), mode)


def _names(outputs: Outputs, capture_mode: str | None) -> list[str]:
    """Return the names of the arrays that these outputs contain."""
    rendered = ("transient", "steady", "noisy", "phasor", "depth", "normals")
    names = [name for name in rendered if getattr(outputs, name)]
    capture = outputs.capture
    if capture is None:
        return names

    # In confocal captures, the laser follows the sensor
    with_laser = capture_mode != "confocal"
    geometry = [name for name in GEOMETRY if with_laser or not name.startswith("laser")]
    names += ["capture", *["hidden_depth"] * capture.hidden_depth, "capture_on_wall"]
    return names + [f"capture_{name}" for name in (*geometry, *ORIGINS)]


def _first_scene(config: Config, records: list[int]) -> mi.Scene:
    """Load the scene of the first record, and draw again if it cannot be loaded."""
    for attempt in range(config.retry):
        with suppress(ValueError):
            return load(scene_of(config, config.draw(records[0], attempt)), config)
    return load(scene_of(config, config.draw(records[0], config.retry)), config)


@dataclass(frozen=True)
class DatasetPlan:
    """Plan of a data set. `print` shows its arrays with their shapes and sizes.

    Attributes:
        config: Description of the data set.
        records: Numbers of the records.
        layout: Arrays of the data set.
    """

    config: Config
    records: list[int]
    layout: DatasetLayout

    @property
    def bytes(self) -> int:
        """Size of all arrays [bytes]."""
        return len(self.records) * self.layout.bytes

    def __str__(self) -> str:
        # Summarize the records
        count = len(self.records)
        varied = ", ".join(self.config.varied) or "nothing"
        scene = self.config.plain["scene"]
        some = f"{count} record{'s' * (count != 1)} of {scene}"
        some += f" (of {self.config.records})" if count != self.config.records else ""

        # List the arrays as a table
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
