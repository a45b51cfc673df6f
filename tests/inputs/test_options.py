"""Every option of every command with bad text: one line on stderr, status 2, nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from helpers.bad_inputs import listing, one_clear_line
from helpers.hidden_scenes import small_capture as captured
from helpers.made_dataset import make_dataset

from tofrender import io
from tofrender.cli.app import app, main
from tofrender.integrators import passes
from tofrender.nlos.reconstruction import methods
from tofrender.rendering import pieces, workers

NUMBERS = {
    "zero": "0",
    "minus one": "-1",
    "a fraction": "1.5",
    "nan": "nan",
    "inf": "inf",
    "-inf": "-inf",
    "huge": "1e30",
    "large": str(1 << 70),
    "text": "many",
    "empty": "",
    "blank": " ",
    "underscore": "1_000",
    "hexadecimal": "0x10",
    "padded": " 4",
    "another script": "\u0663",
    "many digits": "9" * 5000,
    "lines": "1\n2",
    "true": "True",
    "a list": "1,2",
    "a dict": "{}",
    "complex": "1j",
    "percent": "5%",
    "unit": "5m",
}
NAMES = {
    "empty": "",
    "text": "nonsense",
    "capitals": "FRAMES",
    "a number": "3",
    "lines": "a\nb",
    "long": "x" * 3000,
    "bytes": "b'x'",
    "none": "None",
    "a path": "../x",
    "surrogate": "\udcff",
}
KINDS: dict[str, tuple[dict[str, str], set[str]]] = {
    "count": (NUMBERS, set()),
    "seed": (NUMBERS, {"zero"}),
    "term": (NUMBERS, {"zero"}),
    "metres": (NUMBERS, {"zero", "minus one", "a fraction", "huge", "large"}),
    "positive": (NUMBERS, {"a fraction", "huge", "large"}),
    "width": (NUMBERS, {"a fraction", "huge", "large"}),
    "pulse": (NUMBERS | {"capitals": "AUTO"}, {"a fraction", "huge", "large"}),
    "from 0": (NUMBERS, {"zero", "a fraction", "huge", "large"}),
    "from 1": (NUMBERS, {"a fraction", "huge", "large"}),
    "from 30": (NUMBERS, {"huge", "large"}),
    "alpha": (NUMBERS, {"a fraction"}),
    "depth": (NUMBERS, {"minus one"}),
    "choice": (NAMES, set()),
    "sensor": (NUMBERS, {"zero"}),
    "dpi": (NUMBERS, set()),
    "span": (
        NUMBERS
        | {"one end": "3", "three": "1,2,3", "backwards": "15,3", "empty span": "3,3"}
        | {"capitals": "AUTO", "nan end": "3,nan", "far": "0,1e13", "text ends": "a,b"},
        set(),
    ),
    "size": (
        NUMBERS
        | {"0x8": "0x8", "8x": "8x", "8x8x8": "8x8x8", "-8x8": "-8x8", "8.5x8": "8.5x8"}
        | {"70000x8": "70000x8", "nanx8": "nanx8", "two blanks": "8  8"},
        set(),
    ),
    "address": (
        NAMES
        | {"no port": "tcp://127.0.0.1", "port 0": "tcp://127.0.0.1:0", "blank": " "}
        | {"far port": "tcp://127.0.0.1:70000", "no host": "tcp://:8786", "http": "http://a:1"},
        set(),
    ),
    "definition": (
        {"empty": "", "no =": "spp", "no name": "=3", "unknown": "wdth=3", "lines": "a\nb=3"},
        set(),
    ),
    "scene": (
        NAMES | {"misspelt": "cornel_box", "no file": "no.xml", "folder": ".", "NUL-like": "\x01"},
        set(),
    ),
    "file": (NAMES | {"folder": ".", "no file": "no.h5"}, set()),
    "render": (NAMES | {"no render": ".", "no file": "no.xml"}, set()),
}
SCENE = ["cornell_box", "--size", "4x4", "--spp", "1"]
COMMANDS: dict[str, tuple[list[str], dict[str, str]]] = {
    "render": (
        [*SCENE, "--bins", "4", "--bin-width", "4"],
        {
            "scene": "scene",
            "--spp": "count",
            "--size": "size",
            "--bins": "count",
            "--start-opl": "metres",
            "--bin-width": "width",
            "--window": "span",
            "--pulse-width": "pulse",
            "--max-depth": "depth",
            "--integrator": "choice",
            "--sampler": "choice",
            "--sensor": "sensor",
            "--variant": "choice",
            "--seed": "seed",
            "--format": "choice",
            "--precision": "choice",
            "--figure": "choice",
            "--dpi": "dpi",
            "-D": "definition",
            "--workers": "count",
            "--scheduler": "address",
            "--checkpoint": "from 0",
        },
    ),
    "phasor": (
        [*SCENE, "--freq", "2e7"],
        {
            "source": "render",
            "--freq": "positive",
            "--spp": "count",
            "--size": "size",
            "--max-depth": "depth",
            "--seed": "seed",
            "--variant": "choice",
            "--figure": "choice",
            "--dpi": "dpi",
            "--checkpoint": "from 0",
        },
    ),
    "gate": (
        [*SCENE, "--at", "6"],
        {
            "scene": "scene",
            "--at": "from 0",
            "--pulse-width": "width",
            "--spp": "count",
            "--size": "size",
            "--max-depth": "depth",
            "--seed": "seed",
            "--variant": "choice",
            "--figure": "choice",
            "--dpi": "dpi",
            "--checkpoint": "from 0",
        },
    ),
    "capture": (
        ["nlos_plane", "--grid", "2x2", "--spp", "1"],
        {
            "scene": "scene",
            "--mode": "choice",
            "--grid": "size",
            "--wall": "choice",
            "--spp": "count",
            "--seed": "seed",
            "--variant": "choice",
            "--workers": "count",
            "--scheduler": "address",
            "--checkpoint": "from 0",
        },
    ),
    "reconstruct": (
        ["wall.h5", "--method", "bp"],
        {
            "source": "file",
            "--method": "choice",
            "--figure": "choice",
            "--dpi": "dpi",
            "--workers": "count",
            "--scheduler": "address",
        },
    ),
    "merge": (
        ["a", "b"],
        {
            "sources": "render",
            "--format": "choice",
            "--precision": "choice",
            "--figure": "choice",
            "--dpi": "dpi",
        },
    ),
    "warp": (
        ["beckmann", "--alpha", "0.5", "--count", "4"],
        {
            "name": "choice",
            "--alpha": "alpha",
            "--points": "choice",
            "--count": "count",
            "--dpi": "dpi",
            "--seed": "seed",
            "--variant": "choice",
        },
    ),
    "warptest": (
        ["beckmann", "--headless", "--alpha", "0.5", "--count", "4"],
        {
            "name": "choice",
            "--module": "file",
            "--alpha": "alpha",
            "-D": "definition",
            "--points": "choice",
            "--count": "count",
            "--samples": "count",
            "--dpi": "dpi",
            "--seed": "seed",
            "--variant": "choice",
            "--port": "count",
        },
    ),
    "view": (
        ["cornell_box", "--live", "--size", "4x4", "--spp", "1", "--no-browser"],
        {
            "source": "scene",
            "--spp": "count",
            "--size": "size",
            "--max-depth": "depth",
            "--seed": "seed",
            "--variant": "choice",
            "--host": "choice",
            "--port": "count",
        },
    ),
    "compare": (
        ["veach", "--no-browser"],
        {"one": "choice", "--variant": "choice", "--host": "choice", "--port": "count"},
    ),
    "report": (["render.npz"], {"source": "file", "--megabytes": "positive"}),
    "release": (["a1"], {"assignment": "choice"}),
    "verify": (
        ["a1"],
        {"assignment": "choice", "--seeds": "count", "--wrong": "count", "--only": "choice"},
    ),
    "start": (["a1", "folder"], {"assignment": "choice"}),
    "submit": (["a1", "folder"], {"assignment": "choice", "folder": "file"}),
    "grade": (
        ["a1", "--submission", "folder"],
        {
            "assignment": "choice",
            "--submission": "file",
            "--time-limit": "from 30",
            "--memory": "from 1",
            "--jobs": "count",
            "--seed": "count",
        },
    ),
    "gradescope": (
        ["a1", "-o", "a.zip"],
        {
            "assignment": "choice",
            "--time-limit": "from 30",
            "--memory": "from 1",
            "--seed": "count",
        },
    ),
    "similarity": (["a1", "--all", "folder", "-o", "x"], {"assignment": "choice"}),
    "new-term": (["a1"], {"assignment": "choice", "--term": "term"}),
}
ELSEWHERE = {
    "--out": "test_outputs.py has the places, and the course's tests",
    "--csv": "the course's tests",
    "--all": "the course's tests",
    "--roster": "the course's tests",
    "--sheet": "the course's tests",
    "--feedback": "the course's tests",
    "--image": "test_warp_images",
    "--video": "a switch",
    "--pdf": "a switch",
    "--resume": "a switch",
    "--errors": "a switch",
    "report title": "any text",
    "--json": "a switch",
    "--browser": "a switch",
    "--headless": "a switch",
    "--live": "a switch",
    "warp parameters": "as of warptest",
    "warptest host": "as of view",
    "compare two": "tests/apps",
    "--progress": "a switch",
    "scenes": "has no other options",
    "doctor": "has no other options",
    "start folder": "the course's tests",
    "dataset config": "tests/datasets",
    "dataset only": "test_cli_dataset.py",
    "dataset plan": "a switch",
    "dataset variant": "test_cli_dataset.py",
    "dataset workers": "as of render",
    "dataset scheduler": "as of render",
}
SUFFIXES = {"capture": ".h5", "report": ".html", "warp": ".png", "warptest": ".png", "view": ".npz"}
COURSE = {"verify", "start", "submit", "grade", "gradescope", "similarity", "new-term"}
WITHOUT_OUT = COURSE | {"compare"}


@pytest.fixture
def no_work(monkeypatch):
    """Fail if anything is rendered, reconstructed, tested or graded."""

    def never(*_, **__):
        raise AssertionError("work has started")

    monkeypatch.setattr(pieces, "steps", never)
    for name in ("steps", "expose"):
        monkeypatch.setattr(passes, name, never)
    monkeypatch.setattr(methods, "backproject", never)
    monkeypatch.setattr("tofrender.sampling.suites.chi_square_test", never)
    monkeypatch.setattr("panel.io.server.get_server", never)


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    return io.save_capture(captured(), tmp_path_factory.mktemp("wall") / "wall.h5").read_bytes()


def cases():
    for command, (_, options) in COMMANDS.items():
        for number, (option, kind) in enumerate(options.items()):
            yield pytest.param(command, option, kind, number, id=f"{command}{option}")


def replaced(command: str, option: str, text: str) -> list[str]:
    """Arguments with another value for one of them."""
    good = list(COMMANDS[command][0])
    if not option.startswith("-"):
        at = 1 if (command, option) == ("submit", "folder") else 0
        good[at] = text
        return good
    if option in good and option != "--only":
        del good[good.index(option) : good.index(option) + 2]
    return [*good, option, text]


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(("command", "option", "kind", "number"), list(cases()))
def test_bad_options(
    tmp_path, monkeypatch, capsys, pytestconfig, wall, command, option, kind, number
):
    monkeypatch.chdir(tmp_path)
    Path("wall.h5").write_bytes(wall)
    before = listing(tmp_path)
    out = [] if command in WITHOUT_OUT else ["--out", f"out{SUFFIXES.get(command, '')}"]
    texts, good = KINDS[kind]
    labels = [label for label in texts if label not in good]
    if not pytestconfig.getoption("--all-inputs"):
        labels = labels[number % 2 :: 2]
    wrong = {}
    for label in labels:
        status = main([command, *replaced(command, option, texts[label]), *out])
        said = capsys.readouterr().err
        what = one_clear_line(ValueError(said.removeprefix("error: ").rstrip("\n")), "")
        if status != 2 or what or not said.startswith("error: ") or listing(tmp_path) != before:
            wrong[label] = (status, what or said)
    assert not wrong


def test_every_option_is_in_the_table():
    commands = typer.main.get_command(app).commands
    missing = []
    for name, command in commands.items():
        known = COMMANDS.get(name, ([], {}))[1]
        for parameter in command.params:
            named = {*parameter.opts, parameter.name}
            left_out = {*ELSEWHERE} & {*named, name, f"{name} {parameter.name}"}
            if parameter.name != "help" and not named & set(known) and not left_out:
                missing.append(f"{name} {parameter.opts[0]}")
    assert not missing


@pytest.mark.parametrize("what", ["no file", "folder", "text", "empty", "pipe"])
def test_warp_images(tmp_path, capsys, what):
    import os

    path = tmp_path / "a.exr"
    if what == "folder":
        path.mkdir()
    elif what == "pipe":
        os.mkfifo(path)
    elif what != "no file":
        path.write_text("text" * (what == "text"))
    arguments = ["warp", "hierarchical", "--image", str(path), "--out", str(tmp_path / "b.png")]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith("error: --image = ")


def test_a_scheduler_that_does_not_answer(tmp_path, capsys, monkeypatch, wall):
    monkeypatch.setattr(workers, "ANSWER_S", 0.3)
    file, out = tmp_path / "wall.h5", tmp_path / "out"
    file.write_bytes(wall)
    arguments = ["reconstruct", str(file), "--method", "bp", "--out", str(out)]
    assert main([*arguments, "--scheduler", "tcp://127.0.0.1:1"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: --scheduler = tcp://127.0.0.1:1: does not answer; must be ")
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("words", [["--spp"], ["--nonsense"], ["extra", "word"], ["--seed=x=y"]])
@pytest.mark.parametrize("command", ["render", "phasor", "gate", "capture", "reconstruct", "warp"])
def test_words_that_make_no_sense(tmp_path, monkeypatch, capsys, command, words):
    monkeypatch.chdir(tmp_path)
    assert main([command, *COMMANDS[command][0], "--out", "out", *words]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_dataset_is_needed_for_phasors(tmp_path, capsys):
    """A folder that holds a render of another kind."""
    broken = make_dataset(2, 3, 3).drop_attrs()
    folder = tmp_path / "render"
    io.save_exr_stack(make_dataset(2, 3, 3), folder, progress=False)
    (folder / "steady.exr").write_bytes(b"text")
    assert broken.attrs == {}
    arguments = ["phasor", str(folder), "--freq", "2e7", "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    assert "must be as it was saved" in capsys.readouterr().err
