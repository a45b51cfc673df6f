"""Phasor panels, overlays of arrival times, camera unwarping, and the player in notebooks."""

import colorsys

import drjit as dr
import imageio_ffmpeg
import mitsuba as mi
import numpy as np
import pytest
from helpers.drawings import drawn, part_of
from helpers.limits import lower
from helpers.made_dataset import START, WIDTH, make_dataset
from helpers.support import refused
from matplotlib import pyplot as plt

import tofrender
from tofrender import io, vis
from tofrender.paths.camera import sample_camera
from tofrender.signals.units import SPEED_OF_LIGHT, opl_to_ns


def parts_of(phasor):
    """Per channel, depths and phases wrong on purpose: they must be worked out from the sums."""
    wrong = np.full(phasor.shape, 9.0), np.full(phasor.shape, -7.0)
    return phasor.real, phasor.imag, abs(phasor), *wrong


def random_phasors(*shape):
    rng = np.random.default_rng(4)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def maps(figure, rows):
    images = [axes.images[0] for axes in figure.axes[: 5 * rows]]
    return [images[5 * row : 5 * row + 5] for row in range(rows)]


def test_channels_are_added_before_phase_and_depth():
    frequencies = [20e6, 50e6]
    phasor = random_phasors(2, 6, 9, 3)
    figure = vis.phasor_panel(frequencies, *parts_of(phasor), title="box")
    sums = phasor.sum(axis=-1)
    for frequency, row, total in zip(frequencies, maps(figure, 2), sums, strict=True):
        unambiguous = SPEED_OF_LIGHT / (2 * frequency)
        depth = np.mod(np.angle(total), 2 * np.pi) * SPEED_OF_LIGHT / (4 * np.pi * frequency)
        expected = (total.real, total.imag, abs(total), np.angle(total), depth)
        for image, values in zip(row, expected, strict=True):
            np.testing.assert_allclose(image.get_array(), values, rtol=1e-12)
        for image in row[:2]:
            assert image.norm.vmin == -image.norm.vmax < 0
        assert (row[3].norm.vmin, row[3].norm.vmax) == (-np.pi, np.pi)
        assert row[3].cmap.name == "phase"
        assert (row[4].norm.vmin, row[4].norm.vmax) == (0, pytest.approx(unambiguous))
    assert drawn(figure).std() > 0
    assert figure.get_suptitle() == "box"
    assert not plt.get_fignums()


def test_every_map_has_units():
    figure = vis.phasor_panel([20e6, 1.5e9], *parts_of(random_phasors(2, 6, 9, 1)))
    drawn(figure)
    bars = [axes.get_xlabel() for axes in figure.axes[10:15]]
    assert bars[:4] == ["[W m⁻² sr⁻¹]"] * 3 + ["[rad]"]
    assert bars[4] == "half the path length\n[m], c/2f = 7.495 m"
    ticks = [text.get_text() for text in figure.axes[13].get_xticklabels()]
    assert ticks == ["−π", "0", "π"]
    assert [a.get_xlabel() for a in figure.axes[:10]] == [""] * 5 + ["x [pixel]"] * 5
    assert [figure.axes[i].get_ylabel() for i in (0, 5)] == ["y [pixel]"] * 2
    assert [figure.axes[i].texts[0].get_text() for i in (0, 5)] == ["20 MHz", "1.5 GHz"]


def test_images_without_channels_are_drawn_as_they_are():
    phasor = random_phasors(5, 7, 3)
    total = phasor.sum(axis=-1)
    unwrapped = np.full((5, 7), 4.25)
    parts = phasor.real, phasor.imag, abs(total), np.angle(total), unwrapped
    figure = vis.phasor_panel(100e6, *parts)
    depth = maps(figure, 1)[0][4]
    np.testing.assert_array_equal(depth.get_array(), unwrapped)
    assert depth.norm.vmax == 4.25


@pytest.mark.parametrize("fill", [0, np.nan, np.inf])
def test_pixels_without_a_phase_are_left_open(fill):
    phasor = random_phasors(4, 6, 3)
    phasor[1:3] = fill
    for values in (phasor, phasor[1:3]):
        figure = vis.phasor_panel(50e6, *parts_of(values))
        assert drawn(figure).std() > 0
        for image in maps(figure, 1)[0][3:]:
            hidden = np.ma.getmaskarray(np.ma.masked_invalid(image.get_array()))
            assert hidden[np.isin(np.arange(len(values)), (1, 2)) | (len(values) == 2)].all()


