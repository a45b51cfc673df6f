"""Places that cannot be written, found before any work: one clear line, and nothing is lost."""

import errno
import os
import shutil
import sys
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from helpers.bad_inputs import listing, one_clear_line
from helpers.hidden_scenes import small_capture as captured
from helpers.limits import lower
from helpers.made_dataset import make_dataset
from helpers.refusals import refused

import tofrender
from tofrender import io, report
from tofrender.cli.app import main

if sys.platform != "linux":
    pytest.skip("the places are Linux's", allow_module_level=True)


def picture():
    return make_dataset(2, 3, 3, energy_outside_window=0.0)


QUIET = {"progress": False}
CLOUD = xr.Dataset({name: ("point", np.zeros(9)) for name in "xyz"})
WRITERS = {
    "npz": (".npz", lambda path: io.save_npz(picture(), path)),
    "stack": ("", lambda path: io.save_exr_stack(picture(), path, **QUIET)),
    "parts": (".exr", lambda p: io.save_exr_stack(picture(), p, layout="multipart", **QUIET)),
    "png": ("", lambda path: io.save_png_frames(picture(), path, min_size=4, **QUIET)),
    "gif": (".gif", lambda path: io.save_video(picture(), path, min_size=4, **QUIET)),
    "mp4": (".mp4", lambda path: io.save_video(picture(), path, min_size=4, **QUIET)),
    "capture": (".h5", lambda path: io.save_capture(captured(), path)),
    "cloud": (".ply", lambda path: io.save_point_cloud(CLOUD, path)),
    "page": (".html", lambda path: report(picture(), path)),
    "layers": (".exr", lambda path: io.save_exr_layers(path, {"": np.ones((2, 3, 3))})),
}
SCENE = ["--size", "4x4", "--spp", "1"]
COMMANDS = {
    "render": ("", ["render", "cornell_box", *SCENE, "--bins", "4", "--bin-width", "4"]),
    "phasor": ("", ["phasor", "cornell_box", *SCENE, "--freq", "2e7"]),
    "phasor of a render": ("", ["phasor", "{render}", "--freq", "2e7"]),
    "gate": ("", ["gate", "cornell_box", *SCENE, "--at", "6"]),
    "doppler": ("", ["doppler", "cornell_box", *SCENE]),
    "fmcw": ("", ["fmcw", "cornell_box", *SCENE]),
    "capture": (".h5", ["capture", "nlos_plane", "--grid", "2x2", "--spp", "1"]),
    "lidar": (".ply", ["lidar", "cornell_box", "--shots", "2x2", "--spp", "1"]),
    "reconstruct": ("", ["reconstruct", "{capture}", "--method", "bp"]),
    "report": (".html", ["report", "{render}"]),
    "sense": ("", ["sense", "{render}", "--sensor", "itof"]),
    "twin": ("", ["twin", "recordings"]),
    "warp": (".png", ["warp", "tent", "--count", "4"]),
}
REPLACES = {"gif", "mp4", "layers", "lidar", "report", "warp"}
"""Those that replace a file without being told to."""


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """What the commands read."""
    folder = tmp_path_factory.mktemp("sources")
    io.save_exr_stack(picture(), folder / "render", **QUIET)
    io.save_capture(captured(), folder / "wall.h5")
    return {"{render}": str(folder / "render"), "{capture}": str(folder / "wall.h5")}


PLACES = {
    # what is wrong there: below a folder, or anywhere; {} is the suffix
    **{"in a file": "file/a{}", "deep in a file": "file/b/a{}", "in /proc": "/proc/a{}"},
    **{"in /sys": "/sys/a{}", "deep in /proc": "/proc/1/b/a{}", "a long name": "x" * 300 + "{}"},
    **{"a long path": "x/" * 3000 + "a{}", "two lines": "a\nb{}", "a folder": "folder{}"},
    **{"what is there": "there{}", "a loop": "loop{}", "a link astray": "astray{}"},
    "another suffix": "a.xyz",
}


def place(folder: Path, suffix: str, what: str) -> str:
    """Where nothing can be written."""
    (folder / "file").write_text("mine")
    (folder / f"there{suffix}").write_text("mine")
    (folder / f"folder{suffix}").mkdir()
    (folder / f"folder{suffix}" / "thesis.tex").write_text("mine")
    (folder / f"loop{suffix}").symlink_to(folder / f"loop{suffix}")
    (folder / f"astray{suffix}").symlink_to("/proc/nowhere/x")
    return str(folder / PLACES[what].format(suffix))


