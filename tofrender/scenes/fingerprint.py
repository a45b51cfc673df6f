"""Compute fingerprints that identify a render, from the scene's description, parameters and files.

`load_scene` stores a hash of the scene's complete description in the scene's id. Scenes that
Mitsuba has loaded have no such description. For them, the parameters and printed forms of the
objects are hashed.
"""

from __future__ import annotations

import hashlib
import re
from contextlib import suppress
from functools import cached_property
from inspect import isclass, isroutine
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.interface import POSITIONS, readable, rows
from .dangerous_files import resolved_path
from .motion import moved
from .nodes import NAMELESS, is_kind

RULE = "2-"
"""Prefix of fingerprints: the number of the rule by which they are made."""

DESCRIPTION = "description "  # Start of the id of a scene with a stored description
NOT_COUNTED = (mi.ObjectType.Film, mi.ObjectType.Sampler, mi.ObjectType.Integrator)
"""Kinds of objects that are not part of a description; a render compares or replaces them."""

WALL = "relay_wall"
"""Id by which a capture finds its relay wall. Integrators may also have ids as parameters."""

TYPE: Any = mi.Properties.Type


def fingerprint(scene: mi.Scene, sensor: mi.Sensor, integrator: Any) -> str:
    """Return a short hash of everything that a picture depends on except size, samples and seed.

    The hash covers materials, lights, meshes, textures, sensor, integrator, the film's filter and
    references. Names of parts and files are not included, except for ids that the integrator refers
    to.

    Returns:
        The text "2-" and twelve hexadecimal digits.
    """
    # The stored description, and the current parameters of scene and sensor
    described = scene.id() if scene.id().startswith(DESCRIPTION) else moved(scene)
    graph = _Graph(not described.startswith(DESCRIPTION))
    film = sensor.film()
    parts = [described, graph.digest(scene), graph.digest(sensor)]
    parts += [str(film.rfilter()), str(film.sample_border())]

    # The integrator's attributes; `hide_emitters` is not in `__dict__` of Mitsuba's base class
    attributes = {"hide_emitters": None, **getattr(integrator, "__dict__", {})}
    values = (f"{name} = {_text(getattr(integrator, name, v))}" for name, v in attributes.items())
    parts += [type(integrator).__name__, *sorted(values)]

    # Shapes that the integrator refers to by id
    referred = {WALL, *re.findall(r"[^\s,'\[\]()]+", "\n".join(parts))}
    parts += sorted(f"{s.id()}: {graph.digest(s)}" for s in scene.shapes() if s.id() in referred)
    return RULE + _hash("\n".join(parts))[:12]


def shape_digest(shape: mi.Shape) -> str:
    """Return a hash of a shape with its material, emitter and medium, independent of its id."""
    return _Graph(True).digest(shape)


def content_digest(scene: mi.Scene, sensor: mi.Sensor) -> str:
    """Return a hash of everything that a scene and a sensor contain now, without any rounding.

    Unlike `fingerprint`, the hash also depends on ids, on the size of the film, and on the order of
    emitters, vertices and faces. Plugins in Python contribute the parameters that they report to
    Mitsuba. The integrator, samplers and other properties of films are not included.
    """
    # Mitsuba merges meshes in another order each time, so that the order of shapes is arbitrary
    graph = _Graph(True, exact=True)
    parts = [scene.id(), graph.digest(scene)]

    # Emitters are chosen by their index. Therefore their order is important
    parts += [graph.digest(emitter.get_shape() or emitter) for emitter in scene.emitters()]

    # The sensor, and the size and crop of its film
    film = sensor.film()
    numbers = [*film.size(), *film.crop_size(), *film.crop_offset()]
    parts += [graph.digest(sensor), str([int(number) for number in numbers])]
    return _hash("\n".join(parts))


def _printed(node: mi.Object) -> str:
    """Return the printed form of an object without addresses, "" for plugins without this form."""
    with suppress(RuntimeError):
        return re.sub(r" at 0x[0-9a-fA-F]+", "", str(node))
    return ""


