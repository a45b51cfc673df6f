"""Description of a data set: a TOML file or a mapping, which is checked before any work starts."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import date, time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..nlos.modes import MODES
from ..rendering.settings import SETTINGS
from ..runtime import checks
from ..runtime.settings import CHECKS
from ..runtime.tables import boolean, checked, known_keys, read_toml, table, text
from ..scenes.loading import find_scene
from ..sensors.sensor_config import read_sensor
from .randomness import Source
from .varied import REPEATABLE, Varied, parse_varied

MAX_RECORDS = 10_000_000
MAX_RETRY = 1000
MAX_VALUE = 1e15

Check = Callable[[str, Any], Any]


@dataclass(frozen=True)
class Capture:
    """Settings of the captures of a relay wall."""

    mode: str | None = None  # one of `MODES`; None for the mode of the scene
    grid: tuple[int, int] | None = None  # columns and rows of points; None for the size of the film
    relay_wall: str | None = None  # id of the wall; None to find the wall
    hidden_depth: bool = True  # whether records contain the true depth of the hidden objects


@dataclass(frozen=True)
class Outputs:
    """Outputs of each record."""

    transient: bool = False
    steady: bool = False
    depth: bool = False
    normals: bool = False
    phasor: tuple[float, ...] = ()  # frequencies [Hz]
    noisy: int | None = None  # samples per pixel of a second, independent transient
    capture: Capture | None = None

    @property
    def rendered(self) -> bool:
        """Whether records need `render`."""
        return self.transient or self.steady


@dataclass(frozen=True)
class Config:
    """Checked description of a data set.

    Attributes:
        records, seed, retry, arguments, parameters, outputs, materials, objects, window, sensor:
            Values of the keys with these names, see docs/datasets.md.
        scene: Name of a built-in scene, path of an XML file, or a dict.
        settings: Settings of `load_scene`.
        varied: Varied quantities, by name.
        normalize_each_record: Whether `photons_per_cycle` of the sensor is the mean of each record.
            Otherwise it is the mean of record 0, and all records have the same factor.
        folder: Folder to which names of files are relative.
        plain: The configuration in a form that JSON supports.
        checksum: Checksum of a scene that is a file or a dict, otherwise empty.
        given: The configuration before the checks.
    """

    records: int
    seed: int
    retry: int
    scene: Any
    arguments: dict[str, Any]
    parameters: dict[str, Any]
    settings: dict[str, Any]
    window: tuple[float, float] | None
    sensor: int
    sense: dict[str, Any] | None  # Description of a sensor, table `[sensor]`
    outputs: Outputs
    materials: dict[str, dict[str, Any]]
    objects: dict[str, dict[str, Any]]
    varied: dict[str, Varied]
    normalize_each_record: bool
    folder: Path
    plain: dict[str, Any] = field(repr=False)
    checksum: str
    given: dict[str, Any] = field(repr=False)

    @property
    def photons_per_cycle(self) -> float | None:
        """Mean signal of the sensor; None without a sensor, or if radiometry gives the signal."""
        return None if self.sense is None else self.sense["photons"].get("photons_per_cycle")

    @property
    def shares_photons(self) -> bool:
        """Whether all records use the factor from radiance to photons of record 0."""
        return self.photons_per_cycle is not None and not self.normalize_each_record

    def draw(self, record: int, attempt: int = 0) -> dict[str, Any]:
        """Draw the values of a record. They depend on seed, record, attempt and names only."""
        return {
            name: varied.distribution.draw(Source(self.seed, record, name, attempt))
            for name, varied in self.varied.items()
        }

    def render_seed(self, record: int, attempt: int = 0, use: str = "render") -> int:
        """Return the seed of one use of a record, such as its render."""
        # Names of quantities cannot contain brackets, so this name is different
        return Source(self.seed, record, f"[{use}]", attempt).integer()


def read_config(source: str | os.PathLike[str] | Mapping[str, Any] | Config) -> Config:
    """Read the description of a data set.

    Args:
        source: Name of a TOML file, or a mapping with the same keys. In a mapping, `scene` may also
            be a dict for `mi.load_dict`. A `Config` is returned unchanged.

    Raises:
        ValueError: A key is unknown or its value is not allowed. The message names the key.
        FileNotFoundError: The file does not exist.

    Example:
        >>> lamp = {"argument": "light", "distribution": "choice", "values": ["area", "flash"]}
        >>> given = {"records": 3, "scene": "cornell_box", "outputs": {"steady": True}}
        >>> config = read_config(given | {"vary": {"lamp": lamp}})
        >>> config.draw(2) == read_config(given | {"vary": {"lamp": lamp}}).draw(2)
        True
    """
    if isinstance(source, Config):
        return source
    if isinstance(source, Mapping):
        return parse_config(dict(source), Path.cwd())

    # A file may come with the package
    if isinstance(source, str | Path) and not os.path.exists(source):
        from ..scenes.loading import packaged  # Imports Mitsuba

        source = packaged(os.fspath(source)) or source
    given, path = read_toml("config", source)
    return parse_config(given, path.absolute().parent)


def _grid(name: str, value: Any) -> Any:
    """Check the number of points of a capture."""
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(f"{name} = {value!r}: must be [width, height] in points")
    return tuple(checks.integer(name, each, 1, checks.MAX_SIZE) for each in value)


def _window(name: str, value: Any) -> tuple[float, float] | None:
    """Check a time window."""
    return None if value is None else checks.interval(name, value, "[start, end] in meters")


def _only(key: str, check: Check) -> Check:
    """Return the check of a table with one key. The check returns the value of the key."""
    return lambda name, value: checked(name, {key: None} | table(name, value), {key: check})[key]


def _frequencies(name: str, value: Any) -> tuple[float, ...]:
    """Check frequencies [Hz]."""
    from ..films.phasor import parse_frequencies

    if not isinstance(value, list | tuple) or not value:
        raise ValueError(f"{name} = {value!r}: must be a list of one frequency or more, in hertz")
    for each in value:
        checks.number(name, each, unit="hertz", positive=True)
    try:
        return parse_frequencies(list(value))
    except ValueError as error:
        raise ValueError(f"outputs.phasor.{error}") from None


def _outputs(name: str, value: Any) -> Outputs:
    """Check the outputs. At least one output must be set."""
    found = Outputs(**checked(name, table(name, value), OUTPUTS))
    if found == Outputs():
        raise ValueError("outputs: must ask for one output or more, for example transient = true")
    return found


def _render(name: str, value: Any) -> dict[str, Any]:
    """Check the settings of `load_scene`, `window` and `sensor`."""
    given = checked(name, table(name, value), RENDER)
    if given.get("window") is None:
        return given

    # Convert the window to the start and the width of the bins
    for key in ("start_opl", "bin_width_opl"):
        if key in given:
            raise ValueError(f"render.{key} = {given[key]:g}: must be left out with window")
    if "temporal_bins" not in given:
        raise ValueError("render.temporal_bins: must be given with window")
    start, end = given["window"]
    return given | {"start_opl": start, "bin_width_opl": (end - start) / given["temporal_bins"]}


def _parameters(name: str, value: Any) -> dict[str, Any]:
    """Check the parameters of an XML file."""
    given = table(name, value)
    for key, each in given.items():
        checks.instance(f"{name}.{key}", each, bool | str | int | float, "a number or text")
    return given


def _plugins(name: str, value: Any) -> dict[str, dict[str, Any]]:
    """Check materials or objects, and return them as dicts for Mitsuba."""
    given = table(name, value)
    for key, each in given.items():
        if not isinstance(each, Mapping) or not isinstance(each.get("type"), str):
            raise ValueError(f"{name}.{key}: must be a table with a plugin's name as its type")
        if "." in key or not key:
            raise ValueError(f"{name}.{key!r}: must be a name without dots")
        _require_plain(f"{name}.{key}", each)
    return {key: dict(each) for key, each in given.items()}


def _require_plain(where: str, value: Any) -> None:
    """Raise a ValueError if plugins do not support a value.

    Some of these values would end the process in Mitsuba's parser.
    """
    if isinstance(value, Mapping):
        for key, part in value.items():
            _require_plain(f"{where}.{key}", part)
    elif isinstance(value, list | tuple):
        if not value or any(isinstance(part, Mapping | str | bool) for part in value):
            raise ValueError(f"{where} = {value!r}: must be a list of numbers")
        for part in value:
            _require_plain(where, part)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        checks.number(where, value, low=-MAX_VALUE, high=MAX_VALUE)
    elif value is None or isinstance(value, date | time) or value == "":
        raise ValueError(f"{where} = {value!r}: must be a number, text, a list or a table")


def _scene(name: str, value: Any) -> Any:
    """Check the type of a scene."""
    allowed = "a built-in scene's name, an XML file or, in Python, a dict"
    return checks.instance(name, value, str | os.PathLike | Mapping, allowed)


RENDER = CHECKS | {"window": _window, "sensor": SETTINGS["sensor"].check}
CAPTURE = {
    "mode": partial(checks.one_of, allowed=MODES),
    "grid": _grid,
    "relay_wall": text,
    "hidden_depth": boolean,
}
OUTPUTS = {
    **dict.fromkeys(("transient", "steady", "depth", "normals"), boolean),
    "phasor": _only("frequencies_hz", _frequencies),
    "noisy": _only("spp", CHECKS["spp"]),
    "capture": lambda name, value: Capture(**checked(name, table(name, value), CAPTURE)),
}
CONFIG: dict[str, Check] = {
    "records": partial(checks.integer, low=1, high=MAX_RECORDS),
    "seed": SETTINGS["seed"].check,
    "retry": partial(checks.integer, low=0, high=MAX_RETRY),
    "scene": _scene,
    "arguments": table,
    "parameters": _parameters,
    "render": _render,
    "outputs": _outputs,
    "sensor": lambda _, value: value,  # Checked in `parse_config`, where the folder is known
    "normalize_each_record": boolean,
    "materials": _plugins,
    "objects": _plugins,
    "vary": lambda name, value: {
        key: parse_varied(key, each) for key, each in table(name, value).items()
    },
}
"""The check of each key."""

REQUIRED = ("records", "scene", "outputs")
DEFAULTS = {name: {} for name in CONFIG if name not in REQUIRED}
DEFAULTS |= {"seed": 0, "retry": 0, "sensor": None, "normalize_each_record": False}


def parse_config(given: dict[str, Any], folder: Path) -> Config:
    """Check a mapping and convert it to a `Config`.

    Args:
        given: Configuration as it was read.
        folder: Folder to which names of files are relative.

    Raises:
        ValueError: A key is unknown or missing, or its value is not allowed.
    """
    # Check each key
    known_keys("", given, CONFIG)
    for name in REQUIRED:
        if name not in given:
            raise ValueError(f"{name}: must be given")
    found = checked("", DEFAULTS | given, CONFIG)
    scene: Any = found["scene"]
    varied = found.pop("vary")
    render = found.pop("render")

    # Find the scene
    if not isinstance(scene, Mapping):
        scene = os.fspath(scene)
        scene = find_scene(str(folder / scene) if scene.lower().endswith(".xml") else scene)
    found["scene"] = scene

    # Read the sensor
    sense = found.pop("sensor")
    if isinstance(sense, str) and sense.endswith(".toml"):
        sense = folder / sense
    sense = sense if sense is None else read_sensor(sense)["given"]
    if found["normalize_each_record"] and "photons_per_cycle" not in (sense or {}).get(
        "photons", ()
    ):
        raise ValueError(
            "normalize_each_record has no effect without photons_per_cycle in the sensor; remove it"
        )

    # Arguments belong to built-in scenes, parameters to XML files
    built_in = isinstance(scene, str)
    is_xml = isinstance(scene, Path)
    if found["arguments"] and not built_in:
        raise ValueError("arguments: must be left out, only built-in scenes have them")
    if found["parameters"] and not is_xml:
        raise ValueError("parameters: must be left out, only XML files have them")

    # The grid of a capture is the size of the film
    sized = [name for name in ("width", "height") if name in render]
    if sized and found["outputs"].capture is not None and found["outputs"].capture.grid is not None:
        raise ValueError(f"render.{sized[0]}: must be left out with outputs.capture.grid")

    # Does the scene have the varied argument or parameter?
    owners = {"argument": (built_in, "a built-in scene"), "parameter": (is_xml, "an XML file")}
    for name, each in varied.items():
        fits, owner = owners.get(each.target, (True, ""))
        if not fits:
            where = f"vary.{name}.{each.target} = {each.part!r}"
            raise ValueError(f"{where}: must be left out, scene is not {owner}")
    _require_once(varied, {kind: found[f"{kind}s"] for kind in owners})
    return Config(
        **found,
        settings={name: value for name, value in render.items() if name in CHECKS},
        window=render.get("window"),
        sensor=render.get("sensor", 0),
        sense=sense,
        varied=varied,
        folder=folder,
        plain=_plain(given, scene),
        checksum=_checksum(scene),
        given=given,
    )


def _require_once(varied: Mapping[str, Varied], fixed: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise a ValueError if a part of the scene is varied twice, or also has a fixed value."""
    owners: dict[tuple[str, str], str] = {}
    for name, each in varied.items():
        part = (each.target, str(each.part))
        where = f"vary.{name}.{each.target} = {each.part!r}"
        if each.part in fixed.get(each.target, ()):
            raise ValueError(f"{where}: is in [{each.target}s] too; must be in one of both")
        if each.target not in REPEATABLE and part in owners:
            raise ValueError(f"{where}: vary.{owners[part]} has it too; must be in one of both")
        owners[part] = name


def _plain(given: Mapping[str, Any], scene: Any) -> dict[str, Any]:
    """Convert the configuration to a form that JSON supports."""
    found = dict(given)
    if isinstance(scene, Path):
        found["scene"] = os.fspath(given["scene"])
    elif not isinstance(scene, str):
        found["scene"] = "a dict"
    return json.loads(json.dumps(found, default=_as_json))


def _checksum(scene: Any) -> str:
    """Return the checksum of a scene that is a file or a dict, otherwise an empty text."""
    if isinstance(scene, str):
        return ""
    is_file = isinstance(scene, Path)
    content = scene.read_bytes() if is_file else json.dumps(scene, default=_as_json).encode()
    return hashlib.sha256(content).hexdigest()[:16]


def _as_json(value: Any) -> Any:
    """Convert an array or a transform to lists, and another object to the name of its type."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if hasattr(value, "matrix"):
        return np.array(value.matrix).tolist()
    return type(value).__name__
