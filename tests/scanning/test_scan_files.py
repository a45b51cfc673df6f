"""Scan patterns, CSV files of shots, point clouds as files, and the command `tofrender lidar`."""

import json

import numpy as np
import pytest
import xarray as xr
from helpers.point_cloud_files import read_ply
from helpers.refusals import refused

from tofrender import io
from tofrender.cli.app import main
from tofrender.scanning import scan_pattern

SMALL = ["lidar", "cornell_box", "--shots", "6x4", "--spp", "4"]


def degrees(pattern):
    return np.rad2deg([pattern["azimuth"], pattern["elevation"]]).T.round(6).tolist()


def test_patterns():
    raster = scan_pattern("raster", shots=(2, 2), fov_deg=(40, 20), rate_hz=10.0)
    assert degrees(raster) == [[10, 5], [-10, 5], [10, -5], [-10, -5]]
    assert raster["time"].values == pytest.approx([0, 0.1, 0.2, 0.3])
    spinning = scan_pattern("spinning", shots=(4, 2), fov_deg=(360, 20))
    assert degrees(spinning)[:4] == [[135, 5], [135, -5], [45, 5], [45, -5]]
    rosette = np.array(degrees(scan_pattern("rosette", shots=(500, 20), fov_deg=(40, 40))))
    radius = np.hypot(*rosette.T)
    assert radius.max() == pytest.approx(20, abs=0.01)
    assert rosette[0] == pytest.approx([20, 0])
    assert np.histogram2d(*rosette.T, bins=8, range=[[-14, 14]] * 2)[0].min() > 20  # No gaps


def test_csv(tmp_path):
    path = tmp_path / "shots.csv"
    path.write_text("azimuth_deg, elevation_deg, time_s\n10, -5, 0.5\n0, 0, 1\n")
    read = scan_pattern(path)
    assert degrees(read) == [[10, -5], [0, 0]]
    assert read["time"].values.tolist() == [0.5, 1.0]
    path.write_text("elevation_deg,azimuth_deg\n1,2\n")
    assert degrees(scan_pattern(str(path))) == [[2, 1]]
    assert scan_pattern(path)["time"].values.tolist() == [0.0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("azimuth_deg,pitch\n1,2\n", "has 1 rows of azimuth_deg, pitch; must be"),
        ("azimuth_deg,elevation_deg,more\n1,2,3\n", "has 1 rows of .*more; must be"),
        ("azimuth_deg,elevation_deg\n", "has 0 rows of"),
        ("azimuth_deg,elevation_deg\n1,2,3\n", "must be a CSV file"),
        ("azimuth_deg,elevation_deg\n1,\n", "finite azimuth_deg"),
        ("azimuth_deg,elevation_deg\n1,up\n", "finite azimuth_deg"),
        ("azimuth_deg,elevation_deg\n1,91\n", "elevation_deg up to 90"),
        ("", "must be a CSV file"),
        ("\0\xff\xfe\n" * 9, "pattern = .*must be a CSV file"),
        (None, "must be a CSV file"),
    ],
)
def test_wrong_csv(tmp_path, content, said):
    path = tmp_path / "shots.csv"
    if content is not None:
        path.write_bytes(content.encode("latin-1"))
    with refused(said):
        scan_pattern(path)


