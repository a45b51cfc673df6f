"""Tone mapping of difficult data, animations, plots and the summary."""

import numpy as np
import pytest
from helpers.drawings import drawn, linear
from helpers.made_dataset import make_dataset
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation

from tofrender import vis

SPEED_M_PER_NS = 0.299792458


def test_srgb_curve_and_exposure():
    values = np.array([[0, 0.001, 0.0031308, 0.18, 0.5, 1.0, 2.0]])
    expected = [0, 3, 10, 118, 188, 255, 255]  # IEC 61966-2-1
    assert vis.tonemap(values, exposure=1)[0, :, 0].tolist() == expected
    assert vis.tonemap(2 * values, exposure=0.5)[0, :, 0].tolist() == expected


@pytest.mark.parametrize("fill", [0.0, -1.0, np.nan, np.inf, -np.inf])
def test_images_without_usable_light(fill):
    picture = vis.tonemap(np.full((8, 8, 3), fill, np.float32))
    assert picture.dtype == np.uint8
    assert picture.shape == (8, 8, 3)
    if fill == np.inf:
        assert (picture == 255).all()
    else:
        assert picture.max() < 80


def test_one_bright_pixel_in_the_dark():
    values = np.zeros((1500, 1500), np.float32)  # more values than auto_exposure samples
    values[700, 3] = 1e-20
    assert vis.auto_exposure(values) == pytest.approx(1e20)
    picture = vis.tonemap(values)
    assert (picture[700, 3] == 255).all()
    assert picture.sum() == 3 * 255


def test_sampled_exposure_is_close():
    values = np.random.default_rng(3).gamma(0.3, 1, 5_000_000).astype(np.float32)
    exact = 1 / np.percentile(values[values > 0], 99.5)
    assert vis.auto_exposure(values) == pytest.approx(exact, rel=0.02)


def test_callers_array_stays():
    values = np.array([[[-1, np.nan, np.inf], [0.1, 0.2, 0.3]]], np.float32)
    copy = values.copy()
    values.setflags(write=False)
    vis.tonemap(values)
    np.testing.assert_array_equal(values, copy)


def test_unfinished_pixels_are_hatched():
    values = np.ones((16, 16, 3), np.float32)
    values[:8, :, 1] = np.nan
    picture = vis.tonemap(values)
    assert (picture[8:] == 255).all()
    hatch = picture[:8].reshape(-1, 3)
    assert len(np.unique(hatch, axis=0)) == 2
    assert hatch.max() < 80
    assert (hatch == hatch[:, :1]).all()


@pytest.mark.parametrize("shape", [(4,), (4, 5, 2), (4, 5, 6, 3)])
def test_tonemap_shapes(shape):
    with pytest.raises(ValueError, match=r"must be \(height, width\) or"):
        vis.tonemap(np.zeros(shape))


def test_shadows_lift_the_dark_and_keep_white_and_hues():
    rng = np.random.default_rng(0)
    hues = rng.uniform(0.1, 1, (50, 1, 3)) * [[[1, 0.5, 0]]]
    values = hues / hues.max(axis=2, keepdims=True) * np.geomspace(1e-4, 1, 40)[:, None]
    plain = vis.tonemap(values, exposure=1) / 255
    lifted = vis.tonemap(values, exposure=1, shadows=3) / 255
    assert (lifted >= plain).all()
    assert (lifted[:, -1] == plain[:, -1]).all()
    assert (np.diff(lifted.max(axis=2), axis=1) >= 0).all()
    ratios = linear(lifted)[..., 1] / linear(lifted)[..., 0]
    steps = 2 / (255 * lifted[..., 1].clip(1 / 255))  # Of eight bits, as a part
    assert (np.abs(ratios / (values[..., 1] / values[..., 0]) - 1) < 0.05 + 3 * steps).all()
    dark = linear(vis.tonemap(np.full((1, 1), 1e-3), exposure=1, shadows=6)[0, 0, 0] / 255)
    assert dark == pytest.approx(64e-3, rel=0.25)  # k = 390 bends it by a sixth already


