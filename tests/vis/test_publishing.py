"""Figures fit to publish: nothing overlaps or is cut at two widths, and files are whole."""

import io as io_
import itertools
from functools import cache
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import xarray as xr
from helpers.drawings import drawn, linear, part_of
from helpers.made_dataset import make_dataset
from helpers.support import refused
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import tofrender
from tofrender import io, sampling, vis
from tofrender.runtime.canvas import PALETTES
from tofrender.vis.color_maps import hue_map, phase_map, time_map

COLUMN, PAGE = 3.4, 7.0


@cache
def data() -> xr.Dataset:
    """Light of 60 ns, with dark and unfinished pixels and a long name."""
    made = make_dataset(height=20, width=24, bins=60, scene="a box with a rather long name")
    made["transient"].values[:3] = np.nan
    made["steady"].values[:3] = np.nan
    made["transient"].values[5:8, 5:9] = 0
    return made


def phasors(*frequencies: float):
    rng = np.random.default_rng(3)
    shape = (len(frequencies), 20, 24, 1)
    values = 1e-4 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    values[:, :3] = np.nan
    return panel(frequencies, values, title="a box of a rather long name")


def panel(frequencies, values, **options):
    parts = values.real, values.imag, abs(values), np.angle(values), abs(values)
    return vis.phasor_panel(frequencies, *parts, **options)


def reconstruction():
    axes = {"z": np.linspace(0.4, 1, 8), "y": np.linspace(-1, 1, 9), "x": np.linspace(-1, 1, 9)}
    values = np.random.default_rng(1).random((8, 9, 9)).astype(np.float32)
    values[:, :3] = 0
    named = {"scene": "a box around the corner of a rather long name", "method": "fbp"}
    return vis.reconstruction_figure(xr.Dataset({"intensity": ((*"zyx",), values)}, axes, named))


def strategies(depth: int = 5) -> xr.Dataset:
    pairs = [(s, n + 1 - s) for n in range(1, depth + 1) for s in range(n + 1) if n + 1 - s]
    shape = (2, len(pairs), 8, 9, 3)
    steady = np.random.default_rng(2).random(shape).astype(np.float32)
    coords = {"weighting": ["mis", "none"], "channel": ["R", "G", "B"]}
    coords |= {name: ("strategy", [pair[k] for pair in pairs]) for k, name in enumerate("st")}
    dims = ("weighting", "strategy", "y", "x", "channel")
    return xr.Dataset({"steady": (dims, steady)}, coords)


def pyramid(depth: int = 5):
    return vis.pyramid_figure(strategies(depth))


@cache
def verdict(name: str):
    options = {"alpha": 0.3} if name == "beckmann" else {}
    case = sampling.warp_case(name, **options)
    return case.test(samples=20_000, resolution=11), np.array(case.sample(sampling.grid(64)))


def warped(name: str):
    return vis.warp_figure(verdict(name)[1], verdict(name)[0], "64 points of a grid")


def plan(name: str, view: str):
    scene = tofrender.load_scene(name, optimize=False)
    return vis.plan_figure(scene, view=view, title=f"{name}, from {view}")


def player():
    animation = vis.visualize_transient(data())
    animation._draw_was_started = True  # pyright: ignore  # It is not to be played here
    return animation._fig  # pyright: ignore


FIGURES = {
    "summary": lambda: vis.summary_figure(data()),
    "pixel": lambda: vis.plot_pixel_transient(data(), 12, 12),
    "tiny numbers": lambda: vis.plot_pixel_transient(1e-7 * data().transient.values, 12, 12, 0, 9),
    "animation": player,
    "arrival": lambda: vis.light_in_flight(data()),
    "peak": lambda: vis.light_in_flight(data(), style="peak"),
    "isochrones": lambda: vis.light_in_flight(data(), style="rainbow"),
    "gate": lambda: vis.gate_figure(data()["transient"].values[:, :, 9], 5.9, 0.03, title="a box"),
    "phasors": lambda: phasors(20e6),
    "phasors, unwrapped": lambda: phasors(20e6, 50e6),
    "reconstruction": reconstruction,
    "pyramid": pyramid,
    "verdict": lambda: vis.verdict_figure(verdict("beckmann")[0]),
    "warp in the plane": lambda: warped("tent"),
    "warp on the sphere": lambda: warped("beckmann"),
    "plan": lambda: plan("wall_box_sphere_nlos", "above"),
    "plan of a box": lambda: plan("cornell_box", "side"),
}


