"""Commands that are stopped or killed: nothing half-written, and `--resume` goes on from there.

The processes are real; what goes on runs in this one. The moments are random, with fixed seeds:
three for each signal here, twenty in `make test-kills`.
"""

import functools
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest
import xarray as xr
from helpers.commands import done, refused, run
from helpers.films_in_parts import in_small_steps, replace_launch, watch_steps
from helpers.support import largest

import tofrender
from tofrender.cli import checkpoints as checkpoints_of_commands, render as cli_render
from tofrender.cli.app import main
from tofrender.cli.checkpoints import AGAIN
from tofrender.runtime import atomic, checkpoints
from tofrender.runtime.checkpoints import Checkpoint

ROOT = Path(__file__).parents[2]

KILLS = int(os.environ.get("TOFRENDER_KILLS", "3"))  # Random moments for each signal

SPP = 512
SIZE = ["--size", "16x16"]
RENDER = ["render", "cornell_box", *SIZE, "--bins", "30", "--bin-width", "0.4", "--no-video"]
RENDER += ["--format", "npz"]
CAPTURE = ["capture", "nlos-z", "--grid", "4x4", "--mode"]
COMMANDS = {
    "render": RENDER,
    "gate": ["gate", "cornell_box", *SIZE, "--at", "5.9", "--pulse-width", "0.3"],
    "phasor": ["phasor", "cornell_box_flash", *SIZE, "--freq", "2e7", "--freq", "5e7"],
    "single": [*CAPTURE, "single"],
    "exhaustive": [*CAPTURE, "exhaustive"],
}
SAMPLES = {"single": 8192, "exhaustive": 768}
WRITES_PARTS = ("render", "single")

SMALL_STEPS = """
import math, sys
from tofrender.integrators import passes
from tofrender.runtime.checkpoints import Checkpoint
passes.STEP_SAMPLES = passes.FIRST_SAMPLES = 4096
passes.STEP_S = math.inf
Checkpoint.due, save, saved = True, Checkpoint.save, []
def waiting(*arguments):
    save(*arguments)
    saved.append(None)
    if len(saved) == int(sys.argv[1]):
        print("here", flush=True)
        sys.stdin.readline()
Checkpoint.save = waiting
from tofrender.cli import main
sys.exit(main(sys.argv[2:]))
"""


def arguments(name: str, out: Path, *options: object, spp: int = 0) -> list[str]:
    command = [*COMMANDS[name], "--out", out, "--spp", spp or SAMPLES.get(name, SPP), *options]
    return [str(each) for each in command]


def place(folder: Path, name: str) -> Path:
    """What a command writes there."""
    return folder / ("out.h5" if name in SAMPLES else "out")


def started(given: list[str], saved: int = 1) -> subprocess.Popen:
    """A process that runs a command in small steps, each of which it keeps.

    After so many it says so, and waits for a line; or 0, and it does not.
    """
    command = [sys.executable, "-c", SMALL_STEPS, str(saved), *given]
    pipes: dict = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE) | {"text": True}
    process = subprocess.Popen(command, cwd=ROOT, preexec_fn=_heard, **pipes)
    if saved:
        assert process.stdout.readline() == "here\n", process.stderr.read()
    return process


