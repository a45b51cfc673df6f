"""For scripts and shells: --json, completion, pictures and figures of other kinds."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import types
from pathlib import Path
from typing import Any, Union, get_args, get_origin

import numpy as np
import pytest
from helpers.commands import COMMAND, HEAVY, ROOT, TINY, done, imported_by, refused, rest_of, run
from helpers.films_in_parts import in_small_steps, names, watch_steps
from helpers.hidden_scenes import small_capture as captured
from PIL import Image

import tofrender
from tofrender import io
from tofrender.cli import completion
from tofrender.cli.answers import SCHEMAS
from tofrender.cli.app import main
from tofrender.runtime import doctor, progress

ALL = {"command": str, "version": str}
SMALL = ["--size", "6x5", "--spp", "1"]


def mistakes(value: Any, kind: Any, where: str = "") -> list[str]:
    """Where a value is not of its type."""
    if isinstance(kind, dict):
        if set(value) != set(kind):
            return [f"{where}: has {sorted(value)}, must have {sorted(kind)}"]
        return [m for name in kind for m in mistakes(value[name], kind[name], f"{where}.{name}")]
    if isinstance(kind, list) or get_origin(kind) is list:
        (inner,) = kind if isinstance(kind, list) else get_args(kind)
        return [m for k, each in enumerate(value) for m in mistakes(each, inner, f"{where}[{k}]")]
    if get_origin(kind) in (Union, types.UnionType):
        return [] if any(not mistakes(value, each) for each in get_args(kind)) else [where]
    good = type(value) is kind or (kind is float and type(value) is int)
    return [] if good else [f"{where} = {value!r}: must be {kind}"]


def said(capsys, *arguments: object) -> dict:
    """The object that a command says, which is of its schema; stdout has nothing else."""
    out, _ = done(capsys, *arguments, "--json")
    assert out.count("\n") == 1
    return checked(json.loads(out), str(arguments[0]))


def checked(found: dict, command: str) -> dict:
    """Facts of a command without what all have."""
    assert found.pop("command") == command
    assert found.pop("version") == tofrender.__version__
    assert not mistakes(found, SCHEMAS[command], command)
    return found


def test_json_of_a_render_and_its_phasors(capsys, tmp_path):
    out = tmp_path / "böx"
    facts = said(capsys, "render", "cornell_box", "--out", out, *TINY, "--seed", 7, "--no-video")
    assert facts["out"] == str(out)
    assert set(facts["files"]) == names(out)
    wanted = {"width": 8, "height": 6, "bins": 20, "bin_width": 0.3, "spp": 4, "seed": 7}
    assert wanted.items() <= facts.items()
    assert facts["complete"] is True
    dataset = tofrender.load_exr_stack(out)
    assert facts["energy_outside_window"] == dataset.attrs["energy_outside_window"]
    again = said(capsys, "phasor", out, "--freq", "2e7", "--freq", "5e7", "--out", tmp_path / "p")
    assert again["frequencies_hz"] == [2e7, 5e7]
    assert set(again["files"]) == names(tmp_path / "p")
    assert (again["width"], again["height"]) == (8, 6)


def test_json_of_phasors_and_gates_of_a_scene(capsys, tmp_path):
    options = [*SMALL, "--out", tmp_path / "out"]
    facts = said(capsys, "phasor", "cornell_box", "--freq", "2e7", *options)
    assert facts["source"] == "cornell_box"
    facts = said(capsys, "gate", "cornell_box", "--at", "6", *options)
    assert (facts["at"], facts["spp"], facts["width"]) == (6, 1, 6)
    assert set(facts["files"]) == names(tmp_path / "out")


def test_json_of_captures_and_reconstructions(capsys, tmp_path):
    file = tmp_path / "wall.h5"
    facts = said(capsys, "capture", "nlos_plane", "--grid", "3x2", "--spp", "1", "--out", file)
    assert (facts["columns"], facts["rows"], facts["mode"]) == (3, 2, "confocal")
    found = said(capsys, "reconstruct", file, "--method", "bp", "--out", tmp_path / "out")
    assert set(found["files"]) == names(tmp_path / "out")
    dark = captured()
    dark["transient"][:] = 0
    io.save_capture(dark, tmp_path / "dark.h5")
    arguments = ["reconstruct", tmp_path / "dark.h5", "--method", "bp", "--out", tmp_path / "dark"]
    assert said(capsys, *arguments)["median_depth"] is None


def test_json_of_the_scenes(capsys):
    facts = said(capsys, "scenes")
    assert [each["name"] for each in facts["scenes"]] == list(tofrender.scenes.BUILT_IN)


@pytest.mark.parametrize("ok", [True, False])
def test_json_of_the_doctor(capsys, monkeypatch, ok):
    checks = [
        doctor.Check("Python", True, "3.11"),
        doctor.Check("CUDA", False, "no driver", "update it", required=False),
        doctor.Check("LLVM", ok, "none", "" if ok else "install it"),
    ]
    monkeypatch.setattr(doctor, "diagnose", lambda: checks)
    status, out, err = run(capsys, "doctor", "--json")
    assert (status, err) == (0 if ok else 1, "")
    facts = checked(json.loads(out), "doctor")
    assert facts["works"] is ok
    assert facts["checks"][2]["remedy"] == ("" if ok else "install it")


def test_errors_leave_stdout_empty(capsys, tmp_path):
    arguments = ["render", "cornell_box", "--json", "--out", tmp_path / "out"]
    assert "--spp = 0: must be" in refused(capsys, *arguments, "--spp", "0")
    assert "Use cornell_box" in refused(capsys, "render", "cornel_box", *arguments[2:])


def test_json_of_a_render_that_was_stopped(capsys, tmp_path, monkeypatch):
    watch_steps(monkeypatch, lambda number: number or signal.raise_signal(signal.SIGINT))
    in_small_steps(monkeypatch, 8 * 6)
    arguments = ["render", "cornell_box", *TINY, "--no-video", "--out", tmp_path / "a"]
    status, out, err = run(capsys, *arguments, "--json")
    assert status == 130
    facts = checked(json.loads(out), "render")
    assert facts["complete"] is False
    assert facts["spp"] == 2
    assert "with --resume" in err


def test_the_page_has_all_keys():
    page = (ROOT / "docs" / "for_scripts.md").read_text()
    for command, schema in SCHEMAS.items():
        part = re.search(rf"^## {command}\n(.*?)^## ", page, re.DOTALL | re.MULTILINE)[1]
        rows = [line.split("|")[1] for line in part.splitlines()[2:] if line.startswith("|")]
        told = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
        assert set(told) == set(schema)
        for kind in schema.values():
            if isinstance(kind, list):
                assert set(kind[0]) <= set(re.findall(r"`(\w+)`", part))


ASKED = {
    "bash": {"COMP_WORDS": "{line}", "COMP_CWORD": "{last}"},
    "zsh": {"_TYPER_COMPLETE_ARGS": "{line}"},
    "fish": {"_TYPER_COMPLETE_ARGS": "{line}", "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
}


def asked(shell: str, line: str) -> dict[str, str]:
    """The environment by which a shell's script asks what to complete a line to."""
    values = {"line": line, "last": len(line.split(" ")) - 1}
    found = {name: text.format(**values) for name, text in ASKED[shell].items()}
    return found | {"_TOFRENDER_COMPLETE": f"complete_{shell}"}


