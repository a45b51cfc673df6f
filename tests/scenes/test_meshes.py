"""Meshes of the built-in scenes: closed, smooth, of their size and place; and their files."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from scenes import make_meshes
from scenes.bunny import bunny
from scenes.bust import PROFILE, bust
from tofrender.scenes import BUILT_IN
from tofrender.scenes.meshes import FILE, STROKE, letter_z

KEPT = Path(__file__).parents[2] / "scenes" / "meshes"

# Of each mesh: bounds of its volume [m³], height of its triangles over their longest side, the
# least cosine between a normal and a face's (at the edges of foot and hair), the same for 95 % of
# them, and its height [m]
FACTS = [(bust, (0.015, 0.03), 5e-5, 0.2, 0.9, 0.67), (bunny, (0.05, 0.09), 1e-3, 0.3, 0.95, 0.88)]


@pytest.mark.parametrize(
    ("make", "volumes", "thinnest", "sharpest", "mostly", "height"), FACTS, ids=["bust", "bunny"]
)
def test_meshes_are_closed_and_smooth_and_stand_on_the_ground(
    make, volumes, thinnest, sharpest, mostly, height
):
    vertices, faces, normals = make()
    assert 5000 <= len(faces) <= 20000
    assert set(faces.ravel()) == set(range(len(vertices)))
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)  # no directed edge twice ...
    np.testing.assert_array_equal(  # ... and each one runs the other way in a neighbor
        np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0)
    )
    assert len(vertices) - len(edges) // 2 + len(faces) == 2  # Euler: a sphere, without handles

    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.einsum("fi,fi->f", corners[:, 0], cross).sum() / 6  # positive: faces outwards
    assert volumes[0] < volume < volumes[1]
    areas = np.linalg.norm(cross, axis=1) / 2
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    assert areas.min() > 1e-7
    assert (2 * areas / sides.max(axis=1)).min() > thinnest

    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    cosine = np.einsum("fi,fki->fk", cross / (2 * areas[:, None]), normals[faces])
    assert cosine.min() > sharpest
    assert np.quantile(cosine, 0.05) > mostly
    assert vertices[:, 1].min() == 0
    assert vertices[:, 1].max() == pytest.approx(height, abs=0.01)


def test_bust_looks_forwards_and_bunny_has_two_ears():
    vertices, _, normals = bust()
    assert vertices[:, 1].max() >= PROFILE[-1, 0]
    assert normals[vertices[:, 1].argmax(), 1] > 0.9
    assert normals[vertices[:, 1].argmin(), 1] < -0.9
    nose = vertices[(vertices[:, 1] > 0.47) & (vertices[:, 1] < 0.51)]
    tip = nose[np.hypot(nose[:, 0], nose[:, 2]).argmax()]
    assert tip[2] > 0.1
    assert np.rad2deg(np.arctan2(tip[0], tip[2])) == pytest.approx(18, abs=3)
    vertices, _, _ = bunny()
    ears = vertices[vertices[:, 1] > 0.75]
    assert (abs(ears[:, 2]) > 0.03).all()


def test_letter_is_a_z_with_even_strokes():
    vertices, faces = letter_z()
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (cross[:, 2] < 0).all()  # faces -z, towards the wall
    area = np.linalg.norm(cross, axis=1).sum() / 2
    bar = 0.8 * STROKE
    diagonal = vertices[7] - vertices[4]
    across = np.array([vertices[5, 0] - vertices[4, 0], 0, 0])
    width = np.linalg.norm(np.cross(across, diagonal)) / np.linalg.norm(diagonal)
    assert width == pytest.approx(STROKE, rel=1e-9)
    assert area == pytest.approx(2 * bar + across[0] * (0.8 - 2 * STROKE))
    assert (diagonal[:2] > 0).all()  # rises to the right of who looks along -z
    np.testing.assert_allclose([vertices.min(0)[:2], vertices.max(0)[:2]], [[-0.4] * 2, [0.4] * 2])


@pytest.mark.parametrize("tilt", [0.0, 30.0, -60.0])
def test_patch_has_its_size_place_and_tilt(tilt):
    described = BUILT_IN["nlos_patch"](side=0.04, position=(0.3, -0.2, 0.8), tilt=tilt)
    shape = mi.load_dict(described["hidden_patch"])
    assert float(shape.surface_area()[0]) == pytest.approx(0.0016, rel=1e-5)
    middle = shape.sample_position(0, mi.Point2f(0.5))
    np.testing.assert_allclose(np.array(middle.p).ravel(), [0.3, -0.2, 0.8], atol=1e-6)
    angle = np.deg2rad(tilt)
    expected = [-np.sin(angle), 0, -np.cos(angle)]
    np.testing.assert_allclose(np.array(middle.n).ravel(), expected, atol=1e-6)


def test_mesh_files_are_the_meshes(tmp_path):
    make_meshes.write_ply(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in KEPT.iterdir()}
    for path in tmp_path.iterdir():
        assert (KEPT / path.name).stat().st_size < 1_000_000
        ours, theirs = (
            mi.traverse(mi.load_dict({"type": "ply", "filename": str(folder / path.name)}))
            for folder in (tmp_path, KEPT)
        )
        assert (np.array(ours["faces"]) == np.array(theirs["faces"])).all()
        for what in ("vertex_positions", "vertex_normals"):
            np.testing.assert_allclose(np.array(ours[what]), np.array(theirs[what]), atol=1e-6)
    with np.load(FILE) as kept:
        for name, array in make_meshes.arrays().items():
            np.testing.assert_allclose(kept[name], array, atol=1e-6, err_msg=name)
