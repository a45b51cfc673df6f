"""`tofrender compare`: pictures of the course's scenes, references, files, and the divider."""

import mitsuba as mi
import numpy as np
import pytest
from helpers import browser
from helpers.support import refused

from tofrender.apps.compare import pictures
from tofrender.apps.compare.pictures import Picture, difference, load_picture, render_technique
from tofrender.cli.app import main


def off(scene: str, way: str, spp: int) -> float:
    return difference(render_technique(scene, way, spp), render_technique(scene, "reference", 1))


def test_all_scenes_of_the_course_have_a_reference():
    with np.load(pictures.REFERENCES) as kept:
        assert set(kept.files) == set(pictures.SCENES)
        for name, picture in kept.items():
            assert (picture.dtype, max(picture.shape)) == (np.float16, pictures.SIDE), name
            assert np.isfinite(picture).all(), name
            assert picture.max() > 0, name


@pytest.mark.parametrize("scene", ["sphere_light_medium", "bust_simple", "bust_ao"])
def test_references_are_of_the_scenes_as_they_are(scene):
    way = "mis" if "mis" in pictures.techniques(scene) else "own"
    assert off(scene, way, 64) < 0.06


def test_both_techniques_are_nearer_to_the_reference_than_one():
    assert off("sphere_light_large", "mis", 16) < 0.5 * off("sphere_light_large", "mats", 16)


def test_files(tmp_path):
    values = np.linspace(0, 1, 48, dtype=np.float32).reshape(4, 4, 3)
    mi.Bitmap(values).write(str(tmp_path / "a.exr"))
    assert load_picture(tmp_path / "a.exr").pixels == pytest.approx(values, abs=1e-3)
    for name in ("no.exr", "bad.exr", "bad.npz"):
        if name.startswith("bad"):
            (tmp_path / name).write_bytes(b"text")
        refused("exr|npz", load_picture, tmp_path / name, kind=(ValueError, FileNotFoundError))
    with pytest.raises(ValueError, match=r"b: 2 x 3 pixels; must be 4 x 4, as a"):
        difference(Picture("a", values), Picture("b", np.ones((3, 2, 3), np.float32)))


def test_what_cannot_be_compared(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "vaech", "--no-browser"]) == 2
    assert "did you mean 'veach'?" in capsys.readouterr().err
    assert main(["compare", "a.exr", "b.exr", "--no-browser"]) == 2
    assert capsys.readouterr().err.startswith("error: picture = 'a.exr': must be a file")


def test_the_divider():
    with browser.page_of("compare", "sphere_light_medium", dark=True) as there:
        there.get_by_text("Root mean square difference").wait_for()
        said = there.locator(".box").inner_text()
        for way in ("mats", "mis"):
            assert f"{100 * off('sphere_light_medium', way, 16):.3g} %" in said
        box = there.locator("canvas").last.bounding_box()
        before = browser.shades(there)
        y, half, tenth = box["y"] + 50, *(box["x"] + part * box["width"] for part in (0.5, 0.1))
        browser.drag(there, (half, y), (tenth, y))
        there.wait_for_selector('[data-divider="10"]')
        assert not np.array_equal(browser.shades(there), before)
        slider = there.get_by_label("Divider between the two pictures")
        slider.focus()
        slider.press("End")
        there.wait_for_selector('[data-divider="100"]')
        there.get_by_label("Left", exact=True).select_option(label="nee: light sampling")
        there.get_by_text("nee, 16 samples").first.wait_for()


def test_each_technique_is_rendered_by_its_tracer(monkeypatch):
    kinds = []

    def load(description):
        kinds.append(description["integrator"]["type"])
        raise InterruptedError

    monkeypatch.setattr(pictures.mi, "load_dict", load)
    for scene in ("veach", "cornell_box_steady_state"):
        for way in pictures.TECHNIQUES:
            with pytest.raises(InterruptedError):
                pictures._render(scene, way, 1, 0)
    plugins = [plugin for plugin, _ in pictures.TECHNIQUES.values()]
    assert kinds == 2 * plugins
