"""Load scenes by name, from dicts or XML files, with changed settings.

Mitsuba's parser makes a list of nodes from any of them, `editing.change` changes their properties,
and the parser instantiates the nodes.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path, PurePosixPath
from typing import Any, Unpack
from xml.etree import ElementTree

import drjit as dr
import mitsuba as mi

from ..runtime import checks, plugins
from ..runtime.backend import keep_alive, tracing_lock
from ..runtime.progress import held_signals, status
from ..runtime.settings import SceneSettings, check_settings
from . import BUILT_IN
from .checking import require_inverse
from .compatibility import translate_names
from .editing import STEADY_FILM, change, name_shapes, qualify_plugins
from .files import require_indices, require_readable_dict, require_shallow_xml, require_utf8
from .fingerprint import describe, remember_description
from .motion import moving, take_motions
from .nodes import is_kind
from .numbers import is_transform

parser: Any = mi.parser

PACKAGED = {"scenes": "scenes/xml", "docs/datasets": "datasets/examples"}
"""Folders of a checkout, and where the package has their files."""

POINTS: dict[str, dict[str, tuple[float, ...]]] = {
    "sphere": {"center": (0.0, 0.0, 0.0)},
    "cylinder": {"p0": (0.0, 0.0, 0.0), "p1": (0.0, 0.0, 1.0)},
}
"""Points of shapes that are no transforms, with their defaults [m]."""

LONGEST = 500  # Most characters of an error of Mitsuba's in a message


@status("Loading the scene")
def load_scene(
    source: mi.Scene | Mapping[str, Any] | str | os.PathLike[str],
    *,
    parameters: Mapping[str, Any] | None = None,
    optimize: bool = True,
    **settings: Unpack[SceneSettings],
) -> mi.Scene:
    """Load a scene and change its settings on the way.

    A steady scene (film `hdrfilm`, integrator `path`) becomes a transient one when
    `temporal_bins`, `start_opl` and `bin_width_opl` are all given: its film keeps size, crop and
    the filter that it names (box if it names none), its integrator its depths, which for `path`
    have no limit unless it names one. The film's filter applies to pixels only; the filter in time
    is a box unless the integrator has a `temporal_filter`. An `aov`, `moment` or `stokes` around
    a `path` is left out.

    A shape of an XML file that has a name and no id gets the name as its id. See also `render`.

    Args:
        source: A built-in name (`tofrender scenes` lists them), the path of a Mitsuba XML file, a
            dict as for `mi.load_dict`, or an `mi.Scene`, which is returned as it is.
        parameters: Values for the `<default>` names of an XML file.
        optimize: Whether Mitsuba may merge shapes that share a material, which saves memory but
            makes them one shape. Scenes that tell shapes apart (NLOS) need False. Shapes of a scene
            with several emitters are never merged, since the order of its emitters would be another
            at each load, and a seed would mean other paths.
        **settings: Any of `width`, `height` [pixels], `temporal_bins`, `start_opl`,
            `bin_width_opl` [m], `spp`, `sampler`, `max_depth`, `integrator` (a name, or a dict as
            for `mi.load_dict`), `pulse_width_opl` [m]. What is not given, or None, stays as the
            scene has it; so do depths and `hide_emitters` when the integrator changes.

    Returns:
        The scene, under the active variant.

    Raises:
        ValueError: The scene's name or content, a setting or a parameter is wrong; one line.
        FileNotFoundError: The XML file does not exist.

    Example:
        >>> scene = load_scene("cornell_box", width=32, height=16)
        >>> list(scene.sensors()[0].film().size())
        [32, 16]
    """
    given = check_settings(settings)
    if isinstance(given.get("integrator"), Mapping):
        require_readable_dict(given["integrator"])
    parameters = checks.mapping("parameters", parameters)
    optimize = checks.boolean("optimize", optimize)
    if isinstance(source, mi.Scene):
        changed = [*given, *parameters]
        if changed:
            raise ValueError(
                f"{changed[0]} = {checks.quote((given | parameters)[changed[0]])}: a loaded scene "
                "cannot be changed; give the dict or the XML file that it comes from"
            )
        return source
    config = parser.ParserConfig(mi.variant())
    config.parallel = False  # plugins written in Python can hang in parallel loading
    config.merge_equivalent = config.merge_meshes = optimize
    if isinstance(source, str):
        source = find_scene(source)
    try:
        with tracing_lock(), held_signals(), _files_beside(source):
            state = _resolved(config, source, parameters)
            translate_names(state)
            change(state, given)
            qualify_plugins(state)
            _require_safe(state)
            name_shapes(state)
            if sum(is_kind(node, mi.ObjectType.Emitter) for node in state.nodes) > 1:
                config.merge_meshes = False  # leaves shapes, and so their lamps, in random order
            description = describe(state)  # Of all files as they are loaded
            motions = take_motions(state)
            if motions:
                config.merge_equivalent = config.merge_meshes = False
            parser.transform_all(config, state)
            scene = parser.instantiate(config, state)
            keep_alive(scene)
    except RuntimeError as error:
        raise ValueError(_one_line(str(error))) from None
    if not isinstance(scene, mi.Scene):
        raise ValueError(f"scene: its outermost part is a {type(scene).__name__}, must be a scene")
    remember_description(scene, description)
    return moving(scene, motions) if motions else scene


def parse_file_of(path: Any, parameters: Mapping[str, Any]) -> Any:
    """Mitsuba's parser state of an XML file, a built-in name or a dict, its references resolved."""
    try:
        with tracing_lock(), _files_beside(path):
            return _resolved(parser.ParserConfig(mi.variant()), path, parameters)
    except RuntimeError as error:
        raise ValueError(_one_line(str(error))) from None


