"""The report in a real browser, opened from disk without a network: it shows the data's values."""

import numpy as np
import pytest
from helpers import browser
from helpers.explorer_page import (
    BINS,
    HEIGHT,
    STATE,
    WIDE,
    moving,
    opened,
    picture,
    place,
    set_,
    settle,
    state,
    values_of,
)
from helpers.hidden_scenes import Wall, capture_of, rectangle, turned
from helpers.made_dataset import START, WIDTH

import tofrender
from tofrender import SPEED_OF_LIGHT
from tofrender.apps.explorer.page_contents import contents_of
from tofrender.vis import luminance

GAMMA = 2.2
NEAR = 2  # Of 255, for the steps of a tone curve


def toned(light, gain):
    return 255 * np.minimum(1, gain * light) ** (1 / GAMMA)


def require_picture(page, light) -> None:
    expected = toned(light, state(page)["gain"])
    assert abs(picture(page) - expected).max() <= NEAR


@pytest.fixture(scope="module")
def shown():
    data = moving()
    return data, contents_of(data, packed=True)


def test_time_moves_and_the_picture_is_that_of_the_data(tmp_path, shown):
    data, contents = shown
    light = values_of(contents)
    with opened(tmp_path, contents) as page:
        first = state(page)
        assert picture(page).mean() > 20  # It opens on light
        assert first["bin"] not in (0, BINS - 1)
        page.get_by_label("Time", exact=True).focus()
        steps = ("ArrowRight", first["bin"] + 1), ("End", BINS - 1), ("Home", 0), ("ArrowRight", 1)
        for key, expected in steps:
            page.keyboard.press(key)
            assert state(page)["bin"] == expected
        for k in (15, 40):
            now = set_(page, bin=k)
            assert now["ns"] == pytest.approx(1e9 * (START + (k + 0.5) * WIDTH) / SPEED_OF_LIGHT)
            require_picture(page, light[:, :, k])
            given = data["transient"].values[:, :, k]
            bright = given * now["gain"] > 0.01
            off = abs(picture(page) - toned(given, now["gain"]))[bright]
            assert off.max() <= 255 * 0.05 / GAMMA + 1
        page.get_by_label("Exposure").focus()
        page.keyboard.press("ArrowRight")
        assert state(page)["gain"] == pytest.approx(2**0.1 * now["gain"])
        page.locator(".tof-explorer .heading :is(h2, h3)").first.click()
        page.locator(".play").click()
        page.wait_for_function(f"() => {STATE}.bin >= 43")
        page.keyboard.press("Space")  # On the button
        paused = state(page)
        assert not paused["playing"]
        page.wait_for_timeout(200)
        assert state(page)["bin"] == paused["bin"]


def test_clicked_pixels_have_the_responses_of_the_data(tmp_path, shown):
    data, contents = shown
    scale = contents.header["light"]
    weights = contents.header["weights"]
    with opened(tmp_path, contents) as page:
        set_(page, pixels=[])
        page.mouse.click(*place(page, 5, 7))
        page.mouse.click(*place(page, 20, 11))
        browser.drag(page, place(page, 20, 11), place(page, 26, 3))
        curves = state(page)["curves"]
        assert [(curve["x"], curve["y"]) for curve in curves] == [(5, 7), (26, 3)]
        for curve in curves:
            given = data["transient"].values[curve["y"], curve["x"]]
            found = np.array(curve["values"])
            expected = values_of(contents)[curve["y"], curve["x"]] @ weights
            np.testing.assert_allclose(found, expected, rtol=1e-5)
            off = abs(found - given @ weights)
            assert (off <= scale["least"] + (scale["ratio"] ** 0.5 - 1) * (given @ weights)).all()
        rows = page.locator(".panel > table tbody tr")
        assert rows.count() == 2
        assert "(5, 7)" in rows.first.inner_text()
        page.locator(".frame").focus()
        page.keyboard.press("ArrowDown")
        page.keyboard.press("Shift+ArrowLeft")
        moved = state(page)["curves"][1]
        assert (moved["x"], moved["y"]) == (16, 4)
        page.keyboard.press("Delete")
        settle(page)
        assert rows.count() == 1


