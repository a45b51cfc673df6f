"""`tofrender compare`: pictures of the course's scenes, references, files, films, and the page."""

import mitsuba as mi
import numpy as np
import pytest
from helpers import browser
from helpers.made_dataset import make_dataset
from helpers.processes import wait_for
from helpers.support import refused

from tofrender import io
from tofrender.apps.compare import course_pictures
from tofrender.apps.compare.course_pictures import render_technique
from tofrender.apps.compare.picture_set import (
    Picture,
    PictureSet,
    difference,
    load,
    relative_errors,
)
from tofrender.cli.app import main
from tofrender.vis.transient_figures import Transient

SIZES = ((1400, 900), (800, 600), (390, 844))


def off(scene: str, way: str, spp: int) -> float:
    """Root mean square difference from the reference, as a part of its mean."""
    reference, seen = (render_technique(scene, *w).pixels for w in (("reference", 1), (way, spp)))
    rms, _, mean, _ = difference(reference, seen)
    return rms / mean


def test_all_scenes_of_the_course_have_a_reference():
    with np.load(course_pictures.REFERENCES) as kept:
        assert set(kept.files) == set(course_pictures.SCENES)
        for name, picture in kept.items():
            assert (picture.dtype, max(picture.shape)) == (np.float16, course_pictures.SIDE), name
            assert np.isfinite(picture).all(), name
            assert picture.max() > 0, name


@pytest.mark.parametrize("scene", ["sphere_light_medium", "bust_simple", "bust_ao"])
def test_references_are_of_the_scenes_as_they_are(scene):
    way = "mis" if "mis" in course_pictures.techniques(scene) else "own"
    assert off(scene, way, 64) < 0.06


def test_both_techniques_are_nearer_to_the_reference_than_one():
    assert off("sphere_light_large", "mis", 16) < 0.5 * off("sphere_light_large", "mats", 16)


def test_files(tmp_path):
    values = np.linspace(-1, 1, 48, dtype=np.float32).reshape(4, 4, 3)
    mi.Bitmap(values).write(str(tmp_path / "a.exr"))
    assert load(tmp_path / "a.exr", io.load_exr_stack).pixels == pytest.approx(values, abs=1e-3)
    data = make_dataset(4, 5, 6)
    film = load(io.save_npz(data, tmp_path / "film.npz"), io.load_npz)
    assert np.array_equal(film.pixels, data.steady)
    assert np.array_equal(film.film.values.read(), data.transient)
    for name in ("no.exr", "bad.exr", "bad.npz"):
        if name.startswith("bad"):
            (tmp_path / name).write_bytes(b"text")
        arguments = tmp_path / name, io.load_npz if "npz" in name else io.load_exr_stack
        refused("exr|npz", load, *arguments, kind=(ValueError, FileNotFoundError))
    sizes = [np.ones((height, 4, 3), np.float32) for height in (4, 3)]
    refused("b: 4 x 3 pixels; must be 4 x 4, as a", PictureSet, *map(Picture, "ab", sizes))


def film(name: str, start: float, width: float, bins: int, quantity: str) -> Picture:
    """A film of light that is 1 per meter at a path length of 0 and grows by 1 each meter."""
    opl = start + width * (np.arange(bins) + 0.5)
    values = np.tile((1 + opl) * (width if "bin" in quantity else 1), (2, 3, 1)).astype(np.float32)
    return Picture(name, values.sum(2)[..., None], Transient(values, start, width, 0, 0, quantity))


def test_films_of_other_bins_are_shown_at_the_same_time():
    a, b = film("a", 1, 0.5, 8, "radiance per bin"), film("b", 2, 0.125, 40, "radiance per meter")
    pair = PictureSet(a, b)
    assert (pair.clock.start, pair.clock.width, pair.clock.count) == (2, 0.125, 24)
    for step in (0, 1, 11, 23):
        opl = 2 + 0.125 * (step + 0.5)
        one, other = pair.frames(step)
        assert one.shape == other.shape == (2, 3, 1)
        assert other == pytest.approx(1 + opl)
        assert one == pytest.approx(1 + opl, abs=0.25 + 1e-6)  # The middle of the wider bin
        assert [each[step] for each in pair.responses(2, 1)] == pytest.approx(
            [one[1, 2, 0], opl + 1]
        )
    late = film("late", 9, 0.5, 8, "radiance per bin")
    refused("late: bins from 9 to 13 m; must overlap with 1 to 5 m in time", PictureSet, a, late)
    assert PictureSet(a, film("c", 1, 0.5, 8, "radiance per bin")).quantity == "radiance per bin"