def written(figure: Figure, monkeypatch) -> list:
    """All text that a figure draws, with its box [pixels]."""
    texts, draw = [], Text.draw

    def noted(self, renderer, *args, **kwargs):
        if self.get_visible() and self.get_text().strip():
            box = self.get_window_extent(renderer)
            kept = {"text": self.get_text(), "box": box, "color": self.get_color()}
            texts.append(SimpleNamespace(**kept, axes=self.axes))
        return draw(self, renderer, *args, **kwargs)

    figure.canvas.draw()
    with monkeypatch.context() as patched:
        patched.setattr(Text, "draw", noted)
        figure.canvas.draw()
    return texts


def apart(one, other) -> bool:
    return bool(np.any(one.max - 1 < other.min) or np.any(other.max - 1 < one.min))


@pytest.mark.parametrize(("width", "theme"), [(COLUMN, "light"), (PAGE, "dark")])
@pytest.mark.parametrize("name", FIGURES)
def test_text_is_whole_apart_and_readable(name, width, theme, monkeypatch):
    with vis.figure_style(theme=theme, width=width):
        figure = FIGURES[name]()
    assert figure.get_figwidth() == width
    assert figure.get_figheight() < 9.6
    texts = written(figure, monkeypatch)
    assert len(texts) > 3
    for each in texts:
        assert np.all(each.box.min > -1), each
        assert np.all(each.box.max < figure.bbox.max + 1), each
        assert contrast(each.color, figure.get_facecolor()) >= 4.5, each
    for one, other in itertools.combinations(texts, 2):
        assert apart(one.box, other.box), (one, other)
    for each, axes in itertools.product(texts, figure.axes):
        assert each.axes is axes or apart(each.box, axes.get_window_extent()), (each, axes)
    for one, other in itertools.combinations(figure.axes, 2):
        assert apart(one.get_window_extent(), other.get_window_extent())


def test_rows_of_a_pyramid_become_brighter_by_stops():
    """Light that halves with each segment is drawn alike in all rows."""
    made = strategies(2)
    made["steady"] = 0.5 ** (made["s"] + made["t"]) * xr.ones_like(made["steady"])
    figure = vis.pyramid_figure(made, stops_per_row=1.0)
    shown = np.array([axes.images[0].get_array() for axes in figure.axes])
    assert len(shown) == 5
    assert 0 < shown.min() == shown.max() < 255


@pytest.mark.parametrize("name", ["phasors, unwrapped", "reconstruction", "verdict", "pyramid"])
def test_pictures_are_of_one_size(name):
    with vis.figure_style(width=COLUMN):
        figure = FIGURES[name]()
    drawn(figure)
    panels = [axes for axes in figure.axes if axes.get_title()]
    sizes = [axes.get_window_extent().size for axes in panels]
    assert np.ptp(sizes, axis=0).max() < 0.5


@pytest.mark.parametrize("name", ["phasors", "reconstruction", "arrival", "gate", "pyramid"])
def test_no_white_margins(name):
    with vis.figure_style(width=COLUMN):
        figure = FIGURES[name]()
    inked = drawn(figure)[..., :3].min(axis=2) < 250
    rows, columns = (np.flatnonzero(inked.any(axis=axis)) for axis in (1, 0))
    margins = rows[0], inked.shape[0] - rows[-1], columns[0], inked.shape[1] - columns[-1]
    assert max(margins) < 0.22 * figure.dpi


