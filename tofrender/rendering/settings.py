"""Settings of a render: one record that defines signature, checks, command-line options and tests.

The module does not import NumPy or Mitsuba before a render begins, so `tofrender --help` is fast.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any

from ..runtime import checks
from ..runtime.settings import (
    INTEGRATORS,
    SCENE_SETTINGS,
    Setting,
    check_settings,
    integer,
    unchecked,
)

if TYPE_CHECKING:
    import mitsuba as mi
    import xarray as xr
    from distributed import Client

    from ..labels import FILM
    from ..runtime.checkpoints import Checkpoint

    Integrator = str | Mapping[str, object] | mi.Integrator | None

# Key of the description in the metadata of a field
ABOUT = "setting"

# Largest index of a sensor
MAX_SENSOR = 1 << 16

# Largest number of worker processes
MAX_WORKERS = 1024

# Settings that change a scene while it is loaded. A loaded scene does not support them
FIXED_WHEN_LOADED = ("size", "pulse_width", "max_depth", "define", "settings")

# Names of settings, and the names of the arguments of `load_scene`
SCENE_NAMES = {
    "bins": "temporal_bins",
    "start_opl": "start_opl",
    "bin_width": "bin_width_opl",
    "pulse_width": "pulse_width_opl",
    "max_depth": "max_depth",
    "define": "parameters",
}

# Settings that correspond to two arguments of `load_scene` each
PAIRS = ("size", "width"), ("size", "height"), ("window", "start_opl"), ("window", "bin_width_opl")


def start_and_width(window: object, bins: int, name: str = "window") -> tuple[float, float]:
    """Return the start and the bin width of a window (start, stop) [m]."""
    start, stop = checks.interval(name, window, "'auto' or (start, stop) in meters")
    return start, (stop - start) / bins


def is_auto(value: object) -> bool:
    """Return whether a window or a pulse width is "auto"."""
    return isinstance(value, str) and value == "auto"


def _check_window(name: str, value: object) -> None:
    """Raise a ValueError if a window is neither "auto" nor (start, stop)."""
    if not is_auto(value):
        start_and_width(value, 1, name)


def _check_pulse_width(name: str, value: object) -> None:
    """Raise a ValueError if a pulse width is neither "auto" nor a width [m]."""
    if not is_auto(value):
        checks.width(name, value)


def _check_size(name: str, value: object) -> None:
    """Raise a ValueError if a size is not (width, height) in pixels."""
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ValueError(f"{name} = {checks.quote(value)}: must be (width, height) in pixels")
    for side in value:
        checks.integer(name, side, 1, checks.MAX_SIZE)


def described(setting: Setting, **changes: Any) -> dict[str, Setting]:
    """Return the metadata of a field that a setting describes, with changes of the setting."""
    return {ABOUT: replace(setting, **changes)}


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderSettings:
    """Checked settings of a render.

    A `Setting` in the metadata of each field describes it. For a setting that is None, the value of
    the scene is used. `settings` contains further arguments of `load_scene`.

    Example:
        >>> RenderSettings("cornell_box", size=(64, 48), bins=100).scene_changes
        {'width': 64, 'height': 48, 'temporal_bins': 100}
    """

    scene: mi.Scene | Mapping[str, object] | str | PathLike[str] = field(
        kw_only=False, metadata=described(Setting("Built-in name or path of a Mitsuba XML file"))
    )
    spp: int | None = field(default=None, metadata=described(SCENE_SETTINGS["spp"]))
    seed: int = field(
        default=0, metadata=described(integer("Seed of all random numbers", 0, checks.MAX_SEED))
    )
    size: tuple[int, int] | None = field(
        default=None,
        metadata=described(
            Setting("Width and height of the picture [pixels]", _check_size, 1, checks.MAX_SIZE)
        ),
    )
    bins: int | None = field(default=None, metadata=described(SCENE_SETTINGS["temporal_bins"]))
    start_opl: float | None = field(default=None, metadata=described(SCENE_SETTINGS["start_opl"]))
    bin_width: float | None = field(
        default=None, metadata=described(SCENE_SETTINGS["bin_width_opl"])
    )
    window: str | tuple[float, float] | None = field(
        default=None,
        metadata=described(
            Setting("Start of the first and stop of the last time bin [m]", _check_window)
        ),
    )
    pulse_width: float | str | None = field(
        default=None,
        metadata=described(SCENE_SETTINGS["pulse_width_opl"], check=_check_pulse_width),
    )
    max_depth: int | None = field(default=None, metadata=described(SCENE_SETTINGS["max_depth"]))
    integrator: Integrator = field(
        default=None, metadata=described(SCENE_SETTINGS["integrator"], check=unchecked)
    )
    sampler: str | mi.Sampler | None = field(
        default=None, metadata=described(SCENE_SETTINGS["sampler"], check=unchecked)
    )
    sensor: int = field(
        default=0, metadata=described(integer("Index of the sensor", 0, MAX_SENSOR))
    )
    define: Mapping[str, object] | None = field(
        default=None,
        metadata=described(Setting("Values of an XML file's parameters", checks.mapping)),
    )
    settings: Mapping[str, object] | None = field(
        default=None,
        metadata=described(Setting("More changes of the scene while it is loaded", checks.mapping)),
    )
    errors: bool = field(
        default=False,
        metadata=described(Setting("Estimate the standard error of each bin", checks.boolean)),
    )
    denoise: bool = field(
        default=False, metadata=described(Setting("Remove noise from the film", checks.boolean))
    )

    def __post_init__(self) -> None:
        # Check each value. None is valid if it is the default
        for each in fields(RenderSettings):
            value = getattr(self, each.name)
            if value is not None or each.default is not None:
                SETTINGS[each.name].check(each.name, value)

        # Check combinations of settings
        if self.window is not None:
            for name in ("start_opl", "bin_width"):
                value = getattr(self, name)
                if value is not None:
                    raise ValueError(f"{name} = {value:g}: must be left out with `window`")
        if self.errors and self.denoise:
            raise ValueError(
                "denoise = True: must be False with errors, which are unknown after denoising"
            )
        self._check_scene_changes()

    def _check_scene_changes(self) -> None:
        """Check the changes of the scene.

        Raises:
            ValueError: A change is wrong, given twice, or not supported for a loaded scene.
        """
        import mitsuba as mi

        # Does `settings` contain arguments of `render`?
        settings = dict(self.settings or {})
        for name in ("source", "integrator", "sampler"):
            if name in settings:
                raise ValueError(f"settings with {name!r}: must be others, this is an argument")

        # A loaded scene cannot be changed
        if isinstance(self.scene, mi.Scene):
            for name in FIXED_WHEN_LOADED:
                value = getattr(self, name)
                if value is not None and not (isinstance(value, Mapping) and not value):
                    shown = name if name == "settings" else f"{name} = {checks.quote(value)}"
                    raise ValueError(
                        f"{shown}: must be left out with a loaded scene, which cannot be changed"
                    )

        # An integrator object has a pulse and a depth already
        if not isinstance(self.integrator, str | Mapping | None):
            for name in ("pulse_width", "max_depth"):
                value = getattr(self, name)
                if value is not None:
                    raise ValueError(
                        f"{name} = {checks.quote(value)}: must be left out with a loaded "
                        "integrator, which has its own"
                    )

        # Is a change given twice?
        for name, scene_name in (*SCENE_NAMES.items(), *PAIRS):
            if scene_name in settings and getattr(self, name) is not None:
                raise ValueError(f"{name}: must be left out, settings has {scene_name}")

        # Check the remaining changes. `load_scene` checks the two that are excluded here
        own = {"optimize", "parameters"}
        check_settings({name: value for name, value in settings.items() if name not in own})

    def translate(self, message: str) -> str:
        """Replace the names of arguments in a message of `load_scene` by the names of settings."""
        # A name in `settings` is already the name that the user wrote
        names = {
            own: name for name, own in SCENE_NAMES.items() if name not in (self.settings or {})
        }
        given = {own for own, name in names.items() if getattr(self, name) is not None}

        # Replace the name at the start of the message, and names in backticks
        start = re.compile(r"\A(\w+)(?= = )")
        message = start.sub(lambda m: names[m[1]] if m[1] in given else m[1], message)
        return re.sub(r"`(\w+)`", lambda m: f"`{names.get(m[1], m[1])}`", message)

    @property
    def values(self) -> dict[str, Any]:
        """All settings by name, without copies of the values."""
        return {each.name: getattr(self, each.name) for each in fields(RenderSettings)}

    @property
    def scene_label(self) -> str:
        """Name or path of the scene; "scene" for other scenes."""
        return os.fspath(self.scene) if isinstance(self.scene, str | os.PathLike) else "scene"

    @property
    def time_axis(self) -> tuple[Any, int | None, float | None, float | None]:
        """Window, number of bins, start and bin width, as arguments of `windowed_film`."""
        return self.window, self.bins, self.start_opl, self.bin_width

    @property
    def scene_changes(self) -> dict[str, Any]:
        """Arguments of `load_scene`. With a window and bins, a steady scene becomes transient."""
        # Add the size and the settings with other names
        given: dict[str, Any] = dict(self.settings or {})
        if self.size is not None:
            given |= dict(zip(("width", "height"), self.size, strict=True))
        values = {own: getattr(self, name) for name, own in SCENE_NAMES.items()}
        if is_auto(self.pulse_width):
            # The pulse is set after the test render
            values["pulse_width_opl"] = None
        given |= {own: value for own, value in values.items() if value is not None}

        # Add the window. A preliminary window is used until an automatic window is found
        if self.window is not None and self.bins is not None:
            start, width = (
                (0.0, 1.0) if is_auto(self.window) else start_and_width(self.window, self.bins)
            )
            given |= {"start_opl": start, "bin_width_opl": width}

        # Add the integrator. An object replaces the integrator later, so any plugin can be loaded
        if self.integrator is not None:
            named = isinstance(self.integrator, str | Mapping)
            given["integrator"] = self.integrator if named else INTEGRATORS[0]
        return given


@dataclass(frozen=True, kw_only=True, eq=False)
class Execution:
    """How a render is executed: earlier results, files, processes and progress bars.

    These arguments do not change the picture. They are not settings, because workers and
    checkpoints must not depend on them.
    """

    resume: Annotated[xr.Dataset, FILM] | None = None
    checkpoint: Checkpoint | str | PathLike[str] | None = None
    out: str | PathLike[str] | None = None
    workers: int | None = field(
        default=None,
        metadata=described(integer("Number of local worker processes", 1, MAX_WORKERS)),
    )
    scheduler: str | None = field(
        default=None,
        metadata=described(
            Setting("Address of a Dask scheduler. Its workers render", checks.address)
        ),
    )
    client: Client | None = None
    progress: bool = field(
        default=True,
        metadata=described(Setting("Show progress bars of long work", checks.boolean)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderArguments(Execution, RenderSettings):
    """All parameters of `render`: the settings, and how the render is executed."""


def described_fields(record: type) -> dict[str, Setting]:
    """Return the settings that describe the fields of a dataclass. Other fields are omitted."""
    return {each.name: each.metadata[ABOUT] for each in fields(record) if ABOUT in each.metadata}


# All settings: fields of `RenderSettings`, and settings of how the work is done
SETTINGS = described_fields(RenderArguments)
