"""Settings that change a scene while it loads, and the check of each.

Nothing here imports Mitsuba: the command line refuses bad values before Mitsuba starts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypedDict

from ..runtime import checks

SAMPLERS = ("padded_sobol", "independent", "stratified", "multijitter", "orthogonal", "ldsampler")
INTEGRATORS = (
    *("transient_path", "transient_volpath", "path_tracer_mats", "path_tracer_nee"),
    *("path_tracer_mis", "transient_light_tracer", "transient_bdpt", "ao"),
)
"""Integrators that a name is enough for."""

IN_TIME = (*INTEGRATORS, "simple", "confocal_transient_path", "transient_nlos_path")
"""Transient integrators."""


class Settings(TypedDict, total=False):
    """Settings that change a scene while it loads; None keeps the scene's own value."""

    width: int | None
    height: int | None
    temporal_bins: int | None
    start_opl: float | None
    bin_width_opl: float | None
    spp: int | None
    sampler: str | None
    max_depth: int | None
    integrator: str | Mapping[str, Any] | None
    pulse_width_opl: float | None


def _integrator(name: str, value: Any) -> Any:
    if not isinstance(value, Mapping):
        return checks.one_of(name, value, INTEGRATORS)
    if not isinstance(value.get("type"), str):
        given = checks.quote(dict(value))
        raise ValueError(f"{name} = {given}: must have a plugin's name as its type")
    return value


CHECKS: dict[str, Callable[[str, Any], Any]] = {
    "width": lambda name, value: checks.integer(name, value, 1, checks.MAX_SIZE),
    "height": lambda name, value: checks.integer(name, value, 1, checks.MAX_SIZE),
    "temporal_bins": lambda name, value: checks.integer(name, value, 1, checks.MAX_BINS),
    "start_opl": checks.metres,
    "bin_width_opl": lambda name, value: checks.metres(name, value, positive=True),
    "spp": lambda name, value: checks.integer(name, value, 1, checks.MAX_SPP),
    "sampler": lambda name, value: checks.one_of(name, value, SAMPLERS),
    "max_depth": checks.depth,
    "integrator": _integrator,
    "pulse_width_opl": checks.width,
}


def check_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that are given (not None), each one checked."""
    for name in settings:
        if name not in CHECKS:
            raise TypeError(f"{name}: no such setting; there are {', '.join(CHECKS)}")
    given = {name: value for name, value in settings.items() if value is not None}
    return {name: CHECKS[name](name, value) for name, value in given.items()}