def _heard() -> None:
    """Let signals arrive that tests are told to ignore, as under nohup."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def kept(out: Path) -> Path:
    return atomic.sibling(out, ".checkpoint.npz")


def ended(process: subprocess.Popen, by: int) -> tuple[int, str]:
    """Exit status, and what was said on stderr, of a process that gets a signal and goes on."""
    process.send_signal(by)
    _, err = process.communicate("\n")
    return process.returncode, err


def hidden(folder: Path) -> list[str]:
    return [name for name in os.listdir(folder) if name.startswith(".tofrender-")]


def values(out: Path) -> list[np.ndarray]:
    """All light that a command has written."""
    if out.suffix == ".h5":
        return [tofrender.load_capture(out)["transient"].values]
    if (out / "transient.npz").exists():
        dataset = tofrender.load_npz(out / "transient.npz")
        return [dataset[name].values for name in ("transient", "steady")]
    if (out / "gate.exr").exists():
        return [OpenEXR.File(str(out / "gate.exr")).channels()["RGB"].pixels]
    files = sorted(out.glob("phasor_*.exr"))
    assert len(files) == 2
    parts = [OpenEXR.File(str(file)).channels() for file in files]
    return [part[name].pixels for part in parts for name in ("I", "Q", "amplitude")]


def content(out: Path) -> dict[str, bytes]:
    files = out.iterdir() if out.is_dir() else [out]
    return {each.name: each.read_bytes() for each in files}


def is_complete(out: Path, name: str) -> bool:
    if name not in WRITES_PARTS:
        return True
    loaded = tofrender.load_npz(out / "transient.npz") if out.is_dir() else None
    return bool((loaded if loaded is not None else tofrender.load_capture(out)).attrs["complete"])


@functools.cache
def whole(name: str) -> list[np.ndarray]:
    """What a command writes if nobody stops it."""
    with tempfile.TemporaryDirectory() as folder:
        out = place(Path(folder), name)
        assert main(arguments(name, out)) == 0
        assert os.listdir(folder) == [out.name]
        return values(out)


def require_equal(out: Path, expected: list[np.ndarray]) -> None:
    for found, wanted in zip(values(out), expected, strict=True):
        assert found.shape == wanted.shape
        assert largest(found, wanted) < 2e-5


def one_line(err: str, start: str = "error: ") -> str:
    """The only line that starts so; no line is a traceback's."""
    assert "Traceback" not in err
    lines = [line for line in err.splitlines() if line.startswith(start)]
    assert len(lines) == 1, err
    return lines[0]


def goes_on(capsys, name: str, out: Path, expected: list[np.ndarray]) -> str:
    """Run the command with --resume to its end; what it says on stderr."""
    _, err = done(capsys, *arguments(name, out, "--resume"))
    require_equal(out, expected)
    assert is_complete(out, name)
    assert os.listdir(out.parent) == [out.name]
    return err


@pytest.mark.parametrize(
    ("name", "by"),
    [
        ("render", signal.SIGINT),
        ("gate", signal.SIGHUP),
        ("phasor", signal.SIGINT),
        ("single", signal.SIGTERM),
        ("exhaustive", signal.SIGINT),
    ],
)
def test_stopped(capsys, tmp_path, name, by):
    expected, out = whole(name), place(tmp_path, name)
    status, err = ended(started(arguments(name, out)), by)
    assert status == 130, err
    said = one_line(err)
    assert said.startswith("error: interrupted after ")
    assert said.endswith(f"; {AGAIN}")
    assert hidden(tmp_path) == [kept(out).name]
    assert out.exists() == (name in WRITES_PARTS)
    if out.exists():
        assert not is_complete(out, name)
        spp = tofrender.load_npz(out / "transient.npz").attrs["spp"] if out.is_dir() else None
        assert spp is None or f"interrupted after {spp} samples per pixel" in said
    assert "resuming from " in goes_on(capsys, name, out, expected)


def test_two_signals_end_at_once(tmp_path):
    out = tmp_path / "out"
    process = started(arguments("render", out))
    process.send_signal(signal.SIGINT)
    status, err = ended(process, signal.SIGINT)
    assert status in (130, -signal.SIGINT)
    assert "Traceback" not in err
    if out.exists():
        assert values(out)
    assert set(hidden(tmp_path)) <= {kept(out).name}


def begun(name: str, out: Path, *options: object) -> subprocess.Popen:
    """A process that has taken the lock of its output."""
    process = started(arguments(name, out, *options), saved=0)
    while not atomic.sibling(out, ".lock").exists() and process.poll() is None:
        time.sleep(0.002)
    return process


