"""`tofrender compare`: pictures of the course's scenes, references, files, and the divider."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from helpers.browser import page
from helpers.served import is_free, served
from PIL import Image

from tofrender.apps.compare import pictures
from tofrender.apps.compare.pictures import Picture, difference, opened, rendered, techniques
from tofrender.cli.app import main

WAIT_MS = 60_000


def test_all_scenes_of_the_course_have_a_reference():
    with np.load(pictures.REFERENCES) as kept:
        assert set(kept.files) == set(pictures.SCENES)
        for name in kept.files:
            assert kept[name].dtype == np.float16
            assert np.isfinite(kept[name]).all()
            assert kept[name].max() > 0
            assert max(kept[name].shape) == pictures.SIDE


@pytest.mark.parametrize("scene", ["sphere_light_medium", "bust_simple", "bust_ao"])
def test_references_are_of_the_scenes_as_they_are(scene):
    way = "mis" if "mis" in techniques(scene) else "own"
    reference = rendered(scene, "reference", 1)
    assert difference(rendered(scene, way, 64), reference) < 0.06


def test_both_techniques_are_nearer_to_the_reference_than_one():
    scene = "sphere_light_large"
    reference = rendered(scene, "reference", 1)
    apart = {name: difference(rendered(scene, name, 16), reference) for name in ("mats", "mis")}
    assert apart["mis"] < 0.5 * apart["mats"]


def test_files(tmp_path):
    values = np.linspace(0, 1, 48, dtype=np.float32).reshape(4, 4, 3)
    mi.Bitmap(values).write(str(tmp_path / "a.exr"))
    assert opened(tmp_path / "a.exr").pixels == pytest.approx(values, abs=1e-3)
    for name in ("no.exr", "bad.exr", "bad.npz"):
        if name.startswith("bad"):
            (tmp_path / name).write_bytes(b"text")
        with pytest.raises((ValueError, FileNotFoundError)) as raised:
            opened(tmp_path / name)
        assert str(raised.value).count("\n") == 0
    with pytest.raises(ValueError, match=r"b: 2 x 3 pixels; must be 4 x 4, as a"):
        difference(Picture("a", values), Picture("b", np.ones((3, 2, 3), np.float32)))


def test_what_cannot_be_compared(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "vaech", "--no-browser"]) == 2
    assert "did you mean 'veach'?" in capsys.readouterr().err
    assert main(["compare", "a.exr", "b.exr", "--no-browser"]) == 2
    assert capsys.readouterr().err.startswith("error: picture = 'a.exr': must be a file")


@pytest.mark.timeout(180)
@pytest.mark.parametrize("dark", [False, True])
def test_the_divider(dark):
    with served("compare", "sphere_light_medium", "--no-browser") as command:
        with page(dark=dark, viewport={"width": 1280, "height": 800}) as there:
            there.goto(command.url)
            there.get_by_text("Root mean square difference").wait_for(timeout=WAIT_MS)
            said = there.locator(".box").inner_text()
            reference = rendered("sphere_light_medium", "reference", 1)
            for way in ("mats", "mis"):
                apart = difference(rendered("sphere_light_medium", way, 16), reference)
                assert f"{100 * apart:.3g} %" in said
            canvas = there.locator("canvas").last
            box = canvas.bounding_box()
            before = _shades(there)
            there.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 50)
            there.mouse.down()
            there.mouse.move(box["x"] + 0.1 * box["width"], box["y"] + 50, steps=5)
            there.mouse.up()
            there.wait_for_selector('[data-divider="10"]', timeout=WAIT_MS)
            assert not np.array_equal(_shades(there), before)
            slider = there.get_by_label("Divider between the two pictures")
            slider.focus()
            slider.press("End")
            there.wait_for_selector('[data-divider="100"]', timeout=WAIT_MS)
            there.get_by_label("Left", exact=True).select_option(label="nee: light sampling")
            there.get_by_text("nee, 16 samples").first.wait_for(timeout=WAIT_MS)
            assert there.errors == []
        assert command.stop() == 0
        assert is_free(command.port)


def _shades(there):
    import io

    return np.array(Image.open(io.BytesIO(there.screenshot())).convert("L"))
