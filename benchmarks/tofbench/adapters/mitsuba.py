"""Mitsuba's steady integrators: sums over time."""

from __future__ import annotations

import numpy as np

from . import mitsuba_scenes as scenes

INSTALL = "pip install mitsuba"
ABILITIES = scenes.FEATURES | {"steady", "inside", "half-space"}


def version() -> str:
    import mitsuba

    return f"Mitsuba {mitsuba.__version__}"


@scenes.cached
def _load(scene: dict):
    mi = scenes.start()
    kind = {"type": "volpath" if scenes.has_media(scene) else "path"}
    film = {"type": "hdrfilm", "pixel_format": "rgb", "component_format": "float32"}
    return mi.load_dict(scenes.dictionary(scene, kind, film), parallel=False, optimize=False)


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    mi = scenes.start()
    return np.array(mi.render(_load(scene), spp=samples, seed=seed))[..., :1]


TAGS = {
    "integrator": ("transient_path", "transient_volpath"),
    "sensor": ("perspective", "thinlens", "irradiancemeter"),
    "film": ("transient_hdr_film",),
    "rfilter": ("box",),
    "sampler": ("independent",),
    "shape": ("rectangle", "sphere", "cube", "disk"),
    "emitter": ("area", "point", "constant"),
    "medium": ("homogeneous",),
    "phase": ("isotropic", "hg", "rayleigh"),
    "bsdf": ("diffuse", "conductor", "roughconductor", "dielectric", "null", "twosided"),
    "rgb": ("rgb",),
}
TAG_OF = {kind: tag for tag, kinds in TAGS.items() for kind in kinds}


def _xml(name: str, value, parent) -> None:
    """A value of a dict as a child of an element."""
    from xml.etree.ElementTree import SubElement

    if isinstance(value, dict):
        tag = TAG_OF[value["type"]]
        if tag == "rgb":
            SubElement(parent, tag, name=name, value=", ".join(map(str, value["value"])))
            return
        node = SubElement(parent, tag, type=value["type"], name=name)
        for key, each in value.items():
            if key != "type":
                _xml(key, each, node)
    elif hasattr(value, "matrix"):
        node = SubElement(parent, "transform", name=name)
        SubElement(node, "matrix", value=" ".join(f"{x:.9g}" for x in np.ravel(value.matrix)))
    elif isinstance(value, list | tuple):
        SubElement(parent, "point", name=name, value=", ".join(map(str, value)))
    else:
        kinds = {bool: "boolean", int: "integer", float: "float", str: "string"}
        text = str(value).lower() if isinstance(value, bool) else str(value)
        SubElement(parent, kinds[type(value)], name=name, value=text)


def write_xml(scene: dict, bins: dict, path: str) -> None:
    """The scene as Mitsuba's XML, with the film and integrator of transient renderers."""
    from xml.etree.ElementTree import Element, ElementTree, indent

    scenes.start()
    kind = {"type": "transient_volpath" if scenes.has_media(scene) else "transient_path"}
    root = Element("scene", version="3.0.0")
    for name, value in scenes.dictionary(scene, kind, scenes.film_of(bins)).items():
        if name != "type":
            _xml(name, value, root)
    indent(root)
    ElementTree(root).write(path, encoding="unicode")