@functools.cache
def lasts(name: str) -> float:
    """Seconds from a command's lock to its end, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        process, start = begun(name, place(Path(folder), name)), time.monotonic()
        process.communicate()
        return time.monotonic() - start


KINDS = [(by, number) for by in ("SIGKILL", "SIGTERM", "SIGHUP") for number in range(KILLS)]
ORDER = ["render", "gate", "exhaustive", "phasor", "single"]


@pytest.mark.parametrize(("by", "number"), KINDS)
def test_killed_at_a_random_moment(capsys, tmp_path, by, number):
    """Some twice in a row. An earlier output stays, or is replaced by a whole one."""
    shift = ("SIGKILL", "SIGTERM", "SIGHUP").index(by)
    name = ORDER[(number + 2 * shift) % len(ORDER)]
    random = np.random.default_rng([number, shift])
    expected, out, number_of = whole(name), place(tmp_path, name), getattr(signal, by)
    before, resume = {}, []
    if name not in SAMPLES and number % 2:
        assert main(arguments(name, out, "--seed", "9", spp=4)) == 0
        before = content(out)
    for _ in range(1 + number % 2):
        process = begun(name, out, *resume)
        time.sleep(random.uniform(0, lasts(name)))
        status, err = ended(process, number_of)
        allowed = {0, -number_of} | ({130, 128 + number_of} if by != "SIGKILL" else set())
        if status == 2:  # Complete already, or nothing is there yet
            assert one_line(err)
            assert resume or out.suffix == ".h5"
            break
        assert status in allowed, (status, err)
        assert "Traceback" not in err
        if out.exists():
            assert values(out)
            if content(out) != before and is_complete(out, name):
                require_equal(out, expected)
        else:
            assert not before
        resume = ["--resume"] if kept(out).exists() else []
    status, _, err = run(capsys, *arguments(name, out, "--resume"))
    if status:
        assert status == 2, err
        one_line(err)
        if not (out.exists() and content(out) != before and is_complete(out, name)):
            if out.suffix == ".h5":
                out.unlink(missing_ok=True)
            done(capsys, *arguments(name, out))
    require_equal(out, expected)
    assert set(os.listdir(tmp_path)) - {kept(out).name} == {out.name}


FAN = ["fan", "--size", "8x6"]
FRAMES = ["render", *FAN, "--bins", "20", "--start-opl", "5", "--bin-width", "0.4", "--spp", "8"]
FRAMES += ["--format", "npz", "--frames", "6", "--frame-time", "0.01", "--poses", "2"]
FOLDERS = {
    "frames": [*FRAMES, "--exposure", "0.002"],
    "zarr": [*RENDER[:-2], "--spp", "64", "--format", "zarr"],
    "doppler": ["doppler", *FAN, "--spp", "256", "--checkpoint", "0.05"],
    "fmcw": ["fmcw", *FAN, "--spp", "128", "--bandwidth", "2e8", "--checkpoint", "0.05"],
    "dataset": ["dataset", "config.toml"],
}
CONFIG = """records = 4
scene = "cornell_box"
outputs = { transient = true }
render = { width = 8, height = 6, spp = 8, temporal_bins = 60, window = [3, 15] }
sensor = { cycles = 9, photons = { photons_per_cycle = 0.5 }, spad = {} }
vary = { turn = { turn = "small-box", distribution = "uniform", low = -40, high = 40 } }
"""


def light_in(out: Path) -> list[np.ndarray]:
    """Return all light and all estimates that a command has written into a folder."""
    if (out / "steady.npy").exists():
        films = [tofrender.load_npz(each / "transient.npz") for each in sorted(out.glob("frame_*"))]
        return [np.load(out / "steady.npy"), *(film["transient"].values for film in films)]
    if (out / "transient.zarr").exists():
        return [tofrender.load_zarr(out / "transient.zarr")["transient"].values]
    for name, variable in (("doppler", "heterodyne"), ("range_rate", "radiance")):
        if (out / f"{name}.nc").exists():
            return [xr.load_dataset(out / f"{name}.nc")[variable].values]
    return [tofrender.load_dataset(out)[name].values for name in ("transient", "sensor_expected")]


def run_until(command: list[str], folder: Path, seconds: float | None) -> tuple[int, str]:
    """Run a command in a folder, and kill it after some seconds; return status and messages."""
    code = [sys.executable, "-c", "import sys; from tofrender.cli import main; sys.exit(main())"]
    pipes: dict = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    paths = {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [*code, *command], cwd=folder, env=os.environ | paths, preexec_fn=_heard, **pipes
    )
    try:
        _, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        _, err = process.communicate()
    return process.returncode, err


@pytest.mark.parametrize("name", FOLDERS)
def test_every_command_that_writes_a_folder_resumes_after_a_kill(name, tmp_path):
    """Killed at random moments, also while it resumes, until it is complete."""
    (tmp_path / "config.toml").write_text(CONFIG)
    place = "out.zarr" if name == "dataset" else "out"
    whole, out = tmp_path / "whole" / place, tmp_path / "killed" / place
    start = time.monotonic()
    status, err = run_until([*FOLDERS[name], "--out", str(whole)], tmp_path, None)
    assert status == 0, err
    lasts_s = time.monotonic() - start
    random = np.random.default_rng(list(name.encode()))

    command = [*FOLDERS[name], "--out", str(out)]
    for _ in range(max(1, KILLS // 3)):
        status, err = run_until(command, tmp_path, random.uniform(0.3, 1.0) * lasts_s)
        assert status in (0, -signal.SIGKILL), err
        resumed = [*FOLDERS[name], "--out", str(out), "--resume"]
        status, err = run_until(resumed, tmp_path, random.uniform(0.3, 1.0) * lasts_s)
        if status == 2:  # Nothing was written before the kill
            assert "--resume: " in one_line(err)
        else:
            assert status in (0, -signal.SIGKILL), err
            command = resumed if status else command
        command = resumed if is_begun(out, name) else [*FOLDERS[name], "--out", str(out)]
    status, err = run_until(command, tmp_path, None)
    assert status == 0, err
    for found, expected in zip(light_in(out), light_in(whole), strict=True):
        np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-5 * np.abs(expected).max())
    assert os.listdir(out.parent) == [out.name]
    assert not [path for path in out.rglob("*") if path.name.startswith(".tofrender-")]


def is_begun(out: Path, name: str) -> bool:
    """Whether a command has something to resume from."""
    if name == "frames":
        return any(
            (each / "frames.json").exists() for each in (out, atomic.sibling(out, ".frames"))
        )
    if name == "dataset":
        return out.exists() or atomic.sibling(out, ".dataset").exists()
    return out.exists() or checkpoints_of_commands.unfinished_work(out) is not None


def test_frames_resume_beside_their_temporary_files(capsys, tmp_path):
    """A killed run leaves hidden files of frames, and of the folder that the frames replace."""
    out = tmp_path / "out"
    command = [*FOLDERS["frames"], "--no-video", "--out", str(out)]
    command[command.index("6")] = "2"
    done(capsys, *command)
    expected = light_in(out)

    # As after a kill: the last frame is not listed, and there are temporary files and folders
    listed = json.loads((out / "frames.json").read_text())
    (out / "frames.json").write_text(json.dumps({"recipe": listed["recipe"], "so_far": {}}))
    steady = np.load(out / "steady.npy")
    steady[1] = np.nan
    np.save(out / "steady.npy", steady)
    half = atomic.sibling(out / "frame_0001", "-0123abcd")
    half.mkdir()
    (half / "transient.npz").write_bytes(b"half")
    atomic.sibling(out / "frames.json", "-0123abcd.json").write_text("{")
    (out / ".tofrender-x.probe").mkdir()

    done(capsys, *command, "--resume")
    assert not hidden(out)
    for found, wanted in zip(light_in(out), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=2e-4, atol=2e-5 * np.abs(wanted).max())

    # A folder that a killed run was removing, or had only just made
    beside = atomic.sibling(out, ".frames")
    beside.mkdir()
    (beside / "steady.npy").write_bytes(b"half")
    assert "already complete, 2 frames" in done(capsys, *command, "--resume")[0]
    assert os.listdir(tmp_path) == ["out"]


def test_a_kill_loses_at_most_the_interval(capsys, tmp_path, monkeypatch):
    """Of a clock that goes on by a second with each step."""
    out, now, lost = tmp_path / "out", [0.0], []

    def look(number):
        now[0] += 1
        samples = 0
        if kept(out).exists():
            with np.load(kept(out)) as archive:
                samples = json.loads(archive["tofrender"].item())["done"]
        lost.append(number + 1 - samples // 16)

    in_small_steps(monkeypatch, 2048)
    watch_steps(monkeypatch, look)
    monkeypatch.setattr(checkpoints, "time", SimpleNamespace(monotonic=lambda: now[0]))
    done(capsys, *arguments("render", out, "--checkpoint", 3))
    assert lost == [1, 2, 3] * (len(lost) // 3) + [1, 2, 3][: len(lost) % 3]
    assert len(lost) > 20


def test_leftovers_go(capsys, tmp_path):
    """Of killed writers of this output, not of others."""
    out = tmp_path / "out"
    mine = [atomic.sibling(out, "-0123abcd"), atomic.sibling(kept(out), "-89abcdef.npz")]
    other = atomic.sibling(tmp_path / "other", "-0123abcd")
    mine[0].mkdir()
    (mine[0] / "half").write_text("x")
    for each in (mine[1], other):
        each.write_text("x")
    done(capsys, *arguments("render", out, spp=4))
    assert set(os.listdir(tmp_path)) == {"out", other.name}


@pytest.mark.parametrize("name", ["render", "gate", "single"])
def test_two_runs_with_one_output(capsys, tmp_path, name):
    """The second is refused at once, and does no harm to the first."""
    out = place(tmp_path, name)
    with atomic.locked(out):
        files = set(os.listdir(tmp_path))
        said = refused(capsys, *arguments(name, out))
        assert said.startswith(f"--out = {out}: another process")
        assert set(os.listdir(tmp_path)) == files
    done(capsys, *arguments(name, out, spp=4))


@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_to_go_on_from(capsys, tmp_path, name):
    said = refused(capsys, *arguments(name, place(tmp_path, name), "--resume"))
    assert said.startswith("--resume: ")
    assert os.listdir(tmp_path) == []


class Stopped:
    """Makes commands of this process small-stepped, and stops them after some steps."""

    def __init__(self, monkeypatch) -> None:
        self.patch = monkeypatch

    def after(self, steps: int, by: int = signal.SIGINT) -> None:
        number = count(1)

        def due(checkpoint) -> bool:
            if next(number) == steps:
                signal.raise_signal(by)
            return False

        in_small_steps(self.patch, 2048)
        self.patch.setattr(Checkpoint, "due", property(due))


@pytest.fixture
def stopped(monkeypatch):
    with monkeypatch.context() as patch:
        yield Stopped(patch)


def stop(capsys, stopped, name, out, *options, steps: int = 3, spp: int = 0) -> str:
    stopped.after(steps)
    status, _, err = run(capsys, *arguments(name, out, *options, spp=spp))
    assert status == 130, err
    return err


def test_without_resume_nothing_is_thrown_away(capsys, tmp_path, stopped):
    out, expected = tmp_path / "out", whole("gate")
    stop(capsys, stopped, "gate", out)
    assert hidden(tmp_path) == [kept(out).name]
    before = kept(out).read_bytes()
    stopped.after(0)
    said = f"a stopped run has left {kept(out)}. Either {AGAIN}, or remove it"
    assert refused(capsys, *arguments("gate", out)) == f"--out = {out}: {said}"
    assert kept(out).read_bytes() == before
    kept(out).unlink()
    done(capsys, *arguments("gate", out))
    require_equal(out, expected)
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("render", ()),
        ("render", ("--format", "zarr")),
        ("render", ("--errors",)),
        ("single", ()),
        ("exhaustive", ()),
    ],
)
def test_what_is_complete_stays(capsys, tmp_path, name, options):
    """`--resume || ...`, as for clusters, would else render all again; 0 whatever was there."""
    out = place(tmp_path, name)
    done(capsys, *arguments(name, out, *options, spp=16))
    before = {file: file.stat().st_mtime_ns for file in [out, *out.rglob("*")]}
    status, told, err = run(capsys, *arguments(name, out, "--resume", *options, spp=16))
    assert (status, err) == (0, "")
    assert told == f"{out}: already complete, 16 samples per pixel\n"
    assert {file: file.stat().st_mtime_ns for file in [out, *out.rglob("*")]} == before
    said = refused(capsys, *arguments(name, out, "--resume", "--seed", 3, *options, spp=16))
    assert "seed = 0" in said
    assert re.search(r"\b3\b", said.split("seed = 0")[1])
    assert os.listdir(tmp_path) == [out.name]


def test_a_checkpoint_on_top_of_an_earlier_render(capsys, tmp_path, stopped):
    """DIR has 128 samples and a stopped run's file more; after Ctrl-C DIR has a part of all."""
    out, expected = tmp_path / "out", whole("render")
    done(capsys, *arguments("render", out, spp=128))
    err = stop(capsys, stopped, "render", out, "--resume")
    assert f"resuming from 128 samples per pixel in {out}" in err
    assert "interrupted after 176 samples per pixel" in err
    assert tofrender.load_npz(out / "transient.npz").attrs["spp"] == 176
    assert "interrupted after 224 samples" in stop(capsys, stopped, "render", out, "--resume")
    stopped.after(0)
    assert "resuming from 224 " in goes_on(capsys, "render", out, expected)