def file_digest(file: Path) -> str:
    """Return a hash of a file's bytes."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def remember_description(scene: mi.Scene, description: str) -> None:
    """Store a description in the scene's id, the only place that a scene of Mitsuba offers."""
    scene.set_id(DESCRIPTION + description)


def describe(state: Any) -> str:
    """Return a hash of all nodes of a parsed scene: plugins, properties and references.

    Files are hashed by their bytes, independent of their paths. Film, samplers and integrator are
    not included, because a render compares them separately.

    Args:
        state: State of Mitsuba's parser, with resolved references.
    """
    nodes = state.nodes
    known: dict[int, str] = {}

    def digest(index: int) -> str:
        """Return the hash of a node and of the nodes that it refers to."""
        if index not in known:
            node = nodes[index]

            # Read a copy, because Mitsuba reports properties that have not been read
            props = mi.Properties(node.props)
            kept = [props.plugin_name()]
            children = []
            for name, value in props.items():
                kind = props.type(name)
                if kind != TYPE.ResolvedReference:
                    kept.append(f"{name} = {_property(kind, name, value)}")
                elif not any(is_kind(nodes[value.index()], each) for each in NOT_COUNTED):
                    is_name = node.type == mi.ObjectType.Scene or name.startswith(NAMELESS)
                    children.append(f"{'' if is_name else name}: {digest(value.index())}")
            known[index] = _hash("\n".join([kept[0], *sorted(kept[1:]), *children]))
        return known[index]

    return digest(0)


def _property(kind: Any, name: str, value: Any) -> str:
    """Return a property of a node as text without loss of precision."""
    if kind == TYPE.String and "file" in name:
        file = resolved_path(value)
        if file.is_file():
            return file_digest(file)
    if kind == TYPE.Transform:
        return _hash(np.array(value.matrix, np.float64))
    if kind == TYPE.Spectrum:
        return f"{list(map(float, value.wavelengths))}: {list(map(float, value.values))}"
    if kind in (TYPE.Color, TYPE.Vector):
        return str([float(each) for each in value])
    return _text(value)


class _Graph:
    """Hashes of loaded objects, from their class, their parameters and their children.

    Args:
        printed: Whether the printed form of objects is hashed too. It shows flags that are not
            parameters.
        exact: Whether ids, the printed form of shapes, the order of vertices and faces, and all
            digits of transforms are hashed too.
    """

    def __init__(self, printed: bool, exact: bool = False) -> None:
        self.printed = printed
        self.exact = exact
        self._known: dict[Any, str] = {}
        self._parameters: dict[Any, dict[str, Any]] = {}

    def digest(self, root: Any) -> str:
        """Return the hash of an object and its children."""
        if root in self._known:
            return self._known[root]
        parameters: Any = readable(mi.traverse(root))
        for name, (_, _, node, _) in parameters.properties.items():
            of_node = self._parameters.setdefault(node, {})
            of_node[name.rpartition(".")[2]] = parameters[name]
        return self._digest(root)

    def _digest(self, node: Any) -> str:
        """Return the hash of a node with known parameters, and of its children."""
        if node not in self._known:
            # The children; in a scene, their names and order are arbitrary
            children = _Children()
            node.traverse(children)
            separate = mi.Film | mi.Sampler | mi.Integrator
            digests = [
                (n, self._digest(c)) for n, c in children.found if not isinstance(c, separate)
            ]
            if isinstance(node, mi.Scene):
                digests = sorted(("", digest) for _, digest in digests)

            # The printed form
            text = ""
            unprinted = mi.Scene | mi.Sensor if self.exact else mi.Scene | mi.Shape | mi.Sensor
            if self.printed and not isinstance(node, unprinted):
                text = _printed(node)
            if self.exact and isinstance(node, mi.Shape):
                text += f"{node.id()} {node.has_flipped_normals()}"

            # The parameters
            parameters = self._parameters.get(node, {})
            if "faces" in parameters and not self.exact:
                parameters = _without_order(parameters)
            digest = _exact_digest if self.exact else _digest
            values = [f"{name} = {digest(value)}" for name, value in parameters.items()]
            kind = [type(node).__name__, node.class_name(), text]
            self._known[node] = _hash("\n".join([*kind, *values, *map(str, digests)]))
        return self._known[node]


