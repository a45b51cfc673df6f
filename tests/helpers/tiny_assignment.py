"""Quick assignments and right submissions for tests of the course's tools."""

import csv
import zipfile
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from tofrender.course.assignments import Assignment, find

RUBRIC = """
[assignment]
id = "a0"
title = "Arithmetic"
also_withhold = ["tofrender.integrators"]
submit = ["*.py", "deliverables/*"]

[[problem]]
id = "a0.add"
title = "Addition"
file = "add.py"
names = ["add"]
withholds = ["tofrender.nlos.light"]
timeout_s = 60
takes_s = 1
tests = [
  { id = "test_add.py::test_numbers", points = 1 },
  { id = "test_add.py::test_arrays", points = 2, visibility = "after_published" },
]

[[problem]]
id = "a0.mean"
title = "Mean"
file = "mean.py"
names = ["mean"]
needs = ["a0.add"]
timeout_s = 60
takes_s = 1
tests = [
  { id = "test_mean_staff.py::test_mean", points = 3 },
  { id = "test_mean_staff.py::test_one", points = 1 },
]

[[problem]]
id = "a0.file"
title = "A file"
timeout_s = 60
takes_s = 1
bonus = true
tests = [{ id = "test_file.py::test_file", points = 0.5 }]
"""

HEAD = """
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a0_{}


"""

FILES = {
    "rubric.toml": RUBRIC,
    "pytest.ini": """
[pytest]
addopts = -p tofrender.course.judge.plugin --strict-markers
testpaths = tests
pythonpath = tests
""",
    "tests/probes.py": """
def add(theirs, a, b):
    return theirs.add(a, b)

def mean(theirs, x):
    return theirs.mean(x)
""",
    "tests/test_add.py": HEAD.format("add")
    + """\
def test_numbers(submission):
    expect.close(submission.ask("add", a=2, b=3), 5.0, "the sum", hint="2 + 3")


@pytest.mark.parametrize("count", [1, 5])
def test_arrays(submission, count):
    a = np.arange(float(count))
    expect.close(submission.ask("add", a=a, b=a), 2 * a, "the sum of arrays")
""",
    "tests/test_mean_staff.py": HEAD.format("mean")
    + """\
def test_mean(submission):
    first = submission.random.integers(1, 100) if submission.seed else 0
    x = first + np.arange(4.0)
    expect.close(submission.ask("mean", x=x), first + 1.5, "the mean")


def test_one(submission):
    expect.close(submission.ask("mean", x=np.array([2.0])), 2.0, "the mean of one number")
""",
    "tests/test_file.py": HEAD.format("file")
    + """\
def test_file(submission):
    expect.close(submission.arrays("deliverables/x.npz")["x"], [1.0, 2.0], "x")
""",
    "starter/add.py": "def add(a, b):\n    raise NotImplementedError('a0.add: add two numbers')\n",
    "starter/mean.py": "def mean(x):\n    raise NotImplementedError('a0.mean: the mean')\n",
    "solutions/add.py": "def add(a, b):\n    return a + b\n",
    "solutions/mean.py": "def mean(x):\n    return sum(x.tolist()) / len(x)\n",
}

ADD0 = "def add0(a, b):\n    return a + b\n"  # The right p0.py of an assignment of `wide`

RIGHT = {name: FILES[f"solutions/{name}"] for name in ("add.py", "mean.py")}
"""A submission that gets all points but the bonus."""

PROBLEM = """
[[problem]]
id = "a0.p{0}"
title = "{1}"
file = "p{0}.py"
names = ["add{0}"]
timeout_s = {2}
takes_s = 1
tests = [{{ id = "test_p{0}.py::test_numbers", points = 1 }}]
"""

TEST = (
    HEAD.format("p{0}")
    + """\
def test_numbers(submission):
    expect.close(submission.ask("call", name="add{0}", a=2, b=3), 5.0, "the sum")
"""
)

CALL = "def call(theirs, name, **arguments):\n    return getattr(theirs, name)(**arguments)\n"


def wide(titles: Iterable[str], endless: Collection[str] = ()) -> dict[str, str]:
    """Files of an assignment with a problem for each title: add two numbers in p0.py, p1.py ...

    Args:
        titles: The problems' titles.
        endless: Those of problems that get 2 s for an answer instead of 300.
    """
    head = '[assignment]\nid = "a0"\ntitle = "Sums"\nalso_withhold = ["tofrender.nlos.light"]\n'
    problems = (PROBLEM.format(n, t, 2 if t in endless else 300) for n, t in enumerate(titles))
    files = {
        "rubric.toml": head + "".join(problems),
        "pytest.ini": FILES["pytest.ini"],
        "tests/probes.py": CALL,
        "solutions/p0.py": "",
    }
    return files | {f"tests/test_p{n}.py": TEST.format(n) for n, _ in enumerate(titles)}


def sums(folder: Path, more: Mapping[str, str] = {}) -> Assignment:
    """An assignment of one sum, p0.py, and more files."""
    return find(write(folder, wide(["sum"]) | more))


def write(folder: Path, files: Mapping[str, str]) -> Path:
    """Write files into a folder; returns it."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def zipped(path: Path, entries: Mapping[str, str | bytes], links: Mapping[str, str] = {}) -> Path:
    """Write a zip of files and of links, both by their names."""
    path.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in entries.items():
            archive.writestr(name, text)
        for name, target in links.items():
            info = zipfile.ZipInfo(name)
            info.create_system = 3
            info.external_attr = 0o120777 << 16
            archive.writestr(info, target)
    return path


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def grade_class(grader: Any, folder: Path, out: Path, say: Callable = print, **more: Any) -> list:
    """Grade a class as the command does; returns the rows of its table, `out` with .csv."""
    from tofrender.course.grade import classes, roster  # needs Linux or macOS

    members, _ = roster.members(
        classes.submissions_in(folder, grader.assignment, [out, out.with_suffix(".csv")]), None
    )
    table = out.with_suffix(".csv")
    classes.Class(grader, folder, members, table, out, **more).grade(say)
    return rows(table)
