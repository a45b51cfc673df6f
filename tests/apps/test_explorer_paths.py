"""Paths of a pixel in the explorer: their list, and their lines in the picture."""

import re

import mitsuba as mi
import numpy as np
import pytest
from helpers import browser
from helpers.refusals import refused

import tofrender
from tofrender.apps.explorer.paths import path_lists, plain_paths

SIZE, PIXEL = 32, (16, 25)
OPTIONS = {"width": SIZE, "height": SIZE, "pulse_width_opl": 0.05}
EXPLORER = "document.getElementById('explorer').explorer"


@pytest.fixture(scope="module")
def rendered():
    scene = tofrender.load_scene("cornell_box", optimize=False, **OPTIONS)
    data = tofrender.render(scene, spp=16, window="auto", progress=False)
    return scene, data, tofrender.paths_of(scene, PIXEL, count=300, spp=2048)


def test_plain_paths_are_those_of_the_dataset(rendered):
    _, _, found = rendered
    plain = plain_paths(found)
    assert (plain["pixel"], plain["opl"], len(plain["paths"])) == ([*PIXEL], None, 300)
    total = sum(path["light"] for path in plain["paths"])
    assert total == pytest.approx(float(found["total"].mean()))
    for k, path in enumerate(plain["paths"]):
        assert path["shapes"] == [name for name in found["shape"].values[k] if name]
        assert len(path["film"]) == len(path["shapes"])
        assert np.floor(path["film"][1]).tolist() == [*PIXEL]


def test_axes_of_paths_are_found_by_their_names(rendered):
    _, _, found = rendered
    some = found.isel(path=slice(None, 9))
    assert path_lists([some.transpose("xy", "vertex", ...)], "transient") == [plain_paths(some)]
    with refused("paths: the axis path"):
        path_lists([found.isel(path=0)], "transient")


def test_a_pixel_shows_the_paths_of_its_bin(tmp_path, rendered):
    _, data, found = rendered
    path = tofrender.report(data, tmp_path / "box.html", paths=[found])
    with browser.page(offline=True, viewport={"width": 1400, "height": 900}) as page:
        page.goto(path.as_uri())
        page.wait_for_selector(".paths button")
        state = page.evaluate(f"{EXPLORER}.state()")
        assert state["pixels"] == [[*PIXEL]]
        low, high = 5.0, 7.0
        start, width = state["start"], float(data.attrs["bin_width_opl"])
        gate = {"first": round((low - start) / width), "count": round((high - low) / width)}
        page.evaluate(f"gate => {EXPLORER}.set({{ view: 'gate', gate }})", gate)
        page.wait_for_timeout(200)
        first = start + gate["first"] * width
        last = first + gate["count"] * width
        kinds = {}
        for each in plain_paths(found)["paths"]:
            if first <= each["opl"] < last:
                kinds.setdefault(" → ".join(reversed(each["shapes"])), []).append(each["opl"])
        shown = page.locator(".paths tbody tr").all()
        assert len(shown) == min(8, len(kinds)) > 1
        for row in shown:
            name, lengths, share = row.locator("td").all_inner_texts()
            its = kinds[name]
            assert name.startswith("light → ")
            assert name.endswith("sensor")
            ends = {f"{min(its):.2f}", f"{max(its):.2f}"}
            assert set(lengths.split("–")) == ends
            fraction = 100 * len(its) / sum(map(len, kinds.values()))
            assert float(share.removesuffix(" %")) == pytest.approx(fraction, rel=0.06)
        lines = page.locator(".lines polyline")
        biggest = len(kinds[shown[0].locator("button").inner_text()])
        assert lines.count() == min(12, biggest)
        u, v = lines.first.get_attribute("points").split()[0].split(",")
        assert (int(float(u)), int(float(v))) == PIXEL
        shown[1].locator("button").click()
        assert shown[1].locator("button").get_attribute("aria-pressed") == "true"
        page.evaluate(f"{EXPLORER}.set({{ pixels: [[2, 2]] }})")
        page.get_by_text("No paths of this pixel are in this file.").wait_for()
        assert page.errors == []


def test_paths_stay_where_the_camera_segment_is_left_out(tmp_path, rendered):
    _, data, found = rendered
    distance = np.full((SIZE, SIZE), 3.0)
    path = tofrender.report(data, tmp_path / "box.html", paths=[found], distance_m=distance)
    with browser.page(offline=True) as page:
        page.goto(path.as_uri())
        page.wait_for_selector(".paths")
        length = found["opl"].values[0]
        listed = []
        for unwarped in (False, True):
            page.evaluate(f"unwarped => {EXPLORER}.set({{ unwarped, view: 'light' }})", unwarped)
            now = page.evaluate(f"{EXPLORER}.state()")
            bin_ = (length - 3.0 * unwarped - now["start"]) / float(data.attrs["bin_width_opl"])
            page.evaluate(f"bin => {EXPLORER}.set({{ bin }})", int(bin_))
            page.wait_for_timeout(200)
            listed.append(page.locator(".paths tbody").inner_text())
        assert listed[0] == listed[1] != ""


def test_a_film_plays_as_fast_after_new_data(tmp_path, rendered):
    _, data, _ = rendered
    path = tofrender.report(data, tmp_path / "box.html")
    with browser.page(offline=True) as page:
        page.goto(path.as_uri())
        page.wait_for_selector(".tof-explorer canvas.plot")
        page.evaluate(f"{EXPLORER}.set({{ bin: 0, playing: true }})")
        page.evaluate(f"for (let k = 0; k < 20; k++) {EXPLORER}.set({{ playing: true }})")
        begin = page.evaluate("performance.now()")
        page.wait_for_function(f"() => {EXPLORER}.state().bin >= 20")
        assert page.evaluate("performance.now()") - begin > 500  # 20 bins a second


def test_a_notebook_traces_paths_of_its_scene(rendered):
    scene, data, _ = rendered
    widget = tofrender.explore(data, scene=scene)
    assert widget.traces
    answers = []
    widget.send = answers.append
    widget._msg_callbacks(widget, {"pixel": [*PIXEL], "range": [4.0, 9.0]}, [])
    widget._msg_callbacks(widget, {"pixel": [SIZE, 0], "range": [4.0, 9.0]}, [])
    found, wrong = answers
    assert found["paths"]
    assert found["traced"]
    width = float(re.search(r"width_opl=(.+)\)", data.attrs["pulse"])[1])
    for path in found["paths"]:
        assert 4 - 5 * width <= path["opl"] < 9 + 5 * width  # The pulse's support
    assert wrong["error"] == f"pixel column = {SIZE}: must be an integer from 0 to {SIZE - 1}"


def test_scenes_and_paths_must_fit(rendered):
    scene, data, found = rendered
    with refused("film of the scene = .*: must be .16, 16, 0, 0."):
        tofrender.explore(data.isel(x=slice(16), y=slice(16)), scene=scene)
    with refused("paths: expected a result of paths_of, but the variable"):
        tofrender.explore(data, paths=[data])
    with refused("paths = .*: must be"):
        tofrender.explore(data, paths=found)
    assert isinstance(scene, mi.Scene)
