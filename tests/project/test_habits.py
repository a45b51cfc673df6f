"""What keeps the habits: linters that commits and `make lint` share, and marks of slow tests."""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from helpers import affected, selection, workers
from helpers.limits import lower
from mutants.planting import Bug, bugs, planted as plant

ROOT = Path(__file__).parents[2]

TIMES = """
import time
import pytest

def compute(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

@pytest.fixture(scope="module")
def shared():
    compute(0.2)

@pytest.mark.parametrize("a", range(4))
@pytest.mark.parametrize("b", range(3))
def test_many_cases(a, b):
    compute(0.04)

def test_long():
    compute(0.7)

@pytest.mark.essential
def test_essential():
    compute(0.7)

def test_fixture_is_charged_to_its_users(shared):
    pass

def test_waiting():
    time.sleep(0.3)

def test_quick():
    pass
"""

CONFTEST = """
from pathlib import Path
from helpers import durations, selection

durations.FILE = Path(__file__).parent / "tests" / "durations.json"
durations.LIMIT_S = 0.6
selection.FAST_S, selection.CASES_S, selection.CASE_S = 0.06, 0.18, 0.6
"""


@pytest.fixture
def run(tmp_path):
    """Run pytest on a file of its own, without this project's settings: its status and lines."""
    tmp_path.joinpath("tests").mkdir()
    tmp_path.joinpath("test_times.py").write_text(TIMES)
    tmp_path.joinpath("conftest.py").write_text(CONFTEST)
    paths = os.pathsep.join([str(tmp_path), str(ROOT / "tests")])
    settings = {"PYTHONPATH": paths, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}

    def run(*options: str, ci: str = "") -> tuple[int, list[str]]:
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull]
        command += ["-p", "helpers.durations", "-p", "helpers.selection"]
        done = subprocess.run(
            [*command, *options, "test_times.py"],
            cwd=tmp_path,
            env=os.environ | settings | {"CI": ci},
            capture_output=True,
            text=True,
        )
        return done.returncode, done.stdout.splitlines()

    return run


def test_make_test_runs_what_durations_say(run, tmp_path):
    assert run("--store-durations")[0] == 0
    file = tmp_path / "tests" / "durations.json"
    stored = json.loads(file.read_text())["test_times.py"]
    near = {"test_many_cases": 0.04, "test_long": 0.7, "test_essential": 0.7, "@shared": 0.2}
    assert stored == pytest.approx(near, rel=0.2, abs=0.03)
    file.write_text(json.dumps({"test_times.py": near}))
    for processes in ([], ["-p", "xdist", "-n", "2"]):
        status, lines = run("--brief", *processes)
        assert status == 0, lines
        assert any(line.startswith("8 passed") for line in lines), lines
        assert "of 17 cases, among them 1 of 6 tests whole" in lines[-1]

    # What a case takes in make test decides how many of them run there.
    assert run("--brief", "--store-durations")[0] == 0
    known = json.loads(file.read_text())["test_times.py"]
    assert known["test_long"] == near["test_long"]
    assert known["brief test_many_cases"] == pytest.approx(0.04, rel=0.2, abs=0.03)
    file.write_text(json.dumps({"test_times.py": near | {"brief test_many_cases": 0.08}}))
    status, lines = run("--brief")
    assert any(line.startswith("6 passed") for line in lines), lines
    file.write_text(json.dumps({"test_times.py": near}))

    status, lines = run("-m", "not slow")
    assert status == 0, lines
    assert lines[-1].startswith("2 passed")
    assert sorted(run("--shard", f"{k}/2")[0] for k in (1, 2)) == [0, 5]  # 5: there are no tests
    assert run("--shard", "3/2")[0] == 4
    status, lines = run("--brief", ci="true")
    assert status == 1, lines
    told = "test_times.py::test_essential: computed for 0."
    assert len([line for line in lines if line.startswith(told)]) == 1, lines


class Case:
    """A case of a test, as pytest describes it."""

    def __init__(self, name: str, **indices: int) -> None:
        self.nodeid = name
        self.callspec = SimpleNamespace(indices=indices)


def test_cases_are_chosen_so_that_each_value_occurs():
    cases = [Case("t", a=a, b=b, c=c) for a in range(4) for b in range(3) for c in range(2)]
    chosen = selection.covering(cases, 4)
    for name, count in (("a", 4), ("b", 3), ("c", 2)):
        assert {case.callspec.indices[name] for case in chosen} == set(range(count))
    assert selection.covering(cases, 99) == cases


def case_times(name: str, seconds: float, count: int = 1) -> selection.Test:
    """A test with cases that each take some seconds."""
    return selection.Test([Case(name)] * count, seconds, 0)


