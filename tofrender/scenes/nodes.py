"""Kinds and references of the nodes of a scene that Mitsuba's parser has read."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mitsuba as mi

from ..runtime.settings import INTEGRATORS

TRANSIENT_INTEGRATORS = (*INTEGRATORS, "simple", "confocal_transient_path", "transient_nlos_path")
"""Names of the transient integrators of this package."""

UNKNOWN = mi.ObjectType.Unknown

NAMELESS = "_arg_"
"""Prefix of the names that Mitsuba's parser gives to unnamed parts of an XML file."""

# Python plugins in a dict have no kind before they are instantiated. Their kind is recognized by
# the ending of the plugin's name.
ENDINGS = {
    mi.ObjectType.Film: ("film",),
    mi.ObjectType.Sampler: ("sampler", "sobol"),
    mi.ObjectType.Integrator: (
        "path",
        "integrator",
        "prb",
        "prb_basic",
        "_projective",
        "_rf_basic",
        *TRANSIENT_INTEGRATORS,
    ),
    mi.ObjectType.Sensor: ("camera", "meter"),
}


def is_kind(node: Any, kind: mi.ObjectType) -> bool:
    """Return whether a node is of a kind; a Python plugin in a dict is recognized by its name."""
    if node.type != UNKNOWN:
        return node.type == kind
    return node.props.plugin_name().endswith(ENDINGS.get(kind, ()))


def parts(props: mi.Properties) -> list[tuple[str, Any]]:
    """Return the references and loaded objects among the properties, with their names.

    Other properties are not read, because reading a property marks it as used.
    """
    kinds = (mi.Properties.Type.ResolvedReference, mi.Properties.Type.Object)
    return [(name, props[name]) for name in props if props.type(name) in kinds]


def references(props: mi.Properties) -> list[tuple[str, int]]:
    """Return names and node indices of the parts that are nodes."""
    kind = mi.Properties.ResolvedReference
    return [(name, value.index()) for name, value in parts(props) if isinstance(value, kind)]


def children(nodes: Any, parent: int, kind: mi.ObjectType) -> list[int]:
    """Return the indices of the nodes of a kind that a node refers to."""
    return [index for _, index in references(nodes[parent].props) if is_kind(nodes[index], kind)]


def replace_plugin(node: Any, plugin: str, kept: Iterable[str]) -> None:
    """Replace a node's plugin, and keep the id, the children and the properties named in `kept`."""
    old = node.props
    new = mi.Properties(plugin)
    new.set_id(old.id())
    for name, value in old.items():
        if name in kept or isinstance(value, mi.Properties.ResolvedReference):
            new[name] = value
    node.props = new
