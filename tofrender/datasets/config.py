"""What a data set is to be: a TOML file or a mapping, read and checked whole before any work."""

from __future__ import annotations

import hashlib
import json
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, time
from pathlib import Path
from typing import Any

import numpy as np

from ..nlos.captures import MODES
from ..runtime import checks
from ..scenes.settings import CHECKS
from .randomness import Source
from .tables import boolean, known_keys, table, text
from .varied import Varied, parse_varied

MAX_RECORDS = 10_000_000
MAX_RETRY = 1000
MAX_VALUE = 1e15

RENDER = (*CHECKS, "window", "sensor")
KEYS = (
    *("records", "seed", "retry", "scene", "arguments", "parameters", "render", "outputs"),
    *("materials", "objects", "vary"),
)


@dataclass(frozen=True)
class Capture:
    """A capture of a relay wall.

    Attributes:
        mode: One of "confocal", "single", "exhaustive".
        grid: Points of the wall, width and height; None for the film's.
        relay_wall: Id of the wall, None to find it.
        hidden_depth: Whether the true depth of what is hidden is wanted.
    """

    mode: str = "confocal"
    grid: tuple[int, int] | None = None
    relay_wall: str | None = None
    hidden_depth: bool = True


@dataclass(frozen=True)
class Outputs:
    """What each record holds.

    Attributes:
        transient, steady, depth, normals: Whether it does.
        phasor: Frequencies of its phasors [Hz].
        noisy: Samples per pixel of a second transient with noise of its own; None for none.
        capture: Its capture, None for none.
    """

    transient: bool = False
    steady: bool = False
    depth: bool = False
    normals: bool = False
    phasor: tuple[float, ...] = ()
    noisy: int | None = None
    capture: Capture | None = None

    @property
    def rendered(self) -> bool:
        """Whether records need `render`."""
        return self.transient or self.steady


@dataclass(frozen=True)
class Config:
    """A data set, checked.

    Attributes:
        records: How many records there are.
        seed: Of all draws and renders.
        retry: How many more draws a record gets whose scene cannot be rendered.
        scene: A built-in scene's name, the path of an XML file, or a dict.
        arguments: What the built-in scene is called with.
        parameters: Values for the `<default>` names of an XML file.
        settings: What `load_scene` changes.
        window: Start and end of the time bins [m], None for the scene's.
        sensor: Number of the sensor.
        outputs: What records hold.
        materials: More materials, as dicts for Mitsuba.
        objects: More objects, as dicts for Mitsuba.
        varied: What is varied, by name.
        folder: Where names of files start.
        plain: All of it as JSON can hold it.
        checksum: Of a scene that is a file or a dict.
        given: What it was read from.
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
    outputs: Outputs
    materials: dict[str, dict[str, Any]]
    objects: dict[str, dict[str, Any]]
    varied: dict[str, Varied]
    folder: Path
    plain: dict[str, Any] = field(repr=False)
    checksum: str
    given: dict[str, Any] = field(repr=False)

    def draw(self, record: int, attempt: int = 0) -> dict[str, Any]:
        """The values of a record, which depend on seed, record, attempt and each name alone."""
        return {
            name: varied.distribution.draw(Source(self.seed, record, name, attempt))
            for name, varied in self.varied.items()
        }

    def render_seed(self, record: int, attempt: int = 0, use: str = "render") -> int:
        """The seed of a record's random numbers; no quantity can have the name."""
        return Source(self.seed, record, f"[{use}]", attempt).integer()


