"""Captures in HDF5: exact round trips, the layout, other people's files, broken ones, y-tal."""

import json
import os
import subprocess
import sys

import h5py
import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import Wall, capture_of, letter_z, rectangle, true_depth, turned
from helpers.made_dataset import assert_same
from helpers.refusals import refused

from tofrender.io import load_capture, save_capture
from tofrender.nlos import check_capture, depth_error, make_capture, reconstruct
from tofrender.rendering.labels import labeled

modes = pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
ATTRS = {"scene": "bördér: [Z]", "spp": 64, "seed": 2**32 - 1, "fraction": 1e-5, "third": 1 / 3}


def example(mode="confocal", **kwargs) -> xr.Dataset:
    """Not square, and nothing symmetric."""
    options = {"bins": 30, "lasers": 2, "legs": True, "start": 1.8, "width": 0.013} | kwargs
    patch = rectangle((0.1, 0.3), (-0.4, -0.2), 1.0, 0.1)
    capture = capture_of(patch, turned(6), mode, **options).isel(x=slice(0, 5))
    for device in ("sensor", "laser"):  # a bumpy wall
        normals = capture[f"{device}_normals"].values
        normals[..., 0] += 0.1 * np.sin(np.arange(normals[..., 0].size)).reshape(normals.shape[:2])
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return capture.assign_attrs(ATTRS)


def in_rgb(capture: xr.Dataset, *factors: float) -> xr.Dataset:
    light = capture["transient"]
    made = capture.drop_dims("channel").assign_coords(channel=["R", "G", "B"])
    return made.assign(transient=(light.dims, light.values * np.float32(factors)))


def time_first(light: np.ndarray, mode: str) -> np.ndarray:
    return light.transpose((4, 1, 0, 3, 2) if mode == "exhaustive" else (2, 1, 0))


@modes
@pytest.mark.parametrize(("legs", "origins"), [(False, True), (True, True), (False, False)])
def test_round_trip_is_exact(tmp_path, mode, legs, origins):
    capture = example(mode, legs=legs).assign_coords(x=[3, 4, 5, 6, 7])
    if legs:
        capture = capture.assign_coords(channel=["R"])
    capture = labeled(capture)
    values = capture["transient"].values
    values[..., 0, 0, :3, 0] = -0.0, 1e-42, np.finfo(np.float32).max
    if not origins:
        for device in ("sensor", "laser"):
            capture[f"{device}_origin"].values[:] = np.nan
    path = tmp_path / "capture.h5"
    assert save_capture(capture, path) == path
    assert_same(load_capture(path), capture)
    assert os.listdir(tmp_path) == ["capture.h5"]


def test_parts_come_back_and_other_numbers_are_refused(tmp_path):
    capture = example()
    for part in (capture.isel(x=slice(None, None, -2)), capture.isel(y=[3, 0])):
        loaded = load_capture(save_capture(part, tmp_path / "c.h5", overwrite=True))
        assert loaded.identical(part.sortby(["y", "x"]))  # Files have the order of labels
    for wrong, said in (
        (capture.assign_coords(x=capture["x"] * 0.5), "capture: the labels along the axis x must"),
        (capture.astype(float), "capture: type of .*float64.*: must be float32"),
    ):
        with refused(said):
            save_capture(wrong, tmp_path / "wrong.h5")
    assert not (tmp_path / "wrong.h5").exists()


@modes
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_light_that_is_not_finite_is_not_read(tmp_path, mode, bad):
    capture = example(mode)
    values = capture["transient"].values
    values[..., 1, 2, 3:5, 0] = bad
    count = values.size - np.isfinite(values).sum()
    path = tmp_path / "capture.h5"
    said = rf"transient: {count} of {values.size} values are not finite, the first is {bad:g} at "
    with pytest.warns(UserWarning, match=f"^{said}.*cannot be read"):
        save_capture(capture, path)
    with refused(f"^path = .*: {said}"):
        load_capture(path)


