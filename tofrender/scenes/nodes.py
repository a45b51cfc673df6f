"""Nodes of a scene that Mitsuba's parser has read: their kinds and references."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mitsuba as mi

from ..runtime.settings import INTEGRATORS

TRANSIENT_INTEGRATORS = (*INTEGRATORS, "simple", "confocal_transient_path", "transient_nlos_path")
"""Transient integrators."""

UNKNOWN = mi.ObjectType.Unknown

NAMELESS = "_arg_"
"""Prefix of the names that Mitsuba's parser gives to unnamed parts of an XML file."""

# Python plugins in a dict have no type before they are built; their names end like this.
ENDINGS = {
    mi.ObjectType.Film: ("film",),
    mi.ObjectType.Sampler: ("sampler", "sobol"),
    mi.ObjectType.Integrator: (
        *("path", "integrator", "prb", "prb_basic", "_projective", "_rf_basic"),
        *TRANSIENT_INTEGRATORS,
    ),
    mi.ObjectType.Sensor: ("camera", "meter"),
}


def is_kind(node: Any, kind: mi.ObjectType) -> bool:
    """Whether a node is of this kind; for a Python plugin in a dict only its name can tell."""
    if node.type != UNKNOWN:
        return node.type == kind
    return node.props.plugin_name().endswith(ENDINGS.get(kind, ()))


def parts(props: mi.Properties) -> list[tuple[str, Any]]:
    """References and ready-made objects; reading other properties would mark them as queried."""
    kinds = (mi.Properties.Type.ResolvedReference, mi.Properties.Type.Object)
    return [(name, props[name]) for name in props if props.type(name) in kinds]


def references(props: mi.Properties) -> list[tuple[str, int]]:
    """Names of the parts that are nodes, and the indices of these."""
    kind = mi.Properties.ResolvedReference
    return [(name, value.index()) for name, value in parts(props) if isinstance(value, kind)]


def children(nodes: Any, parent: int, kind: mi.ObjectType) -> list[int]:
    """Indices of the nodes of a kind that a node refers to."""
    return [index for _, index in references(nodes[parent].props) if is_kind(nodes[index], kind)]


def replace_plugin(node: Any, plugin: str, kept: Iterable[str]) -> None:
    """Replace a node's plugin; its id, its children and the properties `kept` stay."""
    old, new = node.props, mi.Properties(plugin)
    new.set_id(old.id())
    for name, value in old.items():
        if name in kept or isinstance(value, mi.Properties.ResolvedReference):
            new[name] = value
    node.props = new
