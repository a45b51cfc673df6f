"""Compute the references of tofbench again: python -m benchmarks.tofbench_references [NAME ...].

Scenes are read from benchmarks/tofbench/data/NAME.json; bins go to NAME.npz, and the scene for
Mitsuba to NAME.xml.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import numpy as np

from .tofbench.adapters import mitsuba_scenes as scenes
from .tofbench.cases import Case
from .tofbench.references import DATA
from .tofbench.running import describe, rendered

RUNS = 16
SAMPLES = 8192
TAGS = {
    "integrator": ("transient_path", "transient_volpath"),
    "sensor": ("perspective",),
    "film": ("transient_hdr_film",),
    "rfilter": ("box",),
    "sampler": ("independent",),
    "shape": ("rectangle", "sphere", "cube"),
    "emitter": ("area", "point"),
    "medium": ("homogeneous",),
    "phase": ("isotropic", "hg"),
    "bsdf": ("diffuse", "conductor", "roughconductor", "dielectric", "null"),
}
TAG_OF = {kind: tag for tag, kinds in TAGS.items() for kind in kinds}
KINDS = {bool: "boolean", int: "integer", float: "float", str: "string"}


def add(name: str, value, parent: Element) -> None:
    """Add a value of a dict for `mi.load_dict` to an XML element."""
    if isinstance(value, dict) and value["type"] == "rgb":
        SubElement(parent, "rgb", name=name, value=", ".join(map(str, value["value"])))
    elif isinstance(value, dict):
        node = SubElement(parent, TAG_OF[value["type"]], type=value["type"], name=name)
        for key, each in value.items():
            if key != "type":
                add(key, each, node)
    elif isinstance(value, list | tuple):
        SubElement(parent, "point", name=name, value=", ".join(map(str, value)))
    elif type(value) in KINDS:
        text = str(value).lower() if isinstance(value, bool) else str(value)
        SubElement(parent, KINDS[type(value)], name=name, value=text)
    else:
        matrix = " ".join(f"{x:.9g}" for x in np.ravel(value.matrix))
        SubElement(SubElement(parent, "transform", name=name), "matrix", value=matrix)


def write_xml(scene: dict, bins: dict, path: Path) -> None:
    """Write the scene, with the film and integrator of transient renderers."""
    scenes.start()
    kind = {"type": "transient_volpath" if scene["media"] else "transient_path"}
    root = Element("scene", version="3.0.0")
    for name, value in scenes.dictionary(scene, kind, scenes.film_of(bins)).items():
        if name != "type":
            add(name, value, root)
    indent(root)
    ElementTree(root).write(path, encoding="unicode")


def main(names: list[str]) -> None:
    """Compute and write references; by default all references."""
    renderer = describe("tofrender")
    for path in [DATA / f"{name}.json" for name in names] or sorted(DATA.glob("*.json")):
        # Write the scene
        described = json.loads(path.read_text(encoding="utf-8"))
        scene = described["scene"]
        bins = described["bins"]
        write_xml(scene, bins, path.with_suffix(".xml"))

        # Render independent runs
        case = Case(path.stem, "", "", scene, bins, lambda: np.zeros(0), samples=SAMPLES)
        with tempfile.TemporaryDirectory() as folder:
            [(_, result)] = rendered(renderer, [case], RUNS, 1.0, Path(folder))
        if isinstance(result, str):
            sys.exit(f"{path.stem}: {result}")

        # Write mean and standard error
        mean = result[0].mean(axis=0)
        error = result[0].std(axis=0, ddof=1) / np.sqrt(RUNS)
        np.savez_compressed(
            path.with_suffix(".npz"),
            mean=mean.astype(np.float32),
            standard_error=error.astype(np.float32),
        )
        described["by"] = f"{renderer.version}, {RUNS} runs of {SAMPLES} samples per pixel"
        path.write_text(json.dumps(described, indent=1) + "\n", encoding="utf-8")
        print(f"{path.stem} {mean.sum():.6g}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