@pytest.mark.parametrize("seed", range(4))
def test_pixels_off_the_wall_come_back(tmp_path, seed):
    capture = capture_of(rectangle((-0.1, 0.1), (-0.1, 0.1), 1, 0.1), Wall(4), bins=8)
    on_wall = np.random.default_rng(seed).uniform(size=(4, 4)) < (0.1, 0.5, 0.9, 0.0)[seed]
    on_wall[seed, 1:3] = True, False
    capture["on_wall"] = (("y", "x"), on_wall)
    again = load_capture(save_capture(capture, tmp_path / "part.h5"))
    assert again.identical(labeled(capture))


@modes
@pytest.mark.parametrize("gray", [False, True])
def test_colors_come_back_and_others_read_luminance(tmp_path, mode, gray):
    capture = in_rgb(example(mode), *((1, 1, 1) if gray else (0.2, 1, 0.7)))
    capture["transient"].attrs["note"] = "a b"
    capture["opl"].attrs |= {"zero": "the wall", "offset": 1e-5}
    capture = labeled(capture)
    path = save_capture(capture, tmp_path / "c.h5")
    xr.testing.assert_identical(load_capture(path), capture)
    assert not (load_capture(path) - capture)["transient"].values.any()
    with h5py.File(path, "r+") as file:
        luminance = capture["transient"].values @ np.array([0.212671, 0.71516, 0.072169])
        np.testing.assert_allclose(file["H"], time_first(luminance, mode), rtol=1e-5)
        assert len(file["H"].attrs) == (0 if gray else 1)


def test_colors_that_do_not_fit_are_refused(tmp_path):
    path = save_capture(in_rgb(example(), 0.2, 1, 0.7), tmp_path / "c.h5")
    for wrong in (np.ones(3, np.float32), np.ones((30, 6, 5, 3), np.float32)):
        with h5py.File(path, "r+") as file:
            file["H"].attrs["tofrender_colors_0"] = wrong
        with pytest.raises(ValueError, match=r"\Apath = .*: H: colors with shape .*\Z"):
            load_capture(path)


@modes
def test_the_layout(tmp_path, mode):
    """Time first, x before y, and no field besides those that y-tal knows."""
    capture = example(mode)
    with h5py.File(save_capture(capture, tmp_path / "c.h5"), "r") as file:
        fields = {name: file[name] for name in file}
        pairs = [f"{d}_{w}" for d in ("laser", "sensor") for w in ("grid_xyz", "grid_normals")]
        formats = ["laser_grid_format", "sensor_grid_format", "H_format", "volume_format"]
        scalars = ["delta_t", "t_start", "t_accounts_first_and_last_bounces", "scene_info"]
        assert sorted(fields) == sorted(
            [*pairs, *formats, *scalars, "H", "laser_xyz", "sensor_xyz"]
        )
        light, values = capture["transient"].values[..., 0], fields["H"]
        assert values.dtype == np.float32
        np.testing.assert_array_equal(values, time_first(light, mode))
        assert fields["H_format"][()].tolist() == [2 if mode == "exhaustive" else 1]
        assert fields["H_format"].dtype == fields["laser_grid_format"].dtype == np.int32
        sensors = capture["sensor_grid"].values.transpose(1, 0, 2)
        np.testing.assert_array_equal(fields["sensor_grid_xyz"], sensors)
        laser = {"single": (1, 1, 3), "confocal": (5, 6, 3), "exhaustive": (2, 2, 3)}[mode]
        assert fields["laser_grid_xyz"].shape == fields["laser_grid_normals"].shape == laser
        assert fields["delta_t"][()] == 0.013
        assert fields["t_start"][()] == capture.attrs["start_opl"]
        assert fields["delta_t"].dtype == fields["t_start"].dtype == np.float64
        assert fields["t_accounts_first_and_last_bounces"][()] is np.True_
        assert fields["volume_format"].shape is None
        info = json.loads(fields["scene_info"][()])
    assert info["tofrender"]["attrs"]["scene"] == ATTRS["scene"]


