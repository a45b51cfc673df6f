"""Convert scenes in XML files to dicts for `mi.load_dict`, so that users can edit parts by name."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi

from .loading import parse_file_of
from .nodes import NAMELESS, references
from .parts import Dict, ref, rgb

parser: Any = mi.parser
TYPE: Any = mi.Properties.Type


def scene_as_dict(path: Path, parameters: Mapping[str, Any] | None = None) -> Dict:
    """Return the scene of an XML file as a dict.

    The key of a part is its id. A part without an id gets its kind as key (`sensor`, `film`,
    `bsdf`), and further parts of the same kind a number (`bsdf_2`). Names of files become absolute
    paths.

    Example:
        >>> import tofrender
        >>> file = Path(tofrender.__file__).parents[1] / "scenes" / "cornell_box.xml"
        >>> scene = scene_as_dict(file, {"max_depth": 4})
        >>> scene["integrator"], scene["light"]["emitter"]["radiance"]["value"]
        ({'type': 'transient_path', 'max_depth': 4}, [18.387, 13.9873, 6.75357])
    """
    state = parse_file_of(path, parameters or {})
    reader = _Reader(state.nodes, path.absolute().parent)
    scene = reader.node(0, inside=False)

    # Nodes that several parts refer to become parts of the scene
    for index, name in reader.shared.items():
        if scene.get(name, {}).get("type") in (None, "ref"):
            scene[name] = reader.node(index)
    return scene


class _Reader:
    """Converter of the nodes of a parsed scene to dicts.

    Attributes:
        nodes: The nodes of Mitsuba's parser; node 0 is the scene.
        folder: Folder of the XML file. Names of files are relative to this folder.
        shared: Names of the nodes that several nodes refer to, by index.
    """

    def __init__(self, nodes: Any, folder: Path) -> None:
        self.nodes = nodes
        self.folder = folder
        owners = Counter(index for node in nodes for _, index in references(node.props))
        shared = (index for index, count in owners.items() if count > 1)
        self.shared = {index: str(nodes[index].props.id() or f"shared_{index}") for index in shared}

    def node(self, index: int, inside: bool = True) -> Dict:
        """Return a node as a dict. Below the scene, shared nodes become references."""
        node = self.nodes[index]
        found: Dict = {"type": node.props.plugin_name()}
        for name, value in node.props.items():
            if isinstance(value, mi.Properties.ResolvedReference):
                child = value.index()
                key = self._key(found, name, child)
                shared = inside and child in self.shared
                found[key] = ref(self.shared[child]) if shared else self.node(child)
            else:
                found[name] = self._plain(node.props.type(name), name, value)
        return found

    def _key(self, found: Dict, name: str, index: int) -> str:
        """Return the key of a part in the dict `found` of its owner."""
        if not name.startswith(NAMELESS):
            return name

        # The id or the kind, with a number if this key exists
        node = self.nodes[index]
        kind = {"ReconstructionFilter": "rfilter"}.get(node.type.name, node.type.name.lower())
        base = str(node.props.id() or kind)
        key = base
        number = 2
        while key in found:
            key = f"{base}_{number}"
            number += 1
        return key

    def _plain(self, kind: Any, name: str, value: Any) -> Any:
        """Return the value of a property in the form that `mi.load_dict` expects."""
        if kind == TYPE.Color:
            return rgb([float(x) for x in value])
        if kind == TYPE.Vector:
            return [float(x) for x in value]
        if kind == TYPE.Spectrum:
            if value.is_uniform():
                return {"type": "spectrum", "value": float(value.values[0])}
            pairs = zip(value.wavelengths, value.values, strict=True)
            return {"type": "spectrum", "value": [(float(w), float(v)) for w, v in pairs]}
        if name == "filename" and (self.folder / str(value)).exists():
            return str(self.folder / str(value))
        return value
