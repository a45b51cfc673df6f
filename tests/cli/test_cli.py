"""The command line: quick help, one line for whatever is wrong, a folder that appears whole."""

import os
import pty
import re
import shlex
import signal
import subprocess
import sys
import termios

import numpy as np
import OpenEXR
import pytest
import typer
from helpers.commands import COMMAND, HEAVY, ROOT, TINY, done, imported_by, refused, rest_of, run
from helpers.films_in_parts import names
from helpers.limits import lower

import tofrender
from tofrender.apps.warptest.engine import POINT_SETS
from tofrender.apps.warptest.subjects import SUBJECTS
from tofrender.cli import nlos as cli_nlos, options as opt, warp as cli_warp
from tofrender.cli.app import EXAMPLES, GROUPS, LONGEST_SUMMARY, app, main
from tofrender.runtime.atomic import sibling

XML = ROOT / "scenes" / "cornell_box.xml"


def in_a_new_process(code: str) -> str:
    """What a program prints that has `main`, and says at its end which heavy modules are there."""
    start = "import sys; sys.argv = ['tofrender']; from tofrender.cli import main, app\n"
    end = f"\nprint([name for name in {HEAVY!r} if name in sys.modules])"
    command = [sys.executable, "-c", start + code + end]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.stderr == ""
    return done.stdout


EXTRAS = (
    *("anywidget", "cryptography", "dask", "distributed", "jupytext", "laspy", "math_core"),
    *("mdit_py_plugins", "nbclient", "panel", "ptufile", "pytest", "sdtfile", "tomlkit", "zarr"),
)
"""Packages that only extras bring."""


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["--version"], 0, f"tofrender {tofrender.__version__}"),
        (
            ["start", "a1", "mine"],
            1,
            "error: tomlkit is not installed. Run: pip install 'tofrender[course]'",
        ),
    ],
)
def test_without_extras(tmp_path, arguments, status, said):
    absent = f"import sys; sys.modules |= dict.fromkeys({EXTRAS})"
    code = f"{absent}; from tofrender.cli import main; sys.exit(main({arguments}))"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    options: dict = {"capture_output": True, "text": True, "cwd": tmp_path, "env": environment}
    ran = subprocess.run([sys.executable, "-c", code], **options)
    assert (ran.returncode, (ran.stdout + ran.stderr).strip()) == (status, said)
    assert not list(tmp_path.iterdir())


def test_help_imports_nothing_heavy():
    imported, said = imported_by(["--help"])
    assert "Usage: tofrender" in said
    assert "tofrender.cli" in imported
    assert not imported & set(HEAVY)
    commands = typer.main.get_command(app).commands
    code = "\n".join(f"main([{command!r}, '--help'])" for command in commands)
    assert in_a_new_process(code).splitlines()[-1] == "[]"


MODULES = 1065
"""Modules that a small render needs beside those of Python, and 5 % more for later versions."""


def test_a_render_imports_no_more_than_it_needs(tmp_path):
    words = "render cornell_box --size 8x6 --bins 20 --window 3,15 --spp 4 --out"
    arguments = [*words.split(), str(tmp_path / "out")]
    listed = (
        "print(*{n for n in sys.modules if n.partition('.')[0] not in sys.stdlib_module_names})"
    )
    imported = set(in_a_new_process(f"main({arguments!r})\n{listed}").splitlines()[-2].split())
    assert {"matplotlib.figure", "xarray", "tofrender.io.exr"} <= imported
    unused = {"dask", "distributed", "h5py", "rich", "scipy", "tqdm", "zarr", "matplotlib.pyplot"}
    assert not imported & unused
    assert len(imported) < MODULES


def test_bare_command_shows_help(capsys):
    out, _ = done(capsys)
    for command in ("render", "scenes", "doctor"):
        assert command in out


def test_help_lists_every_command_in_one_group(capsys):
    listed = [name for names in GROUPS.values() for name in names]
    assert sorted(listed) == sorted(typer.main.get_command(app).commands)
    out, _ = done(capsys)
    for heading in GROUPS:
        assert f"\n{heading}:\n" in out


