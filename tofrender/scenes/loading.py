"""Load scenes by name, from dicts or from XML files, and change their settings.

Mitsuba's parser converts each source to a list of nodes. `editing.change` changes the properties of
the nodes, and the parser instantiates them.
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
from .dangerous_files import (
    require_indices,
    require_readable_dict,
    require_shallow_xml,
    require_utf8,
)
from .editing import STEADY_FILM, change, name_shapes, qualify_plugins
from .fingerprint import describe, remember_description
from .motion import moving, take_motions
from .nodes import is_kind
from .numbers import is_transform

parser: Any = mi.parser

PACKAGED = {"scenes": "scenes/xml", "docs/datasets": "datasets/examples"}
"""Folders of a checkout, and the folders of an installed package with the same files."""

POINTS: dict[str, dict[str, tuple[float, ...]]] = {
    "sphere": {"center": (0.0, 0.0, 0.0)},
    "cylinder": {"p0": (0.0, 0.0, 0.0), "p1": (0.0, 0.0, 1.0)},
}
"""Points that define shapes in addition to `to_world`, with their defaults [m]."""

LONGEST = 500  # Largest number of characters of Mitsuba's message in an error


@status("Loading the scene")
def load_scene(
    source: mi.Scene | Mapping[str, Any] | str | os.PathLike[str],
    *,
    parameters: Mapping[str, Any] | None = None,
    optimize: bool = True,
    **settings: Unpack[SceneSettings],
) -> mi.Scene:
    """Load a scene, with changed settings.

    If `temporal_bins`, `start_opl` and `bin_width_opl` are all given, a steady scene (film
    `hdrfilm`, integrator `path`) becomes transient. The film keeps its size, crop and
    reconstruction filter; without a filter in the scene, a box filter is used. The integrator keeps
    its depths; without a `max_depth` in the scene, paths of `path` have no limit. The film's filter
    applies to pixels only. In time, the filter is a box unless the integrator has a
    `temporal_filter`. An `aov`, `moment` or `stokes` around the `path` is removed.

    A shape of an XML file with a name and without an id gets the name as its id. See also `render`.

    Args:
        source: A built-in name (`tofrender scenes` lists them), the path of a Mitsuba XML file, a
            dict as for `mi.load_dict`, or an `mi.Scene`, which is returned unchanged.
        parameters: Values for the `<default>` names of an XML file.
        optimize: Whether Mitsuba may merge shapes that share a material. Merging saves memory, but
            the merged shapes are one shape. Pass False if shapes must be distinguished (NLOS).
            Shapes of scenes with several emitters are never merged, because merging would change
            the order of emitters at each load, and therefore the paths of a seed.
        **settings: Any of `width`, `height` [pixels], `temporal_bins`, `start_opl`,
            `bin_width_opl` [m], `spp`, `sampler`, `max_depth`, `integrator` (a name, or a dict as
            for `mi.load_dict`), `pulse_width_opl` [m]. Settings that are omitted or None are those
            of the scene. A new integrator inherits the depths and `hide_emitters` of the old one.

    Returns:
        The scene, in the active variant.

    Raises:
        ValueError: If the scene's name or content, a setting or a parameter is wrong.
        FileNotFoundError: If the XML file does not exist.

    Example:
        >>> scene = load_scene("cornell_box", width=32, height=16)
        >>> list(scene.sensors()[0].film().size())
        [32, 16]
    """
    # Check the arguments
    changes = check_settings(settings)
    if isinstance(changes.get("integrator"), Mapping):
        require_readable_dict(changes["integrator"])
    parameters = checks.mapping("parameters", parameters)
    optimize = checks.boolean("optimize", optimize)

    # A loaded scene is returned unchanged
    if isinstance(source, mi.Scene):
        names = [*changes, *parameters]
        if names:
            raise ValueError(
                f"{names[0]} = {checks.quote((changes | parameters)[names[0]])}: a loaded scene "
                "cannot be changed. Pass the dict or the XML file of the scene"
            )
        return source

    # Configure the parser; plugins written in Python can hang in parallel loading
    config = parser.ParserConfig(mi.variant())
    config.parallel = False
    config.merge_equivalent = config.merge_meshes = optimize
    if isinstance(source, str):
        source = find_scene(source)
    try:
        with tracing_lock(), held_signals(), _file_search(source):
            # Parse the scene and apply the changes
            state = _resolved(config, source, parameters)
            translate_names(state)
            change(state, changes)
            qualify_plugins(state)
            _require_safe(state)
            name_shapes(state)

            # Merging would put the shapes, and therefore their emitters, in random order
            if sum(is_kind(node, mi.ObjectType.Emitter) for node in state.nodes) > 1:
                config.merge_meshes = False

            # Describe the scene before the files are loaded, within the same search of files
            description = describe(state)

            # Remove motions, which Mitsuba's plugins do not support
            motions = take_motions(state)
            if motions:
                config.merge_equivalent = config.merge_meshes = False

            # Instantiate the scene
            parser.transform_all(config, state)
            scene = parser.instantiate(config, state)
            keep_alive(scene)
    except RuntimeError as error:
        raise ValueError(_one_line(str(error))) from None
    if not isinstance(scene, mi.Scene):
        raise ValueError(f"scene: expected a scene, found a {type(scene).__name__}")
    remember_description(scene, description)
    return moving(scene, motions) if motions else scene


def parse_file_of(path: Any, parameters: Mapping[str, Any]) -> Any:
    """Parse an XML file, a built-in name or a dict, and resolve the references.

    Returns:
        The state of Mitsuba's parser.
    """
    try:
        with tracing_lock(), _file_search(path):
            return _resolved(parser.ParserConfig(mi.variant()), path, parameters)
    except RuntimeError as error:
        raise ValueError(_one_line(str(error))) from None


def is_steady(scene: Any, parameters: Mapping[str, Any]) -> bool:
    """Return whether all films of an XML file, a built-in name or a dict are steady."""
    scene = find_scene(scene) if isinstance(scene, str) else scene
    nodes = parse_file_of(scene, parameters).nodes
    films = [node for node in nodes if is_kind(node, mi.ObjectType.Film)]
    return all(node.props.plugin_name() == STEADY_FILM for node in films)


def load_plugin(what: str, description: Mapping[str, Any], kind: type = object) -> Any:
    """Instantiate a plugin from a dict, and check its class.

    Args:
        what: Name of the parameter for error messages, e.g. "integrator".
        description: A dict as for `mi.load_dict`.
        kind: The class that the plugin must have.

    Raises:
        ValueError: If the plugin cannot be loaded or has another class.
    """
    name = description.get("type")
    if not isinstance(name, str):
        shown = checks.quote(dict(description))
        raise ValueError(f"{what} = {shown}: 'type' is missing. Set it to a plugin's name")
    require_readable_dict(description)
    try:
        with tracing_lock(), held_signals():
            plugin = mi.load_dict({**description, "type": plugins.qualified_name(name)})
    except RuntimeError as error:
        raise ValueError(f"{what}: {_one_line(str(error))}") from None
    if not isinstance(plugin, kind):
        wanted = kind.__name__.lower()
        raise ValueError(f"{what} = {name}: expected {wanted}, found {type(plugin).__name__}")
    return plugin


def require_sensor(scene: mi.Scene, number: Any = 0, name: str = "sensor") -> mi.Sensor:
    """Return the scene's sensor with an index. Raise an error for a scene without sensors."""
    sensors = scene.sensors()
    if not sensors:
        raise ValueError("scene: sensor is missing. Add a sensor, for example a perspective camera")
    return sensors[checks.integer(name, number, 0, len(sensors) - 1)]