def is_steady(scene: Any, parameters: Mapping[str, Any]) -> bool:
    """Whether no film of an XML file, a built-in name or a dict is transient."""
    scene = find_scene(scene) if isinstance(scene, str) else scene
    nodes = parse_file_of(scene, parameters).nodes
    films = [node for node in nodes if is_kind(node, mi.ObjectType.Film)]
    return all(node.props.plugin_name() == STEADY_FILM for node in films)


def load_plugin(what: str, description: Mapping[str, Any], kind: type = object) -> Any:
    """Instantiate one plugin of a kind from a dict; errors name it `what`, e.g. "integrator"."""
    name = description.get("type")
    if not isinstance(name, str):
        given = checks.quote(dict(description))
        raise ValueError(f"{what} = {given}: must have a plugin's name as its type")
    require_readable_dict(description)
    try:
        with tracing_lock(), held_signals():
            plugin = mi.load_dict({**description, "type": plugins.qualified_name(name)})
    except RuntimeError as error:
        raise ValueError(f"{what}: {_one_line(str(error))}") from None
    if not isinstance(plugin, kind):
        raise ValueError(f"{what} = {name}: is no {kind.__name__.lower()}; must be one")
    return plugin


def require_sensor(scene: mi.Scene, number: Any = 0, name: str = "sensor") -> mi.Sensor:
    """Return a scene's sensor of a number; refuse a scene without sensors."""
    sensors = scene.sensors()
    if not sensors:
        raise ValueError("scene: has no sensor; it must have one, for example a perspective camera")
    return sensors[checks.integer(name, number, 0, len(sensors) - 1)]


def require_light(scene: mi.Scene) -> None:
    """Refuse a scene without a light; its picture would be black."""
    if not scene.emitters():
        raise ValueError("scene: has no light; it must have an emitter, for example a point light")


