"""The warp tester as its readers see it, in a browser."""

import mitsuba as mi
import numpy as np
import pytest
from helpers import browser
from helpers.processes import wait_for
from helpers.student_warps import write_warps
from PIL import Image

from tofrender.apps.warptest.engine import draw
from tofrender.apps.warptest.subjects import SUBJECTS
from tofrender.sampling import independent, warp_case

TEST = "Run the χ² test"
FITS = "document.documentElement.scroll{0} <= inner{0}"


def drawn(there, count=1024, **more):
    wanted = "".join(f'[data-{key}="{value}"]' for key, value in more.items())
    there.wait_for_selector(f'canvas[data-count="{count}"]{wanted}')
    return there.locator("canvas").first


def choose(there, label: str, option: str) -> None:
    there.get_by_label(label, exact=True).select_option(label=option)


def verdict_of(there) -> str:
    there.get_by_role("button", name=TEST).click()
    there.wait_for_selector(".message >> text=p-value")
    return there.locator(".message:is(.good, .bad)").last.inner_text()


def first_point(there) -> list[float]:
    return [float(x) for x in there.locator("canvas").first.get_attribute("data-first").split()]


def test_choose_a_warp_change_the_points_and_test(tmp_path):
    with browser.page_of("warptest", "tent") as there:
        drawn(there, view="2D")
        choose(there, "Distribution", "Beckmann")
        canvas = drawn(there, view="3D")
        roughness = there.get_by_label("Roughness α", exact=True)
        roughness.fill("0.7")
        roughness.press("Enter")
        choose(there, "Point set", "sobol")
        slider = there.get_by_label("Points", exact=True)
        slider.focus()
        slider.press("ArrowRight")
        drawn(there, 2048, view="3D")

        expected = draw(warp_case("beckmann", alpha=0.7), "sobol", 2048, 0).points[:, 0]
        assert first_point(there) == pytest.approx(expected.tolist(), abs=1e-4)
        said = verdict_of(there)
        verdict = warp_case("beckmann", alpha=0.7).test()
        assert "beckmann (alpha = 0.7): passed" in said
        assert f"{verdict.p_value:.3g} (must be {verdict.alpha:.2g} or more)" in said
        assert f"{verdict.chi2:.1f} with {verdict.degrees_of_freedom} degrees of freedom" in said
        assert there.get_by_text("Passing is no proof").is_visible()
        assert there.evaluate(FITS.format("Width"))
        assert there.locator('svg[role="img"]').count() == 1
        with there.expect_download() as saved:
            there.get_by_text("Save the figure").click()
        saved.value.save_as(tmp_path / "a.png")
        assert np.array(Image.open(tmp_path / "a.png")).std() > 10

        before = canvas.screenshot()
        box = canvas.bounding_box()
        x, y = box["x"], box["y"] + 150
        browser.drag(there, (x + 150, y), (x + 250, y))
        wait_for(lambda: canvas.screenshot() != before)
        there.get_by_role("radio", name="2D").click()
        drawn(there, 2048, view="2D")
        there.get_by_role("checkbox", name="grid").uncheck()
        drawn(there, 2048, grid="0")
        slider.press("ArrowLeft")  # Verdicts go when what they speak of does
        there.wait_for_selector("text=Not tested yet")
        there.wait_for_selector('svg[role="img"]', state="detached")


def test_every_subject_is_drawn():
    with browser.page_of("warptest", "no_op") as there:
        drawn(there)
        for subject in SUBJECTS.values():
            choose(there, "Distribution", subject.title)
            there.wait_for_selector(f".heading h2:text-is('{subject.title}')")
            drawn(there, view="3D" if subject.dimensions == 3 else "2D")
        said = verdict_of(there)
        assert "two_lights (distance = 1): passed" in said


def test_an_image_of_the_readers(tmp_path):
    rng = np.random.default_rng(1)
    sky = rng.lognormal(0, 1, (512, 512)).astype(np.float32)
    mi.Bitmap(sky).write(str(tmp_path / "sky.exr"))
    (tmp_path / "cut.exr").write_bytes((tmp_path / "sky.exr").read_bytes()[:5000])
    with browser.page_of("warptest", "hierarchical") as there:
        drawn(there)
        first = first_point(there)
        there.locator('input[type="file"]').set_input_files(str(tmp_path / "sky.exr"))
        first_of_canvas = browser.found("each.tagName === 'CANVAS'", "each.dataset.first")
        before = there.locator("canvas").first.get_attribute("data-first")
        there.wait_for_function(f"() => {first_of_canvas} !== '{before}'")
        samples = warp_case("hierarchical", image=sky).sample(independent(1024, 0))
        expected = np.array(samples)[:, 0]
        assert first_point(there) == pytest.approx(expected.tolist(), abs=1e-4)
        assert "hierarchical: passed" in verdict_of(there)
        there.locator('input[type="file"]').set_input_files(str(tmp_path / "cut.exr"))
        there.wait_for_selector("text=cut.exr cannot be used")
        there.get_by_role("button", name="2 × 2 example").click()
        there.wait_for_selector("text=Not tested yet")
        wait_for(lambda: first_point(there) == pytest.approx(first))


def test_a_students_module(tmp_path):
    folder = write_warps(tmp_path / "mine")
    size = (820, 1180)
    with browser.page_of("warptest", "tent", "--module", folder, size=size, dark=True) as there:
        drawn(there)
        assert "tent of tent.py: passed" in verdict_of(there)
        assert there.evaluate(FITS.format("Width"))
        choose(there, "Distribution", "Cosine hemisphere")
        drawn(there, view="3D")
        said = verdict_of(there)
        assert "cosine_hemisphere of cosine.py: FAILED" in said
        assert "counts do not follow the pdf" in said
        assert there.locator(".message.bad").count() == 1

        choose(there, "Distribution", "Uniform disk")
        there.wait_for_selector("text=RuntimeError: <b>no</b> & never")
        assert (
            "disk.py, line 6: raise RuntimeError"
            in there.locator(".message.bad").first.inner_text()
        )
        assert there.locator(".message b").count() == 0
        drawn(there, 0)
        choose(there, "Distribution", "Uniform sphere")
        there.wait_for_selector("text=not written yet")
        assert there.get_by_text("sphere.py, line 1: def square_to_uniform_sphere").is_visible()
        there.get_by_role("button", name=TEST).click()
        there.wait_for_selector("text=the test could not be run")

        text = (folder / "disk.py").read_text()
        line = 'raise RuntimeError("<b>no</b> & never")'
        right = "import mitsuba as mi\n    return mi.warp.square_to_uniform_disk(sample)"
        choose(there, "Distribution", "Uniform disk")
        there.wait_for_selector("text=RuntimeError: <b>no</b> & never")
        drawn(there, 0)
        (folder / "disk.py").write_text(text.replace(line, right))
        drawn(there, 1024)  # The file is looked at again by itself
        there.wait_for_selector("text=The file has changed")
        choose(there, "Whose", "This package")
        drawn(there, 1024)
        assert "uniform_disk: passed" in verdict_of(there)