def test_every_command_can_hide_its_bars(monkeypatch, capsys, tmp_path):
    for name, command in typer.main.get_command(app).commands.items():
        options = {option for each in command.params for option in each.secondary_opts}
        assert ("--no-progress" in options) == (name not in ("scenes", "doctor"))
    monkeypatch.setattr("tofrender.runtime.progress.is_watched", lambda: True)
    lower(monkeypatch, bar_delay_s=1e-4)
    for option, shown in (("--progress", True), ("--no-progress", False)):
        arguments = ["warp", "tent", "--count", "16", "--out", str(tmp_path / "a.png"), option]
        assert main(arguments) == 0
        assert ("tofrender warp ..." in capsys.readouterr().err) == shown


@pytest.mark.parametrize(
    ("text", "hertz"),
    [("20MHz", 20e6), ("20 MHz", 20e6), ("1.5kHz", 1500.0), ("2e-3GHz", 2e6), ("50Hz", 50.0)],
)
def test_frequencies_have_units(text, hertz):
    assert opt.hertz("", text) == hertz


def test_large_frequencies_need_no_unit():
    assert opt.hertz("", 20e6) == opt.hertz("", "2e7") == 20e6


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("20mhz", " = '20mhz': must be hertz, or like 20MHz"),
        ("MHz", " = 'MHz': must be hertz, or like 20MHz"),
        ("-1MHz", " = -1000000.0: must be a finite number of hertz"),
        ("1e12GHz", " = 1e+21: must be a finite number of hertz"),
    ],
)
def test_frequencies_without_sense(text, said):
    with pytest.raises(ValueError, match="must be") as error:
        opt.hertz("", text)
    assert str(error.value).startswith(said)


def test_version(capsys):
    assert run(capsys, "--version") == (0, f"tofrender {tofrender.__version__}\n", "")


def test_scenes(capsys):
    out, _ = done(capsys, "scenes")
    assert len(out.splitlines()) >= 5
    assert all(len(line) <= 100 for line in out.splitlines())
    assert "cornell_box_glass  " in out


REFUSALS: dict[str, list[tuple[str, str]]] = {
    # a command and what it must have: more words, and what is said of them
    "render cornell_box": [
        ("--sampler multijiter", "--sampler = 'multijiter': did you mean 'multijitter'?"),
        ("--window auto --start-opl 3", "--start-opl = 3: must be left out with --window"),
        ("--window 3,15 --bin-width 1", "--bin-width = 1: must be left out with --win"),
        ("--window 9999,10000 --bins 1000", "bin_width_opl = 0.001: must be at least "),
        ("--window 0,1", "--window = 0 m to 1 m: no light arrives in it; must overlap"),
        ("--spp 10 --errors", "--spp = 10: must be a multiple of 4 with"),
        ("--workers 2 --scheduler a:1", "--scheduler and --workers"),
        ("-D spp=3", "parameter spp = '3': only XML files have parameters"),
        ("--sp 3", "No such option: --sp"),
        ("--spp", "Option '--spp' requires an argument."),
    ],
    "phasor": [
        ("cornell_box --freq 1e-300", "hertz from 1e-09 to 1e+18"),
        ("cornell_box --freq 20MHz --freq 2e7", "--freq = 20000000.0: must be given once"),
        ("cornell_box", "Missing option '--freq'"),
        ("cornel_box --freq 2e7", "unknown name. Use cornell_box"),
    ],
    "gate cornell_box": [("--at 1 --size 8x8", "--at = 1: no light")],
    "capture nlos-z": [("--out missing/z.h5", "--out = missing/z.h5: the folder")],
    "capture cornell_box": [("--out c.h5", "cornell_box has no relay wall")],
    "warp": [
        ("bekmann", "NAME = 'bekmann': did you mean 'beckmann'? Must be one of tent, uniform_"),
        ("beckmann", "--alpha is missing"),
        ("tent --alpha 1", "--alpha = 1 does not belong to the warp tent"),
        ("tent --image a.exr", "--image = a.exr does not belong to the warp tent"),
        ("hierarchical", "--image is missing"),
        ("hierarchical --image no.exr", "--image = 'no.exr': must be a file that exists"),
    ],
}


