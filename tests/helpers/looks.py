"""Screenshots of pages, compared with stored ones."""

import io
from pathlib import Path

import numpy as np
from PIL import Image

LOOKS = Path(__file__).parents[1] / "apps" / "looks"

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
    assert kept.is_file(), "look at the page, and store its picture there"
    before = np.asarray(Image.open(kept)) / 255
    return float((np.abs(seen - before).max(axis=2) > MOST).mean())
