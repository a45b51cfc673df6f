"""Twin of the TMF8820: measures of agreement, the mesh's parts, and the command on known data."""

import json

import numpy as np
import pytest
from helpers.refusals import refused
from helpers.twin_recordings import CLOTH, LATER, write_recordings

from tofrender import io
from tofrender.apps.twin.agreement import agreement, correlations, first_peaks
from tofrender.apps.twin.experiment import FITTED_BINS
from tofrender.apps.twin.recordings import FILES, load_recording, training_poses
from tofrender.cli.app import main
from tofrender.sensors import MultiZone


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_recordings(tmp_path_factory.mktemp("data"))


@pytest.mark.parametrize("center", [20.0, 24.3, 31.5, 40.8])
def test_first_peaks_of_gaussians(center):
    """The logarithm of a Gaussian is a parabola; a later peak that is higher does not count."""
    bins = np.arange(64)
    first = 300 * np.exp(-((bins - center) ** 2) / 8)
    second = 1000 * np.exp(-((bins - center - 14) ** 2) / 8)
    assert first_peaks(first) == pytest.approx(center, abs=1e-6)
    assert first_peaks(first + second) == pytest.approx(center, abs=1e-3)
    assert first_peaks(0.2 * first + second) == pytest.approx(center + 14, abs=1e-2)


def test_correlations_are_those_of_numpy():
    a, b = np.random.default_rng(1).standard_normal((2, 5, 30))
    expected = [np.corrcoef(x, y)[0, 1] for x, y in zip(a, b, strict=True)]
    np.testing.assert_allclose(correlations(a, b), expected, rtol=1e-12)


def test_agreement_of_changed_histograms():
    bins = np.arange(128)
    centers = np.random.default_rng(3).uniform(20, 50, (6, 4, 1))
    measured = 10 + 1e4 * np.exp(-((bins - centers) ** 2) / 8)
    same = agreement(measured, measured, 0.014)
    assert (same.poses, same.correlation, same.peak_error_m) == (6, pytest.approx(1), 0)
    assert (same.peak_near, same.counts_near) == (1, 1)
    moved = agreement(np.roll(measured, 1, axis=-1), measured, 0.014)
    assert moved.peak_error_m == pytest.approx(0.014, abs=1e-4)
    assert (moved.peak_near, moved.counts_near) == (0, 1)
    assert moved.correlation < 0.95
    brighter = agreement(1.5 * measured, measured, 0.014)
    assert (brighter.correlation, brighter.counts_near) == (pytest.approx(1), 0)
    outside = measured.copy()
    outside[..., :10] = outside[..., 64:] = 9e9
    assert agreement(outside, measured, 0.014) == same


def test_zones_and_poses_correlate_apart():
    """Zone 1 is wrong in all poses, and pose 3 is wrong in all zones."""
    random = np.random.default_rng(6)
    measured = random.gamma(2.0, 30.0, (4, 3, 70))
    expected = 1.3 * measured + random.gamma(2.0, 3.0, measured.shape)
    expected[:, 1] = random.gamma(2.0, 30.0, (4, 70))
    expected[3] = random.gamma(2.0, 30.0, (3, 70))
    found = agreement(expected, measured, 0.014)
    e, m = expected[..., 10:64], measured[..., 10:64]
    by_zone = [np.corrcoef(e[:, k].ravel(), m[:, k].ravel())[0, 1] for k in range(3)]
    by_pose = [np.corrcoef(e[k].ravel(), m[k].ravel())[0, 1] for k in range(4)]
    assert found.zone_correlation == pytest.approx(by_zone)
    assert found.correlation == pytest.approx(np.median(by_pose))
    assert found.correlation_p10 == pytest.approx(np.quantile(by_pose, 0.1))


def test_training_poses_are_a_quarter_of_all_rings():
    chosen = training_poses(128)
    assert chosen.sum() == 32
    assert np.bincount(np.flatnonzero(chosen) % 8).tolist() == [4] * 8
    assert chosen[[0, 4, 11, 15]].all()


def test_parts_of_the_mesh(folder):
    found = load_recording(folder, "pyramid")
    heights = {part: found.vertices[faces][..., 2] for part, faces in found.faces.items()}
    assert heights["cloth"].max() == pytest.approx(-0.16)
    assert (heights["object"].max(axis=1) > -0.15).all()
    assert found.faces["cloth"].shape[0] > 12  # The slab, and the object's lower face
    assert found.counts.shape == (8, 9, 128)


def test_the_command_finds_a_known_sensor(folder, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["twin", str(folder), "--out", str(out), "--json", "--dpi", "40"]
    assert main(arguments) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [each["recording"] for each in facts["table"]] == list(FILES)
    assert [each["poses"] for each in facts["table"]] == [6, 8, 8, 8]
    for each in facts["table"]:
        assert each["correlation"] > 0.999
        assert each["peak_error_m"] < 0.002
        assert each["counts_near"] == 1
        assert len(each["zone_correlation"]) == 9
    assert facts["wrong_mesh_correlation"] < 0.95
    assert facts["later_scale"] == pytest.approx(LATER, rel=0.02)
    assert {each.name for each in out.iterdir()} == set(facts["files"])
    io.check_output(out, overwrite=True)  # The command can replace its own folder
    found = json.loads((out / "twin.json").read_text())["parameters"]
    assert found["albedo cloth"]["value"] == pytest.approx(CLOTH, rel=0.03)
    assert found["bin_width_opl"]["value"] == pytest.approx(
        MultiZone.preset("tmf8820").bin_width_opl, rel=2e-3
    )
    assert FITTED_BINS[1] < 128


def test_folders_without_the_data_are_refused(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for folder, words in (("empty", "tall_block.json: does not exist"), ("no", "not a folder")):
        assert main(["twin", str(tmp_path / folder), "--out", str(tmp_path / "out")]) == 2
        message = capsys.readouterr().err
        assert words in message
        assert message.count("\n") == 1


def test_a_mesh_without_an_object_is_refused(folder, tmp_path):
    for file in (folder / "tall_block").iterdir():
        (tmp_path / "tall_block").mkdir(exist_ok=True)
        (tmp_path / "tall_block" / file.name).write_bytes(file.read_bytes())
    mesh = tmp_path / "tall_block" / "tall_block.stl"
    content = mesh.read_bytes()
    mesh.write_bytes(content[:80] + (12).to_bytes(4, "little") + content[84 : 84 + 12 * 50])
    with refused("must contain a table and an object"):
        load_recording(tmp_path, "tall_block")
