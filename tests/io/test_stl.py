"""STL files: binary and ASCII, with the same mesh, cut short, and of another kind."""

import struct

import mitsuba as mi
import numpy as np
import pytest
from helpers.refusals import refused

from tofrender.io.stl import load_stl, read_stl

CORNERS = np.array(
    [
        [[0.0, 0.0, 0.0], [1.5, 0.0, 0.25], [0.0, -2.0, 0.0]],
        [[1.5, 0.0, 0.25], [0.0, -2.0, 0.0], [1.0, 1.0, 3.0]],
    ]
)


def binary(header: bytes = b"made for a test") -> bytes:
    content = header.ljust(80, b"\0") + struct.pack("<I", len(CORNERS))
    for triangle in CORNERS:
        content += struct.pack("<12fH", 0.0, 0.0, 1.0, *triangle.ravel(), 7)
    return content


def ascii_text() -> bytes:
    lines = ["solid two triangles"]
    for triangle in CORNERS:
        lines += ["  facet normal 0 0 1", "    outer loop"]
        lines += [f"      vertex {x:.3e} {y} {z}" for x, y, z in triangle]
        lines += ["    endloop", "  endfacet"]
    return "\n".join([*lines, "endsolid two triangles", ""]).encode()


FILES = {"binary": binary(), "solid": binary(b"solid binary"), "ascii": ascii_text()}


@pytest.mark.parametrize("kind", FILES)
def test_triangles(tmp_path, kind):
    (tmp_path / "a.stl").write_bytes(FILES[kind])
    vertices, faces = read_stl(tmp_path / "a.stl")
    np.testing.assert_allclose(vertices[faces], CORNERS)
    assert len(vertices) == 4  # Two corners are shared


def test_mesh_in_a_scene(tmp_path):
    (tmp_path / "a.stl").write_bytes(binary())
    mesh = load_stl(tmp_path / "a.stl", bsdf={"type": "diffuse", "reflectance": 0.25})
    scene = mi.load_dict({"type": "scene", "part": mesh})
    ray = mi.Ray3f(mi.Point3f(0.2, -0.2, 5.0), mi.Vector3f(0, 0, -1))
    found = scene.ray_intersect(ray)
    assert found.is_valid()[0]
    np.testing.assert_allclose(found.t[0], 5.0 - 0.25 * 0.2 / 1.5, rtol=1e-6)


@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_is_cut_short_is_refused(tmp_path, kind):
    (tmp_path / "a.stl").write_bytes(FILES[kind][:-30])
    with refused(r"a\.stl.*must"):
        read_stl(tmp_path / "a.stl")


@pytest.mark.parametrize(
    "content",
    {
        "empty": b"",
        "another kind": b"ply\nformat ascii 1.0\n" + bytes(200),
        "no triangles": b"solid a\nendsolid a\n",
        "count of 2^32 - 1": bytes(80) + b"\xff\xff\xff\xff" + bytes(100),
        "not finite": binary()[:96] + struct.pack("<f", np.nan) + binary()[100:],
        "word": ascii_text().replace(b"1.500e+00", b"wide", 1),
    }.items(),
    ids=lambda each: each[0],
)
def test_other_content_is_refused(tmp_path, content):
    (tmp_path / "a.stl").write_bytes(content[1])
    with refused(r"a\.stl"):
        read_stl(tmp_path / "a.stl")
