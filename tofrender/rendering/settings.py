"""Settings of a render: one table, from which checks, command-line options and tests follow.

Nothing here imports NumPy or Mitsuba before a render begins: `tofrender --help` answers at once.
"""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

from ..runtime import checks
from ..runtime.settings import (
    INTEGRATORS,
    SCENE_SETTINGS,
    Setting,
    check_settings,
    integer,
    settings_of,
    unchecked,
)

MAX_SENSOR = 1 << 16
MAX_WORKERS = 1024

FIXED_WHEN_LOADED = ("size", "pulse_width", "max_depth", "define", "settings")
"""Settings that change a scene while it loads; the others suit one that is loaded, too."""

SCENE_NAMES = {
    "bins": "temporal_bins",
    "start_opl": "start_opl",
    "bin_width": "bin_width_opl",
    "pulse_width": "pulse_width_opl",
    "max_depth": "max_depth",
    "define": "parameters",
}
"""Names in `load_scene` of settings that change the scene."""

PAIRS = ("size", "width"), ("size", "height"), ("window", "start_opl"), ("window", "bin_width_opl")
"""Settings that are two in `load_scene`."""


def start_and_width(window: object, bins: int, name: str = "window") -> tuple[float, float]:
    """Start and bin width of a window given as (start, stop)."""
    start, stop = checks.interval(name, window, "'auto' or (start, stop) in metres")
    return start, (stop - start) / bins


def is_auto(value: object) -> bool:
    """Whether a window or a pulse's width is to be found."""
    return isinstance(value, str) and value == "auto"


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

    scene: Annotated[Any, Setting("Built-in name or path of a Mitsuba XML file")]
    spp: Annotated[int | None, SCENE_SETTINGS["spp"]] = None
    seed: Annotated[int, integer("Seed of all random numbers", 0, checks.MAX_SEED)] = 0
    size: Annotated[
        tuple[int, int] | None,
        Setting("Width and height of the picture [pixels]", _check_size, 1, checks.MAX_SIZE),
    ] = None
    bins: Annotated[int | None, SCENE_SETTINGS["temporal_bins"]] = None
    start_opl: Annotated[float | None, SCENE_SETTINGS["start_opl"]] = None
    bin_width: Annotated[float | None, SCENE_SETTINGS["bin_width_opl"]] = None
    window: Annotated[
        tuple[float, float] | str | None,
        Setting("Start of the first and stop of the last time bin [m]", _check_window),
    ] = None
    pulse_width: Annotated[
        float | str | None, replace(SCENE_SETTINGS["pulse_width_opl"], check=_check_pulse_width)
    ] = None
    max_depth: Annotated[int | None, SCENE_SETTINGS["max_depth"]] = None
    integrator: Annotated[Any, replace(SCENE_SETTINGS["integrator"], check=unchecked)] = None
    sampler: Annotated[Any, replace(SCENE_SETTINGS["sampler"], check=unchecked)] = None
    sensor: Annotated[int, integer("Index of the sensor", 0, MAX_SENSOR)] = 0
    define: Annotated[
        Mapping[str, Any] | None, Setting("Values of an XML file's parameters", checks.mapping)
    ] = None
    settings: Annotated[
        Mapping[str, Any] | None,
        Setting("More changes of the scene while it is loaded", checks.mapping),
    ] = None
    errors: Annotated[bool, Setting("Estimate the standard error of each bin", checks.boolean)] = (
        False
    )
    denoise: Annotated[bool, Setting("Remove noise from the film", checks.boolean)] = False

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if value is not None or each.default is not None:
                SETTINGS[each.name].check(each.name, value)
        if self.window is not None:
            for name in ("start_opl", "bin_width"):
                value = getattr(self, name)
                if value is not None:
                    raise ValueError(f"{name} = {value:g}: must be left out with `window`")
        if self.errors and self.denoise:
            raise ValueError("denoise = True: must be False with errors, which stay unknown")
        self._check_scene_changes()

    def _check_scene_changes(self) -> None:
        """Refuse changes that are wrong, given twice, or impossible as the scene is loaded."""
        import mitsuba as mi

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
        if not isinstance(self.integrator, str | Mapping | None):
            for name in ("pulse_width", "max_depth"):
                value = getattr(self, name)
                if value is not None:
                    raise ValueError(
                        f"{name} = {checks.quote(value)}: must be left out with an integrator that "
                        "is made, which has its own"
                    )
        for name, scene_name in (*SCENE_NAMES.items(), *PAIRS):
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


SETTINGS = settings_of(RenderSettings) | {
    "workers": integer("Number of local worker processes", 1, MAX_WORKERS),
    "scheduler": Setting("Address of a Dask scheduler. Its workers render", checks.address),
    "progress": Setting("Show progress bars of long work", checks.boolean),
}
"""The table of settings: those of `RenderSettings`, and of how the work is done."""