def test_a_change_runs_the_whole_tests_of_its_package_and_of_importers():
    own = [case_times(f"tests/films/test_{k}.py::t", 100) for k in range(4)]
    others = [case_times(f"tests/paths/test_{k}.py::t", 150) for k in range(9)]
    rest = [case_times("tests/io/test_a.py::t", 1), case_times("tests/conftest.py::t", 1)]
    every = [*own, *others, *rest]

    # All fit into the time.
    assert selection.whole(every, {"films"}, set(), 0) == own
    assert selection.whole(every, {"films"}, {"io"}, 0) == [*own, rest[0]]

    # The package's own tests fit, and three turns run the importers' tests.
    turns = [selection.whole(every, {"films"}, {"paths"}, turn) for turn in range(3)]
    assert all(turn[:4] == own for turn in turns)
    assert {test for turn in turns for test in turn} == {*own, *others}
    assert max(sum(test.all_s for test in turn) for turn in turns) <= selection.WHOLE_S

    # The package's own tests alone take too long.
    turns = [selection.whole(every, {"paths"}, {"films"}, turn) for turn in range(2)]
    assert {test for turn in turns for test in turn} == {*own, *others}
    assert max(sum(test.all_s for test in turn) for turn in turns) <= 1.25 * selection.WHOLE_S


def test_what_has_changed_follows_from_the_commit(tmp_path):
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a"]
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True)

    for name in ("tofrender/films/film.py", "tests/io/test_a.py", "tests/conftest.py", "README.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1")
    git("init", "-q")
    git("add", ".")
    git("commit", "-q", "-m", "first")
    assert affected.touched("HEAD", tmp_path) == set()
    (tmp_path / "tests/conftest.py").write_text("2")
    (tmp_path / "tests/io/test_a.py").write_text("2")
    assert affected.touched("HEAD", tmp_path) == {"io"}
    (tmp_path / "tofrender/films/film.py").unlink()
    git("commit", "-q", "-a", "-m", "second")
    assert affected.touched("HEAD~1", tmp_path) == {"films", "io"}
    with pytest.raises(ValueError, match="HEAD~9 is not a commit"):
        affected.touched("HEAD~9", tmp_path)


def test_shards_have_each_file_once_and_take_as_long():
    found = [selection.Test([Case(f"{k}.py::t")] * 2, 1 + k % 3, 0) for k in range(40)]
    shards = [selection.shard(found, k, 8) for k in range(1, 9)]
    assert sorted(test.file for part in shards for test in part) == sorted(
        test.file for test in found
    )
    sums = [sum(test.all_s for test in part) for part in shards]
    assert max(sums) < 1.3 * min(sums)


@pytest.mark.essential
def test_each_planted_bug_applies_once_and_has_its_tests():
    planted = bugs()
    assert len(planted) == len({bug.name for bug in planted})
    for bug in planted:
        changed = plant(bug)
        if bug.file.endswith(".py"):
            compile(changed, bug.file, "exec")
        for test in bug.tests:
            file, _, name = test.partition("[")[0].partition("::")
            assert name.rpartition(".")[2].rpartition("::")[2] in (ROOT / file).read_text(), (
                bug.name
            )


MODULE = """
class Film:
    @property
    def size(self):
        return 3 * self.width  # In bins

    @size.setter
    def size(self, size):
        self.width = size / (
            3  # Channels
        )

def size(width):
    if width < 0:
        width = 0
        print(width)
    return 3 * width
"""


@pytest.mark.parametrize(
    ("function", "replace", "replacement", "line"),
    [
        ("Film.size", "size/3", "size", "self.width = size"),
        ("Film", "3 * self.width", "self.width", "return self.width"),
        ("", "3 * width", "width", "return width"),
        ("size", "width = 0\nprint(width)", "pass", "pass"),
        ("Film.size", "self.width", "self.height", 2),
        ("size", "3 * self.width", "self.width", 0),
        ("length", "3 * width", "width", 0),
    ],
)
def test_a_planted_bug_is_at_one_place_of_a_function(
    tmp_path, function, replace, replacement, line
):
    (tmp_path / "film.py").write_text(MODULE)
    bug = Bug("bug", "film.py", function, replace, replacement, "", ())
    if isinstance(line, int):
        with pytest.raises(ValueError, match=f"occurs {line} times in film.py {function}"):
            plant(bug, tmp_path)
        return

    # Exactly one line differs from a text without layout and comments, or two lines became one.
    before = ast.unparse(ast.parse(MODULE)).splitlines()
    after = plant(bug, tmp_path).splitlines()
    assert len([row for row in after if row not in before]) == 1
    assert [row.strip() for row in after if row not in before] == [line]
    assert len(after) == len(before) - replace.count("\n")


def test_processes_are_as_many_as_cores_and_memory_allow(monkeypatch):
    for cores, memory, processes in ((1, 99, 0), (4, 99, 4), (64, 99, 8), (8, 7, 3), (8, 3, 0)):
        monkeypatch.setattr(workers, "cores", lambda cores=cores: cores)
        lower(monkeypatch, free_memory=memory << 30)
        assert workers.pytest_xdist_auto_num_workers() == processes


def test_commits_are_checked_by_what_make_lint_runs():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    lint = re.search(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.M)
    assert lint
    checks = [line.strip().replace(" --check", "") for line in lint[1].splitlines()]
    fixes = [hook["entry"].replace(" --fix", "").replace(" --force-exclude", "") for hook in hooks]
    assert [check.removesuffix(" .") for check in checks] == fixes
