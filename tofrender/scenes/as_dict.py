"""XML files as dicts for `mi.load_dict`, whose parts can be changed by name."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi

from .loading import parse_file_of
from .nodes import NAMELESS, references
from .parts import Dict, ref, rgb

parser: Any = mi.parser
KIND: Any = mi.Properties.Type


def scene_as_dict(path: Path, parameters: Mapping[str, Any] | None = None) -> Dict:
    """The scene of an XML file as a dict.

    Parts go by their ids, those without by what they are (`sensor`, `film`, `bsdf`), with a number
    from the second one on. Names of files become whole paths.

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
    for index, name in reader.shared.items():  # What several parts share stands in the scene too
        if scene.get(name, {}).get("type") in (None, "ref"):
            scene[name] = reader.node(index)
    return scene


class _Reader:
    def __init__(self, nodes: Any, folder: Path) -> None:
        self.nodes, self.folder = nodes, folder
        owners = Counter(index for node in nodes for _, index in references(node.props))
        shared = (index for index, count in owners.items() if count > 1)
        self.shared = {index: str(nodes[index].props.id() or f"shared_{index}") for index in shared}

    def node(self, index: int, inside: bool = True) -> Dict:
        """A node as a dict; within the scene, shared nodes are references."""
        node = self.nodes[index]
        found: Dict = {"type": node.props.plugin_name()}
        for name, value in node.props.items():
            if isinstance(value, mi.Properties.ResolvedReference):
                which = value.index()
                key = self._key(found, name, which)
                shared = inside and which in self.shared
                found[key] = ref(self.shared[which]) if shared else self.node(which)
            else:
                found[name] = self._plain(node.props.type(name), name, value)
        return found

    def _key(self, found: Dict, name: str, index: int) -> str:
        """The name of a part in its owner."""
        if not name.startswith(NAMELESS):
            return name
        node = self.nodes[index]
        kind = {"ReconstructionFilter": "rfilter"}.get(node.type.name, node.type.name.lower())
        base = str(node.props.id() or kind)
        key, number = base, 2
        while key in found:
            key, number = f"{base}_{number}", number + 1
        return key

    def _plain(self, kind: Any, name: str, value: Any) -> Any:
        if kind == KIND.Color:
            return rgb([float(x) for x in value])
        if kind == KIND.Vector:
            return [float(x) for x in value]
        if kind == KIND.Spectrum:
            if value.is_uniform():
                return {"type": "spectrum", "value": float(value.values[0])}
            pairs = zip(value.wavelengths, value.values, strict=True)
            return {"type": "spectrum", "value": [(float(w), float(v)) for w, v in pairs]}
        if name == "filename" and (self.folder / str(value)).exists():
            return str(self.folder / str(value))
        return value
