"""Viewer, warp tester and comparison: one family for everyone, at all sizes, light and dark."""

import json

import pytest
from helpers import browser
from helpers.accessible import hindrances
from helpers.explorer_page import moving
from helpers.jupyterlab import lab, wait_for_kernel
from helpers.looks import SHARE, SIZE, differ, look
from helpers.served import served

from tofrender import io
from tofrender.course import notebooks

QUIET = {"fetchNews": "false", "checkForUpdates": False}
SIZES = ((1400, 900), (800, 600), (390, 844))
READY = {
    "warptest": "canvas[data-count]",
    "compare": "canvas[data-view]",
    "view": ".tof-explorer canvas.plot",
}


@pytest.fixture(scope="module")
def arguments(tmp_path_factory):
    """Of each command."""
    data = moving()
    darker = data.assign(transient=0.7 * data["transient"], steady=0.7 * data["steady"])
    folder = tmp_path_factory.mktemp("films")
    files = [io.save_npz(each, folder / f"{k}.npz") for k, each in enumerate((data, darker))]
    return {"warptest": ["tent"], "compare": files, "view": files[:1]}


@pytest.mark.parametrize("name", READY)
def test_pages_hinder_nobody_and_look_as_they_did(arguments, name):
    with served(name, *arguments[name], "--no-browser") as command:
        for dark in (False, True):
            for width, height in (*SIZES, SIZE):
                viewport = {"width": width, "height": height}
                with browser.page(dark=dark, viewport=viewport) as page:
                    page.goto(command.url)
                    page.wait_for_selector(READY[name])
                    page.wait_for_timeout(300)
                    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
                    if (width, height) == SIZE:
                        kept = f"{name}_{'dark' if dark else 'light'}"
                        assert differ(kept, look(page)) < SHARE
                        page.locator("canvas").first.evaluate("each => each.style.opacity = 0")
                        assert differ(kept, look(page)) > SHARE
                    else:
                        assert hindrances(page) == []
                    assert page.errors == []
        assert command.stop() == 0


def test_the_warp_tester_in_jupyterlab(tmp_path):
    cell = "# %%\nimport tofrender\ntofrender.warptest('beckmann', alpha=0.5)\n"
    notebooks.write(cell, tmp_path, tmp_path / "look.ipynb")
    settings = tmp_path / "CONFIG/lab/user-settings/@jupyterlab/apputils-extension"
    settings.mkdir(parents=True)
    for name, own in (("themes", {"theme": "JupyterLab Dark"}), ("notification", QUIET)):
        (settings / f"{name}.jupyterlab-settings").write_text(json.dumps(own))
    with lab(tmp_path) as (address, token), browser.page() as page:
        page.goto(f"{address}/lab/tree/look.ipynb?token={token}")
        page.wait_for_selector(".jp-Notebook .jp-Cell")
        wait_for_kernel(page)
        page.evaluate("jupyterapp.commands.execute('notebook:run-all-cells')")
        page.wait_for_selector('.tof-warptest.dark canvas[data-count="1024"]')
        page.get_by_role("button", name="Run the χ² test").click()
        page.get_by_text("beckmann (alpha = 0.5): passed").wait_for()