def find_scene(name: str) -> str | Path:
    """Find a built-in scene (hyphens count as underscores; a str) or an XML file (a Path).

    The package's own XML files are found anywhere, as scenes/cornell_box.xml.
    """
    built_in = name.replace("-", "_")
    if built_in in BUILT_IN:
        return built_in
    path = checks.path("scene", name) if name else Path(name)
    if path.is_file():
        return path
    own = packaged(name)
    if own is not None:
        return own
    if path.suffix.lower() == ".xml" or path.name != name:
        what = "is a folder" if path.is_dir() else "does not exist"
        raise FileNotFoundError(f"scene = {name!r}: {what}; must be a Mitsuba XML file")
    near = get_close_matches(built_in, BUILT_IN, 3, 0.5)
    what = f"must be one of {checks.join_names(BUILT_IN)} that `tofrender scenes` lists"
    if near:
        meant = " or ".join(near)
        what = f"did you mean {meant}? Must be a scene that `tofrender scenes` lists"
    raise ValueError(f"scene = {name!r}: {what}, or a Mitsuba XML file")


def packaged(name: str) -> Path | None:
    """A scene or data set that comes with the package, or lies in a checkout, by its name there."""
    path, package = PurePosixPath(name), Path(__file__).parents[1]
    for folder, inside in PACKAGED.items():
        if path.suffix not in (".xml", ".toml") or not path.is_relative_to(folder):
            continue
        files = (
            root / path.relative_to(folder) for root in (package / inside, package.parent / folder)
        )
        found = next((file.resolve() for file in files if file.is_file()), None)
        if found is not None and ".." not in path.parts:
            return found
    return None


def _resolved(config: Any, source: Any, parameters: Mapping[str, Any]) -> Any:
    """Parser state with old versions upgraded and references resolved."""
    state = _parse(config, source, parameters)
    parser.transform_upgrade(config, state)
    parser.transform_resolve(config, state)
    return state


def _parse(config: Any, source: Any, parameters: Mapping[str, Any]) -> Any:
    if isinstance(source, os.PathLike):
        return _parse_file(config, Path(source), parameters)
    for name, value in parameters.items():
        allowed = "left out, only XML files have parameters"
        checks.require(f"parameter {name}", value, not parameters, allowed)
    if isinstance(source, str):
        source = BUILT_IN[source]()
    if not isinstance(source, Mapping):
        shown = repr(source)
        shown = shown if len(shown) < 40 and "\n" not in shown else type(source).__name__
        raise ValueError(
            f"scene = {shown}: must be a built-in name, an XML file, a dict, "
            f"or a scene of the active variant {mi.variant()}"
        )
    if source.get("type") != "scene":
        raise ValueError(f"scene: type = {checks.quote(source.get('type'))}, must be 'scene'")
    require_readable_dict(source)
    parts = {name: part for name, part in source.items() if not _is_folder(part)}
    return parser.parse_dict(config, _with_own_arrays(parts))


def _with_own_arrays(description: Mapping[str, Any]) -> dict[str, Any]:
    """Copy a dict with its bitmaps and tensors.

    Textures convert a bitmap in place to the spectra of a spectral variant, and empty a tensor.
    The objects of the caller must stay as they are.
    """
    copied: dict[str, Any] = {}
    for name, value in description.items():
        if isinstance(value, Mapping):
            value = _with_own_arrays(value)
        elif isinstance(value, mi.Bitmap) or dr.is_tensor_v(value):
            value = type(value)(value)
        copied[name] = value
    return copied


def _is_folder(part: Any) -> bool:
    """Whether a part of a dict names a folder that `_files_beside` searches."""
    return isinstance(part, Mapping) and part.get("type") == "resources"


@contextmanager
def _files_beside(source: Any) -> Iterator[None]:
    """Search meshes and textures in the XML file's folder or a dict's folders first."""
    untyped: Any = mi  # the stubs of these functions are not callable
    before = untyped.file_resolver()
    resolver = mi.FileResolver(before)
    if isinstance(source, os.PathLike):
        path = Path(source).absolute()
        require_utf8("scene", path)
        resolver.prepend(str(path.parent))
    for part in filter(_is_folder, source.values() if isinstance(source, Mapping) else ()):
        folder = checks.path("resources: path", part.get("path"))
        require_utf8("resources: path", folder)
        checks.require("resources: path", str(folder), folder.is_dir(), "a folder that exists")
        resolver.prepend(str(folder.absolute()))
    untyped.set_file_resolver(resolver)
    try:
        yield
    finally:
        untyped.set_file_resolver(before)