def require_light(scene: mi.Scene) -> None:
    """Raise a ValueError if a scene has no light, because its picture would be black."""
    if not scene.emitters():
        raise ValueError("scene: light is missing. Add an emitter, for example a point light")


def find_scene(name: str) -> str | Path:
    """Find a built-in scene or an XML file by its name.

    Hyphens in the name of a built-in scene are replaced by underscores. The package's XML files,
    such as `scenes/cornell_box.xml`, are found from any working directory.

    Returns:
        The name of the built-in scene, or the path of the XML file.

    Raises:
        FileNotFoundError: If the name is a path and the file does not exist.
        ValueError: If the name is not a path and no built-in scene has it.
    """
    # A built-in scene, a file, or a file of the package
    built_in = name.replace("-", "_")
    if built_in in BUILT_IN:
        return built_in
    path = checks.path("scene", name) if name else Path(name)
    if path.is_file():
        return path
    in_package = packaged(name)
    if in_package is not None:
        return in_package

    # Report a missing file, or suggest similar names
    if path.suffix.lower() == ".xml" or path.name != name:
        problem = "is a folder" if path.is_dir() else "does not exist"
        raise FileNotFoundError(f"scene = {name!r}: {problem}. Pass a Mitsuba XML file")
    near = get_close_matches(built_in, BUILT_IN, 3, 0.5)
    remedy = " or ".join(near) if near else f"one of {checks.join_names(BUILT_IN)}"
    raise ValueError(
        f"scene = {name!r}: unknown name. Use {remedy}, or a Mitsuba XML file; "
        "`tofrender scenes` lists the built-in scenes"
    )


def packaged(name: str) -> Path | None:
    """Return the path of a scene or data set of the package, or None if the file is missing.

    Args:
        name: Path relative to the root of a checkout, e.g. "scenes/cornell_box.xml".
    """
    path = PurePosixPath(name)
    package = Path(__file__).parents[1]
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
    """Parse a scene, convert descriptions of older Mitsuba versions, and resolve references."""
    state = _parse(config, source, parameters)
    parser.transform_upgrade(config, state)
    parser.transform_resolve(config, state)
    return state


def _parse(config: Any, source: Any, parameters: Mapping[str, Any]) -> Any:
    """Parse an XML file, a built-in name or a dict."""
    if isinstance(source, os.PathLike):
        return _parse_file(config, Path(source), parameters)

    # Only XML files have parameters
    if parameters:
        name, value = next(iter(parameters.items()))
        raise ValueError(
            f"parameter {name} = {checks.quote(value)}: only XML files have parameters. Remove it"
        )

    # Find the dict
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
        raise ValueError(f"scene: type = {checks.quote(source.get('type'))}: must be 'scene'")
    require_readable_dict(source)
    parts = {name: part for name, part in source.items() if not _is_folder(part)}
    return parser.parse_dict(config, _with_own_arrays(parts))