@pytest.fixture
def completed(capsys, monkeypatch):
    """What a shell is told to complete a line to."""

    def of(shell: str, line: str) -> list[str]:
        monkeypatch.chdir(ROOT)
        for name, text in asked(shell, line).items():
            monkeypatch.setenv(name, text)
        with pytest.raises(SystemExit):
            main(["x"])
        said, err = capsys.readouterr()
        assert err == ""
        if shell == "zsh":
            return re.findall(r'"([^"]+)"(?::|\n|\)|$)', said.replace("\\", ""))
        return [each.split("\t")[0] for each in said.split()]

    return of


@pytest.mark.parametrize("shell", ASKED)
def test_shells_complete(completed, shell):
    assert "cornell_box_glass" in " ".join(completed(shell, "tofrender render cornell_box_g"))
    assert "transient_bdpt" in completed(shell, "tofrender render x --integrator transient_b")


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("rend", "render"),
        ("render x --form", "--format"),
        ("render x --format m", "multipart"),
        ("render x --sampler pad", "padded_sobol"),
        ("render x --variant llvm_ad_s", "llvm_ad_spectral llvm_ad_spectral_polarized"),
        ("gate sphere-light-l", "sphere-light-large"),
        ("capture nlos_z", "nlos_z"),
        ("reconstruct a.h5 --method ph", "phasor"),
        ("warp beck", "beckmann"),
        ("render scenes/cor", "scenes/cornell_box.xml"),
        ("render scenes/n", "scenes/nlos/"),
    ],
)
def test_bash_completes(completed, line, found):
    assert completed("bash", f"tofrender {line}") == found.split()


def test_completion_imports_nothing_heavy():
    imported, said = imported_by([], **asked("bash", "tofrender render c"), PYTHONPATH=str(ROOT))
    assert "tofrender.cli" in imported
    assert not imported & set(HEAVY)
    assert "cornell_box" in said


