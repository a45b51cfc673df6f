"""What identifies a render: every property, reference and file of its scene, and no name."""

import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.peer_scenes import mesh

import tofrender
from tofrender.scenes.fingerprint import content_digest, fingerprint

CORNERS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
FACES = [[0, 1, 2], [0, 2, 3]]


def write_files(folder: Path, faces=FACES, texel: float = 0.5) -> None:
    mesh(folder / "mesh.ply", np.array(CORNERS, float), np.array(faces))
    pixels = np.linspace(0, texel, 48, dtype=np.float32).reshape(4, 4, 3)
    mi.Bitmap(pixels).write(str(folder / "texture.exr"))


def scene_in(folder: Path) -> dict:
    """A scene of parts without names, whose meshes and textures are files."""
    red, blue = ({"type": "rgb", "value": v} for v in ([0.7, 0.1, 0.1], [0.1, 0.1, 0.7]))
    texture = {"type": "bitmap", "filename": str(folder / "texture.exr"), "raw": True}
    at = mi.ScalarTransform4f().translate
    return tofrender.cornell_box(width=4, height=4, temporal_bins=20) | {
        "plain": {"type": "diffuse", "reflectance": dict(red)},
        "other": {"type": "diffuse", "reflectance": dict(blue)},
        "metal": {"type": "roughconductor", "distribution": "beckmann", "alpha": 0.2},
        "plastic": {"type": "roughplastic", "nonlinear": False},
        "a": {"type": "sphere", "radius": 0.1, "bsdf": {"type": "ref", "id": "plain"}},
        "b": {"type": "sphere", "radius": 0.2, "bsdf": {"type": "ref", "id": "other"}},
        "c": {"type": "sphere", "radius": 0.3, "bsdf": {"type": "diffuse", "reflectance": red}},
        "d": {"type": "sphere", "radius": 0.4, "bsdf": {"type": "diffuse", "reflectance": blue}},
        "e": {"type": "disk", "bsdf": {"type": "diffuse", "reflectance": texture}},
        "mesh": {"type": "ply", "filename": str(folder / "mesh.ply"), "bsdf": {"type": "plastic"}},
        "p": {"type": "point", "position": [0, 0.1, 0], "intensity": dict(red)},
        "q": {"type": "point", "position": [0, 0.2, 0], "intensity": dict(blue)},
        "cube": {"type": "cube", "to_world": at([0, 0, 0.1]), "bsdf": {"type": "conductor"}},
    }


def of(scene: dict | Path, load=tofrender.load_scene) -> str:
    loaded = load(scene)
    return fingerprint(loaded, loaded.sensors()[0], loaded.integrator())


def put(*path: str, value) -> Callable[[dict, Path], None]:
    def edit(scene: dict, folder: Path) -> None:
        for name in path[:-1]:
            scene = scene[name]
        scene[path[-1]] = value

    return edit


def swap(one: str, other: str, *path: str) -> Callable[[dict, Path], None]:
    def edit(scene: dict, folder: Path) -> None:
        first, second = scene[one], scene[other]
        *inner, last = path
        for name in inner:
            first, second = first[name], second[name]
        first[last], second[last] = second[last], first[last]

    return edit


TEXTURE, FILM = ("e", "bsdf", "reflectance"), ("sensor", "film")
EDITS: dict[str, Callable[[dict, Path], None]] = {
    "material of a shape": swap("a", "b", "bsdf"),
    "colors of nameless shapes": swap("c", "d", "bsdf", "reflectance", "value"),
    "colors of lamps": swap("p", "q", "intensity", "value"),
    "distribution": put("metal", "distribution", value="ggx"),
    "sample_visible": put("metal", "sample_visible", value=False),
    "nonlinear": put("plastic", "nonlinear", value=True),
    "flip_normals of a sphere": put("a", "flip_normals", value=True),
    "flip_normals of a cube": put("cube", "flip_normals", value=True),
    "face_normals": put("mesh", "face_normals", value=True),
    "texture's filter": put(*TEXTURE, "filter_type", value="nearest"),
    "texture's wrapping": put(*TEXTURE, "wrap_mode", value="clamp"),
    "texture's bytes": lambda scene, folder: write_files(folder, texel=0.6),
    "winding": lambda scene, folder: write_files(folder, [[0, 1, 2], [0, 3, 2]]),
    "topology": lambda scene, folder: write_files(folder, [[0, 1, 3], [1, 2, 3]]),
    "film's filter": put(*FILM, "rfilter", value={"type": "gaussian"}),
    "width of the film's filter": put(*FILM, "rfilter", value={"type": "gaussian", "stddev": 0.4}),
    "sample_border": put("sensor", "film", "sample_border", value=True),
    "roughness": put("metal", "alpha", value=0.3),
    "place": put("cube", "to_world", value=mi.ScalarTransform4f().translate([0, 0, 0.11])),
    "integrator": put("integrator", "camera_unwarp", value=True),
    "field of view": put("sensor", "fov", value=40.0),
}
SILENT = {
    *("texture's filter", "texture's wrapping", "sample_visible"),
    *("flip_normals of a sphere", "flip_normals of a cube"),
}
"""What objects of Mitsuba do not tell of themselves, or not all of them."""


