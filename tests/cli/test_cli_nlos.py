"""`tofrender capture` and `tofrender reconstruct`: from a hidden scene to its picture."""

import numpy as np
import pytest
from helpers import peer_scenes
from helpers.commands import refused, run

import tofrender
from tofrender.cli.app import main
from tofrender.cli.nlos import WALL_SCENES
from tofrender.io.exr import load_exr_layers
from tofrender.runtime import atomic
from tofrender.scenes import BUILT_IN


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    path = tmp_path_factory.mktemp("capture") / "z.h5"
    assert main(["capture", "nlos-z", "--grid", "24x24", "--spp", "32", "--out", str(path)]) == 0
    return path


@pytest.mark.parametrize("method", ["lct", "fk"])
def test_a_hidden_letter_is_found(captured, tmp_path, method, capsys):
    out = tmp_path / method
    atomic.sibling(out, "-0a1b2c3d").mkdir()  # By one that was killed as it wrote
    for _ in range(2):  # The second time, it replaces its own folder
        status, told, err = run(capsys, "reconstruct", captured, "--method", method, "--out", out)
        assert (status, err) == (0, "")
        assert f"{out}: volume.npz, brightness.exr, depth.exr, volume.png; median depth " in told
    depth = float(told.split()[-2])
    assert depth == pytest.approx(1.0, abs=0.02)
    names = {"volume.npz", "brightness.exr", "depth.exr", "volume.png"}
    assert {path.name for path in out.iterdir()} == names
    assert [path.name for path in tmp_path.iterdir()] == [method]
    units = [load_exr_layers(out / f"{name}.exr")[1]["units"] for name in ("brightness", "depth")]
    assert units == ["arbitrary", "m"]
    with np.load(out / "volume.npz") as volume:
        brightness = volume["intensity"].max(axis=0)
        assert brightness.shape == (24, 24)
    # The letter's corners are bright, the notches beside its diagonal are not
    seen = brightness / brightness.max()
    letter, notch = seen[[8, 8, 15, 15], [8, 15, 8, 15]], seen[[11, 12], [8, 15]]
    assert letter.min() > 0.3 > notch.max()


def test_measured_data_that_state_no_geometry(tmp_path, capsys):
    """A point in front of the middle of a wall of 0.7 x 0.5 m."""
    path, out, point_m, bin_s, start_s = (
        tmp_path / "scan.npz",
        tmp_path / "out",
        0.42,
        64e-12,
        -5e-9,
    )
    y, x = np.meshgrid(np.linspace(-0.25, 0.25, 16), np.linspace(-0.35, 0.35, 16), indexing="ij")
    there_and_back_s = 2 * np.sqrt(x**2 + y**2 + point_m**2) / tofrender.SPEED_OF_LIGHT
    bins = np.floor((there_and_back_s - start_s) / bin_s).astype(int)
    np.savez(path, counts=100 * (bins[..., None] == np.arange(200)))

    command, size = (
        ("reconstruct", path, "--method", "bp", "--out", out),
        ("--wall-size", "0.7,0.5"),
    )
    said = f"path = {path}: wall_size = None: must be given by --wall-size, as the file does not"
    assert refused(capsys, *command).startswith(said)
    assert "must be given by --bin-width-s" in refused(capsys, *command, *size)
    status, _, err = run(capsys, *command, *size, "--bin-width-s", bin_s, "--start-s", start_s)
    assert (status, err) == (0, "")
    with np.load(out / "volume.npz") as volume:
        assert [np.ptp(volume[axis]) for axis in "xy"] == pytest.approx([0.7, 0.5])
        found = np.unravel_index(volume["intensity"].argmax(), volume["intensity"].shape)
        at = [volume[axis][k] for axis, k in zip("zyx", found, strict=True)]
        assert at == pytest.approx([point_m, 0, 0], abs=0.03)


def test_a_file_that_exists_is_refused_before_work_starts(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("tofrender.nlos.capture", None)
    out = tmp_path / "mine.h5"
    out.write_text("mine")
    said = refused(capsys, "capture", "nlos-z", "--grid", "2x2", "--spp", "1", "--out", out)
    assert said.startswith(f"--out = {out} exists already")
    assert out.read_text() == "mine"


def test_modes_are_told(tmp_path, capsys):
    path = tmp_path / "single.h5"
    options = ["--mode", "single", "--grid", "4x3", "--spp", "1", "--out", path]
    status, out, _ = run(capsys, "capture", "nlos-z", *options)
    assert (status, out) == (0, f"{path}: single, 4x3 points, 300 bins of 6 mm\n")
    assert tofrender.load_capture(path).attrs["capture_mode"] == "single"
    text = refused(capsys, "reconstruct", path, "--method", "lct", "--out", tmp_path / "out")
    assert "lct" in text
    assert "allows bp, fbp, phasor" in text


def test_a_camera_that_sees_more_than_the_wall(tmp_path, capsys):
    out = tmp_path / "box.h5"
    arguments = ("capture", "wall-box-sphere-nlos", "--grid", "4x4", "--spp", "2", "--out", out)
    status, told, err = run(capsys, *arguments)
    assert err.startswith("warning: sensor: 8 of 16 pixels do not look at the relay wall. They")
    assert err.count("\n") == 1
    assert (status, told.strip()) == (0, f"{out}: confocal, 4x4 points, 1000 bins of 10 mm")
    assert tofrender.load_capture(out)["on_wall"].sum() == 8


def test_the_wall_by_its_id(tmp_path, capsys):
    path = peer_scenes.z_room(tmp_path)
    out = tmp_path / "room.h5"
    arguments = ("capture", path, "--grid", "2x2", "--spp", "1", "--wall")
    assert run(capsys, *arguments, "elm__4", "--out", out)[0] == 0
    said = refused(capsys, *arguments, "wand", "--out", tmp_path / "no.h5")
    assert "relay_wall = 'wand': the scene has no such shape; must be one of 'elm__3'" in said
    assert not (tmp_path / "no.h5").exists()


def test_bins_hold_the_light_of_the_hidden_letter(tmp_path, capsys):
    small = ("capture", "nlos-z", "--grid", "8x6", "--spp", "4")
    status, _, err = run(capsys, *small, "--out", tmp_path / "short.h5")
    assert status == 0
    assert "--bins" in err  # The remedy is an option of the command
    status, told, err = run(capsys, *small, "--bins", "500", "--out", tmp_path / "long.h5")
    assert (status, err) == (0, "")
    assert "500 bins of 6 mm" in told
    assert tofrender.load_capture(tmp_path / "long.h5").sizes["opl"] == 500
    out = ("--out", tmp_path / "workers.h5")
    said = refused(capsys, *small, "--bins", "500", "--workers", "2", *out)
    assert said.startswith("--bins = 500 is not supported with --workers")


def test_a_scene_without_relay_wall_is_refused(tmp_path, capsys):
    said = refused(capsys, "capture", "cornell_box", "--grid", "2x2", "--out", tmp_path / "no.h5")
    assert "cornell_box has no relay wall" in said
    assert "nlos_z" in said


def test_the_scenes_with_a_relay_wall_are_listed():
    """All built-in scenes whose integrator makes captures, and no others."""
    found = set()
    for name in BUILT_IN:
        scene = tofrender.load_scene(name, width=2, height=2, optimize=False)
        if hasattr(scene.integrator(), "capture_plan"):
            found.add(name)
    assert found == set(WALL_SCENES)