def test_exposure_grows_as_light_fades():
    bins, decay = 30, 0.8
    values = np.zeros((4, 5, bins, 3), np.float32)
    values[..., 5:, :] = (decay ** np.arange(bins - 5))[:, None]
    values[0, 0, 0], values[1, 1, 12] = 0.5, np.nan  # a first glimpse; unfinished
    gains = vis.growing_exposure(values, share=0.5, most_stops=20)
    assert gains[0] == vis.auto_exposure(values)
    assert (gains[:6] == gains[0]).all()
    np.testing.assert_allclose(gains[6:12] / gains[5:11], decay**-0.5, rtol=1e-5)
    assert (np.diff(gains) >= 0).all()
    capped = vis.growing_exposure(values, most_stops=2)
    assert capped[-1] == 4 * capped[0]
    assert (vis.growing_exposure(values, share=0) == gains[0]).all()


def test_a_lamp_in_view_does_not_make_all_the_rest_late():
    """It lights one pixel in a thousand, a thousand times as bright as the walls."""
    values = np.full((50, 40, 12), 1.0, np.float32)
    values[:, :, :2], values[:, :, -3:] = 0, 0
    plain = vis.growing_exposure(values)
    values[:2, 0, 3] = 1000
    gains = vis.growing_exposure(values)
    assert (gains[:9] == gains[0]).all()
    np.testing.assert_allclose(gains[0], plain[0], rtol=1e-6)
    assert vis.lit_bins(values) == slice(2, 9)
    assert vis.lit_bins(0 * values) == slice(0, 12)
    assert vis.lit_bins(values, stops=32) == slice(2, 9)


@pytest.mark.parametrize("fill", [0.0, -1.0, np.nan, np.inf, 1e-300])
def test_exposure_without_usable_light(fill):
    gains = vis.growing_exposure(np.full((2, 3, 4), fill))
    assert gains.shape == (4,)
    assert np.isfinite(gains).all()
    assert (gains == gains[0]).all()


def test_animation_title_is_the_time_of_bin_centers():
    values = make_dataset(bins=4)["transient"].values
    animation = vis.visualize_transient(values, 3.5, 0.02)
    assert isinstance(animation, FuncAnimation)
    for index in range(4):
        image, title = animation._func(index)
        assert image.get_array().shape == (6, 10, 3)
        time = (3.5 + (index + 0.5) * 0.02) / SPEED_M_PER_NS
        assert float(title.get_text().split()[2]) == pytest.approx(time, abs=5e-4)
        assert index or title.get_text() == "t = 11.708 ns   OPL = 3.510 m"
    assert animation.to_jshtml().count("data:image/png") == 4


@pytest.mark.parametrize("kind", ["dataset", "rgb", "mono", "without channels"])
def test_all_kinds_of_data(kind):
    dataset = make_dataset(channels="L" if kind in ("mono", "without channels") else "RGB")
    values = dataset["transient"].values
    data = {"dataset": dataset, "without channels": values[..., 0]}.get(kind, values)
    axis = () if kind == "dataset" else (3.5, 0.02)
    vis.visualize_transient(data, *axis).to_jshtml()
    lines = vis.plot_pixel_transient(data, 4, 2, *axis).axes[0].lines
    assert len(lines) == dataset.sizes["channel"]
    for channel, line in enumerate(lines):
        np.testing.assert_allclose(line.get_xdata(), dataset["opl"] / SPEED_M_PER_NS)
        np.testing.assert_array_equal(line.get_ydata(), values[2, 4, :, channel])


