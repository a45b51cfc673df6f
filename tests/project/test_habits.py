"""What keeps the habits: linters that commits and `make lint` share, and marks of slow tests."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from helpers import durations, workers

ROOT = Path(__file__).parents[2]

TIMES = """
import time
import pytest

def compute(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

@pytest.mark.parametrize("k", range(3))
def test_together(k):
    compute(0.1)

@pytest.mark.slow
def test_marked():
    compute(0.25)

def test_waiting():
    time.sleep(0.25)

def test_quick():
    pass
"""


def run_pytest(folder: Path, *options: str, ci: str = "") -> tuple[int, list[str]]:
    """Exit status and lines of a run with a limit of 0.2 s, without this project's settings."""
    folder.joinpath("test_times.py").write_text(TIMES)
    plugin = (
        "from helpers.durations import *\nfrom helpers import durations\ndurations.LIMIT_S = 0.2\n"
    )
    folder.joinpath("limited.py").write_text(plugin)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "limited", "-p", "no:cacheprovider"]
    paths = os.pathsep.join([str(folder), str(ROOT / "tests")])
    done = subprocess.run(
        [*command, "-c", os.devnull, *options, "test_times.py"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": paths, "CI": ci, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout.splitlines()


@pytest.mark.slow
def test_a_slow_test_without_its_mark_fails(tmp_path):
    said = "test_times.py::test_together: computed for "
    side_by_side = ["-p", "xdist", "-n", "2", "--dist", "worksteal"]
    for options, ci in ((["--strict-durations"], ""), ([], "true"), (side_by_side, "true")):
        status, lines = run_pytest(tmp_path, *options, ci=ci)
        assert status == 1
        told = [line for line in lines if ": computed for " in line]
        assert len(told) == 1, lines
        assert told[0].startswith(said)
        assert told[0].endswith(" s; must be marked slow, or take 0.5 s")
    status, lines = run_pytest(tmp_path)
    assert status == 0, lines
    assert not any(said in line for line in lines)


def test_processes_are_as_many_as_cores_and_memory_allow(monkeypatch):
    for cores, memory, processes in ((1, 99, 0), (4, 99, 4), (64, 99, 8), (8, 7, 3), (8, 3, 0)):
        monkeypatch.setattr(workers, "cores", lambda cores=cores: cores)
        monkeypatch.setattr(workers.memory, "free_on_host", lambda memory=memory: memory << 30)
        assert workers.pytest_xdist_auto_num_workers() == processes


def test_this_session_is_watched_under_ci(request):
    strict = request.config.getoption("strict_durations")
    watch = request.config.pluginmanager.get_plugin("durations")
    assert isinstance(watch, durations.Durations) == bool(strict)


def test_commits_are_checked_by_what_make_lint_runs():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    lint = re.search(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.M)
    assert lint
    checks = [line.strip().replace(" --check", "") for line in lint[1].splitlines()]
    fixes = [hook["entry"].replace(" --fix", "").replace(" --force-exclude", "") for hook in hooks]
    assert [check.removesuffix(" .") for check in checks] == fixes[1:]
    assert fixes[0] == ".venv/bin/python .ci/strip_notebooks.py"


def test_notebooks_are_stripped(tmp_path):
    source = next(iter(sorted((ROOT / "notebooks").glob("*.ipynb"))))
    path = tmp_path / source.name
    notebook = json.loads(source.read_text(encoding="utf-8"))
    cell = next(cell for cell in notebook["cells"] if cell["cell_type"] == "code")
    cell.update(
        execution_count=3, outputs=[{"output_type": "stream", "name": "stdout", "text": "1"}]
    )
    notebook["metadata"]["language_info"]["version"] = "3.12.1"
    path.write_text(json.dumps(notebook), encoding="utf-8")
    command = [sys.executable, ROOT / ".ci" / "strip_notebooks.py", path]
    assert subprocess.run(command, capture_output=True).returncode == 1
    assert path.read_text(encoding="utf-8") == source.read_text(encoding="utf-8")
    assert subprocess.run(command, capture_output=True).returncode == 0
