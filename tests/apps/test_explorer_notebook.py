"""The widget in a real JupyterLab: a cell makes it, the page shows it, a click changes it."""

import json
import os
import secrets
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from helpers import browser
from helpers.made_dataset import make_dataset
from helpers.processes import ROOT, wait_for
from helpers.served import is_free
from test_explorer_page import BYTES, HEIGHT, WIDE, place

import tofrender
from tofrender.course import notebooks

CELL = """# %%
import tofrender
tofrender.explore(tofrender.load_npz("data.npz"), title="In a notebook")
"""
# What ipywidgets says of a bar that is closed before the page has drawn it, on a busy machine
OF_A_CLOSED_BAR = ("Could not add child view to box", "processLuminoMessage", "reading 'widgets'")
FIND = "[...document.querySelectorAll('*')].find((each) => each.explorer).explorer"


@contextmanager
def lab(folder: Path):
    """The address of a JupyterLab of this folder; it ends with the block, and its port is free."""
    pytest.importorskip("jupyterlab")
    log, token = folder / "lab.log", secrets.token_hex(16)
    own = {f"JUPYTER_{name}_DIR": str(folder / name) for name in ("CONFIG", "DATA", "RUNTIME")}
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    options = ["--ServerApp.port=0", f"--IdentityProvider.token={token}"]
    options += ["--ServerApp.ip=127.0.0.1"]
    options += [f"--ServerApp.root_dir={folder}", "--expose-app-in-browser"]
    with log.open("wb") as opened:
        server = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", *options],
            cwd=folder,
            env=os.environ | own | {"PYTHONPATH": paths, "HOME": str(folder)},
            stdout=subprocess.DEVNULL,
            stderr=opened,
            start_new_session=True,
        )
    told = folder / "RUNTIME" / f"jpserver-{server.pid}.json"

    def is_up() -> bool:
        assert server.poll() is None, log.read_text()
        return told.exists() and told.read_text().endswith("}")

    try:
        wait_for(is_up)
        port = json.loads(told.read_text())["port"]
        yield f"http://127.0.0.1:{port}", token
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait()
    wait_for(lambda: is_free(port))


def wait_for_kernel(page) -> None:
    """Until it has been idle for two seconds: it is so for a moment before it connects."""
    told = "document.querySelector('.jp-Notebook-ExecutionIndicator')?.dataset.status"
    idle = 0
    while idle < 20:
        page.wait_for_timeout(100)
        idle = idle + 1 if page.evaluate(f"window.jupyterapp && {told}") == "idle" else 0


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
