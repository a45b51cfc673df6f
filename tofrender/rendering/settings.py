"""Settings of a render: one table, from which checks, command-line options and tests follow.

Nothing here imports NumPy or Mitsuba before a render begins: `tofrender --help` answers at once.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

from ..runtime import checks

MAX_SENSOR = 1 << 16
MAX_WORKERS = 1024
INTEGRATORS = (
    *("transient_path", "transient_volpath", "path_tracer_mats", "path_tracer_nee"),
    *("path_tracer_mis", "transient_light_tracer", "transient_bdpt", "ao"),
)
SAMPLERS = (
    *("padded_sobol", "independent", "stratified", "multijitter", "orthogonal", "ldsampler"),
)

FIXED_WHEN_LOADED = ("size", "pulse_width", "max_depth", "define", "settings")
"""Settings that change a scene while it loads; the others suit one that is loaded, too."""


@dataclass(frozen=True)
class Setting:
    """Description of a setting, of which its field in `RenderSettings` has name, type and default.

    Attributes:
        help: What it sets, and in which unit: for `--help` and `render`'s documentation.
        check: Refuses bad values of a parameter of this name, in one line.
        low, high: Least and largest integer.
        choices: All names that are allowed; in Python, objects are, too.
        scene_name: Its name in `load_scene`.
    """

    help: str
    check: Callable[[str, Any], object] | None = None
    low: int | None = None
    high: int | None = None
    choices: tuple[str, ...] = ()
    scene_name: str = ""


def _integer(help: str, low: int, high: int, scene_name: str = "") -> Setting:
    """A setting that is an integer from `low` to `high`."""
    check = partial(checks.integer, low=low, high=high)
    return Setting(help, check, low, high, scene_name=scene_name)


def _field(setting: Setting, default: Any = None) -> Any:
    """A field of a dataclass that has a setting."""
    return field(default=default, metadata={"setting": setting})


def start_and_width(window: object, bins: int, name: str = "window") -> tuple[float, float]:
    """Start and bin width of a window given as (start, stop)."""
    ends: Any = window
    try:
        start, stop = ends
    except (TypeError, ValueError):
        given = checks.quote(window)
        raise ValueError(f"{name} = {given}: must be 'auto' or (start, stop) in metres") from None
    start, stop = checks.metres(f"{name}[0]", start), checks.metres(f"{name}[1]", stop)
    if not start < stop < start + checks.MAX_OPL:
        given = checks.quote(window)
        raise ValueError(f"{name} = {given}: must end after it starts, and not at infinity")
    return start, (stop - start) / bins


def is_auto(value: object) -> bool:
    """Whether a window or a pulse's width is to be found."""
    return isinstance(value, str) and value == "auto"


def _check_length(name: str, value: object) -> float:
    return checks.metres(name, value, positive=True)


def _check_window(name: str, value: object) -> None:
    if not is_auto(value):
        start_and_width(value, 1, name)


def _check_pulse_width(name: str, value: object) -> None:
    if not is_auto(value):
        checks.width(name, value)


def _check_size(name: str, value: object) -> None:
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ValueError(f"{name} = {checks.quote(value)}: must be (width, height) in pixels")
    for side in value:
        checks.integer(name, side, 1, checks.MAX_SIZE)


