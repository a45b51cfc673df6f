"""Measured captures: files as their documentation describes them, cut, of wrong axes, pickles."""

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import measured_files as files
from helpers.bad_inputs import one_clear_line
from helpers.refusals import refused
from scipy.io import savemat

import tofrender
from tofrender.io import load_capture, save_capture
from tofrender.signals.units import SPEED_OF_LIGHT

scans = pytest.mark.parametrize("name", files.SCANS)


def written(name: str, folder: Path) -> Path:
    """A file of a format, with a name that says nothing."""
    if name in ("ptu", "sdt"):
        pytest.importorskip({"ptu": "ptufile", "sdt": "sdtfile"}[name])
    files.SCANS[name].write(folder / "some.file")
    return folder / "some.file"


@scans
def test_scans(tmp_path, name):
    """Counts, window and wall; seen from the wall towards +z, columns go to the right, -x."""
    scan = files.SCANS[name]
    capture = load_capture(written(name, tmp_path), **scan.options)
    np.testing.assert_array_equal(capture["transient"][..., 0], scan.times * files.COUNTS)
    window = capture.attrs["start_opl"], capture.attrs["bin_width_opl"]
    np.testing.assert_allclose(window, np.array([scan.start_s, scan.bin_s]) * SPEED_OF_LIGHT)
    corners = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]]) * np.array(scan.wall) / 2
    grid = capture["sensor_grid"].values
    np.testing.assert_allclose(grid[[0, 0, -1, -1], [0, -1, 0, -1], :2], corners, rtol=1e-6)
    assert (grid[..., 2] == 0).all()
    assert (capture["sensor_normals"].values == [0, 0, 1]).all()
    assert capture.attrs["quantity"] == "photon counts per bin"
    assert capture.attrs["capture_mode"] == "confocal"
    assert capture.attrs["counts_first_and_last_legs"] == 0
    again = load_capture(save_capture(capture, tmp_path / "again.h5"))
    assert again.identical(capture)


def test_fk_moves_by_whole_bins(tmp_path):
    first = np.array([[31, 62], [123, 124]])
    light = np.arange(130) == first[..., None]
    savemat(tmp_path / "a.mat", {"meas": light * 1.0, "tofgrid": first * 32.0})
    assert (load_capture(tmp_path / "a.mat")["transient"][:, :, 0] == 1).all()


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("mode", ["confocal", "single", "exhaustive"])
def test_znlos(tmp_path, mode, reverse):
    light = files.znlos(tmp_path / "a", mode, reverse)
    capture = load_capture(tmp_path / "a")
    assert capture.attrs["capture_mode"] == mode
    light = light[0, 0] if mode == "single" else light
    for index in np.ndindex(light.shape[:-1]):
        at = index[::-1] if len(index) == 2 else (*index[1::-1], *index[:1:-1])
        np.testing.assert_allclose(capture["transient"].values[at][:, 0], light[index], rtol=1e-6)
        *_, x, y = index
        np.testing.assert_allclose(capture["sensor_grid"].values[y, x], [0.3 * x, 0.2 * y, 0])
    window = capture.attrs["start_opl"], capture.attrs["bin_width_opl"]
    assert (*window, capture.attrs["counts_first_and_last_legs"]) == (0.5, 0.01, 1)
    np.testing.assert_allclose(capture["laser_origin"], [-0.5, 0.1, 0.25])


