"""What an explorer is given: right to the tolerance that it states, as small as it has to be."""

import re

import numpy as np
import pytest
from helpers.hidden_scenes import Wall, capture_of, rectangle
from helpers.made_dataset import make_dataset

import tofrender
from tofrender.apps.explorer.compression import Reduction, Scale, bands
from tofrender.apps.explorer.page_contents import contents_of
from tofrender.rendering.cubes import Cube


def noisy(height=20, width=30, bins=50, decades=9):
    """A Dataset with light of many sizes, some of it none."""
    rng = np.random.default_rng(0)
    data = make_dataset(height, width, bins)
    light = 10 ** rng.uniform(-decades, 1, data["transient"].shape)
    light[rng.random(light.shape) < 0.3] = 0
    data["transient"].values[:] = light
    data["steady"].values[:] = light.sum(axis=2)
    return data


def assert_within(found, given, scale: Scale) -> None:
    """As the page says: a relative error from `least` on, an absolute one below."""
    large = given >= scale.least
    np.testing.assert_array_less(abs(found[large] / given[large] - 1), scale.tolerance + 1e-5)
    assert (abs(found[~large] - given[~large]) < scale.least).all()


def layer_of(contents, name="light"):
    """(y, x, bins, channels) as a page has them, and their scale."""
    about = contents.header[name]
    found = contents.layer(about)[0].transpose(2, 3, 0, 1)
    return found, Scale(about["least"], about["ratio"])


@pytest.mark.parametrize("packed", [False, True])
def test_values_are_as_right_as_the_page_says(packed):
    data = noisy()
    contents = contents_of(data, packed=packed)
    found, scale = layer_of(contents)
    assert scale.tolerance < 0.04
    given = data["transient"].values.astype(np.float64)
    assert_within(found, given, scale)
    said = re.search(r"right to ([\d.]+) % from ([\d.e-]+) on", contents.header["notes"][0])
    assert float(said[1]) / 100 == pytest.approx(scale.tolerance, rel=0.05)
    assert float(said[2]) == pytest.approx(scale.least, rel=0.01)
    dark = given[given < scale.least].sum() / given.sum()
    assert dark < 2e-4  # What may be lost of all light


def test_steady_pictures_and_errors_have_scales_of_their_own():
    data = noisy()
    data["transient_error"] = data["transient"] / 7
    data["steady_error"] = data["steady"] / 7
    contents = contents_of(data)
    steady, errors = data["steady"].values[:, :, None], data["transient_error"].values
    for name, values in (("steady", steady), ("errors", errors)):
        found, scale = layer_of(contents, name)
        assert_within(found, values.astype(np.float64), scale)


