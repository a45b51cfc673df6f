"""Putting settings into a scene that Mitsuba's parser has read, before it is built."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mitsuba as mi

from ..runtime import plugins
from .in_time import change_integrator
from .nodes import ENDINGS, become, children, is_kind, is_of_no_known_kind, parts

parser: Any = mi.parser

STEADY_FILM, TRANSIENT_FILM = "hdrfilm", "transient_hdr_film"
FILM_SETTINGS = ("width", "height", "temporal_bins", "start_opl", "bin_width_opl")
WINDOW_SETTINGS = FILM_SETTINGS[2:]
INTEGRATOR_SETTINGS = ("integrator", "max_depth", "pulse_width_opl")

# What survives when a node becomes another plugin.
FILM_KEPT = (
    "width",
    "height",
    "crop_width",
    "crop_height",
    "crop_offset_x",
    "crop_offset_y",
    "sample_border",
)
SAMPLER_KEPT = ("sample_count", "seed")


def use_own_plugins(state: Any) -> None:
    """Let names that other packages may have taken mean our own plugins."""
    for node in state.nodes:
        node.props.set_plugin_name(plugins.qualified_name(node.props.plugin_name()))


def name_shapes(state: Any) -> None:
    """Give shapes without an id the name that an XML file gives them, as exporters do."""
    for parent in state.nodes:
        for name, value in parts(parent.props):
            if isinstance(value, mi.Properties.ResolvedReference) and not name.startswith("_"):
                node = state.nodes[value.index()]
                if node.type == mi.ObjectType.Shape and not node.props.id():
                    node.props.set_id(name)


def change(state: Any, settings: Mapping[str, Any]) -> None:
    """Put settings into a scene that Mitsuba's parser has read.

    A film `hdrfilm` that gets a whole window becomes a `transient_hdr_film`, and the integrator
    `path` then a `transient_path`, also where `aov`, `moment` or `stokes` is around it. Parts that
    the scene leaves to Mitsuba's defaults are added.

    Args:
        state: The `mi.parser.ParserState`, with its references resolved.
        settings: As `check_settings` returns them.

    Raises:
        ValueError: The scene cannot take a setting; one line.
    """
    _Nodes(state).change(settings)


class _Nodes:
    """The parsed scene: a list of nodes whose properties refer to each other by index.

    Here too nodes are named by index, because the list moves in memory when one is added.
    """

    def __init__(self, state: Any) -> None:
        self.nodes = state.nodes

    def change(self, settings: Mapping[str, Any]) -> None:
        """Put `settings`, all checked, into the nodes."""
        film_settings = {k: settings[k] for k in FILM_SETTINGS if k in settings}
        sensors = [i for i, node in enumerate(self.nodes) if is_kind(node, mi.ObjectType.Sensor)]
        if not sensors and settings:
            raise ValueError("scene: has no sensor that could take settings; describe it by a dict")
        turned_transient = False
        for sensor in sensors:
            if film_settings:
                film = self.nodes[self.child(sensor, mi.ObjectType.Film, STEADY_FILM)]
                turned_transient |= _change_film(film, film_settings)
            if "sampler" in settings or "spp" in settings:
                sampler = self.nodes[self.child(sensor, mi.ObjectType.Sampler, "independent")]
                if "sampler" in settings:
                    become(sampler, settings["sampler"], SAMPLER_KEPT)
                if "spp" in settings:
                    sampler.props["sample_count"] = settings["spp"]
        if turned_transient or settings.keys() & {*INTEGRATOR_SETTINGS}:
            wanted = settings.get("integrator", "path")
            if "integrator" in settings:
                self.drop_ready_made(0, mi.ObjectType.Integrator)
            default = wanted if isinstance(wanted, str) else wanted["type"]
            integrator = self.child(0, mi.ObjectType.Integrator, default)
            change_integrator(self.nodes, integrator, settings, turned_transient)

    def drop_ready_made(self, parent: int, kind: mi.ObjectType) -> None:
        """Forget children that are objects already: something else comes in their place."""
        props = self.nodes[parent].props
        for name, value in parts(props):
            if isinstance(value, getattr(mi, kind.name)):
                del props[name]

    def child(self, parent: int, kind: mi.ObjectType, default: str) -> int:
        """The child of `parent` that is of this kind; if there is none, Mitsuba's default is added.

        Raises:
            ValueError: The child is a ready-made object, or nobody can tell which one it is.
        """
        what = kind.name.lower()
        found = children(self.nodes, parent, kind)
        if found:
            return found[0]
        unknown = None
        for name, value in parts(self.nodes[parent].props):
            if isinstance(value, getattr(mi, kind.name)):
                raise ValueError(
                    f"scene: its {what} is a ready-made object, whose settings cannot be changed; "
                    "describe it by a dict"
                )
            if isinstance(value, mi.Properties.ResolvedReference):
                node = self.nodes[value.index()]
                if not is_of_no_known_kind(node):
                    continue
                if name == what:
                    return value.index()
                unknown = node.props.plugin_name()
        if unknown:
            raise ValueError(
                f"scene: {unknown!r} may be its {what}; to change it, use an XML file, which says, "
                f"or a plugin's name that ends in {' or '.join(ENDINGS[kind])}"
            )
        added = parser.SceneNode()
        added.type, added.props = kind, mi.Properties(default)
        self.nodes.append(added)
        index = len(self.nodes) - 1
        reference = mi.Properties.ResolvedReference(index)
        self.nodes[parent].props[f"added_{what}"] = reference
        return index


def _change_film(film: Any, settings: Mapping[str, Any]) -> bool:
    """Change a film node; returns whether it turned from steady to transient."""
    name = film.props.plugin_name()
    window = [setting for setting in WINDOW_SETTINGS if setting in settings]
    turns = bool(window) and name == STEADY_FILM
    if turns:
        missing = [setting for setting in WINDOW_SETTINGS if setting not in settings]
        if missing:
            raise ValueError(
                f"{window[0]} = {settings[window[0]]!r}: the scene's film is steady; to make it "
                f"transient, give {' and '.join(f'`{each}`' for each in missing)} too"
            )
        become(film, TRANSIENT_FILM, FILM_KEPT)
    for setting, value in settings.items():
        film.props[setting] = value
    return turns
