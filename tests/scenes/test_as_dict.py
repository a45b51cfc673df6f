"""XML files as dicts: the same scene, part by part."""

import re
from pathlib import Path

import mitsuba as mi
import pytest
from helpers.scenes import refusal

from tofrender.scenes.as_dict import scene_as_dict
from tofrender.scenes.fingerprint import fingerprint
from tofrender.scenes.loading import load_scene

ROOT = Path(__file__).parents[2] / "scenes"
FILES = sorted(ROOT.rglob("*.xml"))

SHARED = """
<scene version="3.0.0">
    <shape type="sphere" id="one">
        <point name="center" x="1" y="2" z="3"/>
        <bsdf type="twosided"><bsdf type="diffuse" id="inner">
            <spectrum name="reflectance" value="400:0.1, 700:0.5"/></bsdf></bsdf>
        <emitter type="area"><spectrum name="radiance" value="2.5"/></emitter>
    </shape>
    <shape type="sphere" name="two"><ref id="inner"/></shape>
    <shape type="sphere"/><shape type="sphere"/>
</scene>
"""


def values(scene: mi.Scene) -> list[str]:
    """All parameters without the names of those who have them, which files leave out."""
    found = mi.traverse(scene)
    texts = (f"{name.rsplit('.', 1)[-1]} {found[name]}" for name in list(found.keys()))
    return sorted(re.sub(r"object_\d+", "object", text) for text in texts)


@pytest.mark.parametrize("file", FILES, ids=lambda path: path.stem)
def test_a_dict_is_its_file(file):
    one, other = (load_scene(s, optimize=False) for s in (file, scene_as_dict(file)))
    assert values(one) == values(other)
    assert sorted(s.id() for s in one.shapes()) == sorted(s.id() for s in other.shapes())
    cameras = [scene.sensors()[0] for scene in (one, other)]
    assert list(cameras[0].film().size()) == list(cameras[1].film().size())
    assert len(fingerprint(other, cameras[1], other.integrator())) == 14


def test_what_is_shared_stays_shared(tmp_path):
    path = tmp_path / "shared.xml"
    path.write_text(SHARED)
    found = scene_as_dict(path)
    assert found["one"]["bsdf"]["inner"] == {"type": "ref", "id": "inner"}
    assert found["two"]["inner"] == {"type": "ref", "id": "inner"}
    assert found["inner"]["reflectance"]["value"] == [(400.0, 0.1), (700.0, 0.5)]
    assert found["one"]["emitter"]["radiance"] == {"type": "spectrum", "value": 2.5}
    assert {"shape", "shape_2"} < set(found)
    assert len(mi.load_dict(found).shapes()) == 4


def test_wrong_files_are_refused(tmp_path):
    said = refusal(scene_as_dict, tmp_path / "no.xml", kind=FileNotFoundError)
    assert "no.xml" in said
    said = refusal(scene_as_dict, ROOT / "cornell_box.xml", {"depth": 3})
    assert said.startswith("parameter depth = '3': cornell_box.xml")
