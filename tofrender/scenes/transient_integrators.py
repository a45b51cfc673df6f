"""Replace the integrator of a parsed scene by a transient integrator."""

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
"""Integrators that add AOVs or statistics to the picture of a nested integrator."""

INHERITED = ("max_depth", "rr_depth", "hide_emitters")
"""Parameters that the replacement of an integrator inherits."""

DEPTHS = {"path": -1, "volpath": -1, "volpathmis": -1, "ptracer": -1, "prbvolpath": 6}
"""Default `max_depth` of Mitsuba's integrators; -1 is unlimited."""

REPLACEMENTS = {
    "path": "transient_path",
    "volpath": "transient_volpath",
    "volpathmis": "transient_volpath",
    "prbvolpath": "transient_volpath",
}
"""Transient integrators that replace Mitsuba's integrators when the film becomes transient."""

ONE_BOUNCE = ("ao", "simple")  # Integrators without `max_depth`
UNLIMITED = 0xFFFFFFFF  # Mitsuba's integrators print a `max_depth` of -1 as this number


def transient_integrator_for(integrator: Any) -> str:
    """Return the name of the transient integrator for the paths of a Mitsuba integrator.

    The integrator may be nested in a wrapper.

    Raises:
        ValueError: If the paths of the integrator are unknown.
    """
    printed = str(integrator)
    if "max_depth" not in printed or not type(integrator).__module__.startswith("mitsuba"):
        raise ValueError(_unknown(integrator))
    return "transient_volpath" if re.search("Vol(umetric|path)", printed) else "transient_path"


def path_tracer_of(integrator: Any) -> dict[str, Any]:
    """Return a transient integrator that follows the same paths as a Mitsuba integrator.

    Mitsuba's integrators expose their depths only in the printed form, which is parsed.

    Returns:
        A dict for `mi.load_dict` with type, depths and `hide_emitters`.

    Raises:
        ValueError: If the depths of the integrator are unknown.
    """
    printed = re.match(r"\w+\[\s*max_depth = (\d+)(?:,\s*rr_depth = (\d+))?", str(integrator))
    if printed is None:
        raise ValueError(_unknown(integrator))
    depth = int(printed[1])
    roulette = printed[2] or getattr(integrator, "rr_depth", 5)
    return {
        "type": plugins.qualified_name(transient_integrator_for(integrator)),
        "max_depth": -1 if depth == UNLIMITED else depth,
        "rr_depth": int(roulette),
        "hide_emitters": getattr(integrator, "hide_emitters", False),
    }


def _unknown(integrator: Any) -> str:
    """Return the message for an integrator with unknown paths."""
    is_python = type(integrator).__module__ != "mitsuba"
    kind = type(integrator).__name__ if is_python else integrator.class_name()
    return (
        f"integrator = {kind}: not supported, because its paths are unknown. Use transient_path or "
        "another transient integrator, or a path tracer of Mitsuba"
    )


def change_integrator(
    nodes: Any, index: int, settings: Mapping[str, Any], now_transient: bool
) -> None:
    """Apply settings to a scene's integrator, or replace the integrator.

    Args:
        nodes: Nodes of the parsed scene.
        index: Index of the integrator.
        settings: Checked settings of `SceneSettings`, by name.
        now_transient: Whether the settings replaced a steady film by a transient film.

    Raises:
        ValueError: If the integrator cannot be replaced.
    """
    wrapper = nodes[index].props.plugin_name()
    inner = _innermost(nodes, index)
    name = nodes[inner].props.plugin_name()
    props = nodes[inner].props

    # Replace `max_bounces` by `max_depth`, which all integrators support
    if "max_bounces" in props:
        props["max_depth"] = checks.depth_of_bounces(props["max_bounces"])
        del props["max_bounces"]

    # Choose the new integrator
    wanted = settings.get("integrator")
    in_time = now_transient or "pulse_width_opl" in settings
    if wanted is None and in_time and name not in TRANSIENT_INTEGRATORS:
        if name not in REPLACEMENTS:
            raise ValueError(
                f"integrator = {name!r}: does not support a transient film or a pulse. "
                f"Use one of {', '.join(INTEGRATORS)}"
            )
        wanted = REPLACEMENTS[name]

    # Replace the integrator, or remove the wrapper around it
    if isinstance(wanted, Mapping) or (wanted is not None and wanted != name):
        nodes[index].props = _replacement(wanted, nodes[inner].props)
    elif (wanted is not None or now_transient) and inner != index:
        nodes[index].props = mi.Properties(nodes[inner].props)

    # Apply the other settings
    inner = _innermost(nodes, index)
    for setting in ("max_depth", "pulse_width_opl"):
        if setting in settings:
            nodes[inner].props[setting] = settings[setting]

    now = nodes[index].props.plugin_name()
    if wrapper in WRAPPERS and now != wrapper:
        warnings.warn(
            f"integrator = {wrapper!r}: replaced by {now!r}, which does not compute its "
            f"{WRAPPERS[wrapper]}",
            stacklevel=5,
        )


def _innermost(nodes: Any, index: int) -> int:
    """Return the index of the integrator that samples paths, inside of all wrappers."""
    while nodes[index].props.plugin_name() in WRAPPERS:
        nested = children(nodes, index, mi.ObjectType.Integrator)
        if len(nested) != 1:
            break
        index = nested[0]
    return index


def _replacement(wanted: str | Mapping[str, Any], old: mi.Properties) -> mi.Properties:
    """Return the properties of a new integrator, which inherits depths of the old integrator.

    Args:
        wanted: A plugin's name, or a dict as for `mi.load_dict`. Its parameters have priority.
        old: Properties of the integrator that is replaced.
    """
    values: dict[str, Any] = {"type": wanted} if isinstance(wanted, str) else dict(wanted)
    plugin = values.pop("type")
    new = mi.Properties(plugin)
    new.set_id(old.id())

    # Inherit depths and `hide_emitters`
    if plugin in TRANSIENT_INTEGRATORS:
        inherited = {"max_depth": DEPTHS[old.plugin_name()]} if old.plugin_name() in DEPTHS else {}
        inherited |= {name: old[name] for name in INHERITED if name in old}
        if plugin in ONE_BOUNCE:
            inherited.pop("max_depth", None)
        values = inherited | values

    # Store the parameters, and instantiate nested plugins
    for name, value in values.items():
        if isinstance(value, Mapping):
            value = mi.load_dict({**value, "type": plugins.qualified_name(value.get("type", ""))})
        try:
            new[name] = value.item() if hasattr(value, "item") else value
        except TypeError:
            raise ValueError(
                f"integrator: {name} = {value!r}: plugins do not support a {type(value).__name__}. "
                "Pass a number, a text, a dict or a Mitsuba object"
            ) from None
    return new
