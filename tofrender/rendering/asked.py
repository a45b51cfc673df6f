"""What is asked of a render, once: `render`, the command and workers fill the same record."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import mitsuba as mi

from ..runtime import checks
from ..scenes.settings import INTEGRATORS, check_settings

ARGUMENTS = ("source", "integrator", "sampler")
"""What `load_scene` takes and a render is asked in another way."""

SETTINGS = {
    "bins": "temporal_bins",
    "start_opl": "start_opl",
    "bin_width": "bin_width_opl",
    "pulse_width": "pulse_width_opl",
    "max_depth": "max_depth",
    "define": "parameters",
}
"""Words that `load_scene` has under another name, or the same."""

SCENES_OWN = ("size", "pulse_width", "max_depth", "define", "settings")
"""Words that change a scene while it loads; the others suit one that is loaded, too."""


@dataclass(frozen=True, eq=False)
class Asked:
    """What is asked of a render; None leaves the scene's own.

    Attributes:
        scene: A built-in name, the path of a Mitsuba XML file, a dict, or a loaded scene.
        spp: Samples per pixel.
        seed: Seed of all random numbers.
        size: Width and height [pixels].
        bins: Number of time bins.
        start_opl: Where they start [m].
        bin_width: Width of each [m].
        window: (start, stop) of all [m], or "auto".
        pulse_width: Standard deviation of a Gaussian pulse [m], or "auto".
        max_depth: Longest path, in segments; -1 for any.
        integrator: A plugin's name, a dict or an integrator.
        sampler: A sampler's name, or a sampler.
        sensor: Number of the sensor.
        define: Values of an XML file's parameters, by name.
        settings: More of what `load_scene` can change, by its names.
        errors: Whether error bars are wanted.

    Raises:
        ValueError: A value is wrong, or two contradict each other; one line.

    Example:
        >>> Asked("cornell_box", size=(64, 48), bins=100).changes
        {'width': 64, 'height': 48, 'temporal_bins': 100}
    """

    scene: Any
    spp: int | None = None
    seed: int = 0
    size: tuple[int, int] | None = None
    bins: int | None = None
    start_opl: float | None = None
    bin_width: float | None = None
    window: Any = None
    pulse_width: float | str | None = None
    max_depth: int | None = None
    integrator: Any = None
    sampler: Any = None
    sensor: int = 0
    define: Mapping[str, Any] | None = None
    settings: Mapping[str, Any] | None = None
    errors: bool = False

    def __post_init__(self) -> None:
        for name, check in _CHECKS.items():
            value = getattr(self, name)
            if value is not None:
                check(name, value)
        checks.integer("seed", self.seed, 0, checks.MAX_SEED)
        checks.boolean("errors", self.errors)
        if self.window is not None:
            for name in ("start_opl", "bin_width"):
                value = getattr(self, name)
                if value is not None:
                    raise ValueError(f"{name} = {value:g}: must be left out with `window`")
            if not is_auto(self.window):
                start_and_width(self.window, 1)
        self._check_settings()

    def _check_settings(self) -> None:
        """Refuse settings that are wrong, or asked for by another word too."""
        settings = checks.mapping("settings", self.settings)
        for name in ARGUMENTS:
            if name in settings:
                raise ValueError(f"settings with {name!r}: must be others, this is an argument")
        if isinstance(self.scene, mi.Scene):
            for name in SCENES_OWN:
                value = getattr(self, name)
                if value is not None and not (isinstance(value, Mapping) and not value):
                    shown = name if name == "settings" else f"{name} = {checks.quote(value)}"
                    raise ValueError(
                        f"{shown}: must be left out with a loaded scene, which cannot be changed"
                    )
        for name, its in SETTINGS.items():
            if its in settings and getattr(self, name) is not None:
                raise ValueError(f"{name}: must be left out, settings has {its}")
        known = {"optimize", "parameters"}
        check_settings({name: its for name, its in settings.items() if name not in known})

    def in_own_words(self, message: str) -> str:
        """A message of `load_scene`, with the words that were asked with."""
        words = {its: name for name, its in SETTINGS.items() if name not in (self.settings or {})}
        given = {its for its, name in words.items() if getattr(self, name) is not None}
        start = re.compile(r"\A(\w+)(?= = )")
        message = start.sub(lambda m: words[m[1]] if m[1] in given else m[1], message)
        return re.sub(r"`(\w+)`", lambda m: f"`{words.get(m[1], m[1])}`", message)

    # ------------------------------------------------------------------------------- what it means

    @property
    def words(self) -> dict[str, Any]:
        """All of it by name, nothing copied."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def name(self) -> str:
        """What a Dataset calls the scene: its name or path, else "scene"."""
        is_name = isinstance(self.scene, str | os.PathLike)
        return os.fspath(self.scene) if is_name else "scene"

    @property
    def timing(self) -> tuple[Any, int | None, float | None, float | None]:
        """What is asked of the time axis, for `windowed_film`."""
        return self.window, self.bins, self.start_opl, self.bin_width

    @property
    def changes(self) -> dict[str, Any]:
        """What `load_scene` is to change, by its names.

        With a window and a number of bins, a steady scene turns transient.
        """
        given: dict[str, Any] = dict(self.settings or {})
        if self.size is not None:
            given |= dict(zip(("width", "height"), self.size, strict=True))
        values = {its: getattr(self, name) for name, its in SETTINGS.items()}
        if is_auto(self.pulse_width):  # Once the light was looked at
            values["pulse_width_opl"] = None
        given |= {its: value for its, value in values.items() if value is not None}
        if self.window is not None and self.bins is not None:
            # One that is to be found takes the place of this one
            start, width = (
                (0.0, 1.0) if is_auto(self.window) else start_and_width(self.window, self.bins)
            )
            given |= {"start_opl": start, "bin_width_opl": width}
        if self.integrator is not None:
            # For an object any other keeps the place: the scene's own need not even load
            named = isinstance(self.integrator, str | Mapping)
            given["integrator"] = self.integrator if named else INTEGRATORS[0]
        return given