@pytest.mark.parametrize(
    ("command", "words", "text"),
    [
        pytest.param(command, words, text, id=f"{command} {words}")
        for command, cases in REFUSALS.items()
        for words, text in cases
    ],
)
def test_bad_options_are_refused_in_one_line(capsys, tmp_path, monkeypatch, command, words, text):
    monkeypatch.chdir(tmp_path)
    out = [] if "--out" in words else ["--out", f"out{'.png' * (command == 'warp')}"]
    assert text in refused(capsys, *command.split(), *out, *words.split())
    assert not list(tmp_path.iterdir())


BAD_NUMBERS = ["inf", "-inf", "1e400", "9" * 5000, "", " 3", "1_0", "0x10", "\u0663", "-2"]
ALL_KINDS = {"render": ["--spp", "--bin-width", "--max-depth"], "gate": ["--at"]}
NUMBERS = {
    "render": ["--bins", "--start-opl", "--pulse-width", "--seed"],
    "phasor": ["--freq", "--spp", "--max-depth", "--seed"],
    "gate": ["--pulse-width", "--spp", "--max-depth", "--seed"],
    "capture": ["--spp", "--seed", "--grid"],
    "warp": ["--alpha", "--count", "--seed"],
    "verify": ["--seeds"],
    "grade": ["--time-limit", "--memory", "--jobs"],
    **{key: ["--time-limit", "--memory"] for key in ("gradescope", "prairielearn", "classroom50")},
    "new-term": ["--term"],
}


def test_bad_numbers_are_refused_before_anything_is_imported():
    cases = [(c, o, text) for c in ALL_KINDS for o in ALL_KINDS[c] for text in BAD_NUMBERS]
    cases += [(c, o, text) for c in NUMBERS for o in NUMBERS[c] for text in ("nan", "\u0663")]
    cases += [("render", "--spp", "2.5"), ("verify", "--seeds", "1.0")]
    code = f"""
import contextlib, io
for command, option, text in {cases!r}:
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        status = main([command, option, text])
    line, start = said.getvalue(), f"error: {{option}} = "
    if status != 2 or line.count("\\n") != 1 or not line.startswith(start):
        print(command, option, repr(text[:9]), status, line)
"""
    assert in_a_new_process(code) == "[]\n"


def test_choices_are_those_there_are():
    """The command line names them without importing what has them."""
    for choices, there in (
        (cli_nlos.MODES, tofrender.nlos.MODES),
        (cli_nlos.METHODS, tofrender.nlos.METHODS),
        (cli_warp.WARPS, SUBJECTS),
        (cli_warp.POINT_SETS, POINT_SETS),
    ):
        assert set(choices) == set(there)


def test_help_says_types_ranges_and_defaults(capsys):
    words = " ".join(run(capsys, "render", "--help")[1].split())
    for text in (
        "--spp N Samples per pixel (1 to 16777216). [default: (from the scene)]",
        "--start-opl NUMBER ",
        "--bin-width NUMBER ",
        "--seed N Seed of all random numbers (0 to 4294967295). [default: 0]",
        "--format NAME File format of the transient (one EXR per bin, one PNG per bin, ",
        ": frames, png, multipart, npz, zarr.",
        "--size WxH ",
    ):
        assert text in words


def test_every_help_has_a_short_summary_two_examples_and_no_types(capsys):
    for name, command in typer.main.get_command(app).commands.items():
        assert len(command.get_short_help_str(200)) <= LONGEST_SUMMARY
        text = run(capsys, name, "--help")[1]
        _, _, examples = text.partition("\nExamples:\n")
        assert [line.split()[:2] for line in examples.splitlines()] == 2 * [["tofrender", name]]
        assert not re.search(r"<\w+", text)