@pytest.mark.parametrize("changed", [False, True])
def test_killed_on_top_of_an_earlier_render(capsys, tmp_path, changed):
    """If the folder has changed since, the checkpoint is of another render's rest."""
    out, expected = tmp_path / "out", whole("render")
    done(capsys, *arguments("render", out, spp=128))
    before = content(out)
    ended(started(arguments("render", out, "--resume")), signal.SIGKILL)
    assert content(out) == before
    if changed:
        rest = kept(out).read_bytes()
        kept(out).unlink()
        done(capsys, *arguments("render", out, spp=64))
        kept(out).write_bytes(rest)
        assert "resuming from 64 samples per pixel" in goes_on(capsys, "render", out, expected)
        return
    err = goes_on(capsys, "render", out, expected)
    assert f"resuming from 128 samples per pixel in {out}\n" in err
    assert f" of {SPP} samples per pixel\n" in err


def test_a_damaged_checkpoint(capsys, tmp_path, stopped):
    out, expected = tmp_path / "out", whole("gate")
    stop(capsys, stopped, "gate", out)
    stopped.after(0)
    content = kept(out).read_bytes()
    kept(out).write_bytes(content[: len(content) // 2])
    err = goes_on(capsys, "gate", out, expected)
    assert err.startswith("warning: ")
    assert "damaged" in err
    assert err.count("\n") == 1


def test_without_checkpoints(capsys, tmp_path, monkeypatch):
    out = tmp_path / "out"
    in_small_steps(monkeypatch, 2048)
    number = count()

    def stopping(launch):
        def step(*arguments, **options):
            assert not kept(out).exists()
            if next(number) == 0:
                signal.raise_signal(signal.SIGINT)
            return launch(*arguments, **options)

        return step

    replace_launch(monkeypatch, stopping)
    status, _, err = run(capsys, *arguments("gate", out, "--checkpoint", 0))
    assert status == 130
    assert one_line(err) == f"error: interrupted after 16 of {SPP} samples per pixel"
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "module", "writer"),
    [
        ("render", cli_render, "write"),
        ("gate", tofrender.io, "save_exr_layers"),
        ("phasor", tofrender.io, "save_exr_layers"),
        ("single", tofrender.io, "save_capture"),
    ],
)
def test_files_become_whole(capsys, tmp_path, monkeypatch, name, module, writer):
    out, expected = place(tmp_path, name), whole(name)
    write, number = getattr(module, writer), count()

    def interrupted(*arguments, **options):
        if not next(number):
            signal.raise_signal(signal.SIGINT)
        return write(*arguments, **options)

    monkeypatch.setattr(module, writer, interrupted)
    status, _, err = run(capsys, *arguments(name, out))
    assert status == 130
    assert one_line(err).startswith("error: interrupted after all files")
    require_equal(out, expected)
    assert os.listdir(tmp_path) == [out.name]
