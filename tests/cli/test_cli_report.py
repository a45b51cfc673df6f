"""`tofrender report`: a page of whatever the other commands have written."""

import functools
import json
import re

import numpy as np
import pytest
from helpers.commands import refused
from helpers.hidden_scenes import Wall, capture_of, rectangle
from helpers.made_dataset import make_dataset

import tofrender
from tofrender.apps.compare.picture_set import PictureSet, load
from tofrender.apps.explorer.page_contents import contents_of
from tofrender.cli.app import main
from tofrender.cli.report import load_result
from tofrender.io.netcdf import save_measurement
from tofrender.sensors.sensor_config import read_sensor


def header_of(page) -> dict:
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'id="header">(.*?)</script>', text, re.DOTALL)[1])


def made(folder, kind):
    """Something to show, and what the page calls it."""
    data = make_dataset(4, 6, 8, energy_outside_window=0.0)
    patch = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
    stack = functools.partial(tofrender.save_exr_stack, progress=False)
    writers = {
        "frames": ("box", stack),
        "parts": ("a.exr", functools.partial(stack, layout="multipart")),
        "npz": ("a.npz", tofrender.save_npz),
        "zarr": ("a.zarr", tofrender.save_zarr),
    }
    if kind in writers:
        name, write = writers[kind]
        write(data, folder / name)
        return folder / name, "transient"
    capture = capture_of(patch, Wall(4), bins=24, width=0.05)
    path = tofrender.save_capture(capture, folder / "wall.h5")
    if kind == "capture":
        return path, "capture"
    arguments = ["reconstruct", str(path), "--method", "bp", "--out", str(folder / "volume")]
    assert main(arguments) == 0
    return folder / "volume" / ("volume.npz" if kind == "file" else ""), "volume"


@pytest.mark.parametrize("kind", ["frames", "parts", "npz", "zarr", "capture", "volume", "file"])
def test_all_that_commands_write(tmp_path, capsys, kind):
    source, shown = made(tmp_path, kind)
    capsys.readouterr()
    page = tmp_path / "report.html"
    for _ in range(2):  # The second time, it replaces its own page
        assert main(["report", str(source), "-o", str(page), "--title", "My <title>"]) == 0
        said = capsys.readouterr()
        assert said.out == f"{page}: 0.1 MB\n"
        assert said.err == ""
    header = header_of(page)
    assert header["kind"] == shown
    assert header["title"] == "My <title>"


def test_a_volume_with_its_capture(tmp_path):
    source, _ = made(tmp_path, "volume")
    page = tmp_path / "report.html"
    capture = str(tmp_path / "wall.h5")
    assert main(["report", str(source), "--capture", capture, "-o", str(page)]) == 0
    header = header_of(page)
    assert "wall" in header["parts"]
    assert header["volume"]["kind"] == "volume"


def test_a_report_may_lie_with_its_render(tmp_path):
    folder, _ = made(tmp_path, "frames")
    assert main(["report", str(folder), "-o", str(folder / "report.html")]) == 0
    tofrender.save_exr_stack(make_dataset(4, 6, 8), folder, overwrite=True, progress=False)