@pytest.mark.parametrize("shell", ASKED)
def test_the_script_of_a_shell(tmp_path, shell):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "HOME": str(tmp_path)}
    environment["_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION"] = "1"
    for option in ("--show-completion", "--install-completion"):
        command = [*COMMAND, option, shell]
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=ROOT)
        assert ran.returncode == 0, ran.stderr
        if option == "--show-completion":
            assert f"complete_{shell}" in ran.stdout
    assert any("tofrender" in path.name for path in tmp_path.rglob("*") if path.is_file())


def test_scenes_are_those_there_are():
    assert set(tofrender.scenes.BUILT_IN) == set(completion.scene_names())


def test_paths_that_cannot_be_looked_at():
    assert completion.paths("/no/such/folder/a", ".xml") == []


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image)


def test_pictures(capsys, tmp_path):
    out = tmp_path / "box"
    arguments = ["render", "cornell_box", "--out", out, *TINY, "--format", "png", "--no-video"]
    told, _ = done(capsys, *arguments)
    frames = {f"frame_{k:04d}.png" for k in range(20)}
    assert names(out) == frames | {"steady.png", "summary.png"}
    assert "frame_0000.png ... frame_0019.png, steady.png, summary.png" in told
    assert pixels(out / "steady.png").shape == (6, 8, 3)
    brightest = max(pixels(out / name).mean() for name in frames)
    assert brightest > 20
    done(capsys, *arguments)  # In place of the first
    assert "contains PNG pictures only" in refused(capsys, *arguments, "--resume")
    assert "--precision = half: must be" in refused(capsys, *arguments, "--precision", "half")


@pytest.mark.parametrize("kind", ["pdf", "svg"])
def test_vectors(capsys, tmp_path, kind):
    out, marks = tmp_path / "out", {"pdf": b"%PDF", "svg": b"<?xml"}
    figure = ["--figure", kind]
    done(capsys, "render", "cornell_box", "--out", out, *TINY, "--no-video", *figure)
    assert (out / f"summary.{kind}").read_bytes().startswith(marks[kind])
    assert not (out / "summary.png").exists()
    panel = tmp_path / "panel"
    run(capsys, "phasor", out, "--freq", "2e7", "--out", panel, *figure)
    assert (panel / f"panel.{kind}").read_bytes().startswith(marks[kind])
    gate = tmp_path / "gate"
    run(capsys, "gate", "cornell_box", *SMALL, "--at", "6", "--out", gate, *figure)
    assert (gate / f"picture.{kind}").read_bytes().startswith(marks[kind])
    io.save_capture(captured(), tmp_path / "a.h5")
    volume = tmp_path / "volume"
    arguments = ["reconstruct", tmp_path / "a.h5", "--method", "bp", "--out", volume]
    for _ in range(2):  # The second replaces the first
        done(capsys, *arguments, *figure)
    assert (volume / f"volume.{kind}").read_bytes().startswith(marks[kind])


def test_dots_per_inch(capsys, tmp_path):
    widths = []
    for dpi in (50, 100):
        out = tmp_path / f"{dpi}"
        arguments = ["--out", out, *TINY, "--no-video", "--dpi", dpi]
        done(capsys, "render", "cornell_box", *arguments)
        widths.append(pixels(out / "summary.png").shape[1])
        run(capsys, "warp", "tent", "--out", tmp_path / f"{dpi}.png", "--dpi", dpi)
        widths.append(pixels(tmp_path / f"{dpi}.png").shape[1])
    assert widths[2] == pytest.approx(2 * widths[0], abs=2)
    assert widths[3] == pytest.approx(2 * widths[1], abs=2)


_WAITS = """
import sys, time
from tofrender.cli import main, render
from tofrender.runtime import backend
activate = backend.activate
def waiting(*arguments):
    start = time.process_time()
    sys.stdin.readline()
    print(time.process_time() - start, flush=True)
    activate(*arguments)
backend.activate = waiting
main(sys.argv[1:])
"""


def test_a_command_is_seen_to_work_within_a_second(tmp_path):
    """In a terminal, after the delay and what drawing it computes, while the command waits."""
    screen, stderr = pty.openpty()
    termios.tcsetwinsize(stderr, (30, 100))
    arguments = ["render", "cornell_box", "--out", tmp_path / "a", *SMALL, "--no-video"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": stderr}
    command = [sys.executable, "-c", _WAITS, *map(str, arguments)]
    with subprocess.Popen(command, cwd=ROOT, text=True, **pipes) as process:
        os.close(stderr)
        seen = b""
        while b"tofrender render ..." not in seen:
            seen += os.read(screen, 4096)
        process.stdin.write("\n")
        process.stdin.flush()
        assert progress.DELAY_S + float(process.stdout.readline()) < 1
        rest_of(screen)
    assert process.returncode == 0
    os.close(screen)