def _with_own_arrays(description: Mapping[str, Any]) -> dict[str, Any]:
    """Copy a dict together with its bitmaps and tensors.

    Textures of Mitsuba change these objects: they convert a bitmap to the spectra of a spectral
    variant, and they empty a tensor. The copy protects the caller's objects.
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
    """Return whether a part of a dict names a folder with files of the scene."""
    return isinstance(part, Mapping) and part.get("type") == "resources"


@contextmanager
def _file_search(source: Any) -> Iterator[None]:
    """Search meshes and textures in the folder of the XML file, or in the dict's folders, first."""
    untyped: Any = mi  # Mitsuba's stubs declare these functions as not callable
    before = untyped.file_resolver()
    resolver = mi.FileResolver(before)

    # The folder of the XML file
    if isinstance(source, os.PathLike):
        path = Path(source).absolute()
        require_utf8("scene", path)
        resolver.prepend(str(path.parent))

    # Folders that the dict names
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
    """Parse an XML file with values of its parameters."""
    if not path.is_file():
        raise FileNotFoundError(f"scene = {str(path)!r}: does not exist. Pass a Mitsuba XML file")
    if not os.access(path, os.R_OK):
        raise ValueError(f"scene = {str(path)!r}: cannot be read. Change the file's permissions")
    text = {name: str(value) for name, value in parameters.items()}
    require_shallow_xml(path, text)
    try:
        return parser.parse_file(config, str(path), **text)
    except RuntimeError as error:
        # List the parameters if the file does not use one
        unused = re.search(r"unused parameters:\s*- \$(\w+)=(.*)", str(error))
        if not unused:
            raise
        defaults = [node.get("name", "") for node in ElementTree.parse(path).iter("default")]
        remedy = f"Use one of {', '.join(defaults)}" if defaults else "Remove it"
        raise ValueError(
            f"parameter {unused[1]} = {unused[2]!r}: {path.name} does not use it. {remedy}"
        ) from None


def _require_safe(state: Any) -> None:
    """Raise a ValueError for foreign native plugins, wrong inverses, and wrong indices in PLY."""
    for node in state.nodes:
        props = node.props
        plugins.require_safe_type(props.plugin_name())
        _require_extended(props)

        # Check the transform here, because loaded meshes do not keep it
        to_world = props.get("to_world", None)
        props.mark_queried("to_world", False)  # So that Mitsuba still reports it if it is unused
        if is_transform(to_world):
            name = f"{props.id() or props.plugin_name()}.to_world"
            require_inverse(name, to_world, flat=True)

        if props.plugin_name() == "ply" and "filename" in props:
            require_indices(str(props["filename"]))


def _require_extended(props: mi.Properties) -> None:
    """Raise a ValueError for a sphere or a cylinder of size zero, and name its parameters.

    A loaded shape has only a transform, so a later message could not name these parameters.
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

    # Are the points finite? Mitsuba reports points of a wrong type
    points = dict(defaults)
    for point in points:
        if point in props and props.type(point) == mi.Properties.Type.Vector:
            vector: Any = props[point]
            points[point] = tuple(float(each) for each in vector)
            valid = all(map(math.isfinite, points[point]))
            checks.require(f"{name}.{point}", list(points[point]), valid, "finite numbers [m]")

    # Do the two ends of a cylinder differ?
    if kind == "cylinder" and points["p0"] == points["p1"]:
        raise ValueError(f"{name}.p0 = {list(points['p0'])}: must differ from p1, the other end")


def _one_line(message: str) -> str:
    """Reduce an error of Mitsuba's parser to one line, without names of Mitsuba's source files."""
    # Keep the last error of a plugin in Python, and remove source files of Mitsuba
    if "Traceback (most recent call last)" in message:
        message = re.split(r"^\w+: ", message, flags=re.MULTILINE)[-1]
    message = re.sub(r"\[[\w.]+:\d+\] ", "", message)

    # Rewrite frequent errors
    wrong_type = r'property "(\w+)" has the wrong type \(expected (.+), got (.+)\)'
    if found := re.search(wrong_type, message):
        name, expected, actual = found.groups()
        return f"{name} of type {actual.strip('<>')}: must be of type {expected.strip('<>')}"
    if found := re.search(r"\[([\w.]+)\] missing 'type' attribute", message):
        return f"{found[1]} is a dict without a type. Add a plugin's name as 'type'"
    unsupported = r"could not assign an object of type '(.*?)' to key '(.*?)'"
    if found := re.search(unsupported, message):
        kind, key = found.groups()
        return f"{key} of type {kind}: must be a number, text, a tuple, a dict or a Mitsuba object"

    # Join the lines of all other errors, and shorten the text
    lines = [line.strip().removeprefix("- ") for line in message.splitlines()]
    text = " ".join(line for line in lines if line)
    return text if len(text) < LONGEST else f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