def test_a_hatch_is_explained_where_there_is_one():
    whole = make_dataset(height=8, width=9, bins=20)
    for make in (vis.summary_figure, vis.light_in_flight):
        assert not make(whole).legends
        told = make(data()).legends[0].get_texts()[0].get_text()
        assert told in ("no light, or not finished", "not finished")
    assert phasors(20e6).legends[0].get_texts()[0].get_text() == "no light, or not finished"
    figure = reconstruction()
    assert figure.legends[0].get_texts()[0].get_text() == "nothing found"
    assert len([axes for axes in figure.axes if not axes.get_title()]) == 2  # One bar for all


def test_phasors_at_two_frequencies_have_a_depth_beyond_one():
    depth = np.full((4, 5), 11.0)
    phases = [4 * np.pi * f / tofrender.SPEED_OF_LIGHT * depth for f in (20e6, 50e6)]
    values = np.exp(1j * np.array(phases))[..., None]
    figure = panel((20e6, 50e6), values)
    named = {axes.get_title(): axes for axes in figure.axes}
    np.testing.assert_allclose(named["unwrapped"].images[0].get_array(), depth)
    np.testing.assert_allclose(named["residual"].images[0].get_array(), 0, atol=1e-6)
    far = panel((20e6, 50.0001e6), values)  # repeat together after 749 km
    assert "unwrapped" not in {axes.get_title() for axes in far.axes}


def test_a_gate_has_time_and_scale():
    figure = vis.gate_figure(np.full((4, 5), 2.0), 2.99792458, 0.0299792458, exposure=0.25)
    picture, bar = figure.axes
    assert picture.get_title() == "t = 10.00 ± 0.10 ns, OPL = 2.998 ± 0.030 m"
    assert bar.get_ylabel() == "radiance per meter [W m⁻³ sr⁻¹]"
    assert bar.get_ylim() == (0, 4)
    assert (picture.images[0].get_array() == vis.tonemap(np.array([[0.5]]), exposure=1)).all()


def test_style_holds_in_its_block():
    def colors():
        figure = vis.plot_pixel_transient(data(), 12, 12)
        return figure.get_facecolor(), figure.get_figwidth()

    usual = colors()
    with vis.figure_style(theme="dark"):
        figure = vis.plot_pixel_transient(data(), 12, 12)
        dark = colors()
        with vis.figure_style(width=COLUMN):
            assert colors() == (dark[0], COLUMN)
        assert colors() == dark
    assert colors() == usual
    assert usual[0] == (1, 1, 1, 1)
    assert max(dark[0][:3]) < 0.15
    figure.canvas.draw()  # Ticks made late are those of the theme, too
    for label in figure.axes[0].get_xticklabels():
        assert label.get_color() == PALETTES["dark"].ink


def contrast(one, other) -> float:
    light, dark = sorted(linear(to_rgb(c)) @ (0.2126, 0.7152, 0.0722) for c in (one, other))[::-1]
    return (light + 0.05) / (dark + 0.05)


DEUTERANOPIA = np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]])
"""Of linear RGB (Vienot, Brettel, Mollon 1999)."""
LMS_OF_RGB = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
LAB_OF_LMS = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def apart_by(colors):
    """Distances of all pairs of sRGB colors in OKLab, about as large as they look.

    The first are of usual eyes, the second of those with deuteranopia.
    """
    light = linear(colors)
    seen = np.stack([light, np.clip(light @ DEUTERANOPIA.T, 0, 1)])
    places = np.cbrt(seen @ LMS_OF_RGB.T) @ LAB_OF_LMS.T
    return np.linalg.norm(places[:, :, None] - places[:, None], axis=3)