def test_command(tmp_path, capsys):
    out = tmp_path / "cloud.ply"
    assert main([*SMALL, "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["command"], said["shots"]) == ("lidar", 24)
    assert said["files"] == ["cloud.ply", "cloud_truth.ply"]
    points, truth = read_ply(out), read_ply(tmp_path / "cloud_truth.ply")
    assert points.size == said["points"] >= truth.size > 12
    first = points[points["return_number"] == 1]
    assert np.nanmedian(np.abs(first["range"] - first["true_range"])) < 0.01
    assert set(truth["shot"]) <= set(range(24))
    assert main([*SMALL, "--out", str(tmp_path / "cloud.nc"), "--pattern", "rosette"]) == 0
    with xr.open_dataset(tmp_path / "cloud.nc", engine="scipy") as stored:
        assert {*"xyz", "intensity", "return_number", "time"} <= set(stored)
        assert stored.attrs["pulses"] == 1


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--pattern", "rastr"], "--pattern = 'rastr': did you mean 'raster'?"),
        (["--pattern", "no.csv"], "--pattern = no.csv"),
        (["--shots", "0x4"], "--shots = 0x4:"),
        (["--divergence", "-1"], "--divergence = -1:"),
        (["--fov", "400x10"], "--fov = '400x10'"),
    ],
)
def test_bad_commands(tmp_path, capsys, more, said):
    assert main([*SMALL, *more, "--out", str(tmp_path / "a.ply")]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def cloud():
    columns = {"x": [0.0, 1.5, -200.0], "y": [0.0] * 3, "z": [1.0, 2.0, 3.0]}
    columns |= {
        "intensity": [1.0, 2.0, 4.0],
        "time": [0.0, 0.5, 1.0],
        "true_range": [1.0, 2.0, 3.0],
    }
    columns |= {name: np.uint8([1, 2, 1]) for name in ("return_number", "number_of_returns")}
    return xr.Dataset({name: ("point", np.asarray(each)) for name, each in columns.items()})


def test_las(tmp_path):
    laspy = pytest.importorskip("laspy")
    found = laspy.read(io.save_point_cloud(cloud(), tmp_path / "a.las"))
    assert found.xyz[2].tolist() == pytest.approx([-200, 0, 3])
    assert found.intensity.tolist() == [1, 2, 4]
    assert np.asarray(found.return_number).tolist() == [1, 2, 1]
    assert found.gps_time.tolist() == [0.0, 0.5, 1.0]


def test_las_intensity_has_one_scale_for_all_files(tmp_path):
    """A point keeps its LAS intensity when brighter points are in the same file."""
    laspy = pytest.importorskip("laspy")
    whole = cloud().assign(intensity=("point", [12.4, 700.0, 90_000.0]))
    scale = {"intensity_scale": 0.5}
    parts = [whole.isel(point=slice(0, 2)), whole.isel(point=slice(1, 3))]
    files = [io.save_point_cloud(p, tmp_path / f"{k}.las", **scale) for k, p in enumerate(parts)]
    first, second = (laspy.read(file).intensity.tolist() for file in files)
    assert first == [6, 350]
    assert second == [350, 45_000]
    with pytest.warns(UserWarning, match=r"1 of 3 points .* pass intensity_scale=0\.7 or less"):
        path = io.save_point_cloud(whole, tmp_path / "cut.las")
    assert laspy.read(path).intensity.tolist() == [12, 700, 65_535]


@pytest.mark.parametrize(
    ("offset", "width", "step"),
    [(0.0, 3.0, 1e-4), (5.3e6, 40.0, 1e-4), (-214_800.0, 5.0, 1e-4), (7.0e5, 1.2e6, 1e-3)],
)
def test_las_places_far_clouds(tmp_path, offset, width, step):
    laspy = pytest.importorskip("laspy")
    x = offset + width * np.array([0.0, 0.31, 1.0])
    y = -2 * offset + np.array([1.0, 2.5, -7.0])
    far = cloud().assign(x=("point", x), y=("point", y))
    found = laspy.read(io.save_point_cloud(far, tmp_path / "a.las"))
    assert np.asarray(found.x) == pytest.approx(x, abs=0.51 * step, rel=0)
    assert np.asarray(found.y) == pytest.approx(y, abs=0.51 * step, rel=0)
    assert np.asarray(found.z) == pytest.approx([1, 2, 3], abs=0.51 * step, rel=0)
    assert found.header.scales.tolist() == [step] * 3


def test_las_of_no_points(tmp_path):
    laspy = pytest.importorskip("laspy")
    path = io.save_point_cloud(cloud().isel(point=slice(0, 0)), tmp_path / "a.las")
    assert len(laspy.read(path).points) == 0


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("return_number", np.uint8([1, 16, 2]), "return_number = .*must be from 0 to 15 in a LAS"),
        ("return_number", [1.0, 1.5, 2.0], "return_number = .*must be integers"),
        ("intensity", [1.0, -2.0, 3.0], "intensity = .*must be from 0 to inf"),
        ("intensity", [1.0, np.nan, 3.0], "intensity"),
        ("y", [1.0, np.inf, 3.0], "cloud: y"),
        ("y", [1.0, 1e13, 3.0], "cloud: y = .*must be from -1e.12 to 1e.12"),
    ],
)
def test_las_refuses_values(tmp_path, name, values, said):
    pytest.importorskip("laspy")
    with refused(said):
        io.save_point_cloud(cloud().assign({name: ("point", values)}), tmp_path / "a.las")
    assert not list(tmp_path.iterdir())


def test_las_without_laspy(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("tofrender.io.point_clouds.find_spec", lambda name: None)
    with refused(r"path = .*: must be .ply or .nc without laspy, see tofrender\[lidar\]"):
        io.save_point_cloud(cloud(), tmp_path / "a.las")
    assert main([*SMALL, "--out", str(tmp_path / "a.las")]) == 2
    assert capsys.readouterr().err.startswith("error: --out = ")
