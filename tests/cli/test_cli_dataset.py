"""`tofrender dataset`: the plan, what is refused, and a run that is killed."""

import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import refused, run
from helpers.films_in_parts import script

from tofrender.datasets import load_dataset
from tofrender.datasets.making import under_way

CONFIG = """
records = 4
seed = 3
scene = "cornell_box"

[render]
width = 8
height = 8
spp = {spp}
temporal_bins = 60
window = [3, 15]

[outputs]
transient = true
depth = true

[vary.turn]
turn = "small-box"
distribution = "uniform"
low = -40
high = 40
"""


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "boxes.toml"
    path.write_text(CONFIG.format(spp=4))
    return path


def test_the_plan_alone(config, capsys):
    status, out, err = run(capsys, "dataset", config, "--plan", "--only", "1,2-3")
    assert (status, err) == (0, "")
    assert out.startswith("3 records of cornell_box (of 4); varied: turn\narray ")
    assert "transient  record, y, x, opl, channel  3 x 8 x 8 x 60 x 3  135 KiB\n" in out


def test_all_and_one_of_them(config, tmp_path, capsys):
    out = tmp_path / "all.zarr"
    status, told, err = run(capsys, "dataset", config, "--out", out)
    assert (status, told) == (0, f"{out}: 4 records, depth, transient\n")
    assert err.startswith("4 records of cornell_box; varied: turn\n")
    one = tmp_path / "one.zarr"
    status, told, _ = run(capsys, "dataset", config, "--out", one, "--only", 2)
    assert (status, told) == (0, f"{one}: 1 record, depth, transient\n")
    alone, whole = load_dataset(one), load_dataset(out)
    for name in ("transient", "depth", "turn"):
        np.testing.assert_allclose(alone[name][0], whole[name][2], rtol=1e-4, atol=1e-6)
    assert refused(capsys, "dataset", config, "--out", out).endswith("must be a new folder")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ([], "--out is missing"),
        (["--out", "boxes"], "out = boxes: must be the name of a folder that ends in .zarr"),
        (["--out", "x.zarr", "--only", "x"], "--only = x: must be indices of records, like 17 or"),
        (["--out", "x.zarr", "--only", "3-1"], "--only = 3-1: must be indices of records, like 17"),
        (["--out", "x.zarr", "--only", "9"], "only = 9: must be an integer from 0 to 3"),
        (["--out", "x.zarr", "--resume"], "--resume: x.zarr has no stopped run. Remove"),
        (["--out", "x.zarr", "--workers", "0"], "--workers = 0: must be an integer from 1 to 1024"),
    ],
)
def test_bad_options_are_refused(config, tmp_path, monkeypatch, capsys, options, text):
    monkeypatch.chdir(tmp_path)
    assert text in refused(capsys, "dataset", config, *options)
    assert list(tmp_path.iterdir()) == [config]


WAITS = """
import sys
from tofrender.cli.app import main
from tofrender.datasets.stored_records import StoredRecords
put = StoredRecords.write_part
def waiting(*arguments):
    receipt = put(*arguments)
    print("here", flush=True)
    input()
    return receipt
StoredRecords.write_part = waiting
sys.exit(main(sys.argv[1:]))
"""


def killed(config: Path, out: Path, number: int) -> int:
    """Start a run, send it a signal when a record is there, and give the exit status."""
    process = script(WAITS, "dataset", config, "--out", out, stdin=subprocess.PIPE)
    assert process.stdout.readline() == "here\n", process.stderr.read()
    process.send_signal(number)
    process.communicate("\n")
    return process.returncode


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM], ids=["kill -9", "kill"])
def test_a_killed_run_goes_on(tmp_path, capsys, number):
    config, out, whole = tmp_path / "c.toml", tmp_path / "x.zarr", tmp_path / "whole.zarr"
    config.write_text(CONFIG.format(spp=32))
    status = killed(config, out, number)
    assert status == (-number if number == signal.SIGKILL else 130)
    assert not out.exists()
    assert len(list((under_way(out) / "receipts").glob("record *.json"))) == 1
    assert "an unfinished data set is beside it" in refused(capsys, "dataset", config, "--out", out)
    status, _, err = run(capsys, "dataset", config, "--out", out, "--resume")
    assert status == 0
    assert "resuming from 1 of 4 records" in err
    status, told, err = run(capsys, "dataset", config, "--out", out, "--resume")
    assert (status, told, err) == (0, f"{out}: already complete, 4 records\n", "")
    config.write_text(CONFIG.format(spp=16))
    said = refused(capsys, "dataset", config, "--out", out, "--resume")
    assert "is there, with another config; must be a new folder" in said
    config.write_text(CONFIG.format(spp=32))
    assert run(capsys, "dataset", config, "--out", whole)[0] == 0
    one, other = load_dataset(out), load_dataset(whole)
    for name in ("transient", "depth", "turn", "render_seed"):
        np.testing.assert_allclose(one[name], other[name], rtol=1e-4, atol=1e-6)
    assert not list(tmp_path.glob(".tofrender-*"))