@pytest.mark.parametrize("name", [*files.SCANS, "Z-NLOS"])
def test_cut_files(tmp_path, name):
    """One clear line at every length."""
    path = tmp_path / "some.file"
    options: dict = {}
    if name in files.SCANS:
        written(name, tmp_path)
        options = files.SCANS[name].options
    else:
        files.znlos(path, "single")
    content, wrong = path.read_bytes(), {}
    lengths = range(0, len(content), max(1, len(content) // 60))
    for length in [*lengths, len(content) - 1]:
        path.write_bytes(content[:length])
        try:
            load_capture(path, **options)
            wrong[length] = "was read"
        except Exception as error:
            wrong[length] = one_clear_line(error, "path")
    assert not {length: what for length, what in wrong.items() if what}


PIXELS = [[k // 4, k % 4, 1, 2] for k in range(12)]


def as_csv(path: Path, head: str = "y,x,0,4e-12", lines: list = PIXELS) -> None:
    path.write_text(head + "\n" + "".join(",".join(map(str, line)) + "\n" for line in lines))


def as_npz(path: Path, **arrays) -> None:
    with path.open("wb") as file:
        np.savez(file, **arrays)


CUBE = np.ones((3, 4, 6))
OBJECTS = np.array([print], dtype=object)

WRONG = {
    "lct flat": (
        lambda p: savemat(p, {"rect_data": CUBE[0], "width": 1.0}),
        "rect_data with shape",
    ),
    "lct text": (lambda p: savemat(p, {"rect_data": "abc", "width": 1.0}), "rect_data"),
    "lct two": (lambda p: savemat(p, {"rect_data": CUBE, "width": [1.0, 2]}), "width with shape"),
    "lct negative": (lambda p: savemat(p, {"rect_data": -CUBE, "width": 1.0}), "counts = -1"),
    "lct NaN": (lambda p: savemat(p, {"rect_data": CUBE * np.nan, "width": 1.0}), "counts = nan"),
    "lct no wall": (lambda p: savemat(p, {"rect_data": CUBE, "width": -1.0}), "wall_size = -2"),
    "no capture": (
        lambda p: savemat(p, {"a": 1}),
        "rect_data width MATLAB or meas MATLAB or cells MATLAB",
    ),
    "f-k no tofgrid": (lambda p: savemat(p, {"meas": CUBE}), "tofgrid is missing"),
    "f-k frames": (lambda p: savemat(p, {"meas": CUBE[None]}), "meas with shape"),
    "f-k turned": (
        lambda p: savemat(p, {"meas": CUBE, "tofgrid": np.ones((4, 3))}),
        "tofgrid with shape",
    ),
    "f-k late": (
        lambda p: savemat(p, {"meas": CUBE, "tofgrid": np.full((3, 4), 1e4)}),
        "tofgrid = .* within the bins",
    ),
    "f-k seconds": (
        lambda p: savemat(p, {"meas": np.ones((3, 4, 600)), "tofgrid": np.full((3, 4), 9.6e-9)}),
        "tofgrid: its delays are at most 9.6e-09 ps",
    ),
    "f-k nanoseconds": (
        lambda p: savemat(p, {"meas": np.ones((3, 4, 600)), "tofgrid": np.full((3, 4), 9.6)}),
        "tofgrid: its delays are at most 9.6 ps",
    ),
    "npz picoseconds": (
        lambda p: as_npz(p, counts=CUBE, bin_width_s=4.0),
        "bin_width_s = 4: a bin",
    ),
    "csv picoseconds": (lambda p: as_csv(p, "y,x,0,4"), "bin_width_s = 4: a bin"),
    "cells two": (lambda p: files.photon_times(p, A=_cells()), "cells = "),
    "cells of seconds": (lambda p: savemat(p, {"T": _cells(1e-12)}), "numbers of bins"),
    "cells of text": (lambda p: savemat(p, {"T": _cells("abc")}), "must hold real numbers"),
    "cells no bin width": (files.photon_times, "bin_width_s = None: must be given"),
    "npz flat": (lambda p: as_npz(p, counts=CUBE[0], bin_width_s=1e-12), "counts with shape"),
    "npz no bin width": (lambda p: as_npz(p, counts=CUBE), "bin_width_s = None: must be given"),
    "npz pickle": (lambda p: as_npz(p, counts=OBJECTS, bin_width_s=1e-12), "must"),
    "npz other": (lambda p: as_npz(p, a=CUBE), "must contain counts NPZ"),
    "csv uneven": (lambda p: as_csv(p, "y,x,0,1e-12,3e-12", [[0, 0, 1, 1, 1]]), "equal steps"),
    "csv one bin": (lambda p: as_csv(p, "y,x,0", [[0, 0, 1]]), "2 or more"),
    "csv few": (lambda p: as_csv(p, lines=PIXELS[:-2] + PIXELS[-1:]), "each pixel of a grid once"),
    "csv twice": (lambda p: as_csv(p, lines=[*PIXELS, PIXELS[3]]), "each pixel of a grid once"),
    "csv half": (lambda p: as_csv(p, lines=[[0.5, 0, 1, 2]]), "each pixel of a grid once"),
    "csv wide": (lambda p: as_csv(p, lines=[[*each, 3] for each in PIXELS]), "2 of each pixel"),
    "csv text": (lambda p: as_csv(p, "y,x,a,b"), "must head lines of numbers"),
    "znlos turned": (
        lambda p: files.znlos(p, "single", data=np.ones((1, 1, 3, 4, 3, 6))),
        "data with shape",
    ),
    "znlos bins": (lambda p: files.znlos(p, "confocal", t=7), "data with shape"),
    "znlos lacks": (lambda p: files.znlos(p, "confocal", deltaT="x"), "deltaT of type"),
}


def _cells(value=1) -> np.ndarray:
    cells = np.empty((3, 4), object)
    cells[...] = value
    return cells


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files(tmp_path, name):
    write, message = WRONG[name]
    write(tmp_path / "a")
    options = {} if name.split()[0] in ("lct", "znlos") else {"wall_size": 1}
    with refused(message) as caught:
        load_capture(tmp_path / "a", **options)
    assert not one_clear_line(caught.value, "path")


class Trap:
    """A pickle of it makes a folder when it is read."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.mkdir, (self.path,)


@pytest.mark.parametrize("name", ["pickle", "npy", "npz", "cells", "hdf5"])
def test_pickles_are_not_read(tmp_path, name):
    trap, path = Trap(tmp_path / "trapped"), tmp_path / "a"
    held = np.array([trap, trap], object)
    if name == "pickle":
        path.write_bytes(pickle.dumps(trap))
    elif name == "npy":
        with path.open("wb") as file:
            np.save(file, held, allow_pickle=True)
    elif name == "npz":
        as_npz(path, counts=held, bin_width_s=1e-12)
    elif name == "cells":
        cells = np.empty((1, 2), object)
        cells[...] = np.frombuffer(pickle.dumps(trap), np.uint8).reshape(1, -1).tobytes()
        savemat(path, {"D": cells})
    else:
        files.znlos(path, "single", data=np.void(pickle.dumps(trap)))
    with refused("must") as caught:
        load_capture(path, **({} if name == "hdf5" else {"wall_size": 1}))
    assert str(path) in str(caught.value)
    assert not trap.path.exists()
    pickle.loads(pickle.dumps(trap))
    assert trap.path.exists()  # The trap works


def test_options_of_files_that_state_all(tmp_path):
    files.znlos(tmp_path / "a", "single")
    with refused("wall_size = 2: must be None, as the file states it"):
        load_capture(tmp_path / "a", wall_size=2)
    for bad, message in ((-1, "meters above 0"), ((1, 2, 3), "width and height"), ("1", "meters")):
        files.lct(tmp_path / "b")
        with refused(f"wall_size = .*{message}"):
            load_capture(tmp_path / "b", wall_size=bad)


@pytest.mark.parametrize("name", ["ptufile", "sdtfile"])
def test_missing_packages_are_named(tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    content = b"PQTTTR" if name == "ptufile" else bytes(42) + b"*IDENTIFICATION"
    (tmp_path / "a").write_bytes(content + bytes(40))
    with refused(rf"this file needs {name}: pip install 'tofrender\[data\]'", ImportError):
        load_capture(tmp_path / "a", wall_size=1)


def test_integers_in_ytal_files_are_counts(tmp_path):
    import h5py

    capture = load_capture(written("npz", tmp_path))
    path = save_capture(capture, tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        light = file["H"][()]
        del file["H"], file["scene_info"]
        file["H"] = light.astype(np.uint16)
    assert tofrender.load_capture(path).attrs["quantity"] == "photon counts per bin"
