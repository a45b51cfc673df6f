"""Explorers in a browser: open a page, read and set its state."""

from contextlib import contextmanager

import numpy as np
import xarray as xr

from helpers import browser
from helpers.made_dataset import make_dataset
from tofrender.apps.explorer.single_page import page_of
from tofrender.rendering.dataset import in_components

HEIGHT, WIDE, BINS = 24, 32, 60

STATE = "document.getElementById('explorer').explorer.state()"

BYTES = """() => {
  const canvas = document.querySelector(".tof-picture");
  const { width, height } = canvas;
  const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
  return { width, height, bytes: [...data] };
}"""


def moving():
    data = make_dataset(HEIGHT, WIDE, BINS)
    light = data["transient"].values
    x, bins = np.arange(WIDE)[None, :, None], np.arange(BINS)
    front = np.exp(-(((bins - 10 - 1.2 * x) / 3.0) ** 2))
    rows = 1 + np.arange(HEIGHT)[:, None, None] / HEIGHT
    light[:] = 0.02 * light + (0.1 * front * rows)[..., None] * [1.0, 0.6, 0.3]
    data["steady"].values[:] = light.sum(axis=2)
    return data


@contextmanager
def opened(folder, contents, fragment="", **options):
    """A page that shows these contents; at its end, nothing must have gone wrong."""
    path = folder / "report.html"
    path.write_text(page_of(contents), encoding="utf-8")
    with browser.page(offline=True, **options) as page:
        page.goto(path.as_uri() + fragment)
        page.wait_for_selector(".tof-explorer canvas.plot")
        settle(page)
        yield page
        assert page.errors == []
        assert browser.elsewhere(page, "file:") == []


def settle(page) -> None:
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 30)))")


def state(page):
    settle(page)
    return page.evaluate(STATE)


def set_(page, **changes):
    page.evaluate("changes => document.getElementById('explorer').explorer.set(changes)", changes)
    return state(page)


def place(page, x, y):
    """Where the middle of a pixel is."""
    frame = page.locator(".frame").bounding_box()
    size = frame["width"] / WIDE, frame["height"] / HEIGHT
    return frame["x"] + (x + 0.5) * size[0], frame["y"] + (y + 0.5) * size[1]


def picture(page):
    found = page.evaluate(BYTES)
    return np.array(found["bytes"]).reshape(found["height"], found["width"], 4)[..., :3]


def values_of(contents, name="light"):
    """(y, x, bins, channels), as the page has them."""
    return contents.layer(contents.header[name])[0].transpose(2, 3, 0, 1)


def polarized() -> xr.Dataset:
    """Light whose angle grows to the right and whose degree grows downwards."""
    data = moving()
    light = data["transient"].values.mean(axis=3)
    angle = np.linspace(0, 3, WIDE)[:, None]
    degree = np.linspace(0.2, 1, HEIGHT)[:, None, None]
    parts = [1 + 0 * angle, degree * np.cos(2 * angle), degree * np.sin(2 * angle), -0.1 * angle]
    stokes = np.stack([light * part for part in parts], axis=-1).astype(np.float32)
    flat = make_dataset(HEIGHT, WIDE, BINS, channels=[f"S{k}.L" for k in range(4)])
    flat["transient"].values[:] = stokes
    flat["steady"].values[:] = stokes.sum(axis=2)
    return in_components(flat)


def fragment(page) -> str:
    page.wait_for_timeout(700)  # The address follows after half a second
    return page.evaluate("location.hash")


def saved(page, kind: str, folder):
    with page.expect_download() as download:
        page.get_by_role("button", name=kind).click()
    path = folder / download.value.suggested_filename
    download.value.save_as(path)
    return path