def test_examples_of_the_help_have_options_that_exist():
    """The options of each example are parsed. Files need not exist for that."""
    for name, command in typer.main.get_command(app).commands.items():
        _, _, examples = command.help.partition(EXAMPLES)
        for example in examples.splitlines():
            arguments = shlex.split(example)[2:]
            with command.make_context(name, arguments) as context:
                assert context.params


def test_bad_scene_is_one_line(capsys, tmp_path):
    out = ["--out", tmp_path / "out"]
    assert "unknown name. Use cornell_box" in refused(capsys, "render", "cornel-box", *out)
    assert "no.xml" in refused(capsys, "render", "no.xml", *out)
    broken = tmp_path / "broken.xml"
    broken.write_text('<scene version="3.0.0">\n<shape>\n')
    assert "broken.xml" in refused(capsys, "render", broken, *out)
    said = refused(capsys, "render", XML, *out, "-D", "w=3")
    assert "parameter w = '3'" in said
    assert "width, height" in said
    assert "Missing option '--out'" in refused(capsys, "render", "cornell_box")
    assert "did you mean 'render'" in refused(capsys, "rendr").lower()


def test_folder_with_other_content_is_refused(capsys, tmp_path):
    (tmp_path / "thesis.tex").write_text("dear")
    line = refused(capsys, "render", "cornell_box", "--out", tmp_path)
    assert line.startswith(f"--out = {tmp_path}: ")
    assert "thesis.tex" in line
    assert (tmp_path / "thesis.tex").read_text() == "dear"
    assert "--out" in refused(capsys, "render", "cornell_box", "--out", tmp_path / "thesis.tex")
    assert "--out" in refused(capsys, "render", "cornell_box", "--out", "/proc/out")


