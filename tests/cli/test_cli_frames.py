"""`tofrender render --frames`: folders, video, and going on after a stop."""

import json
from functools import partial

import numpy as np
import pytest
from helpers.commands import done, refused

from tofrender import io, render_frames
from tofrender.cli.app import main
from tofrender.cli.checkpoints import AGAIN
from tofrender.motion import frames as module

FAN = ["render", "fan", "--size", "13x9", "--bins", "8", "--start-opl", "5", "--bin-width", "1"]
FAN += ["--spp", "4", "--format", "npz", "--frames", "3", "--frame-time", "0.01"]
SETTINGS = {"size": (13, 9), "bins": 8, "start_opl": 5.0, "bin_width": 1.0, "spp": 4}
BLUR = ["--exposure", "0.004", "--poses", "2"]

close = partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-6)


def test_frames_are_those_of_python(tmp_path, capsys):
    out = tmp_path / "film"
    said, _ = done(capsys, *FAN, *BLUR, "--json", "--out", out)
    names = [f"frame_000{k}" for k in range(3)]
    assert json.loads(said)["files"] == [*names, "frames.json", "steady.npy", "video.mp4"]
    expected = render_frames(
        "fan", [0, 0.01, 0.02], exposure_s=0.004, poses=2, progress=False, **SETTINGS
    )
    for k, name in enumerate(names):
        assert {"summary.png", "transient.npz", "video.mp4"} == {
            path.name for path in (out / name).iterdir()
        }
        found = io.load_npz(out / name / "transient.npz")
        np.testing.assert_allclose(
            found["transient"], expected["transient"][k], rtol=1e-4, atol=1e-6
        )
        assert found.attrs["time_s"] == pytest.approx(0.01 * k)
    np.testing.assert_allclose(
        np.load(out / "steady.npy"), expected["steady"], rtol=1e-4, atol=1e-6
    )
    assert (out / "video.mp4").stat().st_size > 1000


def test_a_stopped_run_goes_on_frame_by_frame(tmp_path, capsys, monkeypatch):
    out, plain, rendered = tmp_path / "film", module.render_frame, []

    def stopped(job, time_s, shutter):
        rendered.append(time_s)
        if len(rendered) == 2:
            raise KeyboardInterrupt
        return plain(job, time_s, shutter)

    monkeypatch.setattr(module, "render_frame", stopped)
    command = [*FAN, "--no-video", "--out", str(out)]
    assert main(command) == 130
    assert f"interrupted after 1 of 3 frames; {AGAIN}" in capsys.readouterr().err
    assert sorted(p.name for p in out.iterdir()) == ["frame_0000", "frames.json", "steady.npy"]
    before = (out / "frame_0000" / "transient.npz").stat().st_mtime_ns
    assert "a stopped run has left frames in" in refused(capsys, *command)
    said = refused(capsys, *command, "--resume", "--row-time", "0.001")
    assert "have row_time_s = 0.0 instead of 0.001" in said
    assert refused(capsys, *command, "--resume", "--seed", "2").startswith(
        "--resume: the frames in"
    )
    done(capsys, *command, "--resume")
    assert rendered == [0.0, 0.01, 0.01, 0.02]
    assert (out / "frame_0000" / "transient.npz").stat().st_mtime_ns == before
    assert "already complete, 3 frames" in done(capsys, *command, "--resume")[0]
    assert len(rendered) == 4
    rendered.clear()
    mine = (out / "frame_0002" / "transient.npz").read_bytes()
    assert main([*command, "--seed", "2"]) == 130
    assert (out / "frame_0002" / "transient.npz").read_bytes() == mine  # Until the new one is whole
    capsys.readouterr()
    assert "a stopped run has left frames in" in refused(capsys, *command)
    said, _ = done(capsys, *command, "--seed", "2", "--resume", "--json")
    assert json.loads(said)["seed"] == 2
    assert (out / "frame_0002" / "transient.npz").read_bytes() != mine
    assert [path.name for path in tmp_path.iterdir()] == ["film"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--frames", "3"], "--frame-time is missing"),
        (["--exposure", "1"], "--exposure requires --frames"),
        (["--row-time", "1"], "--row-time requires --frames"),
        (
            ["--frames", "3", "--frame-time", "1", "--denoise"],
            "--denoise cannot be combined with --frames",
        ),
        (
            ["--frames", "3", "--frame-time", "1", "--checkpoint", "2"],
            "--checkpoint cannot be combined",
        ),
        (
            ["--frames", "3", "--frame-time", "1", "--format", "zarr"],
            "--format = zarr cannot be combined",
        ),
        (["--frames", "3", "--frame-time", "1", "--resume"], "--resume: "),
    ],
)
def test_options_that_do_not_suit_frames(tmp_path, capsys, options, said):
    out = tmp_path / "film"
    small = ["render", "fan", "--size", "4x4", "--start-opl", "5", "--spp", "1", *options]
    assert said in refused(capsys, *small, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize("name", ["notes.txt", "video.mp4"])
def test_other_content_is_kept(tmp_path, capsys, name):
    (tmp_path / name).write_text("mine")
    said = refused(capsys, *FAN, "--out", str(tmp_path))
    assert f"contains other files ({name})" in said


def test_facts_are_of_all_frames(tmp_path, capsys):
    out = tmp_path / "film"
    said, _ = done(capsys, *FAN, "--json", "--out", out)
    times = [io.load_npz(each / "transient.npz").attrs for each in sorted(out.glob("frame_*"))]
    facts = json.loads(said)
    assert facts["render_seconds"] == pytest.approx(sum(t["render_seconds"] for t in times))
    outside = [each["energy_outside_window"] for each in times]
    assert facts["energy_outside_window"] == max(outside) > outside[-1]
    (out / "frames.json").write_text(
        json.dumps(
            {"so_far": facts, "recipe": json.loads((out / "frames.json").read_text())["recipe"]}
        )
    )  # As if it was killed while the video was written
    again, _ = done(capsys, *FAN, "--json", "--out", out, "--resume")
    assert json.loads(again) == facts