def test_pixels_and_times_are_those_of_a_crop_or_a_selection():
    """Axes come from the coordinates, which follow a selection; attributes do not."""
    dataset = make_dataset(x0=20, y0=30)
    line = vis.plot_pixel_transient(dataset, 24, 32).axes[0].lines[0]
    np.testing.assert_array_equal(line.get_ydata(), dataset["transient"].values[2, 4, :, 0])
    with pytest.raises(ValueError, match="x = 4: must be an integer from 20 to 29"):
        vis.plot_pixel_transient(dataset, 4, 32)
    part = dataset.isel(opl=slice(2, None), x=slice(1, None), y=slice(1, None))
    line = vis.plot_pixel_transient(part, 21, 31).axes[0].lines[0]
    assert line.get_xdata()[0] == pytest.approx(float(dataset.opl[2]) / SPEED_M_PER_NS)
    np.testing.assert_allclose(line.get_ydata(), part.transient.values[0, 0, :, 0], rtol=1e-6)
    for name, said in (("opl", "do not skip bins"), ("x", "the axis x skips pixels")):
        with pytest.raises(ValueError, match=said):
            vis.summary_figure(dataset.isel({name: slice(None, None, 2)}))


def test_quantity_of_an_array_is_what_it_is_said_to_be():
    quantity = "radiance per meter"
    figure = vis.plot_pixel_transient(np.ones((2, 2, 4)), 0, 0, 0.0, 0.1, quantity=quantity)
    assert figure.axes[0].get_ylabel() == "radiance per meter"


def test_summary_shows_title_and_axes_with_units():
    dataset = make_dataset(height=20, width=30, bins=40)
    dataset["transient"].values[:, :2] = 0
    dataset["steady"].values[:] = dataset["transient"].sum("opl") / (1 - 0.0123)
    figure = vis.summary_figure(dataset)
    steady, peak, plot, bar = figure.axes
    title = "bördér, 64 spp, 1.2 % of the energy outside the render's window"
    assert figure.get_suptitle() == title
    assert {axes.get_xlabel() for axes in (steady, peak)} == {"x [pixel]"}
    assert plot.get_xlabel() == bar.get_ylabel() == "time [ns]"
    assert plot.get_ylabel() == "radiance per bin [10⁻³ W m⁻² sr⁻¹]"
    assert len([line for line in plot.lines if line.get_xdata().size]) == 3
    shown = peak.images[0].get_array()
    assert np.ma.getmaskarray(np.ma.masked_invalid(shown))[:, :2].all()
    energy = vis.luminance(dataset["transient"].values)
    expected = dataset["opl"].values[energy.argmax(axis=2)] / SPEED_M_PER_NS
    np.testing.assert_allclose(shown[:, 2:], expected[:, 2:])
    assert figure._repr_png_().startswith(b"\x89PNG")  # What notebooks show
    assert not plt.get_fignums()


def test_summary_of_chosen_pixels_and_an_unfinished_crop():
    dataset = make_dataset(height=20, width=30, x0=20, y0=30, channels="L", complete=0)
    dataset["transient"].values[:5] = np.nan
    dataset["steady"].values[:5] = np.nan
    figure = vis.summary_figure(dataset, pixels=[(22, 40), (25, 31)])
    labels = [text.get_text() for text in figure.axes[2].get_legend().get_texts()]
    assert labels == ["(22, 40)", "(25, 31)"]
    assert figure.get_suptitle().endswith("(interrupted)")
    assert drawn(figure).std() > 0
    with pytest.raises(ValueError, match="y = 3: must be an integer from 30 to 49"):
        vis.summary_figure(dataset, pixels=[(22, 3)])


@pytest.mark.parametrize("size", [(1, 1, 1), (1, 40, 3), (40, 1, 3)])
@pytest.mark.parametrize("fill", [None, 0.0, np.nan])
def test_summary_of_extreme_data(size, fill):
    dataset = make_dataset(*size)
    if fill is not None:
        dataset["transient"].values[:] = fill
        dataset["steady"].values[:] = fill
    assert drawn(vis.summary_figure(dataset)).shape[2] == 4