def test_failure_is_one_line_and_status_one(capsys, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("the lamp\n  broke")

    monkeypatch.setattr("tofrender.rendering.work_items.render_item", fail)
    arguments = ["render", "cornell_box", "--out", str(tmp_path / "out"), *TINY]
    assert run(capsys, *arguments) == (1, "", "error: the lamp broke\n")
    monkeypatch.setenv("TOFRENDER_DEBUG", "1")
    with pytest.raises(RuntimeError):
        main(arguments)


FRAMES = {f"frame_{k:04d}.exr" for k in range(20)} | {"steady.exr", "summary.png"}


def test_render_and_render_again(capsys, tmp_path):
    folder = tmp_path / "box"
    arguments = ["render", "cornell-box", "--out", folder, *TINY]
    for video in ("--no-video", "--video"):
        out, _ = done(capsys, *arguments, video)
        assert names(folder) == FRAMES | ({"video.mp4"} if video == "--video" else set())
        assert "frame_0000.exr ... frame_0019.exr, steady.exr, summary.png" in out
        assert "samples per second" in out
        assert "% of the energy outside the window" in out
    assert names(tmp_path) == {"box"}
    dataset = tofrender.load_exr_stack(folder)
    assert dataset.attrs["scene"] == "cornell_box"
    assert dataset.attrs["spp"] == 4
    assert dict(dataset.sizes) == {"y": 6, "x": 8, "opl": 20, "channel": 3}


@pytest.mark.parametrize(("layout", "file"), [("multipart", "stack.exr"), ("npz", "transient.npz")])
def test_formats(capsys, tmp_path, layout, file):
    folder = tmp_path / "box"
    arguments = ["render", XML, "--out", folder, *TINY, "--no-video", "--format", layout]
    done(capsys, *arguments, "-D", "max_depth=2")
    assert names(folder) == {file, "summary.png"}


def test_a_film_outlives_files_that_cannot_be_written(capsys, tmp_path, monkeypatch):
    arguments = ["render", "cornell_box", "--out", tmp_path / "a", *TINY, "--format", "zarr"]

    def full(*_, **__):
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(tofrender.vis, "summary_figure", full)
        assert run(capsys, *arguments, "--no-video")[0] == 1
    done(capsys, *arguments, "--no-video", "--resume")
    assert tofrender.load_zarr(tmp_path / "a" / "transient.zarr").attrs["complete"] == 1
    assert names(tmp_path) == {"a"}


def test_settings_arrive(capsys, tmp_path):
    options = "--start-opl 3.0 --pulse-width 0.05 --max-depth 2 --seed 7 --sampler multijitter"
    options = [*TINY, *options.split(), "--format", "npz", "--no-video"]
    done(capsys, "render", "cornell_box_steady_state", "--out", tmp_path / "box", *options)
    dataset = tofrender.load_npz(tmp_path / "box" / "transient.npz")
    assert dataset.attrs["start_opl"] == pytest.approx(3.0)
    assert dataset.attrs["bin_width_opl"] == pytest.approx(0.3)
    assert "multijitter" in dataset.attrs["sampler"].lower()
    assert dataset.attrs["seed"] == 7
    assert "0.05" in dataset.attrs["pulse"]


@pytest.mark.parametrize("scene", ["cornell_box", "cornell_box_steady_state"])
def test_window_auto(capsys, tmp_path, scene):
    arguments = ["--size", "8x6", "--spp", "4", "--bins", "16", "--window", "auto"]
    folder = tmp_path / "box"
    out = ["--out", folder, "--format", "npz", "--no-video"]
    status, _, err = run(capsys, "render", scene, *out, *arguments)
    assert (status, err) == (0, "")
    dataset = tofrender.load_npz(folder / "transient.npz")
    assert dataset.sizes["opl"] == 16
    assert 3 < dataset.attrs["start_opl"] < 4
    assert dataset.attrs["energy_outside_window"] < 0.01


def test_lost_energy_is_one_line(capsys, tmp_path):
    arguments = ["render", "cornell_box", "--out", tmp_path / "box", *TINY, "--no-video"]
    _, err = done(capsys, *arguments, "--bins", "8")
    assert err.startswith("warning: ")
    assert err.count("\n") == 1


def test_ctrl_c(tmp_path):
    folder = tmp_path / "box"
    size = ["--size", "64x64", "--max-depth", "4", "--spp", str(1 << 24)]
    screen, stderr = pty.openpty()  # The bar shows in a terminal only
    termios.tcsetwinsize(stderr, (24, 80))
    process = subprocess.Popen(
        [*COMMAND, "render", "cornell_box", "--out", folder, *size, "--no-video"],
        cwd=ROOT,
        stderr=stderr,
    )
    os.close(stderr)
    try:
        shown = b""
        while b"Rendering" not in shown:
            shown += os.read(screen, 1 << 12)
        process.send_signal(signal.SIGINT)
        err = rest_of(screen)
        process.wait()
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "error: interrupted after" in err
    assert names(tmp_path) == {"box", sibling(folder, ".checkpoint.npz").name}
    dataset = tofrender.load_exr_stack(folder)
    assert 0.9 < float(dataset.transient.sum() / dataset.steady.sum()) < 1.0


def test_phasors_of_a_scene(tmp_path, capsys):
    out = tmp_path / "phasors"
    options = ["--freq", "20e6", "--freq", "50e6", "--out", out, "--size", "8x6", "--spp", "4"]
    for _ in range(2):  # Its own output is replaced
        told, _ = done(capsys, "phasor", "cornell_box_flash", *options)
        assert "panel.png" in told
    assert names(out) == {"phasor_20MHz.exr", "phasor_50MHz.exr", "panel.png"}
    channels = OpenEXR.File(str(out / "phasor_20MHz.exr")).channels()
    assert set(channels) == {"I", "Q", "amplitude", "phase", "depth"}
    depth = channels["depth"].pixels
    assert depth.shape == (6, 8, 3)
    assert 0 <= depth.min() <= depth.max() < 7.5


def test_phasors_of_a_render(tmp_path, capsys):
    """Converted from bins, they are those that are rendered, up to what the window lost.

    Of a flash, whose bins and phasors take the same paths.
    """
    folder, converted, direct = (tmp_path / name for name in ("render", "converted", "direct"))
    tiny = ["--size", "8x6", "--spp", "16"]
    window = ["--start-opl", "3", "--bins", "3000", "--bin-width", "0.01", "--no-video"]
    commands = (
        ("render", "cornell_box_flash", "--out", folder, *tiny, *window, "--max-depth", "8"),
        ("phasor", folder, "--freq", "20e6", "--out", converted),
        ("phasor", "cornell_box_flash", "--freq", "20e6", "--out", direct, *tiny),
    )
    for command in commands:
        done(capsys, *command)
    first, second = (
        OpenEXR.File(str(path / "phasor_20MHz.exr")).channels()["I"].pixels
        for path in (converted, direct)
    )
    np.testing.assert_allclose(first, second, atol=0.01 * np.abs(second).max())


def test_a_gate(tmp_path):
    out = tmp_path / "gate"
    options = ["--at", "5.9", "--size", "16x12", "--spp", "4", "--out", str(out)]
    assert main(["gate", "cornell_box", *options]) == 0
    assert names(out) == {"gate.exr", "picture.png"}
    assert OpenEXR.File(str(out / "gate.exr")).channels()["RGB"].pixels.shape == (12, 16, 3)


def test_phasors_below_a_hertz_have_files_of_their_own(tmp_path):
    command = ["phasor", "cornell_box", "--out", str(tmp_path / "out"), "--size", "2x2"]
    for _ in range(2):  # The second replaces the first
        assert main([*command, "--spp", "1", "--freq", "0.1Hz", "--freq", "0.2Hz"]) == 0
    assert {"phasor_0.1Hz.exr", "phasor_0.2Hz.exr"} < names(tmp_path / "out")


def test_control_characters_of_names_do_not_reach_the_terminal(tmp_path, capsys):
    out = tmp_path / "red\x1b[31m"
    assert main(["gate", "cornell_box", "--at", "6", "--size", "2x2", "--out", str(out)]) == 0
    assert main(["gate", "cornell_box", "--at", "6", "--out", str(out / "gate.exr" / "\x9b")]) == 2
    assert main(["gate", "cornell_box", "--at", "6", "--out", "a\nb"]) == 2
    said = "".join(capsys.readouterr())
    assert "must be a name in one line" in said
    assert "\\x1b[31m" in said
    assert not set(said) & {"\x1b", "\x9b"}


def test_phasors_of_a_folder_without_a_render(tmp_path, capsys):
    folder = tmp_path / "empty"
    folder.mkdir()
    arguments = ["phasor", folder, "--freq", "2e7", "--out", tmp_path / "out"]
    assert "does not contain a render" in refused(capsys, *arguments)
    for option in (["--size", "8x6"], ["--spp", "4"], ["--max-depth", "2"]):
        error = refused(capsys, *arguments, *option)
        assert error.startswith(f"{' = '.join(option)} ")
        assert str(folder) in error


IMPORT_INTERRUPTED = """
import signal, sys
sys.argv[0] = "tofrender"

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "mitsuba.python":
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
from tofrender.cli.app import app, main
sys.exit(main(["merge", "a", "b", "--out", "c"]))
"""


@pytest.mark.parametrize("where", ["command line", "command"])
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_status_after_a_signal(capsys, monkeypatch, where, name, status):
    def stopped(*_, **__):
        signal.raise_signal(getattr(signal, name))

    if where == "command":
        monkeypatch.setattr("tofrender.runtime.backend.activate", stopped)
    else:
        monkeypatch.setattr("typer.core.TyperGroup.make_context", stopped)
    usual = {signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    usual |= {signal.SIGINT: signal.default_int_handler}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    try:
        assert run(capsys, "merge", "a", "b", "--out", "c") == (status, "", "error: interrupted\n")
        assert {number: signal.getsignal(number) for number in usual} == usual
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_an_interrupted_import_of_mitsuba_ends_as_ctrl_c_does():
    command = [sys.executable, "-c", IMPORT_INTERRUPTED]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (130, "error: interrupted\n")