def read_config(source: str | os.PathLike[str] | Mapping[str, Any] | Config) -> Config:
    """Read what a data set is to be.

    Args:
        source: The name of a TOML file, or a mapping with the same keys, whose `scene` may be a
            dict for `mi.load_dict` too.

    Raises:
        ValueError: A key is unknown, or its value not allowed; one line that names the key.
        FileNotFoundError: There is no such file; one line.

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
    path = checks.path("config", source)
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileNotFoundError(f"config = {path}: does not exist; must be a TOML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"config = {path}: cannot be read ({type(error).__name__})") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"config = {path}: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise ValueError(f"config = {path}: is nested too deeply; must be flatter") from None
    return parse_config(given, path.absolute().parent)


# ------------------------------------------------------------------------------------ its tables


def parse_config(given: dict[str, Any], folder: Path) -> Config:
    """The config of a mapping, whose names of files start in `folder`.

    Raises:
        ValueError: As `read_config`.
    """
    known_keys("", given, KEYS)
    for name in ("records", "scene", "outputs"):
        if name not in given:
            raise ValueError(f"{name}: must be given")
    scene, is_xml = _scene(given["scene"], folder)
    built_in = isinstance(scene, str)
    arguments, parameters = table("arguments", given), table("parameters", given)
    if arguments and not built_in:
        raise ValueError("arguments: must be left out, only built-in scenes have them")
    if parameters and not is_xml:
        raise ValueError("parameters: must be left out, only XML files have them")
    for name, value in parameters.items():
        if not isinstance(value, bool | str | int | float):
            raise ValueError(f"parameters.{name} = {value!r}: must be a number or text")
    settings, window, sensor = _render(table("render", given))
    materials = {n: _described("materials", n, v) for n, v in table("materials", given).items()}
    objects = {n: _described("objects", n, v) for n, v in table("objects", given).items()}
    vary = table("vary", given)
    varied = {name: parse_varied(name, each) for name, each in vary.items()}
    for name, each in varied.items():
        for kind, fits in (("argument", built_in), ("parameter", is_xml)):
            if each.target == kind and not fits:
                what = "a built-in scene" if kind == "argument" else "an XML file"
                raise ValueError(
                    f"vary.{name}.{kind} = {each.what!r}: must be left out, scene is not {what}"
                )
    fixed = {"argument": arguments, "parameter": parameters}
    taken: dict[tuple[str, str], str] = {}
    for name, each in varied.items():
        if each.what in fixed.get(each.target, ()):
            raise ValueError(
                f"vary.{name}.{each.target} = {each.what!r}: is in [{each.target}s] too; must be "
                "in one of both"
            )
        if each.only_once and (each.target, str(each.what)) in taken:
            raise ValueError(
                f"vary.{name}.{each.target} = {each.what!r}: vary."
                f"{taken[each.target, str(each.what)]} has it too; must be in one of both"
            )
        taken[each.target, str(each.what)] = name
    return Config(
        records=checks.integer("records", given["records"], 1, MAX_RECORDS),
        seed=checks.integer("seed", given.get("seed", 0), 0, checks.MAX_SEED),
        retry=checks.integer("retry", given.get("retry", 0), 0, MAX_RETRY),
        scene=scene,
        arguments=arguments,
        parameters=parameters,
        settings=settings,
        window=window,
        sensor=sensor,
        outputs=_outputs(table("outputs", given)),
        materials=materials,
        objects=objects,
        varied=varied,
        folder=folder,
        plain=_plain(given, scene),
        checksum=_checksum(scene),
        given=given,
    )


def _scene(value: Any, folder: Path) -> tuple[Any, bool]:
    """The scene, and whether it is an XML file."""
    from ..scenes.loading import find_scene

    if isinstance(value, Mapping):
        return value, False
    if not isinstance(value, str | os.PathLike):
        raise ValueError(
            f"scene = {value!r}: must be a built-in scene's name, an XML file or, in Python, a dict"
        )
    name = os.fspath(value)
    found = find_scene(str(folder / name) if name.lower().endswith(".xml") else name)
    return found, isinstance(found, Path)


def _render(given: dict[str, Any]) -> tuple[dict[str, Any], tuple[float, float] | None, int]:
    """Settings, window and sensor."""
    known_keys("render", given, RENDER)
    settings = {n: CHECKS[n](f"render.{n}", v) for n, v in given.items() if n in CHECKS}
    sensor = checks.integer("render.sensor", given.get("sensor", 0), 0, 1000)
    window = given.get("window")
    if window is None:
        return settings, None, sensor
    if not isinstance(window, list | tuple) or len(window) != 2:
        raise ValueError(f"render.window = {window!r}: must be [start, end] in metres")
    start, end = (checks.metres("render.window", each) for each in window)
    if not start < end:
        raise ValueError(f"render.window = {window!r}: must end after it starts")
    for name in ("start_opl", "bin_width_opl"):
        if name in settings:
            raise ValueError(f"render.{name} = {settings[name]:g}: must be left out with window")
    if "temporal_bins" not in settings:
        raise ValueError("render.temporal_bins: must be given with window")
    settings |= {"start_opl": start, "bin_width_opl": (end - start) / settings["temporal_bins"]}
    return settings, (start, end), sensor


def _outputs(given: dict[str, Any]) -> Outputs:
    known_keys("outputs", given, tuple(Outputs.__dataclass_fields__))
    flags: dict[str, Any] = {
        name: boolean(f"outputs.{name}", given[name])
        for name in ("transient", "steady", "depth", "normals")
        if name in given
    }
    if "phasor" in given:
        phasor = table("phasor", given, "outputs.")
        known_keys("outputs.phasor", phasor, ("frequencies_hz",))
        flags["phasor"] = _frequencies(phasor.get("frequencies_hz"))
    if "noisy" in given:
        noisy = table("noisy", given, "outputs.")
        known_keys("outputs.noisy", noisy, ("spp",))
        flags["noisy"] = checks.integer("outputs.noisy.spp", noisy.get("spp"), 1, checks.MAX_SPP)
    if "capture" in given:
        flags["capture"] = _capture(table("capture", given, "outputs."))
    found = Outputs(**flags)
    if found == Outputs():
        raise ValueError("outputs: must ask for one output or more, for example transient = true")
    return found


def _frequencies(value: Any) -> tuple[float, ...]:
    from ..films.phasor import parse_frequencies

    name = "outputs.phasor.frequencies_hz"
    if not isinstance(value, list | tuple) or not value:
        raise ValueError(f"{name} = {value!r}: must be a list of one frequency or more, in hertz")
    for each in value:
        checks.number(name, each, unit="hertz", positive=True)
    try:
        return parse_frequencies(list(value))
    except ValueError as error:
        raise ValueError(f"outputs.phasor.{error}") from None


def _capture(given: dict[str, Any]) -> Capture:
    where = "outputs.capture"
    known_keys(where, given, tuple(Capture.__dataclass_fields__))
    grid, found = given.get("grid"), {}
    if grid is not None:
        if not isinstance(grid, list | tuple) or len(grid) != 2:
            raise ValueError(f"{where}.grid = {grid!r}: must be [width, height] in points")
        width, height = (checks.integer(f"{where}.grid", n, 1, checks.MAX_SIZE) for n in grid)
        found["grid"] = (width, height)
    if "relay_wall" in given:
        found["relay_wall"] = text(f"{where}.relay_wall", given["relay_wall"])
    if "hidden_depth" in given:
        found["hidden_depth"] = boolean(f"{where}.hidden_depth", given["hidden_depth"])
    mode = checks.one_of(f"{where}.mode", given.get("mode", "confocal"), MODES)
    return Capture(mode=mode, **found)


def _described(where: str, name: str, value: Any) -> dict[str, Any]:
    """A material or an object, as a dict for Mitsuba."""
    if not isinstance(value, Mapping) or not isinstance(value.get("type"), str):
        raise ValueError(f"{where}.{name}: must be a table with a plugin's name as its type")
    if "." in name or not name:
        raise ValueError(f"{where}.{name!r}: must be a name without dots")
    for key, part in value.items():
        _require_value(f"{where}.{name}.{key}", part)
    return dict(value)


def _require_value(where: str, value: Any) -> None:
    """Refuse what no plugin takes, some of which would end the process in Mitsuba's parser."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            _require_value(f"{where}.{key}", part)
    elif isinstance(value, list | tuple):
        if not value or any(isinstance(part, Mapping | str | bool) for part in value):
            raise ValueError(f"{where} = {value!r}: must be a list of numbers")
        for part in value:
            _require_value(where, part)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        checks.number(where, value, low=-MAX_VALUE, high=MAX_VALUE)
    elif value is None or isinstance(value, date | time) or value == "":
        raise ValueError(f"{where} = {value!r}: must be a number, text, a list or a table")


# ----------------------------------------------------------------------------- as text, to compare


def _plain(given: Mapping[str, Any], scene: Any) -> dict[str, Any]:
    """All keys as JSON holds them."""
    found = dict(given)
    if isinstance(scene, Path):
        found["scene"] = os.fspath(given["scene"])
    elif not isinstance(scene, str):
        found["scene"] = "a dict"
    return json.loads(json.dumps(found, default=_as_json))


def _checksum(scene: Any) -> str:
    """Of a scene that is a file or a dict; built-in ones have none."""
    if isinstance(scene, str):
        return ""
    if isinstance(scene, Path):
        return _digest(scene.read_bytes())
    return _digest(json.dumps(scene, default=_as_json).encode())


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _as_json(value: Any) -> Any:
    """An array or a number of NumPy's, a transform, or the kind of another object."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if hasattr(value, "matrix"):
        return np.array(value.matrix).tolist()
    return type(value).__name__