@pytest.mark.parametrize(("colors", "least"), [(phase_map, 0.14), (hue_map, 0.09)])
def test_every_phase_has_a_color_of_its_own(colors, least):
    """Phases at least an eighth of a turn apart; steps are even."""
    turns = np.arange(256) / 256
    away = np.abs(turns[:, None] - turns)
    for distances in apart_by(colors()(turns)[:, :3]):
        assert distances[np.minimum(away, 1 - away) >= 1 / 8].min() > least
        steps = np.diagonal(np.roll(distances, -1, axis=1))
        assert steps.max() / steps.min() < 2.5


def test_every_time_has_a_color_of_its_own():
    times = np.linspace(0, 1, 101)
    distances = apart_by(time_map()(times)[:, :3])
    assert distances[:, np.abs(times[:, None] - times) >= 0.25].min() > 0.08


@pytest.mark.parametrize("theme", PALETTES)
def test_lines_are_told_apart(theme):
    palette = PALETTES[theme]
    verdicts = palette.good, palette.bad
    for colors, least in ((palette.lines, 0.07), (palette.channels, 0.1), (verdicts, 0.1)):
        distances = apart_by([to_rgb(color) for color in colors])
        assert distances[:, ~np.eye(len(colors), dtype=bool)].min() > least


@pytest.mark.parametrize("ending", ["png", "pdf", "svg", "SVG"])
def test_files_are_whole_and_the_same_each_time(tmp_path, ending):
    paths = [tmp_path / "deep" / f"{name}.{ending}" for name in "ab"]
    for path in paths:
        figure = vis.plot_pixel_transient(data(), 12, 12)
        assert io.save_figure(figure, path, dpi=100) == path
    one, other = (path.read_bytes() for path in paths)
    assert one == other
    io.save_figure(figure, paths[0], dpi=100)  # again, of a figure that was drawn
    assert paths[0].read_bytes() == one
    assert sorted(tmp_path.rglob("*.*")) == paths
    if ending == "png":
        with Image.open(paths[0]) as picture:
            assert picture.size == tuple(int(100 * inches) for inches in figure.get_size_inches())
            assert picture.info["Software"] == "tofrender"
    elif ending == "pdf":
        assert one.startswith(b"%PDF")
        assert one.rstrip().endswith(b"%%EOF")
        assert b"/FontFile2" in one
    else:
        nodes = ElementTree.fromstring(one).iter()
        assert "time [ns]" in [node.text for node in nodes if node.tag.endswith("text")]
    for path in paths:  # with a picture inside
        io.save_figure(vis.light_in_flight(data()), path)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_names_that_are_refused(tmp_path):
    figure = vis.plot_pixel_transient(data(), 12, 12)
    for name in ("a.jpg", "a", "a.png.exr", ".png"):
        refused(
            "must be a file name that ends in .png, .pdf", io.save_figure, figure, tmp_path / name
        )
    assert not list(tmp_path.iterdir())
    (tmp_path / "a.png").mkdir()
    said = "is a folder; must be the name of a file"
    refused(said, io.save_figure, figure, tmp_path / "a.png", kind=FileExistsError)


def test_an_earlier_file_survives_a_failure(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_text("earlier")
    figure = vis.plot_pixel_transient(data(), 12, 12)
    monkeypatch.setattr(figure, "draw", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        io.save_figure(figure, path)
    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_a_video_in_a_notebook_shows_the_brightest_frame_before_it_plays():
    """Not the one with the most light, which may be the lamp alone."""
    values = np.zeros((32, 32, 12), np.float32)
    values[0, 0, 1], values[:, :, 7] = 1000, 1
    animation = vis.visualize_transient(values, 3.5, 0.02)
    assert animation._fig.axes[0].images[0].get_array().mean() > 99  # pyright: ignore
    html = animation._repr_html_()
    assert "http" not in html
    poster = Image.open(io_.BytesIO(part_of(html, "image/jpeg")))
    gray = np.asarray(poster.convert("L"))
    assert np.median(gray[gray.shape[0] // 3 : -gray.shape[0] // 3]) > 99
