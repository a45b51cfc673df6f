"""The widget in a real JupyterLab: a cell makes it, the page shows it, a click changes it."""

import json
import os

import numpy as np
import pytest
from helpers import browser
from helpers.explorer_page import BYTES, HEIGHT, WIDE, place
from helpers.jupyterlab import lab, wait_for_kernel
from helpers.made_dataset import make_dataset

import tofrender
from tofrender.course import notebooks

CELL = """# %%
import tofrender
tofrender.explore(tofrender.load_npz("data.npz"), title="In a notebook")
"""
# What ipywidgets says of a bar that is closed before the page has drawn it, on a busy machine
OF_A_CLOSED_BAR = ("Could not add child view to box", "processLuminoMessage", "reading 'widgets'")
FIND = "[...document.querySelectorAll('*')].find((each) => each.explorer).explorer"


@pytest.mark.parametrize("dark", [False, True])
def test_the_widget_in_jupyterlab(tmp_path, dark):
    data = make_dataset(HEIGHT, WIDE, 40)
    tofrender.save_npz(data, tmp_path / "data.npz")
    notebooks.write(CELL, tmp_path, tmp_path / "look.ipynb")
    settings = tmp_path / "CONFIG/lab/user-settings/@jupyterlab/apputils-extension"
    settings.mkdir(parents=True)
    theme = {"theme": "JupyterLab Dark" if dark else "JupyterLab Light"}
    quiet = {"fetchNews": "false", "checkForUpdates": False}
    for name, own in (("themes", theme), ("notification", quiet)):
        (settings / f"{name}.jupyterlab-settings").write_text(json.dumps(own))
    size = {"width": 1400, "height": 1100}
    with lab(tmp_path) as (address, token), browser.page(viewport=size) as page:
        page.goto(f"{address}/lab/tree/look.ipynb?token={token}")
        page.wait_for_selector(".jp-Notebook .jp-Cell")
        wait_for_kernel(page)
        page.errors.clear()
        page.evaluate("jupyterapp.commands.execute('notebook:run-all-cells')")
        page.wait_for_selector(".tof-explorer canvas.tof-picture")
        assert page.locator(".tof-explorer h2").inner_text() == "In a notebook"
        assert page.locator(".tof-explorer.dark").count() == dark
        page.locator(".tof-explorer canvas.tof-picture").scroll_into_view_if_needed()
        page.evaluate(f"{FIND}.set({{pixels: []}})")
        x, y = 7, 11
        page.mouse.click(*place(page, x, y))
        page.keyboard.press("Escape")
        page.wait_for_function(f"{FIND}.state().curves.length")
        state = page.evaluate(f"{FIND}.state()")
        (curve,) = state["curves"]
        assert (curve["x"], curve["y"]) == (x, y)
        given = tofrender.vis.luminance(data["transient"].values[y, x])
        np.testing.assert_allclose(curve["values"], given, rtol=0.05, atol=1e-5)
        assert max(page.evaluate(BYTES)["bytes"][::4]) == 255
        before = state["bin"]
        page.locator(".tof-explorer").get_by_label("Time", exact=True).focus()
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"{FIND}.state().bin === {before + 1}")
        if folder := os.environ.get("TOFRENDER_SCREENSHOTS"):
            page.screenshot(path=f"{folder}/lab_{'dark' if dark else 'light'}.png")
        closed = OF_A_CLOSED_BAR
        assert [each for each in page.errors if not any(part in each for part in closed)] == []