class _Children(mi.TraversalCallback):
    """Callback of a traversal that collects the children of an object with their names."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, Any]] = []

    def put(self, name: str, value: Any, flags: Any, cpptype: Any = None) -> None:
        """Collect a child. Mitsuba calls this method for each parameter and object."""
        if isinstance(value, mi.Object):
            self.found.append((name, value))


def _without_order(mesh: dict[str, Any]) -> dict[str, Any]:
    """Replace the faces of a mesh by a hash that does not depend on the order of faces.

    Mitsuba merges meshes in arbitrary order, and the order determines the indices of vertices.
    Therefore each face is represented by the attributes at its corners.
    """
    faces = np.array(mesh["faces"]).reshape(-1, 3)
    count = len(rows(mesh, POSITIONS))

    # Collect the attributes at the corners of each face
    rest = {}
    corners = []
    for name, value in mesh.items():
        attribute = name.startswith(("vertex_", "face_")) and dr.is_array_v(value) and len(faces)
        if name.startswith("vertex_") and attribute:
            at = np.array(value).reshape(count, -1)
            corners.append(at[faces].reshape(len(faces), -1))
        elif attribute:
            corners.append(np.array(value).reshape(len(faces), -1))
        elif name != "faces":
            rest[name] = value

    # Project each face to one random number, and hash the sorted numbers
    if corners:
        table = np.ascontiguousarray(np.hstack(corners), np.float32).view(np.uint32)
        random = hashlib.shake_128(b"corners").digest(8 * table.shape[1])
        numbers = table.astype(np.uint64) @ (np.frombuffer(random, np.uint64) | np.uint64(1))
        rest["faces"] = _hash(np.sort(numbers))
    return rest


def _text(value: Any, depth: int = 5) -> str:
    """Return a parameter of an integrator as text.

    Shapes are represented by their ids, and other objects by their attributes, down to `depth`
    levels. For objects with their own `repr`, such as pulses, the text has the `repr` and the
    public attributes.
    """
    if isinstance(value, list | tuple):
        return f"[{', '.join(_text(each, depth) for each in value)}]"
    if isinstance(value, np.ndarray):
        return f"{value.shape} {_hash(value)}"
    if isinstance(value, mi.Shape):
        return value.id()
    if isinstance(value, mi.Bitmap):
        return f"{value.pixel_format()} {value.srgb_gamma()} {_text(np.array(value))}"
    if isinstance(value, mi.VolumeGrid):
        return _text(np.array(value))
    if isinstance(value, mi.Object) and type(value).__module__.startswith("mitsuba"):
        return _Graph(True).digest(value)
    if not depth or isroutine(value) or isclass(value) or not hasattr(value, "__dict__"):
        return _digest(value)
    kind = type(value)
    without_repr = kind.__repr__ is object.__repr__
    inside = ", ".join(
        f"{name} = {_text(each, depth - 1)}"
        for name, each in vars(value).items()
        if (without_repr or name[0] != "_")
        and not isinstance(getattr(kind, name, 0), cached_property)
    )
    return f"{kind.__name__ if without_repr else value}({inside})"


def _digest(value: Any) -> str:
    """Return a parameter as text, with a hash for arrays."""
    if not dr.is_array_v(value) or dr.is_special_v(value):
        return re.sub(r" at 0x[0-9a-fA-F]+", "", str(value))
    array = np.array(value)
    return f"{array.shape} {_hash(array)}"


def _exact_digest(value: Any) -> str:
    """Return a parameter as text with all digits, with a hash for arrays and transforms."""
    array = getattr(value, "matrix", value)
    if not dr.is_array_v(array):
        return repr(value)
    array = np.array(array)
    return f"{array.shape} {array.dtype.str} {_hash(array)}"


def _hash(content: np.ndarray | str) -> str:
    """Return the SHA-256 hash of a text or of an array's bytes."""
    text = content.encode() if isinstance(content, str) else np.ascontiguousarray(content).tobytes()
    return hashlib.sha256(text).hexdigest()
