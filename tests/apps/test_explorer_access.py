"""The report for everyone: names, headings and contrast by axe-core, targets, what is in sight."""

import pytest
from helpers.accessible import hindrances
from helpers.explorer_page import moving, opened, polarized, set_

from tofrender.apps.explorer.page_contents import contents_of

SIZES = [(1400, 900), (800, 600), (390, 844)]


@pytest.mark.parametrize(("width", "height"), SIZES)
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_hinders_readers(tmp_path, dark, width, height):
    viewport = {"width": width, "height": height}
    with opened(tmp_path, contents_of(polarized()), dark=dark, viewport=viewport) as page:
        for view in ("light", "gate", "peak", "phasor"):
            set_(page, view=view, stokes="S1" if view == "gate" else "S0")
            assert hindrances(page) == []
        page.locator("summary").click()
        assert hindrances(page) == []
        page.evaluate("document.querySelector('input').removeAttribute('aria-label')")
        page.evaluate("document.querySelector('.slider > span').remove()")
        page.evaluate("document.querySelector('h1').remove()")
        assert len(hindrances(page)) == 2


def test_targets_are_large_enough(tmp_path):
    with opened(tmp_path, contents_of(moving())) as page:
        for view in ("light", "gate"):
            set_(page, view=view)
            targets = "button:visible, select:visible, label.tick:visible, summary, input:visible"
            for target in page.locator(targets).all():
                size = target.bounding_box()
                is_tick = target.evaluate("each => each.matches('.tick input')")  # Its label counts
                assert is_tick or min(size["width"], size["height"]) >= 24, target.inner_text()


def test_play_and_curves_are_in_sight(tmp_path):
    """At 800 x 600, without scrolling; a wide picture and a tall one are not stretched."""
    viewport = {"width": 800, "height": 600}
    whole = moving()
    for data in (whole, whole.isel(x=slice(0, 8)), whole.isel(y=slice(0, 6)), polarized()):
        with opened(tmp_path, contents_of(data), viewport=viewport) as page:
            set_(page, stokes="angle" if "stokes" in data.dims else "S0")
            for name in (".play", "canvas.plot", ".frame"):
                box = page.locator(name).bounding_box()
                assert box["y"] + box["height"] <= 600
            aspect = data.sizes["x"] / data.sizes["y"]
            assert box["width"] / box["height"] == pytest.approx(aspect, rel=0.02)
