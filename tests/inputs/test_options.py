"""Every option of every command with bad text: one line on stderr, status 2, nothing written."""

from pathlib import Path

import pytest
import typer
from helpers.bad_inputs import OTHER_FILES, kind_of_setting, listing, one_clear_line, sample
from helpers.hidden_scenes import small_capture as captured
from helpers.made_dataset import make_dataset

from tofrender import io
from tofrender.cli.app import app, main
from tofrender.rendering.settings import SETTINGS

SCENE = ["cornell_box", "--size", "4x4", "--spp", "1"]
COMMANDS: dict[str, list[str]] = {
    "render": [*SCENE, "--bins", "4", "--bin-width", "4"],
    "phasor": [*SCENE, "--freq", "2e7"],
    "gate": [*SCENE, "--at", "6"],
    "doppler": SCENE,
    "fmcw": SCENE,
    "capture": ["nlos_plane", "--grid", "2x2", "--spp", "1"],
    "lidar": ["cornell_box", "--shots", "2x2", "--spp", "1"],
    "reconstruct": ["wall.h5", "--method", "bp"],
    "merge": ["a", "b"],
    "sense": ["render", "--sensor", "itof"],
    "twin": ["folder"],
    "warp": ["beckmann", "--alpha", "0.5", "--count", "4"],
    "warptest": ["beckmann", "--headless", "--alpha", "0.5", "--count", "4"],
    "view": ["cornell_box", "--live", "--size", "4x4", "--spp", "1", "--no-browser"],
    "compare": ["veach", "--no-browser"],
    "report": ["wall.h5"],
    "release": ["a1"],
    "verify": ["a1"],
    "start": ["a1", "folder"],
    "submit": ["a1", "folder"],
    "grade": ["a1", "--submission", "folder"],
    **{key: ["a1", "-o", "a.zip"] for key in ("gradescope", "prairielearn", "classroom50")},
    "similarity": ["a1", "--all", "folder", "-o", "x"],
    "new-term": ["a1"],
}
KINDS = {
    "choice": "--figure --format --method --mode --only --pattern --points --precision --variant "
    "--waveform --wall --window-function assignment name one",
    "count": "--count --cycles --frames --jobs --port --poses --pulses --samples --seeds --wrong",
    **{
        "file": "--module --submission --capture",
        "positive": "--bandwidth --bin-width-s --chirp --frame-time --freq --megabytes --memory "
        "--photons --pose-time --rate --wavelength",
    },
    **{"meters": "--start-s", "sides": "--wall-size"},
    **{
        "alpha": "--alpha",
        "dots": "--dpi",
        "from 0": "--at --checkpoint --exposure --row-time",
        "half-angle": "--divergence",
        "seed": "--looks --rate-bins --term",
        "span": "--rates",
    },
    **{
        "from 30": "--time-limit",
        "host": "--host",
        "render": "sources",
        "angles": "--fov",
        "sizes": "--grid --shots",
    },
}
"""The kind of each option and argument, see `bad_inputs.KINDS`."""
OPTIONS = {name: kind for kind, names in KINDS.items() for name in names.split()}
OPTIONS |= {f"--{name.replace('_', '-')}": kind_of_setting(s) for name, s in SETTINGS.items()}
OPTIONS |= {
    **{"-D": "definition", "scene": "source", "view source": "source", "phasor source": "render"},
    **{"sense source": "render", "sense --sensor": "choice"},
    **{"reconstruct source": "file", "report source": "file", "submit folder": "file"},
    **{"twin source": "render"},
    **{"gate --pulse-width": "positive"},
    **{"doppler --exposure": "positive"},
}
SAID = {"--wall": "relay_wall", "--capture": "path", "-D": "", "--submission": ""}
"""What a message names for an option, where that is not the option; no argument is named."""
ELSEWHERE = {
    "test_outputs.py has the places": "--out",
    "a switch": "--video --pdf --resume --errors --denoise --json --browser --headless --live "
    "--progress dataset:plan",
    "the course's tests": "--csv --all --roster --sheet --feedback --columns start:folder"
    " similarity:old",
    "test_warp_images": "--image",
    "any text": "report:title",
    "as of others": "warp:parameters warptest:host compare:two dataset:workers dataset:scheduler",
    "test_cli_dataset.py and tests/datasets": "dataset:config dataset:only dataset:variant",
    "no other options": "scenes doctor",
}
"""Who tries other options."""
TRIED = {name.replace(":", " ") for names in ELSEWHERE.values() for name in names.split()}
SUFFIXES = {
    "capture": ".h5",
    "lidar": ".ply",
    "report": ".html",
    "warp": ".png",
    "warptest": ".png",
    "view": ".npz",
}
COURSE = {"verify", "start", "submit", "grade", "gradescope", "prairielearn", "classroom50"}
COURSE |= {"similarity", "new-term"}
WITHOUT_OUT = COURSE | {"compare"}


