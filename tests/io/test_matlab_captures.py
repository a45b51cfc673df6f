"""`save_matlab_capture`: what the published scripts and `load_capture` read from its files."""

import numpy as np
import pytest
from helpers.refusals import refused
from scipy.io import loadmat

import tofrender
from tofrender.io import load_capture, save_matlab_capture
from tofrender.nlos.captures import without_first_and_last_legs

ROWS, COLUMNS, BINS = 3, 5, 9
WIDTH = 0.02
SIDE = 0.8
LIGHT = np.random.default_rng(5).random((ROWS, COLUMNS, BINS, 3), dtype=np.float32)


def capture(start=0.0, mirrored=False, legs=False, height=SIDE, light=LIGHT):
    """A capture of a tilted wall in three colors, in generic position."""
    # Axes of the wall: columns, rows, and the normal toward the hidden scene
    across = np.array([0.6, 0.0, 0.8])
    down = np.array([-0.48, -0.8, 0.36])
    normal = np.cross(across, down)
    if mirrored:
        across = -across
    x = SIDE * np.linspace(0, 1, COLUMNS)
    y = height * np.linspace(0, 1, ROWS)
    grid = np.array([0.3, -1.2, 2.0]) + x[:, None] * across + y[:, None, None] * down
    origins = {"sensor_origin": grid[1, 2] - normal, "laser_origin": grid[0, 1] - 1.5 * normal}
    return tofrender.make_capture(
        light,
        mode="confocal",
        start_opl=start,
        bin_width_opl=WIDTH,
        sensor_grid=grid,
        sensor_normals=np.broadcast_to(normal, grid.shape),
        counts_first_and_last_legs=legs,
        **origins,
    )


def gray(values):
    return values @ np.array([0.212671, 0.71516, 0.072169], np.float32)


def test_arrays_of_f_k_migration(tmp_path):
    path = save_matlab_capture(capture(3 * WIDTH), tmp_path / "a.mat", layout="fk")
    found = loadmat(path)
    assert found["meas"].shape == (ROWS, COLUMNS, BINS + 3)
    assert (found["meas"][..., :3] == 0).all()
    np.testing.assert_allclose(found["meas"][..., 3:], gray(LIGHT), rtol=1e-5)
    assert (found["tofgrid"] == np.zeros((ROWS, COLUMNS))).all()


def test_arrays_of_the_light_cone_transform(tmp_path):
    path = save_matlab_capture(capture(), tmp_path / "a.mat", layout="lct")
    found = loadmat(path)
    expected = gray(LIGHT)[:, ::-1].transpose(1, 0, 2)
    np.testing.assert_allclose(found["rect_data"], expected, rtol=1e-5)
    assert found["width"].item() == pytest.approx(SIDE / 2, rel=1e-6)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("layout", ["fk", "lct"])
def test_the_wall_comes_back_turned_but_not_mirrored(tmp_path, layout, mirrored):
    """Distances of the points and their order around the normal stay."""
    given = capture(mirrored=mirrored)
    path = save_matlab_capture(given, tmp_path / "a.mat", layout=layout)
    found = load_capture(path)
    assert found.attrs["bin_width_opl"] == pytest.approx(WIDTH, rel=1e-6)
    light = gray(LIGHT)[:, ::-1] if mirrored else gray(LIGHT)
    np.testing.assert_allclose(found["transient"][..., 0], light, rtol=1e-5)
    grid = given["sensor_grid"].values[:, ::-1] if mirrored else given["sensor_grid"].values
    sides = []
    for points, normals in (
        (grid, given["sensor_normals"].values),
        (found["sensor_grid"].values, found["sensor_normals"].values),
    ):
        columns = points[0, -1] - points[0, 0]
        rows = points[-1, 0] - points[0, 0]
        turn = np.dot(np.cross(columns, rows), normals[0, 0])
        sides.append((np.linalg.norm(columns), np.linalg.norm(rows), turn))
    assert sides[0] == pytest.approx(sides[1], rel=1e-5)
    assert sides[0][2] > 0


def test_legs_are_subtracted_and_light_is_divided_between_bins(tmp_path):
    """Energy and mean path length of each pixel stay."""
    given = capture(start=3.03, legs=True)
    found = load_capture(save_matlab_capture(given, tmp_path / "a.mat", layout="fk"))
    bare = without_first_and_last_legs(given)
    assert found.attrs["start_opl"] == 0
    means = []
    for each, values in (
        (found, found["transient"][..., 0]),
        (bare, gray(bare["transient"].values)),
    ):
        total = np.asarray(values).sum(axis=2)
        means.append((total, (np.asarray(values) * each["opl"].values).sum(axis=2) / total))
    np.testing.assert_allclose(means[0][0], means[1][0], rtol=1e-5)
    np.testing.assert_allclose(means[0][1], means[1][1], rtol=1e-5)


def test_bins_before_the_wall_are_dropped(tmp_path):
    found = load_capture(save_matlab_capture(capture(-2 * WIDTH), tmp_path / "a.mat", layout="lct"))
    np.testing.assert_allclose(found["transient"][..., 0], gray(LIGHT)[..., 2:], rtol=1e-5)


def test_what_does_not_fit(tmp_path):
    uneven = capture()
    for device in ("sensor", "laser"):
        uneven[f"{device}_grid"].values[1, 2] += 0.05
    cases = {
        "0.8 m wide and 0.6 m high": (capture(height=0.6), "a.mat", "fk"),
        "layout": (capture(), "a.mat", "phasor"),
        "all bins end": (capture(-1.0), "a.mat", "fk"),
        "regular grid": (uneven, "a.mat", "lct"),
        "on a plane wall": (capture().isel(y=[0]), "a.mat", "fk"),
        ".mat": (capture(), "a.h5", "fk"),
    }
    for text, (given, name, layout) in cases.items():
        with refused(text):
            save_matlab_capture(given, tmp_path / name, layout=layout)
    assert list(tmp_path.iterdir()) == []