def test_parts_of_a_phasor_must_fit():
    real, imaginary, _, phase, depth = good = parts_of(random_phasors(4, 6, 3))
    for frequencies, parts, said in (
        ([20e6, 50e6], good, r"I with shape \(4, 6, 3\): must be \(2, height, width, channels\)"),
        (20e6, parts_of(random_phasors(4, 6, 2)), r"I with shape .*must be \(height, width, chan"),
        (20e6, (real, imaginary[:, :5], *good[2:]), r"Q with shape \(4, 5, 3\): must be \(4, 6, 3"),
        (20e6, (*good[:3], phase[:2], depth), r"phase with shape .* must be \(4, 6, 3\) or \(4, 6"),
        (
            20e6,
            (real, imaginary * 1j, *good[2:]),
            "Q of type complex128: must contain real numbers",
        ),
    ):
        refused(said, vis.phasor_panel, frequencies, *parts)


def two_arrivals(early, late, share=0.25, bins=40):
    """A row of three pixels: light at two bins, none, and all at the first; the sky above."""
    data = np.zeros((2, 3, bins), np.float32)
    data[1, 0, early], data[1, 0, late] = 1 - share, share
    data[1, 2, early] = 1
    return data


def hue(pixel):
    return colorsys.rgb_to_hsv(*(pixel / 255))[0]


@pytest.mark.parametrize("style", ["arrival", "peak"])
def test_colors_tell_the_time(style):
    data = two_arrivals(4, 24)
    figure = vis.light_in_flight(data, 3.5, 0.02, style=style)
    picture = figure.axes[0].images[0].get_array()
    assert (picture[0] == 0).all()
    assert (picture[1, 1] == 0).all()
    bar = figure.axes[1]
    assert bar.get_ylabel().endswith("[ns]")
    low, high = (opl_to_ns(3.5 + (b + 0.5) * 0.02) for b in (4, 4 + 0.25 * 20))
    if style == "peak":
        assert hue(picture[1, 0]) == hue(picture[1, 2])
    else:
        assert bar.get_ylim() == pytest.approx((low, high), rel=1e-3)
        assert hue(picture[1, 0]) == pytest.approx(0.075, abs=0.01)  # late is orange
        assert hue(picture[1, 2]) == pytest.approx(0.62, abs=0.01)  # early is blue
    assert drawn(figure).std() > 0
    assert not plt.get_fignums()


def test_rainbow_repeats_after_a_period_and_turns_gray_when_light_is_spread():
    """Light 10 bins apart: the same hue at a period of 10 bins, none at one of 20."""
    data = two_arrivals(4, 14, share=0.5)
    data[0, 0, 9] = 1
    period = opl_to_ns(10 * 0.02)
    options = {"start_opl": 3.5, "bin_width_opl": 0.02, "style": "rainbow"}
    same, spread = (vis.light_in_flight(data, **options, period_ns=k * period) for k in (1, 2))
    picture = same.axes[0].images[0].get_array()
    colors = same.axes[1]._colorbar.cmap  # pyright: ignore
    turn = opl_to_ns(3.5 + 4.5 * 0.02) / period % 1
    for pixel, expected in ((picture[1, 0], turn), (picture[0, 0], (turn + 0.5) % 1)):
        np.testing.assert_allclose(pixel / 255, colors(expected)[:3], atol=0.01)
    np.testing.assert_allclose(picture[1, 2], picture[1, 0].astype(float), atol=1)
    assert np.ptp(spread.axes[0].images[0].get_array()[1, 0]) <= 2
    assert same.axes[1].get_ylabel() == "arrival time, modulo 0.6671 ns [ns]"


def test_color_bar_of_a_rainbow_says_when_light_arrived():
    """Looked up in the bar, a pixel's color gives its time, to the steps of a color."""
    bins, period = 120, opl_to_ns(120 * 0.02)
    options = {"style": "rainbow", "period_ns": period, "exposure": 1.0}
    figure = vis.light_in_flight(np.eye(bins)[None], 0.0, 0.02, **options)
    picture = np.asarray(figure.axes[0].images[0].get_array())[0] / 255
    times = np.linspace(0, period, 4001)
    bar = figure.axes[1]._colorbar  # pyright: ignore
    colors = bar.cmap(bar.norm(times))[:, :3]
    found = times[((colors[None] - picture[:, None]) ** 2).sum(axis=2).argmin(axis=1)]
    off = found - opl_to_ns((np.arange(bins) + 0.5) * 0.02)
    assert np.abs(off).max() < 0.005 * period