@pytest.fixture
def no_work(no_work, monkeypatch):
    """Nor is anything served."""
    monkeypatch.setattr("panel.io.server.get_server", no_work)


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    return io.save_capture(captured(), tmp_path_factory.mktemp("wall") / "wall.h5").read_bytes()


def cases() -> list[tuple[str, str, str]]:
    """Commands, their options, and the kind of each."""
    found = []
    for command, described in typer.main.get_command(app).commands.items():
        for parameter in described.params:
            option = parameter.opts[0]
            named = {*parameter.opts, command, f"{command} {parameter.name}"}
            if not named & TRIED:
                kind = OPTIONS.get(f"{command} {option}", OPTIONS.get(option, "unknown"))
                found.append((command, option, kind))
    return found


def replaced(command: str, option: str, text: str) -> list[str]:
    """Arguments with another value for one of them."""
    good = list(COMMANDS[command])
    if not option.startswith("-"):
        at = 1 if (command, option) == ("submit", "folder") else 0
        good[at] = text
        return good
    if option in good and option != "--only":
        del good[good.index(option) : good.index(option) + 2]
    return [*good, option, text]


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("command", "option", "kind", "start"),
    [pytest.param(*case, number, id="".join(case[:2])) for number, case in enumerate(cases())],
)
def test_bad_options(
    tmp_path, monkeypatch, capsys, pytestconfig, wall, command, option, kind, start
):
    monkeypatch.chdir(tmp_path)
    Path("wall.h5").write_bytes(wall)
    before = listing(tmp_path)
    out = [] if command in WITHOUT_OUT else ["--out", f"out{SUFFIXES.get(command, '')}"]
    texts = sample(kind, pytestconfig.getoption("--all-inputs"), start, texts=True)
    name = SAID.get(option, option) if option.startswith("-") else ""
    wrong = {}
    for label, text in texts.items():
        if not option.startswith("-") and text.startswith("-"):
            continue
        status = main([command, *replaced(command, option, text), *out])
        said = capsys.readouterr().err
        what = one_clear_line(ValueError(said.removeprefix("error: ").rstrip("\n")), name)
        if status != 2 or what or not said.startswith("error: ") or listing(tmp_path) != before:
            wrong[label] = (status, what or said)
    assert not wrong


@pytest.mark.parametrize("what", ["missing", "folder", "text", "empty", "pipe"])
def test_warp_images(tmp_path, capsys, what):
    path = tmp_path / "a.exr"
    OTHER_FILES[what](path)
    arguments = ["warp", "hierarchical", "--image", str(path), "--out", str(tmp_path / "b.png")]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith("error: --image = ")


@pytest.mark.parametrize("words", [["--spp"], ["--nonsense"], ["extra", "word"], ["--seed=x=y"]])
@pytest.mark.parametrize("command", ["render", "phasor", "gate", "capture", "reconstruct", "warp"])
def test_words_that_make_no_sense(tmp_path, monkeypatch, capsys, command, words):
    monkeypatch.chdir(tmp_path)
    assert main([command, *COMMANDS[command], "--out", "out", *words]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_damaged_render_has_no_phasors(tmp_path, capsys):
    folder = io.save_exr_stack(make_dataset(2, 3, 3), tmp_path / "render", progress=False)
    (folder / "steady.exr").write_bytes(b"text")
    assert main(["phasor", str(folder), "--freq", "2e7", "--out", str(tmp_path / "out")]) == 2
    assert "must be a readable EXR file as it was saved" in capsys.readouterr().err
