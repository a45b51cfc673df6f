"""Apply settings to a scene that Mitsuba's parser has read, before the scene is instantiated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mitsuba as mi

from ..runtime import plugins
from .nodes import ENDINGS, UNKNOWN, children, is_kind, parts, replace_plugin
from .transient_integrators import change_integrator

parser: Any = mi.parser

STEADY_FILM = "hdrfilm"
TRANSIENT_FILM = "transient_hdr_film"

FILM_SETTINGS = ("width", "height", "temporal_bins", "start_opl", "bin_width_opl")
WINDOW_SETTINGS = FILM_SETTINGS[2:]
INTEGRATOR_SETTINGS = ("integrator", "max_depth", "pulse_width_opl")

# Properties that a node keeps when its plugin is replaced
CROP = ("crop_width", "crop_height", "crop_offset_x", "crop_offset_y")
FILM_KEPT = ("width", "height", *CROP, "sample_border")
SAMPLER_KEPT = ("sample_count", "seed")


def qualify_plugins(state: Any) -> None:
    """Replace plugin names that mitransient may also register by unambiguous names."""
    for node in state.nodes:
        node.props.set_plugin_name(plugins.qualified_name(node.props.plugin_name()))


def name_shapes(state: Any) -> None:
    """Use the name in the XML file as the id of each shape without an id."""
    for parent in state.nodes:
        for name, value in parts(parent.props):
            if isinstance(value, mi.Properties.ResolvedReference) and not name.startswith("_"):
                node = state.nodes[value.index()]
                if node.type == mi.ObjectType.Shape and not node.props.id():
                    node.props.set_id(name)


def change(state: Any, settings: Mapping[str, Any]) -> None:
    """Apply settings to a scene that Mitsuba's parser has read.

    If the settings contain a complete time window, a film `hdrfilm` becomes a
    `transient_hdr_film`, and the integrator `path` becomes a `transient_path`, even inside an
    `aov`, `moment` or `stokes`. Missing parts (film, sampler, integrator) are added with Mitsuba's
    defaults.

    Args:
        state: The parser's state, which is changed.
        settings: Checked settings of `SceneSettings`, by name.

    Raises:
        ValueError: If the scene cannot be changed in this way.
    """
    # Nodes are addressed by index, because the list moves in memory when a node is added
    nodes = state.nodes
    film_settings = {k: settings[k] for k in FILM_SETTINGS if k in settings}

    # Find the sensors
    sensors = [i for i, node in enumerate(nodes) if is_kind(node, mi.ObjectType.Sensor)]
    if not sensors and settings:
        for i, node in enumerate(nodes):
            if node.type == UNKNOWN and children(nodes, i, mi.ObjectType.Film):
                raise ValueError(
                    f"scene: its sensor has the unknown type {node.props.plugin_name()!r}; use a "
                    "sensor of Mitsuba, or a Python plugin with a name that ends in "
                    f"{' or '.join(ENDINGS[mi.ObjectType.Sensor])}"
                )
        raise ValueError(
            "scene: no sensor was found for the settings. Describe the sensor by a dict or in XML"
        )

    # Change film and sampler of each sensor
    now_transient = False
    for sensor in sensors:
        if film_settings:
            film = nodes[_child(nodes, sensor, mi.ObjectType.Film, STEADY_FILM)]
            now_transient |= _change_film(film, film_settings)
        if "sampler" in settings or "spp" in settings:
            sampler = nodes[_child(nodes, sensor, mi.ObjectType.Sampler, "independent")]
            if "sampler" in settings:
                replace_plugin(sampler, settings["sampler"], SAMPLER_KEPT)
            if "spp" in settings:
                sampler.props["sample_count"] = settings["spp"]

    # Change the integrator; a ready-made one is removed if another is requested
    if now_transient or settings.keys() & {*INTEGRATOR_SETTINGS}:
        wanted = settings.get("integrator", "path")
        if "integrator" in settings:
            scene = nodes[0].props
            for name in [name for name, each in parts(scene) if isinstance(each, mi.Integrator)]:
                del scene[name]
        default = wanted if isinstance(wanted, str) else wanted["type"]
        integrator = _child(nodes, 0, mi.ObjectType.Integrator, default)
        change_integrator(nodes, integrator, settings, now_transient)


def _child(nodes: Any, parent: int, kind: mi.ObjectType, default: str) -> int:
    """Return the index of the first child of a kind, or add the plugin `default` as a child."""
    found = children(nodes, parent, kind)
    if found:
        return found[0]

    # Is there a part that may be of this kind, but cannot be changed?
    role = kind.name.lower()
    unknown = None
    for name, value in parts(nodes[parent].props):
        if isinstance(value, getattr(mi, kind.name)):
            raise ValueError(
                f"scene: the settings of its {role} cannot be changed, because the {role} is a "
                "loaded object. Describe it by a dict"
            )
        if isinstance(value, mi.Properties.ResolvedReference):
            node = nodes[value.index()]
            if any(is_kind(node, each) for each in mi.ObjectType if each != UNKNOWN):
                continue
            if name == role:
                return value.index()
            unknown = node.props.plugin_name()
    if unknown:
        raise ValueError(
            f"scene: the plugin {unknown!r} may be its {role}, and the settings need the {role}. "
            f"Use an XML file, or a plugin with a name that ends in {' or '.join(ENDINGS[kind])}"
        )

    # Add Mitsuba's default
    added = parser.SceneNode()
    added.type = kind
    added.props = mi.Properties(default)
    nodes.append(added)
    index = len(nodes) - 1
    nodes[parent].props[f"added_{role}"] = mi.Properties.ResolvedReference(index)
    return index


def _change_film(film: Any, settings: Mapping[str, Any]) -> bool:
    """Apply settings to a film node. Return True if the film was steady and is now transient."""
    name = film.props.plugin_name()
    window = [setting for setting in WINDOW_SETTINGS if setting in settings]
    to_transient = bool(window) and name == STEADY_FILM
    if to_transient:
        missing = [setting for setting in WINDOW_SETTINGS if setting not in settings]
        if missing:
            raise ValueError(
                f"{window[0]} = {settings[window[0]]!r}: the scene's film is steady. Pass "
                f"{' and '.join(f'`{each}`' for each in missing)} too to make it transient"
            )
        replace_plugin(film, TRANSIENT_FILM, FILM_KEPT)
        film.props["temporal_filter"] = "box"  # The steady film's filter applies to pixels only
    for setting, value in settings.items():
        film.props[setting] = value
    return to_transient
