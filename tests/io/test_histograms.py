"""Histograms of multi-zone sensors and poses: layouts of files, and files that are wrong."""

import gzip
import json

import numpy as np
import pytest
from helpers.refusals import refused

from tofrender.io import load_histograms, load_poses

rng = np.random.default_rng(4)
COUNTS = rng.integers(0, 900, (3, 6, 5))  # poses, zones, bins
REFERENCE = rng.integers(0, 900, (3, 2, 5))
POSES = np.tile(np.eye(4), (3, 1, 1))
POSES[:, :3] += rng.uniform(-1, 1, (3, 3, 4))


def records(last_row=(0.0, 0.0, 0.0, 0.0)) -> list[dict]:
    poses = POSES.copy()
    poses[:, 3] = last_row
    return [
        {"hists": c.tolist(), "pose": p.tolist(), "reference_hist": r[0].tolist(), "tick": 3}
        for c, p, r in zip(COUNTS, poses, REFERENCE, strict=True)
    ]


def frames() -> list[dict]:
    """Frames of a log with 2 rows and 3 columns of zones, and one without histograms."""
    made = []
    for counts, reference in zip(COUNTS.reshape(3, 2, 3, 5), REFERENCE, strict=True):
        zones = [[{"bin": zone.tolist()} for zone in row] for row in counts]
        diodes = [{"bin": each.tolist()} for each in reference]
        made.append({"info": {"frame_number": 1}, "mp_histo": zones, "ref_histo": diodes})
    return [*made, {"info": {}, "results": []}]


@pytest.mark.parametrize("last_row", [(0, 0, 0, 0), (0, 0, 0, 1)])
def test_posed_histograms(tmp_path, last_row):
    (tmp_path / "a.json").write_text(json.dumps(records(last_row)))
    found = load_histograms(tmp_path / "a.json")
    np.testing.assert_array_equal(found["counts"], COUNTS)
    np.testing.assert_array_equal(found["reference"], REFERENCE[:, :1])
    np.testing.assert_array_equal(found["to_world"], POSES)
    np.testing.assert_array_equal(load_poses(tmp_path / "a.json"), POSES)


@pytest.mark.parametrize("layout", ["whole", "compressed", "documents", "lines"])
def test_logs_of_the_driver(tmp_path, layout):
    file = tmp_path / "a.json"
    whole = {"configuration": {}, "Result_Set": frames()}
    if layout == "whole":
        file.write_text(json.dumps(whole))
    elif layout == "compressed":
        file.write_bytes(gzip.compress(json.dumps(whole).encode()))
    else:
        indent = 2 if layout == "documents" else None
        parts = [{"time": "now"}, *({"Result_Set": each} for each in frames())]
        file.write_text("".join(json.dumps(each, indent=indent) + "\n" for each in parts))
    found = load_histograms(file)
    np.testing.assert_array_equal(found["counts"], COUNTS)
    np.testing.assert_array_equal(found["reference"], REFERENCE)
    assert (found.attrs["zone_rows"], found.attrs["zone_columns"]) == (2, 3)


@pytest.mark.parametrize("rows", [3, 4])
@pytest.mark.parametrize("separator", [" ", ", "])
def test_table_of_poses(tmp_path, rows, separator):
    lines = [separator.join(map(repr, pose[:rows].ravel().tolist())) for pose in POSES]
    (tmp_path / "poses.txt").write_text("\n".join(["# sensor to world", *lines]))
    np.testing.assert_array_equal(load_poses(tmp_path / "poses.txt"), POSES)


def changed(name, value) -> list[dict]:
    made = records()
    made[1][name] = value
    return made


WRONG = {
    "empty list": [],
    "no histograms": [{"pose": np.eye(4).tolist()}],
    "other bins": changed("hists", [[1, 2]]),
    "negative": changed("hists", (-COUNTS[1] - 1).tolist()),
    "text": changed("hists", "many"),
    "not finite": changed("hists", (COUNTS[1] * np.nan).tolist()),
    "pose of 3 numbers": changed("pose", [1, 2, 3]),
    "log without histograms": {"Result_Set": [{"results": []}]},
    "frames of other zones": {"Result_Set": [frames()[0], {"mp_histo": [[{"bin": [1]}]]}]},
    "number": 3,
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_histograms_are_refused(tmp_path, name):
    (tmp_path / "a.json").write_text(json.dumps(WRONG[name]))
    with refused(r"a\.json.*must"):
        load_histograms(tmp_path / "a.json")


@pytest.mark.parametrize("content", [b"", b"[[[1,", b"\x1f\x8b cut", b"[" * 100_000, b"\xff\xfe"])
def test_damaged_files_are_refused(tmp_path, content):
    (tmp_path / "a.json").write_bytes(content)
    for load in (load_histograms, load_poses):
        with refused(r"a\.json.*must"):
            load(tmp_path / "a.json")


@pytest.mark.parametrize("text", ["1 2 3", "{}", "[]", "[[1, 2]]", '[{"a": 1}]', "1 2 nan"])
def test_wrong_poses_are_refused(tmp_path, text):
    (tmp_path / "a.txt").write_text(text)
    with refused(r"a\.txt.*must"):
        load_poses(tmp_path / "a.txt")
