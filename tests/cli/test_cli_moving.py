"""`tofrender doppler` and `tofrender fmcw`: what they write, what they refuse, their page."""

import json
import re

import numpy as np
import pytest
import xarray as xr
from helpers.commands import done, refused
from helpers.limits import lower

import tofrender
from tofrender.apps.explorer.page_contents import contents_of
from tofrender.cli.answers import SCHEMAS
from tofrender.cli.report import load_result
from tofrender.io.command_files import is_listed
from tofrender.io.exr import load_exr_layers

BOX = ["cornell_box_flash", "--size", "6x5", "--spp", 8, "--seed", 3]


@pytest.mark.essential
def test_doppler_writes_what_the_function_measures(tmp_path, capsys):
    out = tmp_path / "a"
    facts = json.loads(done(capsys, "doppler", *BOX, "--cycles", 2, "--out", out, "--json")[0])
    assert list(facts) == ["command", "version", *SCHEMAS["doppler"]]
    assert sorted(path.name for path in out.iterdir()) == sorted(facts["files"])
    scene = tofrender.load_scene("cornell_box_flash", width=6, height=5)
    given = tofrender.doppler(scene, cycles=2, spp=8, seed=3, progress=False)
    measured = xr.load_dataset(out / "doppler.nc")
    layers, *_ = load_exr_layers(out / "doppler.exr")
    assert np.allclose(measured["homodyne"], given["homodyne"], rtol=1e-4)
    assert np.array_equal(layers["homodyne.Q"], measured["homodyne"].values[:, :, 1])
    assert np.array_equal(layers["rate"][..., 0], measured["rate"].astype(np.float32))
    assert abs(measured["rate"]).max() < 1e-3  # Nothing moves
    out = tmp_path / "b"
    done(capsys, "doppler", *BOX, "--waveform", "triangle", "--out", out)
    assert sorted(path.name for path in out.iterdir()) == ["doppler.exr", "doppler.nc"]
    said = refused(
        capsys, "doppler", *BOX, "--waveform", "triangle", "--dpi", 99, "--out", tmp_path / "c"
    )
    assert "require --waveform sine" in said


@pytest.mark.filterwarnings("ignore::UserWarning")  # Energy outside the bins
def test_fmcw_writes_film_spectra_and_estimates(tmp_path, capsys):
    out = tmp_path / "a"
    options = ["--looks", 2, "--photons", 500, "--bandwidth", 5e8, "--rates=-1,1"]
    facts = json.loads(done(capsys, "fmcw", *BOX, *options, "--out", out, "--json")[0])
    assert list(facts) == ["command", "version", *SCHEMAS["fmcw"]]
    assert sorted(path.name for path in out.iterdir()) == sorted(facts["files"])
    names = ("range_rate", "spectra", "estimates")
    film, spectra, estimates = (xr.load_dataset(out / f"{name}.nc") for name in names)
    lidar = tofrender.Fmcw(
        bandwidth_hz=5e8, chirp_s=1e-5, wavelength_m=1.55e-6, looks=2, photons=500
    )
    again = lidar.spectra(film, 3)
    assert np.array_equal(again["down"], spectra["down"])
    assert np.allclose(lidar.estimates(again)["opl"], estimates["opl"])
    assert abs(estimates["rate"]).median() < 0.02  # Nothing moves; some pixels are dark
    at_rest = film["radiance"].sum(("y", "x", "opl", "channel"))
    assert at_rest.sel(rate=0, method="nearest") == pytest.approx(at_rest.sum().item())
    contents = contents_of(load_result(out))
    shown, axis = contents.layer(contents.header["rates"]), contents.header["rateAxis"]
    assert shown.shape == (facts["rate_bins"], facts["bins"], 1, 5, 6)
    assert axis["start"] == pytest.approx(-1)
    assert axis["width"] * axis["count"] == pytest.approx(2)
    light = film["radiance"].sum("channel").transpose("rate", "opl", "y", "x").values[:, :, None]
    assert shown.sum() == pytest.approx(light.sum(), rel=0.02)
    done(capsys, "report", out, "--out", tmp_path / "a.html")