def test_numbers_of_a_difference_leave_out_what_is_unknown():
    a, b = np.array([[1.0, 2.0, np.nan]]), np.array([[1.0, -2.0, 5.0]])
    assert difference(a, b) == pytest.approx((np.sqrt(8), 4, 1.5, -0.5))
    assert np.isnan(difference(a * np.nan, b)).all()


def test_relative_errors_are_their_formulas():
    r = np.array([[4.0, 1.0, 0.0, np.nan]])
    x = np.array([[5.0, 0.0, 0.0, 2.0]])
    eps = 0.01 * (16 + 1 + 0) / 3
    rel_mse = (1 / (16 + eps) + 1 / (1 + eps) + 0) / 3
    assert relative_errors(r, x) == pytest.approx((rel_mse, (2 / 9 + 2 + 0) / 3))
    assert relative_errors(7 * r, 7 * x) == pytest.approx(relative_errors(r, x))
    assert relative_errors(0 * r, 0 * r) == (0, 0)
    assert np.isnan(relative_errors(r * np.nan, x)).all()


def test_three_films_have_one_clock():
    a = film("a", 1, 0.5, 8, "radiance per bin")
    b = film("b", 2, 0.125, 40, "radiance per meter")
    c = film("c", 1.5, 0.25, 12, "radiance per bin")
    films = PictureSet(a, b, c)
    assert (films.clock.start, films.clock.width, films.clock.count) == (2, 0.125, 20)
    assert films.quantity == "radiance per meter"
    frames = films.frames(7)
    assert len(frames) == 3
    for frame, width in zip(frames, (0.5, 0.125, 0.25), strict=True):
        assert frame == pytest.approx(1 + 2 + 0.125 * 7.5, abs=width / 2)
    late = film("late", 4.6, 0.5, 8, "radiance per bin")
    refused("late: bins from 4.6 to 8.6 m; must overlap with 2 to 4.5 m", PictureSet, b, c, late)


def test_what_cannot_be_compared(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "vaech", "--no-browser"]) == 2
    assert "did you mean 'veach'?" in capsys.readouterr().err
    assert main(["compare", "a.exr", "b.exr", "--no-browser"]) == 2
    assert capsys.readouterr().err.startswith("error: picture = 'a.exr': must be a file")