def allowed(writer: str, suffix: str, what: str) -> bool:
    """Whether there is nothing wrong with a place."""
    any_name = what == "another suffix" and (not suffix or writer == "layers")
    return any_name or (what == "what is there" and writer in REPLACES)


@pytest.mark.parametrize("what", [*PLACES, "nothing", "a NUL"])
@pytest.mark.parametrize("writer", WRITERS)
def test_functions(tmp_path, writer, what):
    suffix, save = WRITERS[writer]
    never = {"nothing": "", "a NUL": f"a\0b{suffix}"}
    path = never[what] if what in never else place(tmp_path, suffix, what)
    before = listing(tmp_path)
    if allowed(writer, suffix, what):
        save(path)
        return
    with pytest.raises((ValueError, OSError)) as error:
        save(path)
    assert not one_clear_line(error.value, "path")
    assert listing(tmp_path) == before


def run(capsys, sources: dict[str, str], command: str, out: str) -> tuple[int, str]:
    arguments = [sources.get(word, word) for word in COMMANDS[command][1]]
    status = main([*arguments, "--out", out])
    return status, capsys.readouterr().err


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("what", PLACES)
@pytest.mark.parametrize("command", COMMANDS)
def test_commands(tmp_path, capsys, sources, command, what):
    suffix = COMMANDS[command][0]
    path = place(tmp_path, suffix, what)
    if allowed(command, suffix, what):
        return
    before = listing(tmp_path)
    status, said = run(capsys, sources, command, path)
    assert status == 2, said
    assert said.count("\n") == 1
    assert not one_clear_line(ValueError(said.removeprefix("error: ").strip()), "--out")
    assert listing(tmp_path) == before


Usage = namedtuple("Usage", "total used free")


@pytest.mark.parametrize("writer", WRITERS)
def test_a_full_disk(tmp_path, monkeypatch, writer):
    suffix, save = WRITERS[writer]
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(100, 90, 10))
    said = "the disk is too full; needs up to .*, 10 bytes is free"
    with refused(said, OSError) as error:
        save(tmp_path / f"a{suffix}")
    assert error.value.errno == errno.ENOSPC
    assert not os.listdir(tmp_path)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_full_disk_for_a_command(tmp_path, monkeypatch, capsys, sources, command):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(100, 90, 10))
    status, said = run(capsys, sources, command, str(tmp_path / f"a{COMMANDS[command][0]}"))
    assert (status, said.count("\n")) == (2, 1), said
    assert said.startswith("error: --out = ")
    assert "the disk is too full; needs up to" in said
    assert not os.listdir(tmp_path)


MADE_OF = {
    "render": (WRITERS["stack"], "phasor {} --freq 2e7"),
    "capture": (WRITERS["capture"], "reconstruct {} --method bp"),
    "image": (WRITERS["layers"], "warp hierarchical --image {}"),
}


@pytest.mark.parametrize("where", ["same", "inside", "above", "by a link", "by dots"])
@pytest.mark.parametrize("kind", MADE_OF)
def test_a_source_is_not_replaced_by_what_is_made_of_it(tmp_path, capsys, kind, where):
    folder = tmp_path / "sources"
    folder.mkdir()
    (suffix, save), command = MADE_OF[kind]
    source = folder / f"source{suffix}"
    save(source)
    command = [word.format(source) for word in command.split()]
    link = tmp_path / f"link{source.suffix}"
    link.symlink_to(source)
    out = {
        "same": source,
        "inside": source / f"out{source.suffix}",
        "above": folder,
        "by a link": link,
        "by dots": source.parent / ".." / folder.name / source.name,
    }[where]
    before = listing(tmp_path)
    assert main([*command, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: --out = {out}: ")
    assert said.count("\n") == 1
    assert "must " in said
    assert listing(tmp_path) == before


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("mode", "grid", "fits"),
    [("exhaustive", (256, 256), "x"), ("confocal", (4096, 4096), "x"), ("single", (8, 8), "0 x 0")],
)
def test_captures_that_do_not_fit_into_memory(monkeypatch, mode, grid, fits):
    free = 1000 if mode == "single" else 8 << 30
    lower(monkeypatch, free_memory=free)
    with pytest.raises(MemoryError, match=rf"^grid of {grid[0]} x .*{fits} .*would fit$") as error:
        tofrender.capture("nlos_plane", mode=mode, grid=grid, spp=1, progress=False)
    assert not one_clear_line(error.value, "grid")
