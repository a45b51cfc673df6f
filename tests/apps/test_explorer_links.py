"""Links to a view of the report, and what it saves: pictures, films and curves."""

import csv

import numpy as np
import pytest
from helpers.explorer_page import (
    BINS,
    HEIGHT,
    WIDE,
    fragment,
    moving,
    opened,
    picture,
    polarized,
    saved,
    set_,
    settle,
    state,
)
from helpers.made_dataset import START, WIDTH
from PIL import Image, ImageSequence

import tofrender
from tofrender import SPEED_OF_LIGHT
from tofrender.apps.explorer.page_contents import contents_of
from tofrender.vis import luminance

FRAGMENT = "#view=gate&shown=S2&gate=13,13.6&px=20,5;3,7&f=1.2e8&ev=1.5&log=1"


def kept(state: dict) -> dict:
    """What a link keeps: all but which pixel is chosen, and how long it took."""
    return {name: each for name, each in state.items() if name not in ("milliseconds", "active")}


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (800, 600), (390, 844)])
def test_a_link_restores_the_view(tmp_path, width, height):
    viewport = {"width": width, "height": height}
    contents = contents_of(polarized(), packed=True)
    with opened(tmp_path, contents, FRAGMENT, viewport=viewport) as page:
        now = state(page)
        assert (now["view"], now["stokes"], now["log"]) == ("gate", "S2", True)
        assert now["pixels"] == [[20, 5], [3, 7]]
        assert (now["frequency"], now["exposure"]) == (1.2e8, 1.5)
        edges = SPEED_OF_LIGHT * np.array([13e-9, 13.6e-9])
        first, last = np.rint((edges - START) / WIDTH)
        assert now["gate"] == {"first": first, "count": last - first}
        shown = picture(page)
        written = fragment(page)
        page.get_by_role("button", name="Copy link").click()
        page.locator(".saves").get_by_text("Copied").wait_for()
        page.evaluate("location.hash = ''")
        assert state(page)["view"] == "light"
        page.evaluate("hash => { location.hash = hash }", written)  # What was written is read
        assert kept(state(page)) == kept(now)
        assert (picture(page) == shown).all()


def test_the_address_has_what_was_changed(tmp_path):
    with opened(tmp_path, contents_of(moving())) as page:
        assert fragment(page) == ""
        set_(page, bin=7)
        ns = 1e9 * (START + 7.5 * WIDTH) / SPEED_OF_LIGHT
        assert float(fragment(page).removeprefix("#t=")) == pytest.approx(ns, abs=0.002)
        written = fragment(page)
        page.evaluate("location.hash = ''")
        page.evaluate("hash => { location.hash = hash }", written)
        assert state(page)["bin"] == 7
        set_(page, pixels=[[4, 9]], frequency=5.5e7, unwarped=False)
        assert fragment(page).split("&")[1:] == ["px=4,9", "f=5.5e7"]


@pytest.mark.parametrize("wrong", ["#t=abc&view=none&px=1,x;2&gate=3", "#&&==%%&laser=9e9", "#top"])
def test_a_wrong_link_shows_the_first_view(tmp_path, wrong):
    with opened(tmp_path, contents_of(moving())) as page:
        first = state(page)
    with opened(tmp_path, contents_of(moving()), wrong) as page:
        assert kept(state(page)) == kept(first)


def test_curves_as_csv(tmp_path):
    data = moving()
    data["transient_error"] = data["transient"] / 10
    data["steady_error"] = data["steady"] / 10
    with opened(tmp_path, contents_of(data), accept_downloads=True) as page:
        now = set_(page, pixels=[[4, 9], [20, 3]])
        path = saved(page, "CSV", tmp_path)
    assert path.name == "bördér.csv"
    with path.open(newline="") as file:
        headings, *rows = csv.reader(file)
    names = ["x4_y9", "x20_y3"]
    more = [f"{name}_{what}" for what in ("error", "resolution") for name in names]
    assert headings == ["time_ns", "opl_m", *names, *more]
    table = np.array(rows, float)
    opl = START + (np.arange(BINS) + 0.5) * WIDTH
    np.testing.assert_allclose(table[:, 1], opl, rtol=1e-7)
    np.testing.assert_allclose(table[:, 0], 1e9 * opl / SPEED_OF_LIGHT, rtol=1e-7)
    for k, curve in enumerate(now["curves"]):
        np.testing.assert_allclose(table[:, 2 + k], curve["values"], rtol=1e-7)
        np.testing.assert_allclose(table[:, 4 + k], curve["errors"], rtol=1e-7)
        given = luminance(data["transient"].values[curve["y"], curve["x"]])
        off = abs(table[:, 2 + k] - given)
        assert (off <= table[:, 6 + k] * (1 + 1e-3) + 1e-9).all()
        assert table[:, 6 + k].max() < 0.1 * given.max()