@pytest.mark.parametrize("kind", ["npz", "frames", "capture", "volume.npz", "other", "nothing"])
def test_what_cannot_be_read_is_one_line(tmp_path, capsys, kind):
    page = tmp_path / "report.html"
    if kind == "nothing":
        source = tmp_path / "nothing.npz"
    elif kind in ("other", "volume.npz"):
        source = tmp_path / ("a.txt" if kind == "other" else kind)
        source.write_text("text")
    else:
        source, _ = made(tmp_path, kind)
        cut = source if source.is_file() else source / "frame_0003.exr"
        content = cut.read_bytes()
        cut.write_bytes(content[: len(content) // 2])
    capsys.readouterr()
    said = refused(capsys, "report", source, "-o", page)
    assert str(tmp_path)[:60] in said
    assert "must be" in said or "Use a folder" in said
    assert not page.exists()
    assert not list(tmp_path.glob(".tofrender-*"))


def test_not_finite_values_of_a_volume_are_refused(tmp_path, capsys):
    axes = {axis: np.arange(1.0, 3.0) for axis in "xyz"}
    np.savez(tmp_path / "volume.npz", intensity=np.full((2, 2, 2), np.nan), **axes)
    assert "must all be finite" in refused(capsys, "report", tmp_path, "-o", tmp_path / "a.html")


SENSORS = {
    "counts": {"spad": {"mode": "first_photon"}},
    "taps": {"itof": {"frequencies_hz": [2e7, 5e7], "taps": 3, "contrast": 0.7}},
    "gates": {"gated": {"delays_opl": [3.5, 3.54, 3.58, 3.62], "width_s": 2e-10}},
    "sweep": {"streak": {"sweep_opl": 0.05, "spread_sweep": 0.5}},
}


def measured_by(kind):
    """A measurement of a render in generic position, and the render."""
    data = make_dataset(4, 6, 12, x0=3, y0=2, energy_outside_window=0.0)
    sensor = {"cycles": 4000, "photons": {"photons_per_cycle": 0.3}} | SENSORS[kind]
    return tofrender.sensors.sense(data, sensor, seed=3)


@pytest.mark.parametrize("kind", SENSORS)
@pytest.mark.parametrize("is_folder", [False, True])
def test_results_of_all_sensors(tmp_path, capsys, kind, is_folder):
    measured = measured_by(kind)
    save_measurement(measured, tmp_path / "sensed.nc")
    source = tmp_path if is_folder else tmp_path / "sensed.nc"
    page = tmp_path / "report.html"
    assert main(["report", str(source), "-o", str(page)]) == 0
    assert capsys.readouterr().err == ""
    header = header_of(page)
    assert header["kind"] == ("phasors" if kind == "taps" else "transient")
    assert header["grid"]["width"] == 6
    assert header["grid"]["height"] == 4
    assert (
        header["quantity"]
        == {
            "counts": "counts",
            "taps": "amplitude [electrons]",
            "gates": "images [electrons]",
            "sweep": "images [electrons]",
        }[kind]
    )
    contents = contents_of(load_result(source))
    light = contents.layer(contents.header["light"])[0].transpose(2, 3, 0, 1)[..., 0]
    if kind == "taps":
        given = camera_of(measured).depth(measured)
        expected = given["amplitude"].transpose("y", "x", "frequency").values
        phase = np.arctan2(contents.part("Q"), contents.part("I")).reshape(2, 4, 6)
        turns = (phase - given["phase"].values) / (2 * np.pi)
        np.testing.assert_allclose(turns, np.rint(turns), atol=1e-5)
    else:
        name = "counts" if kind == "counts" else "images"
        expected = measured[name].transpose("y", "x", ...).values
        centers = header["axis"]["start"] + header["axis"]["width"] * (
            np.arange(light.shape[2]) + 0.5
        )
        axis = {"counts": "opl", "gates": "delay_opl", "sweep": "sweep"}[kind]
        np.testing.assert_allclose(centers, measured[axis].values, rtol=1e-9)
        assert header["grid"]["first"] == [3, 2]
        if "expected" in measured:
            assert [each["name"] for each in header["orders"]] == ["expectation"]
    scale = contents.header["light"]
    np.testing.assert_allclose(
        light, np.maximum(expected, 0), rtol=scale["ratio"] ** 0.5 - 1 + 1e-6, atol=scale["least"]
    )


def camera_of(measured):
    return read_sensor(json.loads(measured.attrs["sensor"]))["model"]


def test_gates_at_uneven_delays_are_refused(tmp_path, capsys):
    data = make_dataset(4, 6, 12)
    gated = {"delays_opl": [3.5, 3.54, 3.6], "width_s": 2e-10}
    sensor = {"cycles": 9, "photons": {"photons_per_cycle": 0.3}, "gated": gated}
    save_measurement(tofrender.sensors.sense(data, sensor), tmp_path / "sensed.nc")
    said = refused(capsys, "report", tmp_path, "-o", tmp_path / "a.html")
    assert "delay_opl" in said


def frames_in(folder, count=3):
    """A folder as `tofrender render --frames` writes it, of unequal frames."""
    (folder / "film").mkdir()
    (folder / "film" / "frames.json").write_text("{}")
    made = []
    for k in range(count):
        data = make_dataset(4, 6, 8, x0=3, energy_outside_window=0.0)
        data = data.assign_attrs(time_s=0.02 * k + 0.5)
        for name in ("transient", "steady"):
            data[name] = (data[name] * (k + 1)).astype(np.float32)
        tofrender.save_exr_stack(data, folder / "film" / f"frame_{k:04d}", progress=False)
        made.append(data)
    return folder / "film", made


def test_a_folder_of_frames(tmp_path, capsys):
    source, made = frames_in(tmp_path)
    page = tmp_path / "report.html"
    assert main(["report", str(source), "-o", str(page)]) == 0
    assert capsys.readouterr().err == ""
    header = header_of(page)
    assert header["kind"] == "transient"
    assert header["frames"] == [0.5, 0.52, 0.54]
    assert header["lasers"] == 3
    contents = contents_of(load_result(source))
    for name in ("transient", "steady"):
        about = contents.header["light" if name == "transient" else name]
        found = contents.layer(about)
        for k, data in enumerate(made):
            values = data[name].values
            values = values if name == "transient" else values[:, :, None]
            shown = found[k].transpose(2, 3, 0, 1)
            tolerance = about["ratio"] ** 0.5 - 1 + 1e-6
            np.testing.assert_allclose(shown, values, rtol=tolerance, atol=about["least"])
    peaks = contents.part("peaks").reshape(3, 4, 6)
    assert np.array_equal(peaks[0], peaks[2])


def test_frames_of_python_are_explored():
    film = tofrender.render_frames(
        "fan", [0, 0.01], size=(5, 4), bins=8, start_opl=5.0, bin_width=1.0, spp=2, progress=False
    )
    assert contents_of(film).header["frames"] == [0.0, 0.01]
    with pytest.raises(ValueError, match=r"distance_m = .*: must be None for frames"):
        contents_of(film, distance_m=np.ones((4, 5)))


def test_an_empty_folder_of_frames(tmp_path, capsys):
    (tmp_path / "film").mkdir()
    (tmp_path / "film" / "frames.json").write_text("{}")
    said = refused(capsys, "report", tmp_path / "film", "-o", tmp_path / "a.html")
    assert "does not contain finished frames" in said


@pytest.mark.parametrize("kind", [*SENSORS, "frames"])
def test_comparisons_of_measurements_and_frames(tmp_path, kind):
    if kind == "frames":
        source, made = frames_in(tmp_path)
        expected = made[0]["steady"].values
    else:
        source = tmp_path / "sensed.nc"
        measured = measured_by(kind)
        save_measurement(measured, source)
        if kind == "taps":
            expected = measured["taps"].mean(("frequency", "tap")).values[..., None]
        else:
            name = "counts" if kind == "counts" else "images"
            expected = measured[name].transpose("y", "x", ...).values.sum(axis=2)[..., None]
    pair = PictureSet(*(load(source, load_result) for _ in range(2)))
    for picture in pair.pictures:
        np.testing.assert_allclose(picture.pixels, expected, rtol=1e-5, atol=1e-4)
    assert (pair.clock is None) == (kind == "taps")
    name = "film, frame 1 of 3" if kind == "frames" else "sensed.nc"
    assert pair.pictures[0].name.startswith(name)
    if kind == "counts":
        assert pair.quantity == "counts"