def _parse_file(config: Any, path: Path, parameters: Mapping[str, Any]) -> Any:
    if not path.is_file():
        raise FileNotFoundError(f"scene = {str(path)!r}: must be an XML file that exists")
    if not os.access(path, os.R_OK):
        raise ValueError(f"scene = {str(path)!r}: cannot be read, its permissions forbid it")
    text = {name: str(value) for name, value in parameters.items()}
    require_shallow_xml(path, text)
    try:
        return parser.parse_file(config, str(path), **text)
    except RuntimeError as error:
        unused = re.search(r"unused parameters:\s*- \$(\w+)=(.*)", str(error))
        if not unused:
            raise
        defaults = [node.get("name", "") for node in ElementTree.parse(path).iter("default")]
        allowed = ", ".join(defaults) or "none, it has no <default>"
        raise ValueError(
            f"parameter {unused[1]} = {unused[2]!r}: {path.name} does not use it, "
            f"its parameters are: {allowed}"
        ) from None


def _require_safe(state: Any) -> None:
    """Refuse foreign native plugins, wrong inverses, and PLY files that end the process."""
    for node in state.nodes:
        props = node.props
        plugins.require_safe_type(props.plugin_name())
        to_world = props.get("to_world", None)
        props.mark_queried("to_world", False)  # Plugins that do not know it are still told of
        _require_extended(props)
        if is_transform(to_world):  # Meshes keep none, once loaded
            name = f"{props.id() or props.plugin_name()}.to_world"
            require_inverse(name, to_world, flat=True)
        if props.plugin_name() == "ply" and "filename" in props:
            require_indices(str(props["filename"]))


def _require_extended(props: mi.Properties) -> None:
    """Refuse a sphere or a cylinder without extent, by the parameters that the scene gives.

    A loaded shape only has a transform, which would name a parameter that nobody gave.
    """
    kind = props.plugin_name()
    defaults = POINTS.get(kind)
    if defaults is None:
        return
    name = props.id() or kind

    # Has the radius a size?
    if "radius" in props:
        radius = props["radius"]
        valid = isinstance(radius, int | float) and math.isfinite(radius) and radius != 0
        checks.require(f"{name}.radius", radius, valid, "a finite number other than 0 [m]")

    # Are the points finite, and the ends of a cylinder apart? Other types are left to Mitsuba
    points = dict(defaults)
    for point in points:
        if point in props and props.type(point) == mi.Properties.Type.Vector:
            vector: Any = props[point]
            points[point] = tuple(float(each) for each in vector)
            valid = all(map(math.isfinite, points[point]))
            checks.require(f"{name}.{point}", list(points[point]), valid, "finite numbers [m]")
    if kind == "cylinder" and points["p0"] == points["p1"]:
        raise ValueError(f"{name}.p0 = {list(points['p0'])}: must differ from p1, the other end")


def _one_line(message: str) -> str:
    """Reduce an error of Mitsuba's parser to one line, without source files of its code."""
    if "Traceback (most recent call last)" in message:
        message = re.split(r"^\w+: ", message, flags=re.MULTILINE)[-1]  # of a plugin in Python
    message = re.sub(r"\[[\w.]+:\d+\] ", "", message)
    wrong_type = r'property "(\w+)" has the wrong type \(expected (.+), got (.+)\)'
    if found := re.search(wrong_type, message):
        name, wanted, given = found.groups()
        return f"{name} of type {given.strip('<>')}: must be of type {wanted.strip('<>')}"
    if found := re.search(r"\[([\w.]+)\] missing 'type' attribute", message):
        return f"{found[1]}: is a dict without a type; must have a plugin's name as its type"
    no_kind = r"could not assign an object of type '(.*?)' to key '(.*?)'"
    if found := re.search(no_kind, message):
        kind, key = found.groups()
        return f"{key} of type {kind}: must be a number, text, a tuple, a dict or Mitsuba's"
    lines = [line.strip().removeprefix("- ") for line in message.splitlines()]
    text = " ".join(line for line in lines if line)
    return text if len(text) < LONGEST else f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
