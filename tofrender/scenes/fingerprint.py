"""Identify a render by the scene's resolved description, its parameters, and the bytes of files.

A scene that the package loads remembers its description as its id, so that all properties count.
Of one that Mitsuba has loaded, only its objects' parameters and texts can be hashed.
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
from .files import resolved_path
from .motion import moved
from .nodes import NAMELESS, is_kind

RULE = "2-"
"""Prefix of fingerprints; those of the first rule, without it, distinguished fewer scenes."""

DESCRIPTION = "description "
NOT_COUNTED = (mi.ObjectType.Film, mi.ObjectType.Sampler, mi.ObjectType.Integrator)
"""Kinds of objects that a render compares by itself, or may replace."""

WALL = "relay_wall"
"""The id by which a capture finds its wall; integrators may have ids of shapes as parameters."""

TYPE: Any = mi.Properties.Type


def fingerprint(scene: mi.Scene, sensor: mi.Sensor, integrator: Any) -> str:
    """A short hash of all that a picture depends on, but for the film's size, samples and seed.

    Materials, lights, meshes, textures, sensor, integrator, the film's filter and references count;
    names of parts and files do not, but for ids that the integrator refers to. Returns "2-" and
    twelve hexadecimal digits.
    """
    described = scene.id() if scene.id().startswith(DESCRIPTION) else moved(scene)
    graph, film = _Graph(not described.startswith(DESCRIPTION)), sensor.film()
    parts = [described, graph.digest(scene), graph.digest(sensor)]
    parts += [str(film.rfilter()), str(film.sample_border())]
    own = {"hide_emitters": None, **getattr(integrator, "__dict__", {})}  # Mitsuba keeps the first
    values = (f"{name} = {_text(getattr(integrator, name, v))}" for name, v in own.items())
    parts += [type(integrator).__name__, *sorted(values)]
    referred = {WALL, *re.findall(r"[^\s,'\[\]()]+", "\n".join(parts))}
    parts += sorted(f"{s.id()}: {graph.digest(s)}" for s in scene.shapes() if s.id() in referred)
    return RULE + _hash("\n".join(parts))[:12]


def shape_digest(shape: mi.Shape) -> str:
    """A hash of a shape with its material, emitter and medium, whatever its id."""
    return _Graph(True).digest(shape)


def file_digest(file: Path) -> str:
    """A hash of a file's bytes."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def remember_description(scene: mi.Scene, description: str) -> None:
    """Store a description in a scene's id; objects of Mitsuba have no other place for it."""
    scene.set_id(DESCRIPTION + description)


def describe(state: Any) -> str:
    """A hash of all nodes of a parsed scene, references resolved: plugins, properties, references.

    Of files it is their bytes that count, wherever they lie. Film, samplers and the integrator are
    left out: the render says these.
    """
    nodes, known = state.nodes, {}

    def digest(index: int) -> str:
        if index not in known:
            node = nodes[index]
            props = mi.Properties(node.props)  # Mitsuba tells of properties that nobody reads
            kept, children = [props.plugin_name()], []
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
    """A property of a node as text, without loss."""
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
    """Hashes of loaded objects: their class, their parameters, and their children.

    `printed` says whether their printed form counts, too: flags that are no parameters.
    """

    def __init__(self, printed: bool) -> None:
        self.printed = printed
        self._known: dict[Any, str] = {}
        self._parameters: dict[Any, dict[str, Any]] = {}

    def digest(self, root: Any) -> str:
        parameters: Any = readable(mi.traverse(root))
        for name, (_, _, node, _) in parameters.properties.items():
            own = self._parameters.setdefault(node, {})
            own[name.rpartition(".")[2]] = parameters[name]
        return self._digest(root)

    def _digest(self, node: Any) -> str:
        if node not in self._known:
            children = _Children()
            node.traverse(children)
            separate = mi.Film | mi.Sampler | mi.Integrator
            digests = [
                (n, self._digest(c)) for n, c in children.found if not isinstance(c, separate)
            ]
            if isinstance(node, mi.Scene):  # Named by ids or addresses, and in any order
                digests = sorted(("", digest) for _, digest in digests)
            text = ""
            if self.printed and not isinstance(node, mi.Scene | mi.Shape | mi.Sensor):
                with suppress(RuntimeError):  # Python plugins need not describe themselves
                    text = re.sub(r" at 0x[0-9a-fA-F]+", "", str(node))
            own = self._parameters.get(node, {})
            if "faces" in own:
                own = _without_order(own)
            values = [f"{name} = {_digest(value)}" for name, value in own.items()]
            kind = [type(node).__name__, node.class_name(), text]
            self._known[node] = _hash("\n".join([*kind, *values, *map(str, digests)]))
        return self._known[node]


class _Children(mi.TraversalCallback):
    """Children of an object by name."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, Any]] = []

    def put(self, name: str, value: Any, flags: Any, cpptype: Any = None) -> None:
        """Called by Mitsuba for each parameter and object."""
        if isinstance(value, mi.Object):
            self.found.append((name, value))


def _without_order(mesh: dict[str, Any]) -> dict[str, Any]:
    """Parameters of a mesh, its faces hashed by the attributes at their corners, in any order.

    Meshes that Mitsuba merges come in any order, and number their vertices by it.
    """
    faces = np.array(mesh["faces"]).reshape(-1, 3)
    count = len(rows(mesh, POSITIONS))
    rest, corners = {}, []
    for name, value in mesh.items():
        attribute = name.startswith(("vertex_", "face_")) and dr.is_array_v(value) and len(faces)
        if name.startswith("vertex_") and attribute:
            at = np.array(value).reshape(count, -1)
            corners.append(at[faces].reshape(len(faces), -1))
        elif attribute:
            corners.append(np.array(value).reshape(len(faces), -1))
        elif name != "faces":
            rest[name] = value
    if corners:
        table = np.ascontiguousarray(np.hstack(corners), np.float32).view(np.uint32)
        random = hashlib.shake_128(b"corners").digest(8 * table.shape[1])
        numbers = table.astype(np.uint64) @ (np.frombuffer(random, np.uint64) | np.uint64(1))
        rest["faces"] = _hash(np.sort(numbers))
    return rest


def _text(value: Any, depth: int = 5) -> str:
    """A parameter as text: shapes by their ids, other objects by their attributes.

    Of objects that print themselves, like pulses of the package, their text and what is public.
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
    kind, silent = type(value), type(value).__repr__ is object.__repr__
    inside = ", ".join(
        f"{name} = {_text(each, depth - 1)}"
        for name, each in vars(value).items()
        if (silent or name[0] != "_") and not isinstance(getattr(kind, name, 0), cached_property)
    )
    return f"{kind.__name__ if silent else value}({inside})"


def _digest(value: Any) -> str:
    """A parameter as text; arrays by a hash."""
    if not dr.is_array_v(value) or dr.is_special_v(value):
        return re.sub(r" at 0x[0-9a-fA-F]+", "", str(value))
    array = np.array(value)
    return f"{array.shape} {_hash(array)}"


def _hash(content: np.ndarray | str) -> str:
    text = content.encode() if isinstance(content, str) else np.ascontiguousarray(content).tobytes()
    return hashlib.sha256(text).hexdigest()