def values(there) -> list[float]:
    """Of A, B and B - A in the first channel of the chosen pixel."""
    cells = there.locator("tbody tr").first.locator("td").all_inner_texts()
    plain = str.maketrans("−⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "--0123456789")
    return [float(each.translate(plain).replace("·10", "e")) for each in cells[1:]]


def test_techniques_of_the_course():
    with browser.page_of("compare", "sphere_light_medium", dark=True) as there:
        there.get_by_text("RMS from the reference").first.wait_for()
        said = there.locator("dl").inner_text()
        for way in ("mats", "mis"):
            assert f"{100 * off('sphere_light_medium', way, 16):.3g} %" in said
        box = there.locator(".frame").bounding_box()
        before = browser.shades(there)
        y, half, tenth = box["y"] + 50, *(box["x"] + part * box["width"] for part in (0.5, 0.1))
        browser.drag(there, (half, y), (tenth, y))
        there.wait_for_selector('[data-divider^="0.1"]')
        assert not np.array_equal(browser.shades(there), before)
        slider = there.get_by_label("Divider", exact=True).last
        slider.focus()
        slider.press("End")
        there.wait_for_selector('[data-divider="1"]')
        there.get_by_label("A", exact=True).last.select_option(label="nee: light sampling")
        there.get_by_text("A: nee, 16 samples").first.wait_for()
        there.get_by_label("Scene").select_option("bust_ao")
        there.get_by_text("B: reference, 1024 samples").first.wait_for()


@pytest.fixture(scope="module")
def films(tmp_path_factory):
    """Two films on disk, the second of which starts five bins later."""
    folder = tmp_path_factory.mktemp("films")
    one = make_dataset(30, 40, 25)
    other = one.isel(opl=slice(5, None)).copy(deep=True)
    other["transient"] *= 1.5
    other.attrs["start_opl"] += 5 * one.attrs["bin_width_opl"]
    return one, [io.save_npz(each, folder / f"{k}.npz") for k, each in enumerate((one, other))]


@pytest.mark.parametrize("size", SIZES)
def test_films_with_one_clock(films, size):
    one, paths = films
    with browser.page_of("compare", *paths, size=size, dark=size[0] == 390) as there:
        time = there.get_by_label("Time", exact=True)
        there.wait_for_selector("canvas[data-view=divider]")
        assert there.evaluate("document.documentElement.scrollWidth <= innerWidth")
        time.focus()
        frame = there.locator(".frame")
        for key, step in (("Home", 0), ("ArrowRight", 1), ("End", 19)):
            time.press(key)
            box = frame.bounding_box()
            x, y = box["x"] + 20.5 / 40 * box["width"], box["y"] + 7.5 / 30 * box["height"]
            there.mouse.click(x, y)
            expected = float(one.transient[7, 20, 5 + step, 0])
            wait_for(lambda it=expected: values(there)[0] == pytest.approx(it, rel=1e-6))
            a, b, difference = values(there)
            assert b == pytest.approx(1.5 * expected, rel=1e-6)
            assert difference == pytest.approx(b - a, rel=1e-5)
        frame.focus()
        for key, view in (("f", "a"), ("f", "b"), (" ", "a"), ("d", "difference")):
            there.keyboard.press(key)
            there.wait_for_selector(f"canvas[data-view={view}]")
        ends = there.locator(".bar span").all_inner_texts()
        assert ends[0] == f"−{ends[-1]}"
        there.keyboard.press("+")
        there.wait_for_selector('canvas[data-scale="2"]')
        there.mouse.move(box["x"] + 100, box["y"] + 60)
        there.mouse.wheel(0, -300)
        there.wait_for_selector('canvas[data-scale="4"]')
        there.get_by_role("button", name="Whole picture").click()
        there.wait_for_selector('canvas[data-scale="1"]')
        there.get_by_label("All time").check()
        there.get_by_text("0, 0 % of A's mean").wait_for()


def test_three_films_are_chosen_by_lists_and_keys_work_at_once(films, tmp_path):
    one, paths = films
    third = one.copy(deep=True)
    third["transient"] *= 3
    third["steady"] *= 3
    path = io.save_npz(third, tmp_path / "third.npz")
    with browser.page_of("compare", *paths, path) as there:
        there.wait_for_selector("canvas[data-view=divider]")

        # Nothing has the focus yet
        there.keyboard.press("d")
        there.wait_for_selector("canvas[data-view=difference]")
        there.keyboard.press("r")
        there.wait_for_selector("canvas[data-view=relative]")
        assert there.locator(".bar span").all_inner_texts() == ["−2", "−1", "0", "1", "2"]

        # The third film is three times the first film, so 2 (3 - 1) / (3 + 1) = 1 everywhere
        there.get_by_label("All time").check()
        there.get_by_text("third.npz against A").wait_for()
        there.get_by_label("B", exact=True).last.select_option(label="third.npz")
        there.get_by_text("B: third.npz").first.wait_for()
        said = there.locator("dl").inner_text()
        assert f"SMAPE {relative_errors(one.steady.values, third.steady.values)[1]:.3g}" in said
        assert there.errors == []


def test_two_fingers_enlarge_what_is_between_them(films):
    with browser.page_of("compare", *films[1], size=SIZES[2]) as there:
        there.wait_for_selector("canvas[data-view=divider]")
        touches = there.context.new_cdp_session(there)
        box = there.locator(".frame").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

        def fingers(kind: str, *apart: float) -> None:
            points = [{"x": x + each, "y": y, "id": k} for k, each in enumerate(apart)]
            touches.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        fingers("touchStart", -20, 20)
        for half in (30, 40, 60, 80):
            fingers("touchMove", -half, half)
        fingers("touchEnd")
        scale = float(there.locator(".frame canvas").get_attribute("data-scale"))
        assert scale == pytest.approx(4, rel=0.3)


def test_each_technique_is_rendered_by_its_tracer(monkeypatch):
    kinds = []

    def load(description):
        kinds.append(description["integrator"]["type"])
        raise InterruptedError

    monkeypatch.setattr(course_pictures.mi, "load_dict", load)
    for scene in ("veach", "cornell_box_steady_state"):
        for way in course_pictures.TECHNIQUES:
            with pytest.raises(InterruptedError):
                course_pictures._render(scene, way, 1, 0)
    plugins = [plugin for plugin, _ in course_pictures.TECHNIQUES.values()]
    assert kinds == 2 * plugins