@pytest.mark.filterwarnings("ignore::UserWarning")  # Energy outside the bins
def test_fmcw_without_a_size_chooses_one_that_fits(tmp_path, capsys, monkeypatch):
    lower(monkeypatch, moving_values=1 << 20)
    options = ["--spp", 1, "--bandwidth", 5e8, "--rates=-1,1", "--out", tmp_path / "a", "--json"]
    printed, said = done(capsys, "fmcw", BOX[0], *options)
    facts = json.loads(printed)
    values = 3 * facts["width"] * facts["height"] * facts["bins"] * facts["rate_bins"]
    assert 0.5 < values / (1 << 18) <= 1
    assert f"{facts['width']}x{facts['height']} pixels" in said
    assert "--size allows up to 23x23" in said
    assert "--window" in said


@pytest.mark.filterwarnings("ignore::UserWarning")  # Energy outside the bins
def test_fmcw_says_which_options_make_a_film_smaller(tmp_path, capsys, monkeypatch):
    """The size that the message names is accepted, and so is a narrower window."""
    lower(monkeypatch, moving_values=1 << 18)
    scene = ["fmcw", "cornell_box_flash", "--spp", 1, "--bandwidth", 5e8, "--rates=-1,1"]
    said = refused(capsys, *scene, "--size", "40x30", "--out", tmp_path / "a")
    found = re.match(r"--size = 40x30: .* 262,144 .* Use --size (\d+)x(\d+) .*--window", said)
    assert found, said
    width, height = int(found[1]), int(found[2])
    assert width / height == pytest.approx(4 / 3, rel=0.15)
    smaller = ["--size", f"{width}x{height}", "--out", tmp_path / "a", "--json"]
    facts = json.loads(done(capsys, *scene, *smaller)[0])
    assert (facts["width"], facts["height"]) == (width, height)
    narrow = ["--size", "40x30", "--window", "4,4.5", "--chirp", 2e-6, "--out", tmp_path / "b"]
    done(capsys, *scene, *narrow)


MOVING = {"doppler": ["doppler", *BOX, "--cycles", 2], "fmcw": ["fmcw", *BOX, "--rates=-1,1"]}
OTHER = {
    "gate": ["gate", *BOX, "--at", 6.5, "--pulse-width", 0.5],
    "phasor": ["phasor", *BOX, "--freq", 3e7],
}


@pytest.mark.filterwarnings("ignore::UserWarning")  # Energy outside the bins
@pytest.mark.parametrize("name", [*MOVING, *OTHER])
def test_a_finished_run_is_replaced_or_stays(tmp_path, capsys, name):
    """A second run replaces its own files; with --resume, a finished run is complete already."""
    out, command = tmp_path / "out", (MOVING | OTHER)[name]
    facts = json.loads(done(capsys, *command, "--out", out, "--json")[0])
    names = sorted(path.name for path in out.iterdir())
    assert names == sorted(facts["files"])
    assert all(is_listed(each, commands=(name,)) for each in names)
    done(capsys, *command, "--out", out)
    before = {path: path.stat().st_mtime_ns for path in out.iterdir()}

    # With --resume, nothing is changed
    said, _ = done(capsys, *command, "--out", out, "--resume")
    assert said == f"{out}: already complete, 8 samples per pixel\n"
    again = json.loads(done(capsys, *command, "--out", out, "--resume", "--json")[0])
    assert again == facts
    assert {path: path.stat().st_mtime_ns for path in out.iterdir()} == before

    # Another run is named, and files that are missing are rendered again
    said = refused(capsys, *command, "--out", out, "--resume", "--seed", 4)
    assert f"--resume: {out} was made with seed = 3 instead of 4" in said
    next(out.glob("*.png")).unlink()
    assert "no run that writes" in refused(capsys, *command, "--out", out, "--resume")
    (out / "notes.txt").write_text("mine")
    assert "contains other files (notes.txt)" in refused(capsys, *command, "--out", out)


def test_fmcw_refuses_before_it_renders(tmp_path, capsys):
    for options, said in (
        (["--rate-bins", 5], "film with bins of rate 0.4 wide: must be at most as wide as"),
        (["--window", "scene"], "--window = 'scene': must be auto or start,stop"),
        (["--rates", "3,1"], "must end after it starts"),
        (["--bandwidth", 1e12], "must be at most 1048576 in all"),
        (["--resume"], "no run that writes"),
    ):
        assert said in refused(capsys, "fmcw", *BOX, *options, "--out", tmp_path / "a")
        assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("command", ["doppler", "fmcw"])
def test_a_scene_at_rest_gets_a_note(tmp_path, capsys, command):
    small = ("--size", "2x2", "--spp", "1")
    _, told = done(capsys, command, "cornell_box_flash", *small, "--out", tmp_path / "rest")
    assert "note: no part of this scene moves" in told
