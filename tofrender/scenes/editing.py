"""Putting settings into a scene that Mitsuba's parser has read, before it is built."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import mitsuba as mi

from ..runtime import checks, plugins
from .settings import IN_TIME, INTEGRATORS

parser: Any = mi.parser
UNKNOWN = mi.ObjectType.Unknown

STEADY_FILM, TRANSIENT_FILM = "hdrfilm", "transient_hdr_film"
FILM_SETTINGS = ("width", "height", "temporal_bins", "start_opl", "bin_width_opl")
WINDOW_SETTINGS = FILM_SETTINGS[2:]

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
# Python plugins in a dict have no type before they are built; their names end like this.
ENDINGS = {
    mi.ObjectType.Film: ("film",),
    mi.ObjectType.Sampler: ("sampler", "sobol"),
    mi.ObjectType.Integrator: ("path", "integrator", *IN_TIME),
    mi.ObjectType.Sensor: ("camera", "meter"),
}

INTEGRATOR_KEPT = ("max_depth", "rr_depth", "hide_emitters")
SAMPLER_KEPT = ("sample_count", "seed")


def use_own_plugins(state: Any) -> None:
    """Let names that other packages may have taken mean our own plugins."""
    for node in state.nodes:
        node.props.set_plugin_name(plugins.own_name(node.props.plugin_name()))


def name_shapes(state: Any) -> None:
    """Give shapes without an id the name that an XML file gives them, as exporters do."""
    for parent in state.nodes:
        for name, value in _parts(parent.props):
            if isinstance(value, mi.Properties.ResolvedReference) and not name.startswith("_"):
                node = state.nodes[value.index()]
                if node.type == mi.ObjectType.Shape and not node.props.id():
                    node.props.set_id(name)


def _parts(props: mi.Properties) -> list[tuple[str, Any]]:
    """References and ready-made objects; Mitsuba tells of other properties that nobody reads."""
    kinds = (mi.Properties.Type.ResolvedReference, mi.Properties.Type.Object)
    return [(name, props[name]) for name in props if props.type(name) in kinds]


def change(state: Any, settings: Mapping[str, Any]) -> None:
    """Put settings into a scene that Mitsuba's parser has read.

    A film `hdrfilm` that gets a whole window becomes a `transient_hdr_film`, and the integrator
    `path` then a `transient_path`. Parts that the scene leaves to Mitsuba's defaults are added.

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
        sensors = [i for i, node in enumerate(self.nodes) if _is(node, mi.ObjectType.Sensor)]
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
                    _become(sampler, settings["sampler"], SAMPLER_KEPT)
                if "spp" in settings:
                    sampler.props["sample_count"] = settings["spp"]
        if turned_transient or settings.keys() & {"integrator", "max_depth", "pulse_width_opl"}:
            integrator = self.nodes[self.child(0, mi.ObjectType.Integrator, "path")]
            _change_integrator(integrator, settings, turned_transient)

    def child(self, parent: int, kind: mi.ObjectType, default: str) -> int:
        """The child of `parent` that is of this kind; if there is none, Mitsuba's default is added.

        Raises:
            ValueError: The child is a ready-made object, or nobody can tell which one it is.
        """
        what = kind.name.lower()
        unknown = None
        for _, value in _parts(self.nodes[parent].props):
            if isinstance(value, mi.Properties.ResolvedReference):
                node = self.nodes[value.index()]
                if _is(node, kind):
                    return value.index()
                if not any(_is(node, each) for each in mi.ObjectType if each != UNKNOWN):
                    unknown = node.props.plugin_name()
            elif isinstance(value, getattr(mi, kind.name)):
                raise ValueError(
                    f"scene: its {what} is a ready-made object, whose settings cannot be changed; "
                    "describe it by a dict"
                )
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


def _is(node: Any, kind: mi.ObjectType) -> bool:
    """Whether a node is of this kind; for a Python plugin in a dict only its name can tell."""
    if node.type != UNKNOWN:
        return node.type == kind
    return node.props.plugin_name().endswith(ENDINGS.get(kind, ()))


def _become(node: Any, plugin: str, kept: Iterable[str]) -> None:
    """Make a node another plugin, which keeps its id, its children and the properties `kept`."""
    old, new = node.props, mi.Properties(plugin)
    new.set_id(old.id())
    for name, value in old.items():
        if name in kept or isinstance(value, mi.Properties.ResolvedReference):
            new[name] = value
    node.props = new


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
                f"transient, give {' and '.join(missing)} too"
            )
        _become(film, TRANSIENT_FILM, FILM_KEPT)
    for setting, value in settings.items():
        film.props[setting] = value
    return turns


def _change_integrator(integrator: Any, settings: Mapping[str, Any], turns: bool) -> None:
    """Change the integrator's node; `turns` says that the film turned transient."""
    name = integrator.props.plugin_name()
    if "max_bounces" in integrator.props:  # Not every integrator counts bounces; all count depth
        integrator.props["max_depth"] = checks.depth_of_bounces(integrator.props["max_bounces"])
        del integrator.props["max_bounces"]
    if "integrator" in settings:
        if settings["integrator"] != name:
            _become(integrator, settings["integrator"], INTEGRATOR_KEPT)
    elif turns and name not in IN_TIME:
        if name != "path":
            raise ValueError(
                f"integrator = {name!r}: a transient film needs another one; "
                f"must be one of {', '.join(INTEGRATORS)}"
            )
        _become(integrator, "transient_path", INTEGRATOR_KEPT)
    for setting in ("max_depth", "pulse_width_opl"):
        if setting in settings:
            integrator.props[setting] = settings[setting]