def either(name: str, value: Any, old: Any) -> Any:
    """A word's value, which may have been given by the word's old name.

    Raises:
        ValueError: Both are given; one line.
    """
    if old is not None and value is not None:
        raise ValueError(f"{SETTINGS[name]} = {old}: must be left out with `{name}`, its new name")
    if old is not None:
        _CHECKS[name](SETTINGS[name], old)
    return old if value is None else value


# ---------------------------------------------------------------------------------- the window


def start_and_width(window: Any, bins: int) -> tuple[float, float]:
    """Start and bin width of a window given as (start, stop)."""
    try:
        start, stop = window
    except (TypeError, ValueError):
        raise ValueError(
            f"window = {checks.quote(window)}: must be 'auto' or (start, stop) in metres"
        ) from None
    start, stop = checks.metres("window[0]", start), checks.metres("window[1]", stop)
    if not start < stop < start + checks.MAX_OPL:
        raise ValueError(
            f"window = {checks.quote(window)}: must end after it starts, and not at infinity"
        )
    return start, (stop - start) / bins


def is_auto(value: Any) -> bool:
    """Whether a window or a pulse's width is to be found."""
    return isinstance(value, str) and value == "auto"


def _size(name: str, value: Any) -> None:
    """Refuse what is no width and height."""
    if not isinstance(value, tuple | list) or len(value) != 2:
        given = checks.quote(value)
        raise ValueError(f"{name} = {given}: must be (width, height) in pixels")
    for side in value:
        checks.integer(name, side, 1, checks.MAX_SIZE)


_CHECKS = {
    "spp": lambda name, value: checks.integer(name, value, 1, checks.MAX_SPP),
    "size": _size,
    "bins": lambda name, value: checks.integer(name, value, 1, checks.MAX_BINS),
    "start_opl": checks.metres,
    "bin_width": lambda name, value: checks.metres(name, value, positive=True),
    "pulse_width": lambda name, value: is_auto(value) or checks.width(name, value),
    "max_depth": checks.depth,
    "define": checks.mapping,
}
