"""Scan patterns, CSV files of shots, point clouds as files, and the command `tofrender lidar`."""

import json
import re

import numpy as np
import pytest
import xarray as xr
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


def read_ply(path):
    """Vertices of a binary PLY, by its header alone."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    kinds = {"double": "<f8", "uchar": "u1", "int": "<i4"}
    properties = re.findall(r"property (\w+) (\w+)", header.decode())
    dtype = [(name, kinds[kind]) for kind, name in properties]
    table = np.frombuffer(body, dtype)
    assert f"element vertex {table.size}\n" in header.decode()
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    return table


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
        (["--shots", "0x4"], "--shots = 0x4: must be"),
        (["--divergence", "-1"], "--divergence = -1: must be"),
        (["--fov", "400x10"], "fov_deg = 400"),
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
    assert found.intensity.tolist() == [16384, 32768, 65535]
    assert np.asarray(found.return_number).tolist() == [1, 2, 1]
    assert found.gps_time.tolist() == [0.0, 0.5, 1.0]


def test_las_without_laspy(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("tofrender.io.point_clouds.find_spec", lambda name: None)
    with refused(r"path = .*: must be .ply or .nc without laspy, see tofrender\[lidar\]"):
        io.save_point_cloud(cloud(), tmp_path / "a.las")
    assert main([*SMALL, "--out", str(tmp_path / "a.las")]) == 2
    assert capsys.readouterr().err.startswith("error: --out = ")