@pytest.mark.parametrize(
    ("rare", "extend"), [([], "neither"), ([35], "max"), ([3], "min"), ([3, 35], "both")]
)
def test_color_bar_of_arrivals_points_to_what_lies_beyond(rare, extend):
    data = np.zeros((20, 20, 40), np.float32)
    data[:, :10, 10], data[:, 10:, 20] = 1, 1
    for row, index in enumerate(rare):
        data[row, 0, 10], data[row, 0, index] = 0, 1
    for style in ("arrival", "peak"):
        figure = vis.light_in_flight(data, 3.5, 0.02, style=style)
        assert figure.axes[1]._colorbar.extend == extend  # pyright: ignore


@pytest.mark.parametrize("style", ["arrival", "peak", "rainbow"])
def test_unfinished_and_lost_light(style):
    dataset = make_dataset(height=12, width=9, x0=20, y0=30)
    dataset["transient"].values[:3] = np.nan
    dataset["transient"].values[3:6] = 0  # the steady image has light, the window none
    dataset["transient"].values[6, 0, 0] = np.inf
    before = dataset.copy(deep=True)
    figure = vis.light_in_flight(dataset, style=style)
    image = figure.axes[0].images[0]
    picture = np.asarray(image.get_array())
    np.testing.assert_array_equal(picture[:3], vis.tonemap(np.full((3, 9), np.nan)))
    gray = picture[3:6]
    assert gray.max() > 0
    assert (gray == gray[..., :1]).all()
    assert image.get_extent() == [19.5, 28.5, 41.5, 29.5]
    assert drawn(figure).std() > 0
    assert dataset.identical(before)


@pytest.mark.parametrize("style", ["arrival", "peak", "rainbow"])
@pytest.mark.parametrize("fill", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 40, 3, 3)])
def test_overlays_without_usable_light(style, fill, shape):
    figure = vis.light_in_flight(np.full(shape, fill, np.float32), 3.5, 0.02, style=style)
    assert drawn(figure).shape[2] == 4


def test_bad_overlays():
    for options, message in (
        ({"style": "peek"}, "style = 'peek': did you mean 'peak'"),
        ({"period_ns": 1.0}, "period_ns = 1.0: must be None for style = 'arrival'"),
        ({"style": "rainbow", "period_ns": 0.1}, "= 0.1: must be at least two bins, 0.13"),
    ):
        refused(message, vis.light_in_flight, np.ones((2, 2, 5)), 3.5, 0.02, **options)


def test_a_shift_by_whole_bins_is_exact():
    dataset = make_dataset()
    distances = np.full((6, 10), 7 * WIDTH)
    distances[2:] += 2 * WIDTH
    unwarped = vis.unwarp_camera(dataset, distances)
    before, after = dataset["transient"].values, unwarped["transient"].values
    assert after.shape == (6, 10, 7, 3)
    np.testing.assert_array_equal(after[:2, :, 2:], before[:2])
    np.testing.assert_array_equal(after[2:, :, :5], before[2:])
    assert not after[:2, :, :2].any()
    np.testing.assert_allclose(unwarped["opl"][0], START - 9 * WIDTH + WIDTH / 2, rtol=1e-12)
    np.testing.assert_array_equal(unwarped["steady"], dataset["steady"])


def test_light_is_kept_and_moved_by_its_distance():
    dataset = make_dataset(height=8, width=7, bins=30, x0=3)
    rng = np.random.default_rng(5)
    distances = rng.uniform(0, 2, (8, 7)).astype(np.float32)
    unwarped = vis.unwarp_camera(dataset, distances)
    before, after = dataset["transient"], unwarped["transient"]
    np.testing.assert_allclose(after.sum("opl"), before.sum("opl"), rtol=1e-5)

    moved = mean_opl(before) - mean_opl(after)
    np.testing.assert_allclose(moved, distances[..., None] + [0] * 3, atol=1e-5)
    first, last = (np.nonzero(after.values.any(axis=(0, 1, 3)))[0][i] for i in (0, -1))
    assert (first, last) == (0, after.sizes["opl"] - 1)  # nothing empty at either end


