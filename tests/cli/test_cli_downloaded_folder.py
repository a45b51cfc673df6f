"""No command runs Python files of the folder that it is started in."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import course_assignment, tiny_assignment, twin_recordings
from helpers.processes import GUARD_S, ROOT

from tofrender.cli.app import GROUPS
from tofrender.course import notebooks

COMMAND = Path(sys.executable).with_name("tofrender")
SMALL = ["--size", "8x6", "--spp", "1"]
TIMES = ["--bins", "6", "--window", "3,15"]

DATASET = """
records = 2
seed = 3
scene = "cornell_box"

[render]
width = 8
height = 6
spp = 1
temporal_bins = 6
window = [3, 15]

[outputs]
transient = true

[vary.turn]
turn = "small-box"
distribution = "uniform"
low = -40
high = 40
"""

RUNS = {
    "scenes": ["scenes"],
    "doctor": ["doctor"],
    "render": ["render", "cornell_box", "--out", "one", *SMALL, *TIMES, "--workers", "1"],
    "another render": ["render", "cornell_box", "--out", "two", *SMALL, *TIMES, "--seed", "1"],
    "merge": ["merge", "one", "two", "--out", "both"],
    "gate": ["gate", "cornell_box", "--out", "gate", *SMALL, "--at", "6"],
    "phasor": ["phasor", "one", "--out", "phasor", "--freq", "20MHz"],
    "doppler": ["doppler", "corridor", "--out", "doppler", *SMALL],
    "fmcw": ["fmcw", "corridor", "--out", "fmcw", *SMALL],
    "lidar": ["lidar", "cornell_box", "--out", "points.ply", "--spp", "1"],
    "dataset": ["dataset", "boxes.toml", "--out", "boxes.zarr", "--workers", "1"],
    "capture": ["capture", "nlos_patch", "--out", "hidden.hdf5", "--spp", "1", "--grid", "4x4"],
    "reconstruct": ["reconstruct", "hidden.hdf5", "--out", "volume"],
    "sense": ["sense", "one", "--sensor", "scanning_dtof", "--out", "counts"],
    "twin": ["twin", "recordings", "--out", "twin", "--spp", "1", "--dpi", "40"],
    "report": ["report", "one", "--out", "report.html"],
    "warp": ["warp", "tent", "--out", "tent.png"],
    "warptest": ["warptest", "tent", "--headless", "--out", "tent2.png"],
    "start": ["start", "a2", "student"],
    "submit": ["submit", "tiny", "handed_in"],
    "verify": ["verify", "tiny", "--only", "structure"],
    "release": ["release", "tiny", "--out", "released"],
    "grade": ["grade", "sums", "--submission", "right", "--out", "results.json"],
    "grade all": ["grade", "sums", "--all", "class", "--csv", "grades.csv"],
    "gradescope": ["gradescope", "tiny", "--out", "gradescope.zip"],
    "prairielearn": ["prairielearn", "tiny", "--out", "prairielearn.zip"],
    "classroom50": ["classroom50", "tiny", "--out", "classroom50.zip"],
    "similarity": ["similarity", "sums", "--all", "class", "--out", "compared"],
    "new-term": ["new-term", "tiny"],
}
SERVERS = {"view": ["view", "one"], "compare": ["compare", "one", "two"], "warptest": ["warptest"]}


@pytest.fixture(scope="module")
def downloaded(tmp_path_factory):
    """Folder with a module of every name of the standard library, each of which leaves a line."""
    folder = tmp_path_factory.mktemp("downloaded")
    for name in sorted(sys.stdlib_module_names):
        text = f"open({str(folder / 'ran')!r}, 'a').write({name!r} + chr(10))\n"
        (folder / f"{name}.py").write_text(text + f"raise ImportError({name!r})\n")
    (folder / "boxes.toml").write_text(DATASET)
    course_assignment.write(folder / "tiny")
    course_assignment.write_submission(folder / "handed_in")
    tiny_assignment.sums(folder / "sums")
    twin_recordings.write_recordings(folder / "recordings")
    for submission in ("right", "class/ada"):
        tiny_assignment.write(folder / submission, {"p0.py": tiny_assignment.ADD0})
    return folder


def ran_in(folder: Path) -> list[str]:
    """Modules of the folder that have run since the last call."""
    path = folder / "ran"
    lines = path.read_text().splitlines() if path.exists() else []
    path.unlink(missing_ok=True)
    return lines


def environment(folder: Path) -> dict[str, str]:
    kept = {name: text for name, text in os.environ.items() if name != "PYTHONSAFEPATH"}
    return kept | {"PYTHONPATH": str(ROOT)}


def test_the_folder_is_a_trap(downloaded):
    """Python itself falls for it."""
    options: dict = {"cwd": downloaded, "env": environment(downloaded), "capture_output": True}
    subprocess.run([sys.executable, "-c", "import selectors"], **options)
    assert ran_in(downloaded) == ["selectors"]


def test_all_commands_are_tried():
    tried = {command[0] for command in [*RUNS.values(), *SERVERS.values()]}
    assert tried == {name for names in GROUPS.values() for name in names}


@pytest.mark.parametrize("name", RUNS)
def test_command_runs_nothing_of_its_folder(name, downloaded):
    """Neither the command nor any process that it starts."""
    options: dict = {"cwd": downloaded, "env": environment(downloaded), "timeout": GUARD_S}
    done = subprocess.run([COMMAND, *RUNS[name]], capture_output=True, text=True, **options)
    assert ran_in(downloaded) == []
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", SERVERS)
def test_server_runs_nothing_of_its_folder(name, downloaded):
    options: dict = {"cwd": downloaded, "env": environment(downloaded), "text": True}
    options |= {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    server = subprocess.Popen([COMMAND, *SERVERS[name], "--no-browser"], **options)
    try:
        lines = []
        for line in server.stdout:
            lines.append(line)
            if "http" in line:
                break
        assert ran_in(downloaded) == []
        assert "http" in lines[-1], lines
    finally:
        server.kill()
        server.communicate()


def test_workers_run_nothing_of_their_folder(downloaded, tmp_path):
    """Those of Python code, too; afterwards the environment is as before."""
    code = "import os, tofrender\nif __name__ == '__main__':\n"
    code += "    with tofrender.local_workers(1, threads=1) as client:\n"
    code += "        print(client.submit(len, 'abc').result())\n"
    code += "    print(os.environ.get('PYTHONSAFEPATH'))\n"
    options: dict = {"cwd": downloaded, "env": environment(downloaded), "timeout": GUARD_S}
    script = tmp_path / "script.py"
    script.write_text(code)
    command = [sys.executable, script]
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert ran_in(downloaded) == []
    assert done.stdout.split() == ["3", "None"], done.stderr


def test_notebook_runs_nothing_of_its_folder(downloaded, monkeypatch):
    """The kernel imports the standard library before the notebook chooses its own folder."""
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    path = downloaded / "notebook.ipynb"
    notebooks.write("# %%\nimport selectors\n", downloaded, path)
    notebooks.execute(path)
    assert ran_in(downloaded) == []
