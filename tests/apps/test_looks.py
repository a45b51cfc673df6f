"""Pages look as they did when somebody last looked at them: small pictures, kept here.

They are compared at an eightieth of the page's size, so that another font does not matter, and a
part that is missing, moved or of another colour does. After a change that is wanted, look at the
pages, remove the pictures and run this file once.
"""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_explorer_page import contents_of, moving, opened as report

LOOKS = Path(__file__).with_name("looks")
SIZE, SMALL = (1280, 800), (64, 40)
MOST, SHARE = 0.09, 0.02
"""Of white: what a cell may differ by, and the part of cells that may differ by more."""


def look(page) -> np.ndarray:
    """The page as the reader sees it, made small; in [0, 1]."""
    whole = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    return np.asarray(whole.resize(SMALL, Image.Resampling.BOX)) / 255


def differ(name: str, seen: np.ndarray) -> float:
    """The part of cells in which a page is not as it was."""
    kept = LOOKS / f"{name}.png"
    if not kept.exists():
        Image.fromarray(np.rint(255 * seen).astype(np.uint8)).save(kept)
    before = np.asarray(Image.open(kept)) / 255
    return float((np.abs(seen - before).max(axis=2) > MOST).mean())


@pytest.mark.parametrize("dark", [False, True])
def test_the_report(tmp_path, dark):
    viewport = {"width": SIZE[0], "height": SIZE[1]}
    with report(tmp_path, contents_of(moving()), dark=dark, viewport=viewport) as page:
        name = f"report_{'dark' if dark else 'light'}"
        assert differ(name, look(page)) < SHARE
        page.evaluate("document.querySelector('canvas.plot').style.visibility = 'hidden'")
        page.evaluate("document.querySelector('.tof-picture').style.filter = 'invert(1)'")
        assert differ(name, look(page)) > SHARE