@dataclass(frozen=True, eq=False)
class RenderSettings:
    """Settings of a render, checked; None leaves the scene's own.

    `SETTINGS` has the description of each. `settings` are more of what `load_scene` can change.

    Example:
        >>> RenderSettings("cornell_box", size=(64, 48), bins=100).scene_changes
        {'width': 64, 'height': 48, 'temporal_bins': 100}
    """

    scene: Any = field(metadata={"setting": Setting("Built-in name or path of a Mitsuba XML file")})
    spp: int | None = _field(_integer("Samples per pixel", 1, checks.MAX_SPP))
    seed: int = _field(_integer("Seed of all random numbers", 0, checks.MAX_SEED), 0)
    size: tuple[int, int] | None = _field(
        Setting("Width and height of the picture [pixels]", _check_size, 1, checks.MAX_SIZE)
    )
    bins: int | None = _field(_integer("Number of time bins", 1, checks.MAX_BINS, "temporal_bins"))
    start_opl: float | None = _field(
        Setting("Path length where bins start [m]", checks.metres, scene_name="start_opl")
    )
    bin_width: float | None = _field(
        Setting("Width of a time bin [m]", _check_length, scene_name="bin_width_opl")
    )
    window: tuple[float, float] | str | None = _field(
        Setting("Start and stop of all bins, path length [m]", _check_window)
    )
    pulse_width: float | str | None = _field(
        Setting(
            "Standard deviation of a Gaussian pulse [m]",
            _check_pulse_width,
            scene_name="pulse_width_opl",
        )
    )
    max_depth: int | None = _field(
        Setting(
            "Longest path in segments, -1 for any",
            *(checks.depth, -1, checks.MAX_DEPTH),
            scene_name="max_depth",
        )
    )
    integrator: Any = _field(  # noqa: RUF009
        Setting("Plugin that follows the paths", choices=INTEGRATORS)
    )
    sampler: Any = _field(  # noqa: RUF009
        Setting("Plugin that draws the random numbers", choices=SAMPLERS)
    )
    sensor: int = _field(_integer("Number of the sensor", 0, MAX_SENSOR), 0)
    define: Mapping[str, Any] | None = _field(
        Setting("Values of an XML file's parameters", checks.mapping, scene_name="parameters")
    )
    settings: Mapping[str, Any] | None = _field(
        Setting("More changes of the scene while it is loaded", checks.mapping)
    )
    errors: bool = _field(Setting("Measure the noise of each bin", checks.boolean), False)

    def __post_init__(self) -> None:
        for each in fields(self):
            value, check = getattr(self, each.name), SETTINGS[each.name].check
            if check and not (value is None and each.default is None):
                check(each.name, value)
        if self.window is not None:
            for name in ("start_opl", "bin_width"):
                value = getattr(self, name)
                if value is not None:
                    raise ValueError(f"{name} = {value:g}: must be left out with `window`")
        self._check_scene_changes()

    def _check_scene_changes(self) -> None:
        """Refuse changes that are wrong, given twice, or impossible as the scene is loaded."""
        import mitsuba as mi

        from ..scenes.settings import check_settings

        settings = dict(self.settings or {})
        for name in ("source", "integrator", "sampler"):
            if name in settings:
                raise ValueError(f"settings with {name!r}: must be others, this is an argument")
        if isinstance(self.scene, mi.Scene):
            for name in FIXED_WHEN_LOADED:
                value = getattr(self, name)
                if value is not None and not (isinstance(value, Mapping) and not value):
                    shown = name if name == "settings" else f"{name} = {checks.quote(value)}"
                    raise ValueError(
                        f"{shown}: must be left out with a loaded scene, which cannot be changed"
                    )
        for name, scene_name in SCENE_NAMES.items():
            if scene_name in settings and getattr(self, name) is not None:
                raise ValueError(f"{name}: must be left out, settings has {scene_name}")
        own = {"optimize", "parameters"}  # Arguments of `load_scene`, which checks them
        check_settings({name: value for name, value in settings.items() if name not in own})

    def translate(self, message: str) -> str:
        """A message of `load_scene` with the names that the settings have here."""
        names = {
            own: name for name, own in SCENE_NAMES.items() if name not in (self.settings or {})
        }
        given = {own for own, name in names.items() if getattr(self, name) is not None}
        start = re.compile(r"\A(\w+)(?= = )")
        message = start.sub(lambda m: names[m[1]] if m[1] in given else m[1], message)
        return re.sub(r"`(\w+)`", lambda m: f"`{names.get(m[1], m[1])}`", message)

    @property
    def values(self) -> dict[str, Any]:
        """All settings by name, nothing copied."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @property
    def scene_label(self) -> str:
        """Name or path of the scene, else "scene"."""
        is_name = isinstance(self.scene, str | os.PathLike)
        return os.fspath(self.scene) if is_name else "scene"

    @property
    def time_axis(self) -> tuple[Any, int | None, float | None, float | None]:
        """Window, bins, start and bin width, for `windowed_film`."""
        return self.window, self.bins, self.start_opl, self.bin_width

    @property
    def scene_changes(self) -> dict[str, Any]:
        """Arguments of `load_scene`; with a window and bins, a steady scene turns transient."""
        given: dict[str, Any] = dict(self.settings or {})
        if self.size is not None:
            given |= dict(zip(("width", "height"), self.size, strict=True))
        values = {own: getattr(self, name) for name, own in SCENE_NAMES.items()}
        if is_auto(self.pulse_width):  # Known once the light was looked at
            values["pulse_width_opl"] = None
        given |= {own: value for own, value in values.items() if value is not None}
        if self.window is not None and self.bins is not None:
            # A window that is still to be found replaces this one
            start, width = (
                (0.0, 1.0) if is_auto(self.window) else start_and_width(self.window, self.bins)
            )
            given |= {"start_opl": start, "bin_width_opl": width}
        if self.integrator is not None:
            # An object is used instead of any other: the scene's own need not even load
            named = isinstance(self.integrator, str | Mapping)
            given["integrator"] = self.integrator if named else INTEGRATORS[0]
        return given


SETTINGS: dict[str, Setting] = {
    each.name: each.metadata["setting"] for each in fields(RenderSettings)
} | {
    "workers": _integer("Number of processes here that render", 1, MAX_WORKERS),
    "scheduler": Setting("Address of a Dask scheduler, whose workers render", checks.address),
    "progress": Setting("Show a bar for work that takes long", checks.boolean),
}
"""The table of settings: those of `RenderSettings`, and of how the work is done."""

SCENE_NAMES = {name: each.scene_name for name, each in SETTINGS.items() if each.scene_name}
"""Names in `load_scene` of settings that change the scene."""


def either(name: str, value: Any, old: Any) -> Any:
    """The value of a setting that may be given by its old name, as in `load_scene`, instead."""
    setting = SETTINGS[name]
    if old is None:
        return value
    if value is not None:
        raise ValueError(
            f"{setting.scene_name} = {old}: must be left out with `{name}`, its new name"
        )
    if setting.check:
        setting.check(setting.scene_name, old)
    return old
