"""Files that would end the process if Mitsuba read them are refused in one line."""

import os
import struct
import time
from pathlib import Path

import mitsuba as mi
import pytest
from helpers.scenes import refusal as refused

from tofrender.scenes.dangerous_files import MAX_NESTING, require_indices, require_shallow_xml
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
        assert said.startswith(f"{path}: face 1 refers to vertex {wrong}, ")
        assert "vertices 0 to 3" in said
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
    assert refusal(path).startswith("mesh.ply: face 0 refers to vertex 9, ")


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
        line = refusal(nested(path, depth))
        assert line.startswith(f"scene = {str(path)!r}: more than {MAX_NESTING} tags")
        assert "line 2" in line
    assert 'Plugin "x" not found' in refusal(nested(path, MAX_NESTING - 1))


def test_tags_of_a_file_that_is_included(tmp_path):
    nested(tmp_path / "deep.xml", 20_000)
    path = tmp_path / "scene.xml"
    names = '<default name="which" value="deep"/>', '<include filename="$which.xml"/>'
    path.write_text(f'<scene version="3.0.0">{"".join(names)}</scene>', encoding="utf-8")
    assert "deep.xml': more than" in refusal(path)
    path.write_text(f'<scene version="3.0.0">{names[1]}</scene>', encoding="utf-8")
    assert "deep.xml': more than" in refusal(path, parameters={"which": "deep"})
    path.write_text('<scene version="3.0.0"><include filename="scene.xml"/></scene>')
    assert "scene.xml" in refusal(path)


def test_dicts_within_each_other():
    def scene(depth: int) -> dict:
        material: dict = {"type": "diffuse"}
        for _ in range(depth):
            material = {"type": "mask", "bsdf": material}
        return {"type": "scene", "ball": {"type": "sphere", "bsdf": material}}

    assert refusal(scene(20_000)).startswith(f"scene: more than {MAX_NESTING} dicts")
    assert isinstance(load_scene(scene(20)), mi.Scene)


def include(*names: str) -> str:
    tags = "".join(f'<include filename="{name}"/>\n' for name in names)
    return f'<scene version="3.0.0">\n{tags}</scene>'


def test_a_file_that_includes_itself(tmp_path):
    """Directly, or through another file and a parameter; three times a level would take hours."""
    path = tmp_path / "scene.xml"
    path.write_text(include("scene.xml", "scene.xml", "scene.xml"))
    said = refusal(path)
    assert said.startswith(f"scene = {str(path)!r}: scene.xml includes itself, in line 2 of ")
    (tmp_path / "sub").mkdir()
    path.write_text(include("sub/a.xml"))
    (tmp_path / "sub" / "a.xml").write_text(include("$next", "$next"))
    assert "scene.xml includes itself" in refusal(path, parameters={"next": "sub/../scene.xml"})


def test_files_that_include_too_many(tmp_path):
    """3^12 files, none of which includes itself."""
    for level in range(12):
        name = f"{level + 1}.xml"
        (tmp_path / f"{level}.xml").write_text(include(name, name, name))
    (tmp_path / "12.xml").write_text(include())
    assert "includes more than 1000 files" in refusal(tmp_path / "0.xml")


def test_one_file_may_be_included_twice(tmp_path):
    (tmp_path / "empty.xml").write_text(include())
    (tmp_path / "both.xml").write_text(include("empty.xml"))
    path = tmp_path / "scene.xml"
    path.write_text(include("empty.xml", "both.xml", "empty.xml"))
    assert isinstance(load_scene(path), mi.Scene)


def test_a_name_to_include_is_short(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(include("a" * 5000))
    assert "include: filename = 'aaa" in refusal(path)


@pytest.mark.parametrize("where", ["attribute", "comment"])
def test_long_text_takes_time_by_its_length(tmp_path, where):
    """Four million characters take tens of milliseconds; ten seconds if time goes by its square."""
    text = "a" * 4_000_000
    inner = f"<!-- {text} -->" if where == "comment" else f'<default name="x" value="{text}"/>'
    path = tmp_path / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{inner}</scene>')
    start = time.process_time()
    require_shallow_xml(path, {})
    assert time.process_time() - start < 2


NOT_UTF8 = b"sc\xff\xe9ne"


@pytest.mark.skipif(os.name != "posix", reason="names of files are text there")
def test_a_path_that_is_not_utf8(tmp_path):
    name = os.fsdecode(NOT_UTF8)
    folder = tmp_path / name
    folder.mkdir()
    ending = "is not valid UTF-8, which Mitsuba cannot read. Rename the file or the folder"
    for path in (tmp_path / f"{name}.xml", folder / "scene.xml"):
        path.write_text(include())
        assert refusal(path) == f"scene = {str(path)!r}: {ending}"
        assert refusal(str(path)) == f"scene = {str(path)!r}: {ending}"
    search = {"type": "resources", "path": str(folder)}
    expected = f"resources: path = {str(folder)!r}: {ending}"
    assert refusal({"type": "scene", "files": search}) == expected
    mesh = {"type": "ply", "filename": str(folder / "a.ply")}
    assert refusal({"type": "scene", "mesh": mesh}).startswith("mesh.filename = ")


@pytest.mark.parametrize(
    ("shape", "text"),
    [
        ({"type": "sphere", "radius": 0.0}, "ball.radius = 0.0: must be a finite number other"),
        ({"type": "sphere", "radius": 0.0, "center": [1, 2, 3]}, "ball.radius = 0.0: must be"),
        ({"type": "sphere", "radius": float("inf")}, "ball.radius = inf: must be"),
        ({"type": "sphere", "center": [0, float("nan"), 1]}, "ball.center = [0.0, nan, 1.0]: must"),
        ({"type": "cylinder", "radius": 0}, "ball.radius = 0: must be"),
        ({"type": "cylinder", "p1": [0, float("inf"), 1]}, "ball.p1 = [0.0, inf, 1.0]: must be"),
        (
            {"type": "cylinder", "p0": [1, 2, 3], "p1": [1, 2, 3]},
            "ball.p0 = [1.0, 2.0, 3.0]: must differ from p1, the other end",
        ),
    ],
)
def test_shapes_without_extent_by_their_own_parameters(shape, text):
    assert text in refusal({"type": "scene", "ball": shape})