def test_scene_info_is_yaml(tmp_path):
    yaml = pytest.importorskip("yaml", reason="PyYAML comes with y-tal")
    with h5py.File(save_capture(example(), tmp_path / "c.h5"), "r") as file:
        info = yaml.safe_load(file["scene_info"][()])
    assert {k: info["tofrender"]["attrs"][k] for k in ATTRS} == ATTRS


def fields_of(path) -> dict:
    with h5py.File(path, "r") as file:
        return {name: file[name][()] for name in file}


def rewritten(path, **changes):
    """The file with fields replaced; None empties one, "delete" takes it out."""
    with h5py.File(path, "a") as file:
        for name, value in changes.items():
            if name in file:
                del file[name]
            if not (isinstance(value, str) and value == "delete"):
                file[name] = h5py.Empty("f8") if value is None else value
    return path


def test_lists_of_points_become_a_row(tmp_path):
    capture = example("confocal").isel(y=[0])
    path = save_capture(capture, tmp_path / "c.h5")
    fields = fields_of(path)
    changes = {"H": fields["H"][:, :, 0], "H_format": np.int32(3), "scene_info": None}
    for device in ("laser", "sensor"):
        changes[f"{device}_grid_format"] = np.int32([1])
        changes |= {n: fields[n][:, 0] for n in (f"{device}_grid_xyz", f"{device}_grid_normals")}
    loaded = load_capture(rewritten(path, **changes))
    assert loaded.attrs["capture_mode"] == "confocal"
    for name in capture.data_vars:
        np.testing.assert_array_equal(loaded[name], capture[name])


def test_lists_of_pairs_become_exhaustive(tmp_path):
    path = save_capture(example("exhaustive"), tmp_path / "c.h5")
    fields = fields_of(path)
    changes = {"H": fields["H"].reshape(30, 4, 30), "H_format": np.int32([4])}
    for device in ("laser", "sensor"):
        changes[f"{device}_grid_format"] = np.int32([1])
        names = (f"{device}_grid_xyz", f"{device}_grid_normals")
        changes |= {name: fields[name].reshape(-1, 3) for name in names}
    loaded = load_capture(rewritten(path, scene_info="delete", **changes))
    assert loaded["transient"].shape == (1, 4, 1, 30, 30, 1)
    values = loaded["transient"].values[0, :, 0, :, :, 0]
    np.testing.assert_array_equal(values, changes["H"].transpose(1, 2, 0))
    np.testing.assert_array_equal(loaded["laser_grid"].values[0], changes["laser_grid_xyz"])


def test_foreign_scene_info_and_missing_normals(tmp_path):
    capture = capture_of(rectangle((0, 0.1), (0, 0.1), 1, 0.1), Wall(4), bins=10)
    path = save_capture(capture, tmp_path / "c.h5")
    rewritten(path, sensor_grid_normals=None, laser_grid_normals=None, scene_info="args:\n- !!x 1")
    loaded = load_capture(path)
    assert loaded.attrs["scene_info"] == "args:\n- !!x 1"
    assert_same(loaded.drop_attrs(), capture.drop_attrs())
    save_capture(loaded, tmp_path / "again.h5")
    assert load_capture(tmp_path / "again.h5").attrs == loaded.attrs


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"H": "delete"}, "must contain H HDF5 or data deltaT HDF5"),
        ({"H": None}, "the field H is empty"),
        ({"H": np.ones((30, 5))}, r"H with shape \(30, 5\): must be T_Sx_Sy, as in H_format"),
        ({"H_format": np.int32([9])}, r"H_format = 9: must be one of 1 \(T_Sx_Sy\)"),
        ({"H_format": np.int32([2])}, "H with shape .*: must be T_Lx_Ly_Sx_Sy"),
        ({"laser_grid_xyz": np.zeros((2, 2, 3))}, "laser_grid_xyz with .*one point or equal"),
        ({"sensor_grid_normals": None}, "normals are missing"),
        ({"sensor_xyz": None}, "sensor_origin, laser_origin: must be finite"),
    ],
)
def test_broken_files_in_one_line(tmp_path, changes, message):
    path = rewritten(save_capture(example(), tmp_path / "c.h5"), **changes)
    with refused(message) as caught:
        load_capture(path)
    assert str(caught.value).startswith(f"path = {path}: ")