def test_csv_of_a_reduced_page_names_blocks_and_its_resolution(tmp_path):
    """Values are means of blocks of pixels, and differ from these means by one-byte steps."""
    data = moving().assign_coords(x=np.arange(WIDE) + 3, y=np.arange(HEIGHT) + 8)
    contents = contents_of(data.isel(x=slice(0, WIDE - 1)), most_bytes=9_000)
    step = contents.header["grid"]["step"]
    bins = contents.header["axis"]["count"]
    assert step > 1
    blocks = [(1, 2), (-(-(WIDE - 1) // step) - 1, 0)]  # The last one is cut
    with opened(tmp_path, contents, accept_downloads=True) as page:
        set_(page, pixels=[list(each) for each in blocks])
        path = saved(page, "CSV", tmp_path)
    with path.open(newline="") as file:
        headings, *rows = csv.reader(file)
    table = np.array(rows, float)
    for k, (column, row) in enumerate(blocks):
        x = range(column * step, min(column * step + step, WIDE - 1))
        y = range(row * step, min(row * step + step, HEIGHT))
        name = f"x{x[0] + 3}-{x[-1] + 3}_y{y[0] + 8}-{y[-1] + 8}_mean"
        assert headings[2 + k] == name
        assert headings[4 + k] == f"{name}_resolution"
        light = luminance(data["transient"].values[np.ix_(y, x)]).mean(axis=(0, 1))
        joined = np.add.reduceat(light, np.arange(0, BINS, -(-BINS // bins)))
        off = abs(table[:, 2 + k] - joined)
        assert (off <= table[:, 4 + k] * (1 + 1e-3) + 1e-9).all()
        assert off.max() > 0.002 * joined.max()


@pytest.mark.parametrize("dark", [False, True])
def test_the_picture_as_png(tmp_path, dark):
    with opened(tmp_path, contents_of(moving()), dark=dark, accept_downloads=True) as page:
        for view, bars in (("light", 0), ("depth", 1)):
            set_(page, view=view)
            with Image.open(saved(page, "PNG", tmp_path)) as file:
                found = np.array(file.convert("RGB"), int)
            shown = picture(page)
            height, width, _ = shown.shape
            factor = found.shape[1] // width
            assert found.shape == (factor * height + 26 * (1 + bars), factor * width, 3)
            middle = factor // 2
            inner = found[middle : factor * height : factor, middle::factor]
            assert abs(inner - shown).max() <= 2
            assert found[-1, -1].tolist() == ([20, 23, 26] if dark else [255, 255, 255])


@pytest.mark.parametrize("colors", ["color", "false"])
def test_the_film_as_gif(tmp_path, colors):
    with opened(tmp_path, contents_of(moving()), accept_downloads=True) as page:
        set_(page, colors=colors)
        with Image.open(saved(page, "GIF", tmp_path)) as film:
            assert film.n_frames == BINS
            assert film.info["duration"] == 50  # As on the page, 20 bins a second
            frames = [np.array(each.convert("RGB"), int) for each in ImageSequence.Iterator(film)]
        for k in (5, 22, 40):
            set_(page, bin=k)
            shown = picture(page)
            factor = frames[k].shape[1] // shown.shape[1]
            inner = frames[k][factor // 2 :: factor, factor // 2 :: factor][: len(shown)]
            off = abs(inner - shown).max(axis=2)
            assert off.mean() < 4
            assert np.quantile(off, 0.99) < 24
        settle(page)


def test_a_page_of_half_a_megabyte_is_a_film_of_use(tmp_path):
    """As the documentation's first page has it."""
    data = tofrender.render("cornell_box", spp=64, size=(128, 128), window="auto", progress=False)
    path = tofrender.report(data, tmp_path / "small.html", megabytes=0.5)
    assert 300_000 < path.stat().st_size < 500_000
    header = contents_of(data, most_bytes=360_000, packed=True).header
    assert header["light"]["width"] >= 32
    assert header["axis"]["count"] >= 128
