"""The gallery of scenes: the script makes pictures, and its page shows all there is."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.scenes import refusal
from PIL import Image

from scenes import gallery
from tofrender.scenes import BUILT_IN

PAGE = (Path(gallery.__file__).parent / "README.md").read_text(encoding="utf-8")
PLANS = {plan.scene for rows in gallery.PLANS.values() for row in rows for plan in row}
SHOWN = {panel.scene for panels in gallery.PICTURES.values() for panel in panels} | PLANS
SAME_PICTURE = {"cornell_box_steady_state": "cornell_box"}  # Scenes that look as another one does
ONLY_IN_TIME = {
    name
    for name, builder in BUILT_IN.items()
    if builder.__module__.rpartition(".")[2] in ("nlos", "confocal")
}
"""Scenes whose steady picture shows nothing of what is hidden."""


def test_every_scene_has_a_line_and_a_picture():
    listed = re.findall(r"^\| `(\w+)` \|", PAGE, flags=re.MULTILINE)
    assert sorted(listed) == sorted(BUILT_IN)
    assert set(SAME_PICTURE.values()) <= SHOWN
    needed = BUILT_IN.keys() - SAME_PICTURE.keys()
    assert needed <= SHOWN, f"not in gallery.PICTURES or PLANS: {needed - SHOWN}"
    assert PLANS == ONLY_IN_TIME


def test_the_page_shows_the_pictures_that_there_are():
    on_page = re.findall(r"\(pictures/(\w+)\.png\)", PAGE)
    kept = [path.stem for path in gallery.FOLDER.glob("*.png")]
    assert sorted(on_page) == sorted(kept) == sorted([*gallery.PICTURES, *gallery.PLANS])
    sizes = {path.name: path.stat().st_size for path in gallery.FOLDER.iterdir()}
    assert sum(sizes.values()) < 2.4e6, sizes


@pytest.mark.parametrize("name", gallery.PICTURES)
def test_pictures_are_made(name, tmp_path, monkeypatch):
    panels = tuple(replace(panel, spp=2) for panel in gallery.PICTURES[name])
    with Image.open(gallery.FOLDER / f"{name}.png") as kept:
        assert kept.width == len(panels) * (gallery.PANEL_WIDTH + 2) - 2
    monkeypatch.setitem(gallery.PICTURES, name, panels)
    (path,) = gallery.write(tmp_path / "new", [name], width=32)
    assert path == tmp_path / "new" / f"{name}.png"
    image = np.asarray(Image.open(path))
    assert image.shape[1:] == (34 * len(panels) - 2, 3)
    for k, panel in enumerate(panels):
        part = image[:, 34 * k : 34 * k + 32]
        assert part.shape[0] > 16
        assert 10 < part.mean() < 250, panel  # neither black nor white
        assert part.std() > 5, panel
    again = gallery.picture(panels, width=32).astype(int)
    assert np.abs(again - image).max() <= 1  # the same but for the rounding of sums


@pytest.mark.parametrize("name", gallery.PLANS)
def test_plans_are_drawn(name, tmp_path, monkeypatch):
    """A row of them; the file that is kept has a place for each."""
    rows = gallery.PLANS[name]
    assert len({len(row) for row in rows}) == 1
    monkeypatch.setitem(gallery.PLANS, name, rows[:1])
    (path,) = gallery.write(tmp_path, [name])
    image = np.asarray(Image.open(path).convert("RGB")).astype(float)
    width, height = (round(inches * gallery.PLAN_DPI) for inches in gallery.PLAN_SIZE)
    assert image.shape == (height, len(rows[0]) * width, 3)
    for k in range(len(rows[0])):
        part = image[:, k * width : (k + 1) * width]
        assert (part.min(axis=-1) > 250).mean() > 0.5  # a drawing on white, in colors
        assert (np.ptp(part, axis=-1) > 40).mean() > 0.004
        # Nothing is cut off at the left and right, where the legend is widest
        assert (part[:, [0, 1, -2, -1]] > 250).all()
    with Image.open(gallery.FOLDER / f"{name}.png") as kept:
        assert kept.size == (len(rows[0]) * width, len(rows) * height)
        first = np.asarray(kept.convert("RGB")).astype(float)[:height]
    assert np.abs(first - image).mean() < 3  # up to fonts and colors left


def test_labels_are_legible():
    dark = np.zeros((64, 128, 3), np.uint8)
    found = gallery.labeled(dark, "nee")
    assert found.shape == dark.shape
    assert (found[-22:, :40] > 200).any()
    assert not found[:-22].any()
    bright = gallery.labeled(dark + np.uint8(255), "nee")
    assert (bright[-22:, :40] < 50).mean() > 0.3
    assert gallery.labeled(dark, "") is dark


def test_other_names_are_one_line(tmp_path, monkeypatch, capsys):
    said = refusal(gallery.write, tmp_path / "new", ["veech"])
    assert said.startswith("NAME = 'veech': did you mean 'veach'?")
    assert not (tmp_path / "new").exists()
    monkeypatch.setattr("sys.argv", ["gallery", "veech"])
    with pytest.raises(SystemExit) as stop:
        gallery.main()
    assert stop.value.code == 2
    assert "did you mean 'veach'?" in capsys.readouterr().err.splitlines()[-1]
