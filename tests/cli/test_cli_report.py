"""`tofrender report`: a page of whatever the other commands have written."""

import functools
import json
import re

import numpy as np
import pytest
from helpers.hidden_scenes import Wall, capture_of, rectangle
from helpers.made_dataset import make_dataset
from test_cli import refused

import tofrender
from tofrender.cli.app import main


def header_of(page) -> dict:
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'id="header">(.*?)</script>', text, re.DOTALL)[1])


def made(folder, kind):
    """Something to show, and what the page calls it."""
    data = make_dataset(4, 6, 8, energy_outside_window=0.0)
    patch = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
    stack = functools.partial(tofrender.save_exr_stack, progress=False)
    writers = {
        "frames": ("box", stack),
        "parts": ("a.exr", functools.partial(stack, layout="multipart")),
        "npz": ("a.npz", tofrender.save_npz),
        "zarr": ("a.zarr", tofrender.save_zarr),
    }
    if kind in writers:
        name, write = writers[kind]
        write(data, folder / name)
        return folder / name, "transient"
    capture = capture_of(patch, Wall(4), bins=24, width=0.05)
    path = tofrender.save_capture(capture, folder / "wall.h5")
    if kind == "capture":
        return path, "capture"
    arguments = ["reconstruct", str(path), "--method", "bp", "--out", str(folder / "volume")]
    assert main(arguments) == 0
    return folder / "volume" / ("volume.npz" if kind == "file" else ""), "volume"


@pytest.mark.parametrize("kind", ["frames", "parts", "npz", "zarr", "capture", "volume", "file"])
def test_all_that_commands_write(tmp_path, capsys, kind):
    source, shown = made(tmp_path, kind)
    capsys.readouterr()
    page = tmp_path / "report.html"
    for _ in range(2):  # The second time, it replaces its own page
        assert main(["report", str(source), "-o", str(page), "--title", "My <title>"]) == 0
        said = capsys.readouterr()
        assert said.out == f"{page}: 0.1 MB\n"
        assert said.err == ""
    header = header_of(page)
    assert header["kind"] == shown
    assert header["title"] == "My <title>"


def test_a_volume_with_its_capture(tmp_path):
    source, _ = made(tmp_path, "volume")
    page = tmp_path / "report.html"
    capture = str(tmp_path / "wall.h5")
    assert main(["report", str(source), "--capture", capture, "-o", str(page)]) == 0
    header = header_of(page)
    assert "wall" in header["parts"]
    assert header["volume"]["kind"] == "volume"


def test_a_report_may_lie_with_its_render(tmp_path):
    folder, _ = made(tmp_path, "frames")
    assert main(["report", str(folder), "-o", str(folder / "report.html")]) == 0
    tofrender.save_exr_stack(make_dataset(4, 6, 8), folder, overwrite=True, progress=False)


@pytest.mark.parametrize("kind", ["npz", "frames", "capture", "volume.npz", "other", "nothing"])
def test_what_cannot_be_read_is_one_line(tmp_path, capsys, kind):
    page = tmp_path / "report.html"
    if kind == "nothing":
        source = tmp_path / "nothing.npz"
    elif kind in ("other", "volume.npz"):
        source = tmp_path / ("a.txt" if kind == "other" else kind)
        source.write_text("text")
    else:
        source, _ = made(tmp_path, kind)
        cut = source if source.is_file() else source / "frame_0003.exr"
        content = cut.read_bytes()
        cut.write_bytes(content[: len(content) // 2])
    capsys.readouterr()
    assert "must" in refused(capsys, "report", source, "-o", page)
    assert not page.exists()
    assert not list(tmp_path.glob(".tofrender-*"))


def test_not_finite_values_of_a_volume_are_refused(tmp_path, capsys):
    axes = {axis: np.arange(1.0, 3.0) for axis in "xyz"}
    np.savez(tmp_path / "volume.npz", intensity=np.full((2, 2, 2), np.nan), **axes)
    assert "must all be" in refused(capsys, "report", tmp_path, "-o", tmp_path / "a.html")
