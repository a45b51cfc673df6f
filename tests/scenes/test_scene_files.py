"""Files that would end the process if Mitsuba read them are refused in one line."""

import struct
import time
from pathlib import Path

import mitsuba as mi
import pytest
from helpers.scenes import refusal as refused

from tofrender.scenes.files import MAX_NESTING, require_indices
from tofrender.scenes.loading import load_scene

BUNNY = Path(__file__).parents[2] / "scenes" / "meshes" / "bunny.ply"
CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]


def refusal(source, **options) -> str:
    return refused(load_scene, source, **options)


def ply(path: Path, form: str, faces, index: str = "int", more: bool = False) -> dict:
    """A scene with four vertices and the given triangles, in one of PLY's three forms."""
    codes = {"int": "i", "uint": "I", "ushort": "H", "uchar": "B"}
    extra = ["property uchar shade"] if more else []
    header = [
        *("ply", f"format {form} 1.0", "comment faces", f"element vertex {len(CORNERS)}"),
        *("property float x", "property float y", "property float z", *extra),
        *(f"element face {len(faces)}", *extra, f"property list uchar {index} vertex_indices"),
        "end_header\n",
    ]
    shades = [7] if more else []
    rows = [("3f" + "B" * more, [*corner, *shades]) for corner in CORNERS]
    rows += [
        ("B" * more + f"B{len(face)}{codes[index]}", [*shades, len(face), *face]) for face in faces
    ]
    if form == "ascii":
        body = "".join(" ".join(map(str, row)) + "\n" for _, row in rows).encode()
    else:
        order = "<" if "little" in form else ">"
        body = b"".join(struct.pack(order + codes, *row) for codes, row in rows)
    path.write_bytes("\n".join(header).encode() + body)
    return {"type": "scene", "mesh": {"type": "ply", "filename": str(path)}}


FORMS = ("ascii", "binary_little_endian", "binary_big_endian")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("more", [False, True])
def test_faces_must_have_the_vertices_of_their_file(form, more, tmp_path):
    """Far out of range would end the process; near is a triangle to nowhere, or memory's."""
    path = tmp_path / "mesh.ply"
    for face in ((0, 1, 4), (0, 4, 1), (70_000_000, 1, 2), (0, -1, 2)):
        said = refusal(ply(path, form, [(0, 1, 2), face], more=more))
        wrong = next(k for k in face if not 0 <= k < 4)
        assert said == (
            f"{path}: its face 1 has the vertex {wrong}; must be one of its vertices, 0 to 3"
        )
    for index in ("int", "uint", "ushort", "uchar"):
        good = ply(path, form, [(0, 1, 2), (1, 3, 2)], index, more)
        require_indices(str(path))
        if not more:
            assert load_scene(good).shapes()[0].face_count() == 2


def test_a_mesh_beside_the_scene_file(tmp_path):
    ply(tmp_path / "mesh.ply", "ascii", [(0, 1, 9)])
    shape = '<shape type="ply"><string name="filename" value="mesh.ply"/></shape>'
    path = tmp_path / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{shape}</scene>', encoding="utf-8")
    assert refusal(path).startswith("mesh.ply: its face 0 has the vertex 9; must be")


@pytest.mark.parametrize("form", FORMS)
def test_other_faults_of_meshes_are_mitsubas_to_tell(form, tmp_path):
    path = tmp_path / "mesh.ply"
    assert "mesh.ply" in refusal(ply(path, form, [(0, 1, 2, 3)]))
    whole = ply(path, form, [(0, 1, 2), (0, 1, 3)])
    path.write_bytes(path.read_bytes()[:-7])
    assert "mesh.ply" in refusal(whole)
    for content in (b"", b"ply\n", b"solid", path.read_bytes().replace(b"uchar", b"quark")):
        path.write_bytes(content)
        assert "mesh.ply" in refusal(whole)


def test_obj_files_are_refused_by_mitsuba(tmp_path):
    path = tmp_path / "mesh.obj"
    for face in ("1 2 9", "-1 -2 -9", "0 1 2"):
        path.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf {face}\n", encoding="ascii")
        said = refusal({"type": "scene", "mesh": {"type": "obj", "filename": str(path)}})
        assert "reference to invalid vertex" in said


def test_the_check_of_a_mesh_is_fast():
    start = time.process_time()
    for _ in range(10):
        require_indices(str(BUNNY))
    assert time.process_time() - start < 0.2


def nested(path: Path, depth: int, inner: str = "") -> Path:
    tags = '<shape type="x">' * depth, "</shape>" * depth
    text = f'<scene version="3.0.0">\n{tags[0]}{inner}{tags[1]}</scene>'
    path.write_text(text, encoding="utf-8")
    return path


def test_tags_within_each_other(tmp_path):
    path = tmp_path / "scene.xml"
    for depth in (MAX_NESTING, 20_000):
        assert refusal(nested(path, depth)) == (
            f"scene = {str(path)!r}: has more than {MAX_NESTING} tags within each other in line 2; "
            "must have fewer"
        )
    assert 'Plugin "x" not found' in refusal(nested(path, MAX_NESTING - 1))


def test_tags_of_a_file_that_is_included(tmp_path):
    nested(tmp_path / "deep.xml", 20_000)
    path = tmp_path / "scene.xml"
    names = '<default name="which" value="deep"/>', '<include filename="$which.xml"/>'
    path.write_text(f'<scene version="3.0.0">{"".join(names)}</scene>', encoding="utf-8")
    assert "deep.xml': has more than" in refusal(path)
    path.write_text(f'<scene version="3.0.0">{names[1]}</scene>', encoding="utf-8")
    assert "deep.xml': has more than" in refusal(path, parameters={"which": "deep"})
    path.write_text('<scene version="3.0.0"><include filename="scene.xml"/></scene>')
    assert "scene.xml" in refusal(path)


def test_dicts_within_each_other():
    def scene(depth: int) -> dict:
        material: dict = {"type": "diffuse"}
        for _ in range(depth):
            material = {"type": "mask", "bsdf": material}
        return {"type": "scene", "ball": {"type": "sphere", "bsdf": material}}

    assert refusal(scene(20_000)) == f"scene: has more than {MAX_NESTING} dicts within each other"
    assert isinstance(load_scene(scene(20)), mi.Scene)