def test_a_single_bin_shows_the_rows_of_the_chosen_pixels(tmp_path):
    """A curve over time would have a single point. The film starts at the pixel (3, 2)."""
    contents = contents_of(moving().isel(opl=[17], x=slice(3, None), y=slice(2, None)), packed=True)
    with opened(tmp_path, contents) as page:
        set_(page, pixels=[[4, 5]], channel="1")
        shown = state(page)["rows"]
        label = page.get_attribute("canvas.plot", "aria-label")
    values = [shown["profiles"][0]["values"][column] for column in range(WIDE - 3)]
    np.testing.assert_allclose(values, values_of(contents)[5, :, 0, 1], rtol=1e-5)
    assert np.ptp(values) > 0
    assert shown["axis"] == {"start": 2.5, "width": 1, "count": WIDE - 3}
    assert shown["mark"] == {"bin": 4}
    assert "over pixel x" in label


def test_phasors_follow_the_frequency(tmp_path, shown):
    data, contents = shown
    light = luminance(data["transient"].values.astype(np.float64))[..., None]
    with opened(tmp_path, contents) as page:
        set_(page, pixels=[[3, 4], [28, 20]], view="phasor", phasor="phase")
        before = picture(page)
        page.get_by_label("Frequency").focus()
        page.keyboard.press("PageUp")
        after = state(page)
        assert (picture(page) != before).any()
        frequencies = [after["frequency"], 1e8]
        for frequency in frequencies:
            now = set_(page, frequency=frequency)
            parts = tofrender.transient_to_phasor(light, frequency, START, WIDTH)
            amplitude, phase, depth = (part[..., 0] for part in parts[2:])
            for (x, y), found in zip(now["pixels"], now["phasors"], strict=True):
                assert found["amplitude"] == pytest.approx(amplitude[y, x], rel=0.01)
                assert found["phase"] == pytest.approx(phase[y, x], abs=0.01)
                assert found["depth"] == pytest.approx(depth[y, x], abs=0.01 / frequency * 5e7)
            colors = contents.part("map phase").reshape(256, 3).astype(int)
            level = np.rint(255 * (phase + np.pi) / (2 * np.pi)).astype(int)
            off = abs(picture(page) - colors[level]).max(axis=2)
            assert np.quantile(off, 0.95) <= 12  # Of the map's colors, levels apart


def test_a_dragged_gate_shows_what_arrives_in_it(tmp_path, shown):
    data, contents = shown
    light = values_of(contents)
    with opened(tmp_path, contents) as page:
        page.get_by_role("radio", name="Gate").click()
        set_(page, gate={"first": 20, "count": 8})
        require_picture(page, light[:, :, 20:28].sum(axis=2))
        page.locator(".plot").scroll_into_view_if_needed()
        plot = page.locator(".plot").bounding_box()
        left, right = plot["x"] + 64, plot["x"] + plot["width"] - 14

        def at(edge):
            return left + edge / BINS * (right - left), plot["y"] + plot["height"] / 2

        for start, stop, gate in (
            (24, 34, {"first": 30, "count": 8}),
            (38, 45, {"first": 30, "count": 15}),
            (30, 10, {"first": 10, "count": 35}),
        ):
            browser.drag(page, at(start), at(stop))
            assert state(page)["gate"] == gate
        sums = light[:, :, 10:45].sum(axis=2)
        require_picture(page, sums)
        given = data["transient"].values[:, :, 10:45].sum(axis=2)
        np.testing.assert_allclose(sums, given, rtol=0.05)
        page.get_by_role("radio", name="All time").click()
        require_picture(page, values_of(contents, "steady")[:, :, 0])


def test_peaks_and_depths(tmp_path, shown):
    data, contents = shown
    peaks = data["opl"].values[luminance(data["transient"].values).argmax(axis=2)]
    colors = contents.part("map distance").reshape(256, 3).astype(int)
    low, high = (np.sort(peaks, axis=None)[round(q * (peaks.size - 1))] for q in (0.01, 0.99))
    level = np.clip(np.rint(255 * (peaks - low) / (high - low)), 0, 255).astype(int)
    with opened(tmp_path, contents) as page:
        for name, words in (("Peak time", "brightest"), ("Depth", "It assumes a flash")):
            page.get_by_role("radio", name=name, exact=True).first.click()
            settle(page)
            assert abs(picture(page) - colors[level]).max() <= 6  # A level
            assert words in page.locator(".assumes").first.inner_text()
        bar = page.locator(".bar").inner_text().replace("\n", " ").split()
        assert float(bar[0]) == pytest.approx(low / 2, rel=0.01)
        assert float(bar[-2]) == pytest.approx(high / 2, rel=0.01)


