"""`tofrender view` in a browser: what was saved, damaged files, and renders that go on."""

import json
import re

import numpy as np
import pytest
from helpers import browser
from helpers.made_dataset import make_dataset

import tofrender
from tofrender import io

FIND = browser.found("each.explorer", "each.explorer")


def state(there) -> dict:
    there.wait_for_function(f"() => {FIND}")
    return json.loads(there.evaluate(f"JSON.stringify({FIND}.state())"))


def test_parts_of_a_large_cube_are_shown_in_full(tmp_path):
    path = io.save_npz(make_dataset(400, 300, 260), tmp_path / "large.npz")
    with browser.page_of("view", path) as there:
        there.get_by_role("button", name="Look closer").wait_for()
        state(there)
        header = f"{browser.found('each.explorer', 'each')}.textContent"
        assert "are averaged" in there.evaluate(header)
        for name, ends in (("Rows", (100, 140)), ("Columns", (30, 90)), ("Bins", (0, 200))):
            for side, end in zip(("from", "to"), ends, strict=True):
                field = there.get_by_label(f"{name} {side}")
                field.fill(str(end))
                field.press("Tab")
        there.get_by_role("button", name="Look closer").click()
        there.get_by_text("60 × 40 pixels, 200 bins").first.wait_for()
        assert "All pixels and bins are there" in there.evaluate(header)


def test_cut_files_give_a_message_and_whole_ones_their_values(tmp_path):
    scene = tofrender.cornell_box(width=24, height=20, temporal_bins=60)
    data = tofrender.render(scene, spp=16, window="auto", progress=False)
    path = io.save_npz(data, tmp_path / "box.npz")
    whole = path.read_bytes()
    with browser.page_of("view", path) as there:
        state(there)
        path.write_bytes(whole[:3000])
        there.get_by_text("box.npz cannot be shown").wait_for()
        path.write_bytes(whole)
        state(there)
        there.evaluate(f"{FIND}.set({{pixels: [[7, 11]], channel: '1', bin: 20}})")
        shown = state(there)
        assert shown["bins"] == 60
        assert shown["opl"] == pytest.approx(float(data.opl[20]), rel=1e-5)
        curve = np.array(shown["curves"][0]["values"], float)
        expected = data.transient.values[11, 7, :, 1]
        assert curve == pytest.approx(expected, rel=0.03, abs=0.01 * float(expected.max()))


def test_a_render_goes_on_stops_and_is_saved(tmp_path):
    out = tmp_path / "live.npz"
    options = ("--live", "--size", "32x32", "--spp", "1000000", "--out", out)
    with browser.page_of("view", "cornell_box", *options) as there:
        first = state(there)
        there.evaluate(f"{FIND}.set({{pixels: [[3, 4]], bin: 7}})")
        there.get_by_text(re.compile(r": \d\d+ of 1000000")).wait_for()
        there.get_by_role("button", name="Stop").click()
        there.get_by_text("stopped").wait_for()
        now = state(there)
        assert now["bins"] == first["bins"]
        assert now["pixels"] == [[3, 4]]  # What one looks at stays
        assert now["bin"] == 7
        there.evaluate(
            f"{FIND}.set({{pixels: [[16, 25]], view: 'gate', gate: {{first: 30, count: 99}}}})"
        )
        there.get_by_role("button", name="light → floor → small-box → sensor").wait_for()
        there.get_by_role("button", name="Save as live.npz").click()
        there.get_by_text("Saved").wait_for()
        data = io.load_npz(out)
        assert data.attrs["spp"] >= 10
        options = {"window": "auto", "pulse_width": "auto", "spp": int(data.attrs["spp"])}
        whole = tofrender.render("cornell_box", size=(32, 32), progress=False, **options)
        assert np.allclose(data.steady.values, whole.steady.values, rtol=1e-3, atol=1e-4)
        there.get_by_role("button", name="Go on").click()
        there.get_by_text("rendering").wait_for()


def test_a_page_says_that_its_server_has_stopped(tmp_path):
    path = io.save_npz(make_dataset(4, 6, 5), tmp_path / "small.npz")
    with browser.page_of("view", path) as there:
        state(there)
        assert not there.get_by_role("alert").count()
        assert there.command.stop() == 0
        there.get_by_role("alert").get_by_text("The server has stopped").wait_for()


def test_what_cannot_be_viewed(capsys, tmp_path, monkeypatch):
    from tofrender.cli.app import main

    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.npz").write_bytes(b"text")
    for arguments, said in (
        (["cornell_box"], "DIR|FILE|SCENE = 'cornell_box' is a scene. Add --live"),
        (["no.npz"], "DIR|FILE|SCENE = 'no.npz' does not exist"),
        (["bad.npz"], "path = bad.npz: File is not a zip file"),
        ([".", "--spp", "4"], "--spp, --size, --max-depth and --out require --live"),
    ):
        assert main(["view", *arguments, "--no-browser"]) == 2
        err = capsys.readouterr().err
        assert err.startswith(f"error: {said}")
        assert err.count("\n") == 1