def test_a_small_budget_averages_pixels_then_adds_bins():
    data = noisy(21, 30, 300)
    full = contents_of(data)
    assert len(full.data) > 500_000
    for most in (200_000, 60_000, 10_000):
        contents = contents_of(data, most_bytes=most)
        header = contents.header
        step, bins = header["grid"]["step"], header["axis"]["count"]
        time = round(header["axis"]["width"] / 0.02)
        assert header["light"]["height"] == -(-21 // step)
        assert bins == -(-300 // time)
        light, scale = layer_of(contents)
        size = light.size + header["steady"]["height"] * 30 * 3
        assert size <= most or step == 64
        assert step * time > 1
        assert any(f"{step} x {step} pixels are averaged" in note for note in header["notes"])
        sums = data["transient"].values[:step, :step, :time].sum(axis=2).mean(axis=(0, 1))
        assert_within(light[0, 0, 0], sums.astype(np.float64), scale)


def test_errors_of_averages_are_those_of_independent_estimates():
    rng = np.random.default_rng(1)
    errors = rng.random((5, 6, 7, 1))

    def reduced(kind: str) -> np.ndarray:
        found = [band for _, band in bands(Cube(errors), Reduction(2, 3), kind)]
        return np.concatenate(found)[..., 0]

    block, last = errors[2:4, 4:6, 3:6, 0], errors[4:, 4:6, 6:, 0]  # Smaller at the border
    found = reduced("error")
    assert found.shape == (3, 3, 3)
    assert found[1, 2, 1] == pytest.approx(np.sqrt((block**2).sum()) / 4)
    assert found[2, 2, 2] == pytest.approx(np.sqrt((last**2).sum()) / 2)
    assert reduced("mean")[1, 2, 1] == pytest.approx(block.mean())
    assert reduced("sum")[1, 2, 1] == pytest.approx(block.sum() / 4)


def test_cubes_on_disk_are_read_by_bands():
    data = noisy()
    lazy = data.chunk({"y": 7, "opl": 11})
    for most in (None, 30_000):
        a, b = contents_of(data, most_bytes=most), contents_of(lazy, most_bytes=most)
        assert a.header == b.header
        assert a.data == b.data


def test_what_is_dark_negative_or_unknown():
    data = noisy(4, 5, 6)
    data["transient"].values[0, 0] = np.nan
    data["transient"].values[1, 1] = -1
    contents = contents_of(data)
    light = contents.layer(contents.header["light"])[0]
    assert (light[:, :, 0, 0] == 0).all()
    assert (light[:, :, 1, 1] == 0).all()
    assert contents.part("hatch").reshape(4, 5).tolist()[0] == [1, 0, 0, 0, 0]
    black = data * 0
    black.attrs = data.attrs
    assert (contents_of(black.fillna(0)).part("light") == 0).all()


def test_peaks_are_as_fine_as_the_render():
    data = noisy()
    expected = data["opl"].values[tofrender.vis.luminance(data["transient"].values).argmax(axis=2)]
    peaks = contents_of(data, most_bytes=30_000).part("peaks").reshape(expected.shape)
    np.testing.assert_allclose(peaks, expected, rtol=1e-6)


def test_bounces_of_a_pyramid_add_up():
    scene = tofrender.cornell_box(width=8, height=8, temporal_bins=30, bin_width_opl=0.3)
    pyramid = tofrender.strategy_pyramid(scene, max_depth=3, spp=8, progress=False)
    contents = contents_of(pyramid)
    orders = contents.header["orders"]
    assert [each["name"] for each in orders] == ["lamp, seen directly", "1 bounce", "2 bounces"]
    total = contents.layer(contents.header["light"])
    parts = sum(contents.layer(each) for each in orders)
    np.testing.assert_allclose(parts, total, rtol=0.05, atol=3 * contents.header["light"]["least"])


def test_captures_and_volumes():
    patch = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
    capture = capture_of(patch, Wall(4), bins=24, width=0.05)
    contents = contents_of(capture)
    assert contents.header["kind"] == "capture"
    points = contents.part("points").reshape(4, 4, 3)
    upwards = capture["sensor_grid"].values[::-1]  # Rows of this wall run upwards
    np.testing.assert_allclose(points, upwards, rtol=1e-6)
    volume = tofrender.reconstruct(capture, "bp", progress=False)
    contents = contents_of(volume)
    found, scale = layer_of(contents)
    down = 1 if float(volume["frame_axes"].values[1, 1]) < 0 else -1  # Where rows run
    given = volume["intensity"].values[:, ::down]
    assert_within(found[:, :, :, 0].transpose(2, 0, 1), given.astype(np.float64), scale)
    depth = tofrender.depth_map(volume).values[::down]
    np.testing.assert_allclose(contents.part("peaks").reshape(depth.shape), depth, rtol=1e-6)


def test_what_does_not_fit(tmp_path):
    for given, said in (
        ({"orders": {"a": 3}}, r"orders\['a'\]: expected a Dataset of render, found int"),
        ({"orders": {"a": make_dataset(2, 3, 4)}}, r"orders\['a'\]: the axis y has"),
        ({"distance_m": np.ones((2, 2))}, r"distance_m with shape \(2, 2\): must be"),
        ({"distance_m": -np.ones((20, 30))}, "distance_m contains -1: must be from 0"),
        ({"most_bytes": 1}, "megabytes: must be larger"),
    ):
        with pytest.raises(ValueError, match=said):
            contents_of(noisy(), **given)
    with pytest.raises(ValueError, match=r"megabytes = 0.01: must be a finite number from 0.1"):
        tofrender.report(noisy(), tmp_path / "page.html", megabytes=0.01)