_YTAL = """
import json, sys
import numpy as np
import tal
from tal.reconstruct import bp
path, volume, output = sys.argv[1:]
data = tal.io.read_capture(path)
axes = [low + (np.arange(n) + 0.5) * (high - low) / n for low, high, n in json.loads(volume)]
voxels = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
found = bp.solve(data, voxels, tal.enums.VolumeFormat.X_Y_Z_3, progress=False)
assert set(data.scene_info) == {"tofrender"}, data.scene_info
modes = data.is_confocal(), data.is_laser_paired_to_sensor()
axis = float(data.delta_t), float(data.t_start)
counts = bool(data.t_accounts_first_and_last_bounces)
format = data.H_format.name
np.savez(output, H=data.H, found=found, format=format, modes=modes, axis=axis, counts=counts)
tal.io.write_capture(output + ".hdf5", data)
"""


@pytest.fixture(scope="module")
def ytal_python():
    """A Python that has y-tal: this one, or the one that YTAL_PYTHON names."""
    python = os.environ.get("YTAL_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import tal"], capture_output=True, check=False).returncode:
        pytest.skip(
            "y-tal is not installed; it needs NumPy 1, so install it into an environment of its "
            "own and name that one's Python in YTAL_PYTHON"
        )
    return python


@modes
@pytest.mark.parametrize("legs", [False, True])
def test_ytal_reads_our_file_and_finds_the_z(tmp_path, ytal_python, mode, legs):
    patches = letter_z(step=0.05)
    size = {"exhaustive": 8}.get(mode, 16)
    capture = capture_of(patches, Wall(size), mode, legs=legs, bins=160, width=0.01, lasers=8)
    path = save_capture(capture, tmp_path / "z.h5")
    volume = ((-0.7, 0.6, 13), (-0.6, 0.6, 12), (0.7, 1.3, 20))
    output = str(tmp_path / "read")
    command = [ytal_python, "-c", _YTAL, str(path), json.dumps(volume), output]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with np.load(output + ".npz") as read:
        values = capture["transient"].values[..., 0]
        np.testing.assert_array_equal(read["H"], time_first(values, mode))
        assert str(read["format"]) == ("T_Lx_Ly_Sx_Sy" if mode == "exhaustive" else "T_Sx_Sy")
        assert read["modes"].tolist() == [mode == "confocal"] * 2
        assert bool(read["counts"]) == legs
        assert read["axis"].tolist() == [capture.attrs[f"{n}_opl"] for n in ("bin_width", "start")]
        theirs = read["found"].transpose(2, 1, 0)  # (X, Y, Z)
    ours = reconstruct(capture, "bp", volume=volume, weighting="uniform", progress=False)
    intensity = ours["intensity"].values
    assert np.corrcoef(theirs.ravel(), intensity.ravel())[0, 1] > 0.995
    sharp = reconstruct(capture, "fbp", volume=volume, progress=False)
    assert depth_error(sharp, true_depth(patches, sharp)).median < 0.02
    found = ours.assign(intensity=(("z", "y", "x"), theirs))
    assert depth_error(found, true_depth(patches, found)).median < 0.04
    again = load_capture(output + ".hdf5")  # what y-tal writes
    assert_same(again.drop_attrs(), capture.drop_attrs())
    check_capture(again)


def test_a_capture_of_one_point_keeps_its_mode(tmp_path):
    wall = {"sensor_grid": np.zeros((1, 1, 3)), "sensor_normals": [[[0, 0, 1]]]}
    laser = {"laser_grid": (0, 0, 0), "laser_normals": (0, 0, 1)}
    for mode, more in (("confocal", wall), ("single", wall | laser)):
        capture = make_capture([[[1, 2]]], mode=mode, start_opl=0, bin_width_opl=1, **more)
        assert_same(load_capture(save_capture(capture, tmp_path / f"{mode}.h5")), capture)