@pytest.mark.parametrize("load", [tofrender.load_scene, mi.load_dict], ids=["ours", "Mitsuba's"])
def test_every_edit_counts(tmp_path, load):
    """And none as another one."""
    write_files(tmp_path)
    found = {of(scene_in(tmp_path), load): "nothing"}
    for name, edit in EDITS.items():
        if load is mi.load_dict and name in SILENT:
            continue  # docs/checkpoints.md says so
        scene = scene_in(tmp_path)
        edit(scene, tmp_path)
        same = found.setdefault(of(scene, load), name)
        assert same == name
        write_files(tmp_path)


def test_names_and_places_of_files_do_not_count(tmp_path):
    found = set()
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        write_files(tmp_path / name)
        scene = scene_in(tmp_path / name)
        mesh = tmp_path / name / "mesh.ply"
        scene["mesh"]["filename"] = str(mesh.rename(mesh.with_stem(name)))
        scene = {f"{name} {key}" if key in "abcdepq" else key: v for key, v in scene.items()}
        found.add(of(scene))
    assert len(found) == 1


def test_a_shape_that_the_integrator_is_told_of_is_found_by_its_id():
    """Else a capture of another wall of the same scene would go on."""

    def walls(first: str, second: str) -> str:
        scene = tofrender.cornell_box(width=4, height=4, temporal_bins=20)
        names = {"floor": first, "back": second}
        scene = {names.get(name, name): part for name, part in scene.items()}
        return of(scene, partial(tofrender.load_scene, optimize=False))

    assert walls("relay_wall", "x") != walls("x", "relay_wall")
    assert walls("y", "x") == walls("x", "y")


def test_parameters_that_were_set_after_loading_count():
    scene = tofrender.load_scene("cornell_box", width=4, height=4)
    before = fingerprint(scene, scene.sensors()[0], scene.integrator())
    parameters = mi.traverse(scene)
    parameters["white.reflectance.value"] = [0.1, 0.2, 0.3]
    parameters.update()
    assert fingerprint(scene, scene.sensors()[0], scene.integrator()) != before


FRESH = """
import sys, mitsuba as mi
mi.set_variant(sys.argv[1])
import tofrender
from tofrender.scenes.fingerprint import content_digest, fingerprint
for source in sys.argv[2:]:
    s = tofrender.load_scene(source)
    print(fingerprint(s, s.sensors()[0], s.integrator()))
s = mi.load_dict(tofrender.cornell_box())
print(fingerprint(s, s.sensors()[0], s.integrator()))
"""


def test_another_process_finds_the_same():
    file = Path(tofrender.__file__).parents[1] / "scenes" / "cornell_box.xml"
    sources = ["cornell_box_fog", str(file)]
    command = [sys.executable, "-c", FRESH, mi.variant(), *sources]
    told = {
        subprocess.check_output(command, env=os.environ | {"PYTHONHASHSEED": seed}) for seed in "12"
    }
    assert len(told) == 1
    here = [of(tofrender.cornell_box_fog() if n == "cornell_box_fog" else Path(n)) for n in sources]
    assert told.pop().decode().split()[:2] == here


def content(described: dict) -> str:
    scene = mi.load_dict(described)
    return content_digest(scene, scene.sensors()[0])


def two_lamps(**lamp) -> dict:
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [1, 2, 3]}}
    lamps = [
        {"type": "sphere", "center": [x, 0, 0], "radius": 0.1, "emitter": emitter} for x in (-1, 1)
    ]
    lamps[1] |= lamp
    return tofrender.cornell_box(width=4, height=3) | {"a": lamps[0], "b": lamps[1]}


@pytest.mark.parametrize(
    "change",
    [{"center": [1 + 1e-6, 0, 0]}, {"flip_normals": True}, {"bsdf": {"type": "null"}}],
    ids=lambda each: next(iter(each)),
)
def test_the_content_changes_with_each_property(change):
    assert content(two_lamps()) == content(two_lamps())
    assert content(two_lamps(**change)) != content(two_lamps())


def test_the_content_depends_on_the_order_of_emitters():
    described = two_lamps()
    swapped = described | {"a": described["b"], "b": described["a"]}
    assert content(swapped) != content(described)


def test_the_content_does_not_depend_on_the_integrator_and_on_samples():
    described = two_lamps()
    other = described | {"integrator": {"type": "ao"}}
    other["sensor"] = described["sensor"] | {"sampler": {"type": "stratified", "sample_count": 9}}
    assert content(other) == content(described)
    other["sensor"] = described["sensor"] | {"shutter_open": 0.5, "shutter_close": 1.0}
    assert content(other) != content(described)


def test_the_content_has_attached_parameters():
    scene = mi.load_dict(two_lamps())
    before = content_digest(scene, scene.sensors()[0])
    parameters = mi.traverse(scene)
    key = "white.reflectance.value"
    dr.enable_grad(parameters[key])
    parameters.update()
    assert content_digest(scene, scene.sensors()[0]) == before
    parameters[key] = parameters[key] + 1e-6
    parameters.update()
    assert content_digest(scene, scene.sensors()[0]) != before
