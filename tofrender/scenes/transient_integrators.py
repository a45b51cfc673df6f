"""Replace the integrator of a parsed scene by a transient one."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Any

import mitsuba as mi

from ..runtime import checks, plugins
from ..runtime.settings import INTEGRATORS
from .nodes import TRANSIENT_INTEGRATORS, children

WRAPPERS = {"aov": "AOVs", "moment": "moments", "stokes": "Stokes vectors"}
"""Integrators that add AOVs or statistics to the picture of another, nested one."""

INHERITED = ("max_depth", "rr_depth", "hide_emitters")
"""Parameters that the replacement of an integrator inherits."""

DEPTHS = {**dict.fromkeys(("path", "volpath", "volpathmis", "ptracer"), -1), "prbvolpath": 6}
"""Longest paths of Mitsuba's integrators where a scene gives none; -1 is unlimited."""

REPLACEMENTS = {
    "path": "transient_path",
    **dict.fromkeys(("volpath", "volpathmis", "prbvolpath"), "transient_volpath"),
}
"""Transient integrators that replace those of Mitsuba when the film becomes transient."""

ONE_BOUNCE = ("ao", "simple")  # Integrators that take no `max_depth`
UNLIMITED = 0xFFFFFFFF  # A `max_depth` of -1 as Mitsuba's integrators print it


def transient_integrator_for(integrator: Any) -> str:
    """Name of the transient integrator for the paths of one of Mitsuba's, wrapped or not."""
    printed = str(integrator)
    if "max_depth" not in printed or not type(integrator).__module__.startswith("mitsuba"):
        raise ValueError(_unknown(integrator))
    return "transient_volpath" if re.search("Vol(umetric|path)", printed) else "transient_path"


def path_tracer_of(integrator: Any) -> dict[str, Any]:
    """Dict of a transient integrator for the paths of one of Mitsuba's, with the same depths."""
    printed = re.match(r"\w+\[\s*max_depth = (\d+)(?:,\s*rr_depth = (\d+))?", str(integrator))
    if printed is None:
        raise ValueError(_unknown(integrator))
    depth, roulette = int(printed[1]), printed[2] or getattr(integrator, "rr_depth", 5)
    return {
        "type": plugins.qualified_name(transient_integrator_for(integrator)),
        "max_depth": -1 if depth == UNLIMITED else depth,
        "rr_depth": int(roulette),
        "hide_emitters": getattr(integrator, "hide_emitters", False),
    }


def _unknown(integrator: Any) -> str:
    is_python = type(integrator).__module__ != "mitsuba"
    kind = type(integrator).__name__ if is_python else integrator.class_name()
    return (
        f"integrator = {kind}: does not tell which paths it follows; must be one like "
        "transient_path, or a path tracer of Mitsuba's"
    )


def change_integrator(
    nodes: Any, index: int, settings: Mapping[str, Any], now_transient: bool
) -> None:
    """Put settings into a scene's integrator, node `index`, or replace it by another.

    `now_transient` says that the film was steady before.
    """
    wrapper = nodes[index].props.plugin_name()
    inner = _innermost(nodes, index)
    name = nodes[inner].props.plugin_name()
    props = nodes[inner].props
    if "max_bounces" in props:  # Replaced by `max_depth`, which all integrators have
        props["max_depth"] = checks.depth_of_bounces(props["max_bounces"])
        del props["max_bounces"]
    wanted = settings.get("integrator")
    in_time = now_transient or "pulse_width_opl" in settings
    if wanted is None and in_time and name not in TRANSIENT_INTEGRATORS:
        if name not in REPLACEMENTS:
            raise ValueError(
                f"integrator = {name!r}: a transient film or a pulse needs another one; "
                f"must be one of {', '.join(INTEGRATORS)}"
            )
        wanted = REPLACEMENTS[name]
    if isinstance(wanted, Mapping) or (wanted is not None and wanted != name):
        nodes[index].props = _replacement(wanted, nodes[inner].props)
    elif (wanted is not None or now_transient) and inner != index:
        nodes[index].props = mi.Properties(nodes[inner].props)
    inner = _innermost(nodes, index)
    for setting in ("max_depth", "pulse_width_opl"):
        if setting in settings:
            nodes[inner].props[setting] = settings[setting]
    now = nodes[index].props.plugin_name()
    if wrapper in WRAPPERS and now != wrapper:
        warnings.warn(
            f"integrator = {wrapper!r}: becomes {now!r}, its {WRAPPERS[wrapper]} are left out",
            stacklevel=5,
        )


def _innermost(nodes: Any, index: int) -> int:
    """Index of the integrator that samples paths: the one nested in wrappers, else itself."""
    while nodes[index].props.plugin_name() in WRAPPERS:
        nested = children(nodes, index, mi.ObjectType.Integrator)
        if len(nested) != 1:
            break
        index = nested[0]
    return index


def _replacement(wanted: str | Mapping[str, Any], old: mi.Properties) -> mi.Properties:
    """Properties of the new integrator; depths that it does not name are as before."""
    given: dict[str, Any] = {"type": wanted} if isinstance(wanted, str) else dict(wanted)
    plugin = given.pop("type")
    new = mi.Properties(plugin)
    new.set_id(old.id())
    if plugin in TRANSIENT_INTEGRATORS:
        before = {"max_depth": DEPTHS[old.plugin_name()]} if old.plugin_name() in DEPTHS else {}
        before |= {name: old[name] for name in INHERITED if name in old}
        if plugin in ONE_BOUNCE:
            before.pop("max_depth", None)
        given = before | given
    for name, value in given.items():
        if isinstance(value, Mapping):
            value = mi.load_dict({**value, "type": plugins.qualified_name(value.get("type", ""))})
        try:
            new[name] = value.item() if hasattr(value, "item") else value
        except TypeError:
            raise ValueError(
                f"integrator: {name} = {value!r}: is of no kind that a plugin takes"
            ) from None
    return new
