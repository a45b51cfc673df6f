"""Settings of scenes. Checks, options of the command and tests use the descriptions here.

This module does not import NumPy or Mitsuba. Therefore `tofrender --help` answers at once, and the
command refuses bad values before Mitsuba starts.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, TypedDict, get_type_hints

from . import checks

SAMPLERS = ("padded_sobol", "independent", "stratified", "multijitter", "orthogonal", "ldsampler")
INTEGRATORS = (
    "transient_path",
    "transient_volpath",
    "path_tracer_mats",
    "path_tracer_nee",
    "path_tracer_mis",
    "transient_light_tracer",
    "transient_bdpt",
    "ao",
)
"""Integrators that have no required parameters."""


def unchecked(name: str, value: Any) -> Any:
    """Accept any value. The function that uses the setting checks the value."""
    return value


@dataclass(frozen=True)
class Setting:
    """Description of a setting. It annotates a field with the name, type and default.

    Attributes:
        help: Meaning and unit, for `--help` and the documentation of `render`.
        check: Called with the name and the value. It refuses bad values in one line.
        low: Smallest integer.
        high: Largest integer.
        choices: Allowed names. In Python, objects are allowed as well.
    """

    help: str
    check: Callable[[str, Any], Any] = unchecked
    low: int | None = None
    high: int | None = None
    choices: tuple[str, ...] = ()


def integer(help: str, low: int, high: int) -> Setting:
    """Describe a setting that is an integer from `low` to `high`."""
    return Setting(help, partial(checks.integer, low=low, high=high), low, high)


def settings_of(described: type) -> dict[str, Setting]:
    """Return the settings that annotate the fields of a dataclass or a `TypedDict`."""
    hints = get_type_hints(described, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items()}


def _check_length(name: str, value: Any) -> float:
    return checks.meters(name, value, positive=True)


def _check_integrator(name: str, value: Any) -> Any:
    if not isinstance(value, Mapping):
        return checks.one_of(name, value, INTEGRATORS)
    if not isinstance(value.get("type"), str):
        given = checks.quote(dict(value))
        raise ValueError(f"{name} = {given}: must have a plugin's name as its type")
    return value


class SceneSettings(TypedDict, total=False):
    """Settings that change a scene while it loads; None keeps the scene's own value."""

    width: Annotated[int | None, integer("Width of the picture [pixels]", 1, checks.MAX_SIZE)]
    height: Annotated[int | None, integer("Height of the picture [pixels]", 1, checks.MAX_SIZE)]
    temporal_bins: Annotated[int | None, integer("Number of time bins", 1, checks.MAX_BINS)]
    start_opl: Annotated[
        float | None, Setting("Start of the first time bin, optical path length [m]", checks.meters)
    ]
    bin_width_opl: Annotated[
        float | None, Setting("Width of a time bin, optical path length [m]", _check_length)
    ]
    spp: Annotated[int | None, integer("Samples per pixel", 1, checks.MAX_SPP)]
    sampler: Annotated[
        str | None,
        Setting(
            "Plugin of random numbers",
            partial(checks.one_of, allowed=SAMPLERS),
            choices=SAMPLERS,
        ),
    ]
    max_depth: Annotated[
        int | None,
        Setting("Longest path in segments, -1 for no limit", checks.depth, -1, checks.MAX_DEPTH),
    ]
    integrator: Annotated[
        str | Mapping[str, Any] | None,
        Setting("Integrator plugin", _check_integrator, choices=INTEGRATORS),
    ]
    pulse_width_opl: Annotated[
        float | None, Setting("Standard deviation of the Gaussian pulse [m]", checks.width)
    ]


SCENE_SETTINGS = settings_of(SceneSettings)
CHECKS = {name: each.check for name, each in SCENE_SETTINGS.items()}


def check_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Check the settings, and return the settings that are not None."""
    for name in settings:
        if name not in CHECKS:
            raise TypeError(f"{name}: unknown setting; must be one of {', '.join(CHECKS)}")
    given = {name: value for name, value in settings.items() if value is not None}
    return {name: CHECKS[name](name, value) for name, value in given.items()}


def parameter(props: Any, name: str, default: Any) -> Any:
    """Read a parameter of a plugin, and check it by the setting of the same name."""
    value = props.get(name, default)
    return None if value is None else CHECKS[name](name, value)