def test_without_the_way_to_the_camera(tmp_path):
    data = moving()
    way = np.broadcast_to(1.0 + 0.011 * np.arange(WIDE), (HEIGHT, WIDE))
    expected = tofrender.unwarp_camera(data, way)
    contents = contents_of(data, distance_m=way)
    with opened(tmp_path, contents) as page:
        before = set_(page, pixels=[[4, 5], [30, 9]])
        page.get_by_label("Without the camera segment").click()
        now = state(page)
        assert now["start"] == pytest.approx(before["start"] - 1.36, abs=WIDTH)
        centers = now["start"] + (np.arange(now["bins"]) + 0.5) * WIDTH
        for curve in now["curves"]:
            found = np.array(curve["values"])
            line = luminance(expected["transient"].sel(x=curve["x"], y=curve["y"]).values)
            line = np.interp(centers, expected["opl"].values, line, left=0, right=0)
            np.testing.assert_allclose(found, line, rtol=0.06, atol=1e-4)
        frame = picture(page)
        k = int(np.rint((centers[now["bin"]] - float(expected["opl"][0])) / WIDTH))
        light = expected["transient"].values[:, :, k]
        off = abs(frame - toned(light, now["gain"]))
        assert np.quantile(off, 0.99) <= 8


def test_error_bars_and_parts(tmp_path):
    data = moving()
    data["transient_error"] = data["transient"] / 10
    data["steady_error"] = data["steady"] / 10
    parts = {"direct": data * 0.6, "others": data * 0.4}
    with opened(tmp_path, contents_of(data, orders=parts)) as page:
        curve = state(page)["curves"][0]
        for k in range(BINS):
            light = curve["values"][k]
            assert curve["errors"][k] == pytest.approx(light / 10, rel=0.1, abs=1e-5)
            shares = [order["values"][k] for order in curve["orders"]]
            assert shares == pytest.approx([0.6 * light, 0.4 * light], rel=0.1, abs=1e-5)
        legend = page.locator(".legend").inner_text()
        assert "standard error" in legend
        assert "direct" in legend
        assert "others" in legend


def test_captures_show_their_lit_points_and_volumes_their_sides(tmp_path):
    patch = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
    capture = capture_of(patch, Wall(6), bins=40, width=0.03, mode="exhaustive")
    with opened(tmp_path, contents_of(capture)) as page:
        lasers = capture["laser_grid"].shape[0] * capture["laser_grid"].shape[1]
        assert page.locator(".laser").count() == lasers
        first = set_(page, pixels=[[0, 1]])["curves"][0]["values"]
        now = set_(page, laser=lasers - 1)
        assert now["curves"][0]["values"] != first
        curve = now["curves"][0]
        given = capture["transient"].values[-1, -1, curve["y"], curve["x"], :, 0]
        found = curve["values"]
        np.testing.assert_allclose(found, given, rtol=0.05, atol=1e-3 * given.max())
        assert "wall (" in page.locator(".readout").inner_text()
    confocal = capture_of(patch, Wall(6), bins=40, width=0.03)
    volume = tofrender.reconstruct(confocal, "bp", progress=False)
    values = volume["intensity"].values
    with opened(tmp_path, contents_of(volume)) as page:
        sizes = {"front": values.shape[1:], "side": (values.shape[1], values.shape[0])}
        sizes["top"] = values.shape[0], values.shape[2]
        for view, size in sizes.items():
            set_(page, view=view, colors="gray")
            assert picture(page).shape[:2] == size
            assert picture(page).max() == 255
        assert page.get_by_text("Phasors").is_hidden()