def test_what_is_unknown_stays_unknown():
    dataset = make_dataset()
    cube = dataset["transient"].values
    cube[0, 0] = np.nan  # unfinished
    cube[1, 1] = 0
    distances = np.full((6, 10), 0.5 * WIDTH)
    distances[1, 1] = np.nan  # sees nothing
    distances[1, 2] = np.inf  # sees nothing, and yet there is light
    unwarped = vis.unwarp_camera(dataset, distances)["transient"].values
    unknown = np.isnan(unwarped).all(axis=(2, 3))
    assert np.argwhere(unknown).tolist() == [[0, 0], [1, 2]]
    assert np.isfinite(unwarped[~unknown]).all()
    assert not unwarped[1, 1].any()
    cube[:] = 0  # darkness has a window, too
    assert vis.unwarp_camera(dataset, np.ones((6, 10)))["transient"].shape == (6, 10, 5, 3)


def test_an_unwarped_dataset_is_one_like_any_other(tmp_path):
    unwarped = vis.unwarp_camera(make_dataset(fingerprint="abc"), np.full((6, 10), 1.237))
    assert unwarped.attrs["camera_unwarp"] == 1
    assert "fingerprint" not in unwarped.attrs
    path = io.save_exr_stack(unwarped, tmp_path / "stack")
    assert io.load_exr_stack(path).identical(unwarped)
    vis.summary_figure(unwarped)
    refused("camera_unwarp = 1", vis.unwarp_camera, unwarped, np.zeros((6, 10)))


def test_bad_distances():
    for distances, message in (
        (np.ones((10, 6)), r"distance_m with shape \(10, 6\): must be \(6, 10\), one number"),
        (np.full((6, 10), -0.5), "distance_m contains -0.5: must be from 0"),
        (np.full((6, 10), 1e13), r"distance_m contains 1e\+13"),
        (np.arange(60).reshape(6, 10) * 1e9, "distance_m spreads the light over .* bins"),
    ):
        refused(message, vis.unwarp_camera, make_dataset(), distances)


def mean_opl(data):
    return ((data * data["opl"]).sum("opl") / data.sum("opl")).values


def test_unwarping_agrees_with_a_render_that_leaves_the_segment_out():
    described = tofrender.cornell_box(width=32, height=32, start_opl=0.0, temporal_bins=800)
    described["integrator"]["max_depth"] = 3
    in_camera_time = tofrender.render(described, spp=32, progress=False)
    described["integrator"]["camera_unwarp"] = True
    in_scene_time = tofrender.render(described, spp=32, progress=False)
    unwarped = vis.unwarp_camera(in_camera_time, distances_in(described, 32))
    light = (data["transient"].sum("channel") for data in (unwarped, in_scene_time, in_camera_time))
    found, expected, before = map(mean_opl, light)
    assert np.median(abs(found - expected)) < 0.01  # half a bin
    assert np.median(before - expected) > 3


def distances_in(described, samples):
    """Mean distance of what each pixel sees [m], NaN where it sees nothing."""
    scene = mi.load_dict(described)
    film = scene.sensors()[0].film()
    width, height = film.size()
    count = width * height * samples
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, count)
    pixel = dr.arange(mi.UInt32, count) // samples
    camera = sample_camera(scene.sensors()[0], film, sampler, pixel)
    si = scene.ray_intersect(camera.ray)
    seen = np.array(si.is_valid()).reshape(height, width, samples)
    distance = np.array(dr.norm(si.p - camera.origin)).reshape(seen.shape)
    total = np.sum(distance, axis=2, where=seen)
    return np.divide(total, seen.sum(axis=2), out=np.full(total.shape, np.nan), where=seen.any(2))


def test_a_notebook_plays_the_animation(monkeypatch, tmp_path):
    """Every third frame of 23 where eight are allowed; the whole animation stays as it was."""
    lower(monkeypatch, player_frames=8)
    animation = vis.visualize_transient(np.ones((4, 6, 23)), 3.5, 0.02)
    player = animation._repr_html_()
    assert animation._repr_html_() is player
    (tmp_path / "light.mp4").write_bytes(part_of(player, "video/mp4"))
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "light.mp4"))
    assert (frames, round(seconds, 2)) == (8, 1.2)
    assert animation.to_jshtml().count("data:image/png") == 23
    assert not plt.get_fignums()
