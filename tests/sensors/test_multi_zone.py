"""Multi-zone sensors: weights of zones, bins, crosstalk, noise, files, and errors."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from helpers.parts import diffuse, plane, point_light, rotate, translate
from helpers.refusals import refused
from helpers.support import camera, film, scene
from scipy import integrate, stats

from tofrender import SampledPulse
from tofrender.motion import render_poses
from tofrender.sensors import MultiZone
from tofrender.sensors.multi_zone import Light
from tofrender.signals.pulses import KnotPulse

rng = np.random.default_rng(7)
OPL = 0.4 + 0.01 * (np.arange(90) + 0.5)
PULSE = SampledPulse([1.0, 3.0, 0.5], start_opl=-0.03, bin_width_opl=0.025)
PLAIN = MultiZone(
    centers=np.array([[0.21, -0.1], [-0.15, 0.12], [-0.15, -0.1]]),
    sizes=np.array([[0.2, 0.1], [0.15, 0.2], [0.1, 0.1]]),
    gains=np.array([2.0, 3.0, 5.0]),
    starts_opl=np.array([0.31, 0.35, 0.28]),
    floors=np.array([0.5, 0.0, 1.5]),
    pulse=PULSE,
    bins=25,
    bin_width_opl=0.04,
)


def views(light: np.ndarray, width=0.35, height=0.25) -> xr.Dataset:
    """Return renders with a radiance (poses, y, x, opl). Tangents decrease with column and row."""
    rows, columns = light.shape[1:3]
    tan_x = width * (1 - 2 * (np.arange(columns) + 0.5) / columns) + 0.02
    tan_y = height * (1 - 2 * (np.arange(rows) + 0.5) / rows)
    coords = {"tan_x": ("x", tan_x), "tan_y": ("y", tan_y), "opl": OPL[: light.shape[3]]}
    coords["channel"] = ["R", "G"]
    film = ("pose", "y", "x", "opl", "channel"), np.stack([light, 3 * light], axis=-1) / 2
    attrs = {"quantity": "radiance per bin", "bin_width_opl": float(OPL[1] - OPL[0])}
    return xr.Dataset({"transient": film}, coords, attrs)


def flash(at: int, rows=40, columns=60) -> np.ndarray:
    """Return light 1 of all pixels in one bin."""
    light = np.zeros((1, rows, columns, OPL.size))
    light[..., at] = 1.0
    return light


@pytest.mark.parametrize("blur", [0.0, 0.015])
def test_zones_collect_their_part_of_the_field_of_view(blur):
    """Weights equal the integral of cos^4 over the zone. Blurred zones lose no light inside."""
    moved = replace(PLAIN, blur=blur, shift=(0.01, -0.02), scale=(0.9, 1.1), floors=np.zeros(3))
    counts = moved.expected(views(flash(30)))["counts"].sum("bin")[0].values
    for zone in range(3):
        low = moved.scale * (moved.centers - moved.sizes / 2)[zone] + moved.shift
        high = moved.scale * (moved.centers + moved.sizes / 2)[zone] + moved.shift
        exact = integrate.dblquad(
            lambda y, x: 1 / (1 + x * x + y * y) ** 2, low[0], high[0], low[1], high[1]
        )[0]
        assert counts[zone] == pytest.approx(moved.gains[zone] * exact, rel=2e-3)


def test_edges_are_blurred_by_a_gaussian():
    light = Light.of(views(flash(30, 4, 400), height=0.6))
    sharp, soft = (replace(PLAIN, blur=blur).weights(light) / light.cos4 for blur in (0, 0.03))
    step = abs(light.edges_x[1] - light.edges_x[0])
    reach = np.arange(-60, 61)
    kernel = stats.norm.pdf(reach * step, scale=0.03) * step
    row = sharp[1].sum(axis=0)
    expected = np.convolve(row, kernel, mode="same")
    np.testing.assert_allclose(soft[1].sum(axis=0)[70:-70], expected[70:-70], atol=2e-3 * row.max())


def test_a_zone_sees_its_own_side():
    """Light from the left (positive tangents) reaches zone 0, light from the right the others."""
    light = flash(30)
    light[:, :, 30:] = 0.0
    counts = replace(PLAIN, floors=np.zeros(3)).expected(views(light))["counts"].sum("bin")[0]
    assert counts[0] > 0
    assert counts[1] < 1e-12
    above = flash(30)
    above[:, 20:] = 0.0
    counts = replace(PLAIN, floors=np.zeros(3)).expected(views(above))["counts"].sum("bin")[0]
    assert counts[0] < 1e-12
    assert counts[1] > 0


@pytest.mark.parametrize("at", [12, 47])
def test_bins_are_differences_of_the_pulse_s_distribution(at):
    found = PLAIN.expected(views(flash(at)))["counts"][0].values
    light = found - PLAIN.floors[:, None]
    for zone in range(3):
        edges = PLAIN.starts_opl[zone] + 0.04 * np.arange(26) - OPL[at]
        exact = np.diff([float(PULSE.cdf(float(edge))) for edge in edges])
        share = light[zone] / light[zone].sum()
        np.testing.assert_allclose(share, exact, atol=1e-6)


def test_a_start_that_is_a_bin_earlier_moves_counts_by_one_bin():
    earlier = replace(PLAIN, starts_opl=PLAIN.starts_opl - 0.04)
    before, after = (
        each.expected(views(flash(30)))["counts"][0].values for each in (PLAIN, earlier)
    )
    np.testing.assert_allclose(after[:, 1:], before[:, :-1], atol=1e-12)


def test_crosstalk_spreads_the_sum_of_all_signals():
    light = rng.uniform(0, 1, (2, 8, 9, OPL.size))
    same = replace(PLAIN, starts_opl=np.full(3, 0.3), floors=np.zeros(3))
    apart, mixed = (
        each.expected(views(light))["counts"].values / same.gains[:, None]
        for each in (same, replace(same, crosstalk=0.03))
    )
    np.testing.assert_allclose(mixed, apart + 0.03 * apart.sum(axis=1, keepdims=True), rtol=1e-12)


def test_counts_of_a_wall():
    """A tilted wall lit from the sensor: L = albedo I cos / (pi r^2), integrated over a zone."""
    tilt, distance = np.radians(25), 0.8
    wall = plane(translate(0, 0, distance) @ rotate((0, 1, 0), 180 + 25), 9.0, bsdf=diffuse(0.6))
    view = camera((0, 0, 0), (0, 0, 1), film(24, 16, bins=400, start=0.0, bin_width=0.01), fov=50)
    parts = {"wall": wall, "laser": point_light((0, 0, 0), 5.0)}
    pose = [np.eye(4)]
    renders = render_poses(scene(parts, view, max_depth=2), pose, spp=16, progress=False)
    sensor = replace(PLAIN, bins=80, floors=np.zeros(3), bin_width_opl=0.05)
    counts = sensor.expected(renders)["counts"][0]
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    normals = [normal, normal * [-1, 1, 1]]

    def density(y: float, x: float, normal: np.ndarray) -> float:
        length = np.sqrt(1 + x * x + y * y)
        toward = normal @ [x, y, 1.0]
        r = distance * normal[2] * length / toward
        return 0.6 * 5.0 / np.pi * toward / length / r**2 / length**4

    for zone in range(3):
        low = (sensor.centers - sensor.sizes / 2)[zone]
        high = (sensor.centers + sensor.sizes / 2)[zone]
        exact = [
            sensor.gains[zone]
            * integrate.dblquad(density, low[0], high[0], low[1], high[1], args=(each,))[0]
            for each in normals
        ]
        found = float(counts[zone].sum())
        assert min(abs(found / each - 1) for each in exact) < 0.01
    assert abs(exact[0] / exact[1] - 1) > 0.05


def test_noise_is_that_of_photons():
    bright = replace(PLAIN, gains=PLAIN.gains * 1e3)
    renders = views(np.tile(flash(30, 4, 6), (50, 1, 1, 1)))
    expected = bright.expected(renders)["counts"].values
    counts = bright.measure(renders, seed=3)["counts"].values
    assert np.array_equal(counts, bright.measure(renders, seed=3)["counts"].values)
    assert not np.array_equal(counts, bright.measure(renders, seed=4)["counts"].values)
    lit = expected > 0
    assert (counts[~lit] == 0).all()
    chi = ((counts - expected)[lit] ** 2 / expected[lit]).sum()
    assert 1e-3 < stats.chi2.cdf(chi, lit.sum()) < 1 - 1e-3


def test_preset():
    sensor = MultiZone.preset("tmf8820")
    assert sensor.centers.shape == (9, 2)
    assert (sensor.bins, sensor.crosstalk < 0.05) == (128, True)
    assert 0.0278 < sensor.bin_width_opl < 0.0284
    # Zone 3 column + row, columns from +x to -x and rows from +y to -y
    assert (np.diff(sensor.centers.reshape(3, 3, 2)[:, 0, 0]) < 0).all()
    assert (np.diff(sensor.centers.reshape(3, 3, 2)[0, :, 1]) < 0).all()


FILE = """
centers = [[0.1, 0.2], [-0.1, 0.2]]
sizes = [[0.1, 0.1], [0.1, 0.2]]
gains = [1, 2]
starts_opl = [-0.3, -0.31]
floors = [0, 0.5]
bins = 64
bin_width_opl = 0.03
crosstalk = 0.01
pulse = { opl = [-0.02, 0.0, 0.3], values = [0.1, 1.0, 0.01] }
"""


def test_sensor_of_a_file(tmp_path):
    (tmp_path / "a.toml").write_text(FILE)
    sensor = MultiZone.from_file(tmp_path / "a.toml")
    assert sensor.gains.tolist() == [1, 2]
    assert isinstance(sensor.pulse, KnotPulse)
    sampled = "pulse = { values = [1, 2], start_opl = -0.1, bin_width_opl = 0.05 }"
    (tmp_path / "b.toml").write_text(FILE.rpartition("pulse")[0] + sampled)
    assert MultiZone.from_file(tmp_path / "b.toml").pulse.support == pytest.approx((-0.1, 0.0))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gains", "gain", "gain: is not known"),
        ("bins = 64", "", "bins is missing"),
        ("gains = [1, 2]", "gains = [1, 0]", "gains"),
        ("gains = [1, 2]", "gains = [1, 2, 3]", "gains"),
        ("floors = [0, 0.5]", "floors = [0, -0.5]", "floors"),
        ("opl = [-0.02, 0.0, 0.3], ", "", "pulse"),
        ("0.0, 0.3", "0.0, 0.0", "rise"),
        ("values = [0.1, 1.0, 0.01]", "values = [0.1, 1.0, 0.0]", "above 0"),
        ("crosstalk = 0.01", "crosstalk = 1.01", "crosstalk"),
        ("centers = [[0.1, 0.2], [-0.1, 0.2]]", "centers = []", "zones"),
    ],
)
def test_wrong_files_are_refused(tmp_path, old, new, words):
    assert old in FILE
    (tmp_path / "a.toml").write_text(FILE.replace(old, new))
    with refused(words):
        MultiZone.from_file(tmp_path / "a.toml")


def test_other_renders_are_refused():
    good = views(flash(3))
    for wrong, words in (
        (good.drop_vars("tan_x"), "render_poses"),
        (good.assign_attrs(quantity="radiance per meter"), "radiance per bin"),
        (good.assign_attrs(pulse="GaussianPulse(width_opl=0.1)"), "without a pulse"),
        (good["transient"], "render_poses"),
        (good.isel(x=slice(0, 1)), "2 pixels"),
    ):
        with refused(words):
            PLAIN.expected(wrong)