@pytest.mark.parametrize("wall", [Wall(6), turned(6)], ids=["rows upwards", "turned"])
@pytest.mark.parametrize("most_bytes", [None, 500])
def test_the_wall_of_a_capture_has_its_highest_row_on_top(tmp_path, wall, most_bytes):
    """The picture of a wall, the slice of the volume and the 3-D view agree on what is up."""
    patch = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
    capture = capture_of(patch, wall, bins=40, width=0.03)
    volume = tofrender.reconstruct(capture, "bp", progress=False)
    capture = capture.isel(y=slice(1, None), x=slice(2, None))
    row, column, bin_ = 1, 3, 20
    capture["transient"][:] = 0
    capture["transient"][row, column, bin_] = 1
    grid = capture["sensor_grid"].values
    contents = contents_of(capture, most_bytes=most_bytes)
    step = contents.header["grid"]["step"]
    points = contents.part("points").reshape(grid.shape)
    assert points[0, :, 1].mean() > points[-1, :, 1].mean()
    light = values_of(contents)[..., 0]
    top, left, bin_ = np.unravel_index(light.argmax(), light.shape)
    block = points[top * step : (top + 1) * step, left * step : (left + 1) * step].reshape(-1, 3)
    assert np.isclose(block, grid[row, column]).all(axis=1).any()
    with opened(tmp_path, contents) as page:
        now = set_(page, pixels=[[int(left), int(top)]], bin=int(bin_), colors="gray")
        lit = np.argwhere(picture(page).max(axis=2) > 100)
        assert lit.tolist() == [[top, left]]
        assert max(now["curves"][0]["values"]) > 0
        # The name of the block contains the point of the wall
        text = page.locator(".readout").inner_text().partition(")")[0].strip("(")
        columns, rows = ([int(end) for end in ends.split("–")] for ends in text.split(", "))
        assert columns[0] <= capture["x"].values[column] <= columns[-1]
        assert capture["y"].values[0] <= rows[0] <= capture["y"].values[row] <= rows[-1]
        # An address finds the same block again
        curve = now["curves"][0]
        set_(page, pixels=[])
        page.evaluate("hash => { location.hash = hash }", f"#px={curve['x']},{curve['y']}")
        assert state(page)["pixels"] == [[left, top]]
    # A slice of the volume has the rows in the same order
    volume["intensity"][:] = 0
    highest = 0 if volume["frame_axes"].values[1, 1] < 0 else volume.sizes["y"] - 1
    volume["intensity"][3, highest, 1] = 1
    found = values_of(contents_of(volume))[..., 0]
    assert np.argwhere(found).tolist() == [[0, 1, 3]]


def test_hostile_names_stay_text(tmp_path):
    hostile = "</script><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'>"
    hostile += "&lt;b&gt; ü"
    data = moving().assign_attrs(scene=hostile, pulse=hostile, units=hostile, sampler=hostile)
    parts = {hostile: data}
    with opened(tmp_path, contents_of(data, orders=parts, packed=True)) as page:
        assert page.locator("script").count() == 3  # Header, codes and the module
        policy = page.locator("meta[http-equiv=Content-Security-Policy]").get_attribute("content")
        assert policy.startswith("default-src 'none'")
        assert "unsafe" not in policy
        assert page.locator("h1").inner_text() == hostile
        assert page.title() == hostile
        assert page.locator("img").count() == 0
        page.locator("summary").click()
        assert page.locator("dd", has_text="onerror").count() == 2
        assert page.evaluate("window.hacked") is None


@pytest.mark.parametrize(("dark", "width", "height"), [(False, 1280, 900), (True, 390, 840)])
def test_pages_of_all_sizes_and_both_lights(tmp_path, shown, dark, width, height):
    viewport = {"width": width, "height": height}
    with opened(tmp_path, shown[1], dark=dark, viewport=viewport) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        background = "element => getComputedStyle(element).backgroundColor"
        paper = page.locator(".tof-explorer").evaluate(background)
        assert paper == ("rgb(20, 23, 26)" if dark else "rgb(255, 255, 255)")
        canvases = page.locator("canvas[role=img]:visible").all()
        assert len(canvases) >= 3
        for canvas in canvases:
            assert len(canvas.get_attribute("aria-label")) > 20


def test_the_default_box_is_below_ten_megabytes_and_steps_are_quick(tmp_path):
    """As rendered, 256 x 256 pixels and 300 bins of three colors; the full cube is drawn too."""
    data = tofrender.render("cornell_box", spp=4, window="auto", progress=False)
    path = tofrender.report(data, tmp_path / "box.html")
    assert path.stat().st_size < 10e6
    contents = contents_of(data, packed=True)
    assert contents.header["light"]["height"] == 256
    with opened(tmp_path, contents) as page:
        times = []
        for k in range(100, 130):
            set_(page, bin=k)
            times.append(state(page)["milliseconds"])
        assert np.median(times) < 50


def test_touch_adds_and_drags_pixels_and_plays(tmp_path, shown):
    _, contents = shown
    size = {"width": 390, "height": 840}
    with opened(tmp_path, contents, viewport=size, has_touch=True, is_mobile=True) as page:
        set_(page, pixels=[[4, 4]])
        page.touchscreen.tap(*place(page, 20, 10))
        assert state(page)["pixels"] == [[4, 4], [20, 10]]
        page.locator(".play").tap()
        assert state(page)["playing"]
        page.locator(".play").tap()
        assert not state(page)["playing"]
        page.get_by_role("radio", name="Phasor").tap()
        assert state(page)["view"] == "phasor"
