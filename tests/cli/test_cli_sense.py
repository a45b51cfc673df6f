"""`tofrender sense`: what a sensor measures of a render, and its page."""

import json

import numpy as np
import pytest
import xarray as xr
from helpers.commands import done, refused
from helpers.made_dataset import make_dataset

import tofrender
from tofrender.cli.answers import SCHEMAS

TOML = "cycles = 500\nphotons = { photons_per_cycle = 0.5 }\n[spad]\n"


@pytest.fixture
def render(tmp_path):
    tofrender.save_exr_stack(make_dataset(8, 8, 40), tmp_path / "render", progress=False)
    (tmp_path / "sensor.toml").write_text(TOML)
    return tmp_path / "render"


def test_counts_and_their_expectation(tmp_path, capsys, render):
    arguments = ["sense", render, "--sensor", tmp_path / "sensor.toml", "--out", tmp_path / "a"]
    for _ in range(2):  # The second time, it replaces its own folder
        out, err = done(capsys, *arguments, "--seed", (1 << 32) - 1)
    measured = xr.load_dataset(tmp_path / "a" / "sensed.nc")
    given = tofrender.sensors.sense(
        tofrender.load_exr_stack(render), tmp_path / "sensor.toml", (1 << 32) - 1
    )
    assert np.array_equal(measured["counts"], given["counts"])
    assert np.allclose(measured["expected"], given["expected"])
    assert measured.attrs["sensor_seed"] == (1 << 32) - 1
    total, expected = (f"{float(given[name].sum()):,.0f}" for name in ("counts", "expected"))
    names = f"{tmp_path / 'a'}: sensed.nc, summary.png"
    assert out.splitlines() == [names, f"sum of counts {total}, {expected} expected"]
    assert err == ""
    facts = json.loads(done(capsys, *arguments, "--json")[0])
    assert list(facts) == ["command", "version", *SCHEMAS["sense"]]
    assert 0.8 < facts["total"] / facts["expected"] < 1.2


def test_bad_sensors_are_one_line(tmp_path, capsys, render):
    (tmp_path / "key.toml").write_text(TOML + "moed = 'multi_hit'")
    (tmp_path / "text.toml").write_text("cycles")
    for sensor, said in (
        ("flash", "--sensor = 'flash': did you mean 'flash_dtof'? Must be one of"),
        ("flash_dtof", "sensor.pixels = [64, 64]: must be numbers that divide the film of 8 x 8"),
        (tmp_path / "no.toml", "does not exist; must be a TOML file"),
        (tmp_path / "text.toml", "--sensor = "),
        (tmp_path / "key.toml", "sensor.spad.moed: is not known, did you mean mode? Must be one"),
    ):
        assert said in refused(capsys, "sense", render, "--sensor", sensor, "--out", tmp_path / "a")
        assert not (tmp_path / "a").exists()
    options = ["--sensor", "itof", "--out", tmp_path.parent / "other"]
    assert "does not contain a render" in refused(capsys, "sense", tmp_path, *options)
    inside = ["--sensor", "itof", "--out", render / "a"]
    assert "must be outside of" in refused(capsys, "sense", render, *inside)
