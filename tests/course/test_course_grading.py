"""`tofrender grade` on correct, broken and hostile submissions: right points, and no harm."""

import dataclasses
import io
import json
import os
import signal
import subprocess
import sys
import tarfile
import time
import zipfile
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import psutil
import pytest
from helpers import tiny_assignment
from helpers.limits import lower
from helpers.processes import GUARD_S, wait_for
from helpers.tiny_assignment import ADD0, RIGHT, grade_class, zipped

pytest.importorskip("resource", reason="a grading machine runs Linux or macOS")

from tofrender.cli import app as cli
from tofrender.course.assignments import PACKAGE, find
from tofrender.course.grade import classes, grading, results, roster, unpacking
from tofrender.course.grade.results import Results, finished, grades_of
from tofrender.course.judge import plugin, processes, sandbox
from tofrender.course.judge.running import outcomes_of, read_report

SLEEP_S = 10_000_000 + os.getpid()  # what a process sleeps that these tests start and should end
MEMORY_GIB = 0.5


@pytest.fixture(scope="module")
def assignment(tmp_path_factory):
    folder = tmp_path_factory.mktemp("staff") / "a0"
    return find(tiny_assignment.write(folder, tiny_assignment.FILES))


@pytest.fixture(scope="module")
def grader(assignment):
    with grading.open_grader(assignment, time_limit_s=GUARD_S, memory_gib=MEMORY_GIB) as grader:
        yield grader


@pytest.fixture
def home(tmp_path, monkeypatch):
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.setenv("HOME", str(folder))
    return folder


@pytest.fixture
def grade(grader, tmp_path, home):
    def grade(what: dict[str, str] | Path) -> dict:
        place = what
        if isinstance(what, dict):
            place = tiny_assignment.write(tmp_path / "class" / "student", what)
        content = graded(grader, place, tmp_path)
        assert content["extra_data"]["max_score"] == 7
        assert sum(test["max_score"] for test in content["tests"]) == 7
        assert sum(test["score"] for test in content["tests"]) == content["score"]
        return content

    return grade


def graded(grader: grading.Grader, submission: Path, top: Path) -> dict:
    """Grade; afterwards nothing of the submission may run, and nothing new may lie around."""

    def files() -> tuple:
        own = sorted(path for path in top.rglob("*") if path.name != "results.json")
        return own, sorted(grader.scratch.iterdir()), others_shared_memory()

    def processes() -> set[psutil.Process]:
        return set(psutil.Process().children(recursive=True))

    before = processes()
    files_before = files()
    grader.grade(submission, top / "results.json")
    assert processes() <= before  # earlier processes may have ended
    assert files() == files_before
    assert not sleepers()
    return json.loads((top / "results.json").read_text())


def others_shared_memory() -> list[Path]:
    """Shared memory of other users. Root grades as another user, and the tests use some, too."""
    found = []
    for path in sorted(Path("/dev/shm").glob("*")):
        with suppress(OSError):  # it is gone
            found += [path] if path.lstat().st_uid != os.getuid() else []
    return found


def sleepers(what: str = f"sleep {SLEEP_S}") -> list[psutil.Process]:
    processes = psutil.process_iter(["cmdline"])
    return [p for p in processes if " ".join(p.info["cmdline"] or []).startswith(what)]


def points(content: dict) -> list[float]:
    return list(content["extra_data"]["problems"].values())


def outputs(content: dict) -> str:
    return "\n".join(test["output"] for test in content["tests"])


def test_right_submission(grade, tmp_path):
    content = grade(RIGHT)
    assert points(content) == [3, 4, 0]
    assert content["score"] == 7
    assert [test["status"] for test in content["tests"]] == ["passed"] * 4 + ["failed"]
    assert content["tests"][1]["visibility"] == "after_published"
    assert "missing" in content["tests"][4]["output"]
    assert content["extra_data"]["complete"]
    assert content["extra_data"]["summary"] == ""


@pytest.mark.essential
def test_bonus_comes_on_top_of_a_zip_with_a_folder(grade, tmp_path):
    np.savez(tmp_path / "x.npz", x=[1.0, 2.0])
    files: dict = RIGHT | {"deliverables/x.npz": (tmp_path / "x.npz").read_bytes()}
    entries = {f"Müller, Ana/{name}": content for name, content in files.items()}
    entries |= {"__MACOSX/._add.py": "junk", ".DS_Store": "junk", "Müller, Ana/notes/": ""}
    content = grade(zipped(tmp_path / "ana.zip", entries))
    assert points(content) == [3, 4, 0.5]
    assert content["score"] == 7.5


def test_wrong_parts_say_what_came(grade):
    add = "def add(a, b):\n    return a + b if getattr(a, 'size', 1) < 3 else a + 7\n"
    content = grade({"add.py": add, "mean.py": "def mean(x):\n    return sum(x.tolist())\n"})
    assert points(content) == [1, 1, 0]  # a test with a failing case gives nothing
    assert content["tests"][1]["output"].startswith("case 5: ")
    assert "the mean" in content["tests"][2]["output"]
    assert content["extra_data"]["summary"].startswith("a0.add: case 5")
    half = {"add.py": add.replace("a + 7", "a"), "mean.py": RIGHT["mean.py"]}
    assert points(grade(half)) == [2, 4, 0]  # an answer that is off by one factor gives a part


def test_a_table_of_answers_meets_other_numbers_and_the_results_name_their_seed(grader, tmp_path):
    table = "def mean(x):\n    return 1.5 if len(x) == 4 else 2.0\n"  # right for seed 0
    place = tiny_assignment.write(tmp_path / "class" / "student", RIGHT | {"mean.py": table})
    said = {}
    for seed in (5, 5, 6):
        content = graded(dataclasses.replace(grader, seed=seed), place, tmp_path)
        assert content["extra_data"]["seed"] == seed
        assert points(content) == [3, 1, 0]
        assert said.setdefault(seed, outputs(content)) == outputs(content)
    assert said[5] != said[6]


def test_seeds_of_a_class(assignment, tmp_path):
    """Random seeds differ each time; a class keeps the seed of its earlier results."""
    drawn = {grading.seed_of(assignment) for _ in range(5)}
    assert len(drawn) == 5
    assert 0 not in drawn
    assert grading.seed_of(assignment, 7) == 7
    staff = tiny_assignment.sums(tmp_path / "a0", {"seed.txt": "8\n"})
    assert grading.seed_of(staff, 7) == 8
    for text in ("", "0", "x", "1.0", str(1 << 31)):
        (staff.folder / "seed.txt").write_text(text)
        with pytest.raises(ValueError, match=r"seed\.txt: .*: must be an integer from 1 to"):
            grading.seed_of(staff)
    (tmp_path / "a.json").write_text("junk")
    assert results.seed_of_before(tmp_path) == 0
    Results(assignment.rubric, seed=9).write(tmp_path / "b.json")
    assert results.seed_of_before(tmp_path) == 9
    content = json.loads((tmp_path / "b.json").read_text())  # There are no points at first
    assert "score" not in content
    assert content["tests"] == []
    assert not content["extra_data"]["complete"]


SEED = 1_987_654_321
SEEKS = """
import glob, os, pathlib
here = pathlib.Path(__file__)

def add0(a, b):
    paths = ["@CLONE@", "@LOG@", *glob.glob("/proc/[0-9]*/cmdline")]
    paths += glob.glob("/proc/[0-9]*/environ")
    paths += [os.path.join(at, n) for at, _, names in os.walk(here.parents[1]) for n in names]
    found = []
    for path in paths:
        try:
            text = pathlib.Path(path).read_bytes()
        except OSError:
            continue
        if path != str(here) and (b"@SEED@" in text or path in ("@CLONE@", "@LOG@")):
            found.append(path)
    assert not found, found
    return a + b
"""


@pytest.mark.skipif(sandbox.landlock_version() < 6, reason="this machine protects from less")
def test_a_submission_reads_no_seed_no_clone_and_no_log(tmp_path, home):
    clone = tmp_path / "clone" / "solutions.py"
    log = tmp_path / "runner.log"
    tiny_assignment.write(tmp_path, {"clone/solutions.py": "x", "runner.log": "x"})
    staff = tiny_assignment.sums(tmp_path / "a0", {"seed.txt": str(SEED)})
    text = SEEKS.replace("@CLONE@", str(clone)).replace("@LOG@", str(log))
    text = text.replace("@SEED@", str(SEED))
    student = tiny_assignment.write(tmp_path / "student", {"p0.py": text})
    out = tmp_path / "results.json"
    words = ["grade", str(staff.folder), "--submission", str(student), "-o", str(out)]
    subprocess.run([sys.executable, "-m", "tofrender", *words], check=True)
    content = json.loads(out.read_text())
    assert content["extra_data"]["seed"] == SEED
    assert content["score"] == 1, content["tests"][0]["output"]


BOMB = f"""
import os
for _ in range(25):
    if os.fork() == 0:
        os.setsid()
        if os.fork():
            os._exit(0)
        os.execvp("sleep", ["sleep", "{SLEEP_S}"])
"""

PATCHES = """
import json, numpy, pytest
import tofrender.course.judge.wire
from tofrender.course.judge import expect
true = lambda *_, **__: True
numpy.allclose = numpy.all = numpy.array_equal = numpy.abs = true
expect.close = expect.Failure = pytest.fail = json.dumps = true
tofrender.course.judge.plugin = None
"""
ZERO = "def add(a, b):\n    return 0\n"

DEEP = """
import os
os.chdir(os.environ["TMPDIR"])
for _ in range(3000):
    os.mkdir("deep")
    os.chdir("deep")
"""

OUTSIDE = """
import os, pathlib
here = pathlib.Path(__file__)
top = here.parents[1]
questions = pathlib.Path(os.environ["TMPDIR"]).parent / "questions"
places = [here.parent, top, questions, pathlib.Path("@TOP@"), pathlib.Path("/tmp"),
          pathlib.Path("/dev/shm"), top.parent / "edition",
          *top.glob("a0_*/report"), *top.glob("a0_*/judging/tests")]
assert len(places) >= 7, places  # what another user cannot list is not among them
done = []
for place in places:
    for what in (lambda p: p.write_text("x"), lambda p: p.mkdir(), lambda p: p.symlink_to("/")):
        try:
            what(place / "hostile")
            done.append(str(place))
        except OSError:
            pass
assert not done, done
os.kill(os.getppid(), 9)
"""

ADD = RIGHT["add.py"]
HOSTILE = {  # What each problem's file holds and why it gets no point; "" where it gets one
    "right": (ADD, ""),
    "exits at import": ("import os\nos._exit(0)\n", "ended itself with status 0"),
    "fork bomb in sessions of their own": (BOMB + ADD, ""),
    "right after the bomb": (ADD, ""),
    "patches the judge's modules": (PATCHES + ZERO, "problem a0."),
    "withheld module": (
        "from tofrender.nlos.light.confocal import *\n" + ADD,
        "tofrender.nlos.light is not part of the student edition",
    ),
    "100 MB of output": ("import sys\nsys.stdout.write('x' * 100_000_000)\n" + ADD, ""),
    "10 GB in parts": (
        "import numpy as np\n"
        "def add(a, b):\n    return [np.ones(1 << 26, np.uint8) for _ in range(160)]\n",
        "; the process was ended",
    ),
    "closes its outputs": ("import os, sys\nsys.stdout.close()\nos.closerange(0, 3)\n" + ADD, ""),
    "endless loop": ("def add(a, b):\n    while True: pass\n", "no answer within 2 s"),
    "right at the end": (ADD, ""),
}
CONFINED = {
    "reads the reference": ("open('@PACKAGE@/paths/walk.py')\n" + ADD, "PermissionError"),
    "reads a solution": ("open('@TOP@/staff/solutions/p0.py')\n" + ADD, "PermissionError"),
    "writes and kills outside": (OUTSIDE + ADD, "PermissionError: [Errno 1]"),
    "right after them": (ADD, ""),
}
if sandbox.landlock_version() >= 6 and sandbox.protects_files():
    HOSTILE |= CONFINED
SLOW = {
    "recursion": ("def add(a, b):\n    return @NAME@(a, b)\n", "RecursionError"),
    "deep folders": (DEEP + ADD, ""),
    "endless kernel": (
        "import drjit as dr, mitsuba as mi\n"
        "def add(a, b):\n"
        "    i = dr.arange(mi.UInt32, 1024)\n"
        "    (i,) = dr.while_loop((i,), lambda i: i < 2**31, lambda i: ((i + 1) & 1023,))\n"
        "    return i.numpy()\n",
        "no answer within 2 s",
    ),
    "scatter out of range": (
        "import drjit as dr, mitsuba as mi\n"
        "def add(a, b):\n"
        "    x = dr.zeros(mi.Float, 8)\n"
        "    dr.scatter(x, mi.Float(1.0), mi.UInt32(1 << 30))\n"
        "    return x.numpy()\n",
        "SIGSEGV",
    ),
    "stopped": (
        "import os, signal\ndef add(a, b):\n    os.kill(os.getpid(), signal.SIGSTOP)\n",
        "no answer within 2 s",
    ),
    "right": (ADD, ""),
}


@pytest.mark.parametrize("set_of", [HOSTILE, SLOW])
def test_hostile_problems_cost_themselves_only(set_of, tmp_path, home, monkeypatch):
    lower(monkeypatch, judge_start_s=90.0)  # As on a machine slower than those that grade
    endless = [name for name, (_, reason) in set_of.items() if reason.startswith("no answer")]
    staff = tiny_assignment.write(tmp_path / "staff", tiny_assignment.wide(set_of, endless))
    files = {}
    for number, (text, _) in enumerate(set_of.values()):
        text = text.replace("def add(", f"def add{number}(").replace("@NAME@", f"add{number}")
        text = text.replace("@TOP@", str(tmp_path)).replace("@PACKAGE@", str(PACKAGE))
        files[f"p{number}.py"] = text
    student = tiny_assignment.write(tmp_path / "class" / "student", files)
    with grading.open_grader(find(staff), time_limit_s=GUARD_S, memory_gib=MEMORY_GIB) as grader:
        content = graded(grader, student, tmp_path)
    wrong = [
        f"{name}: {test['score']}, {test['output']}"
        for (name, (_, reason)), test in zip(set_of.items(), content["tests"], strict=True)
        if test["score"] != (reason == "") or reason not in test["output"]
    ]
    assert not wrong
    assert content["extra_data"]["max_score"] == len(set_of)
    assert len(json.dumps(content)) < 100_000


def test_no_submission_takes_much_longer_than_its_limit(tmp_path, home, monkeypatch):
    """With a clock that advances only while a problem is judged, by the problem's time limit."""
    titles = [f"endless {k}" for k in range(14)]
    staff = tiny_assignment.write(tmp_path / "staff", tiny_assignment.wide(titles))
    files = {f"p{k}.py": "" for k in range(len(titles))}
    student = tiny_assignment.write(tmp_path / "class" / "student", files)
    now = [0.0]

    def until_its_end(command, timeout_s, **_):
        now[0] += timeout_s
        return processes.Ended(f"took more than {timeout_s:g} s", -9, "")

    monkeypatch.setattr(grading.processes, "run", until_its_end)
    monkeypatch.setattr(grading, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with grading.open_grader(find(staff), time_limit_s=60) as grader:
        content = graded(grader, student, tmp_path)
    assert content["execution_time"] == 60 + grading.GRACE_S
    assert content["score"] == 0
    assert content["tests"][0]["output"] == "not judged: the problem took more than 20 s"
    assert content["tests"][-1]["output"] == "not judged: all problems together took 60 s"


def test_own_judge_and_modules_change_nothing(grade):
    always = "import pytest\n@pytest.fixture\ndef submission():\n    pytest.skip('fine')\n"
    modules = ("json.py", "numpy.py", "mitsuba.py", "tofrender.py", "pytest.py", "random.py")
    own = {
        "conftest.py": always,
        "pytest.ini": "[pytest]\naddopts = --collect-only\n",
        "rubric.toml": "[assignment]\nid = 'a0'\ntitle = 'mine'\n",
        "results.json": '{"score": 100}',
        "sitecustomize.py": "raise SystemExit(0)\n",
        "tests/test_add.py": "def test_numbers():\n    pass\n",
        "probes.py": "def add(*_, **__):\n    return 5\n",
        "add.py": "def add(a, b):\n    return 0\n",
    }
    bad = dict.fromkeys(modules, "raise SystemExit('not this one')\n")
    assert points(grade(RIGHT | bad | own)) == [0, 4, 0]


BAD_ZIPS = {
    "parent": ({"../add.py": "x"}, {}, "'../add.py', a path outside"),
    "backslashes": ({"..\\add.py": "x"}, {}, "a path outside"),
    "absolute": ({"/etc/add.py": "x"}, {}, "a path outside"),
    "drive": ({"C:/add.py": "x"}, {}, "a path outside"),
    "link": ({}, {"add.py": "/etc/passwd"}, "a link or a device"),
    "link to a folder": ({}, {"deliverables": "/etc"}, "a link or a device"),
    "long name": ({"x" * 300 + ".py": "x"}, {}, "too long"),
    "file and folder": ({"deliverables/x.py/y": "", "deliverables/x.py": ""}, {}, "as a folder"),
    "odd name": ({"a\x1b[2Jdd.py": "x"}, {}, "unprintable characters"),
}


@pytest.mark.parametrize("name", BAD_ZIPS)
def test_bad_zip_gives_nothing_and_a_reason(tmp_path, name):
    entries, links, reason = BAD_ZIPS[name]
    path = zipped(tmp_path / "x.zip", RIGHT | entries if not links else entries, links)
    refused(path, reason, ("*.py", "deliverables/*", "*/*/*"))
    assert not (tmp_path / "x.taken").exists()


def refused(path: Path, reason: str, patterns: tuple[str, ...] = ("*.py",)) -> None:
    with pytest.raises(unpacking.BadSubmission, match=reason):
        unpacking.extract(path, patterns, path.with_suffix(".taken"))


def test_expansion_is_counted_as_it_comes(tmp_path, monkeypatch):
    lower(monkeypatch, unpacked_bytes=1 << 20)
    path = zipped(tmp_path / "x.zip", {"add.py": "0" * (50 << 20)})
    lying = path.read_bytes().replace((50 << 20).to_bytes(4, "little"), (9).to_bytes(4, "little"))
    refused(path, "unpacks to more than 1 MiB")
    (tmp_path / "lying.zip").write_bytes(lying)
    refused(tmp_path / "lying.zip", "unpacks to more than 1 MiB|cannot be read")


def test_zip_of_a_gigabyte(grade, tmp_path):
    path = tmp_path / "x.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, text in RIGHT.items():
            archive.writestr(name, text)
        with archive.open("deliverables/x.npz", "w") as file:
            for _ in range(1024):
                file.write(bytes(1 << 20))
    content = grade(path)
    assert content["score"] == 0
    assert content["extra_data"]["complete"]
    assert "the submission unpacks to more than 512 MiB" in content["output"]


def test_zip_of_none_many_double_or_encrypted_files(tmp_path):
    path = tmp_path / "x.zip"
    path.write_bytes(b"PK\x03\x04 no zip at all")
    refused(path, "cannot be read")
    for names in ((f"{i}.py" for i in range(2001)), (f"{i}{'x' * 200}.py" for i in range(5000))):
        refused(zipped(path, dict.fromkeys(names, "")), "more than 2000")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("add.py", "1")
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("add.py", "2")
    refused(path, "twice")
    data = bytearray(zipped(path, {"add.py": "1"}).read_bytes())
    data[6] |= 1
    data[data.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(data)
    refused(path, "encrypted")


def test_folder_with_links_and_pipes(tmp_path):
    folder = tiny_assignment.write(tmp_path / "student", RIGHT | {"notes/old/add.py": ""})
    (folder / "link.py").symlink_to("/etc/passwd")
    (folder / "deliverables").symlink_to("/etc")
    os.mkfifo(folder / "pipe.py")
    taken = unpacking.extract(folder, ["*.py", "deliverables/*"], tmp_path / "taken")
    assert taken == ["add.py", "mean.py"]


NESTED = {
    "Ada_12_assignsubmission_file/my-a0.zip": {"p0.py": ADD0},
    "Ada_12_assignsubmission_file/a0/my-a0.zip": {"my-a0/p0.py": ADD0},
    "my-a0/p0.py": ADD0,
    "mine/my-a0/p0.py": ADD0,
    "README.md": "# mine",
    "notes.py": "1 / 0",
    "old/notes/p0.pdf": "",
}
LAYOUTS = {
    "Moodle's folder with a zip": (0,),
    "a zip in two folders": (1,),
    "a README beside the folder": (2, 4),
    "two folders": (3,),
    "another program beside the folder": (2, 5),
    "more beside two folders": (3, 4, 5, 6),
}


@pytest.mark.parametrize("kind", ["folder", "zip"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_files_are_found_where_platforms_put_them(layout, kind, tmp_path):
    names = [list(NESTED)[number] for number in LAYOUTS[layout]]
    top = tmp_path / "class" / "ada"
    for name in names:
        content = NESTED[name]
        if isinstance(content, dict):
            (top / name).parent.mkdir(parents=True)
            zipped(top / name, content)
        else:
            tiny_assignment.write(top, {name: content})
    if kind == "zip":
        if any(name.endswith(".zip") for name in names):
            pytest.skip("a platform that packs a zip again is not known")
        top = zipped(tmp_path / "ada.zip", {name: NESTED[name] for name in names})
    unpacking.extract(top, ["*.py"], tmp_path / "taken", ["p0.py"])
    assert (tmp_path / "taken" / "p0.py").read_text() == ADD0


def test_capitals_deep_folders_and_notebooks_are_found_and_noted(tmp_path):
    patterns = ["*.py", "notebook.ipynb"]
    cells = [
        {"cell_type": "markdown", "source": ["%%solution p0.py\n", "no"]},
        {"cell_type": "code", "source": ["%%solution p0.py\n", ADD0]},
        {"cell_type": "code", "source": "%%solution ../evil.py\n1"},
        {"cell_type": "code", "source": "%%test p0.py"},
    ]
    notebook = json.dumps({"cells": cells})
    for number, (files, note) in enumerate(
        (
            ({"P0.PY": ADD0}, "'P0.PY' was graded as p0.py"),
            ({"a/b/c/p0.py": ADD0}, "3 levels deep"),
            ({"notebook.ipynb": notebook}, "p0.py: taken from the cells of notebook.ipynb"),
            ({"p0.py": ADD0, "P0.py": "1"}, ""),
            ({"top/p0.py": ADD0, "top/notebook.ipynb": "{}"}, ""),
        )
    ):
        path = zipped(tmp_path / f"{number}.zip", files)
        notes = []
        target = tmp_path / f"taken{number}"
        assert "p0.py" in unpacking.extract(path, patterns, target, ["p0.py"], notes)
        assert (target / "p0.py").read_text() == ADD0
        assert " ".join(notes) == note if not note else note in " ".join(notes)
    assert not (tmp_path / "evil.py").exists()
    for broken in ("[]", "{", '{"cells": [1]}', json.dumps({"cells": []})):
        path = zipped(tmp_path / "broken.zip", {"notebook.ipynb": broken})
        target = tmp_path / f"broken{len(broken)}"
        assert unpacking.extract(path, patterns, target, ["p0.py"]) == ["notebook.ipynb"]


def test_files_in_two_folders_are_refused(tmp_path):
    path = zipped(tmp_path / "x.zip", {"a/p0.py": "1", "b/p0.py": "2"})
    refused(path, "contains the files in two folders, 'a' and 'b'")


def test_a_class_without_files_gets_one_warning(tmp_path, home):
    for name in ("ada", "ben"):
        tiny_assignment.write(
            tmp_path / "class" / name, {f"{name}.docx": "", "1/2/3/4/5/p0.py": ""}
        )
    said = []
    with grading.open_grader(tiny_assignment.sums(tmp_path / "a0")) as grader:
        table = grade_class(grader, tmp_path / "class", tmp_path / "out", said.append)
    assert [row["total"] for row in table] == ["0", "0"]
    told = "2 of 2 submissions are empty: ada: the submission contains none of p0.py"
    assert [line for line in said if "warning" in line] == [
        line for line in said[:1] if told in line
    ]


def test_folder_that_cannot_be_listed(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "walk", Mock(side_effect=PermissionError("closed")))
    refused(tmp_path, "cannot be read: closed")


def test_report_that_was_cut_off(assignment, tmp_path):
    problem = assignment.rubric.problems[0]
    line = {"case": "", "outcome": "passed", "text": "", "share": 1.0, "seconds": 0.1}
    lines = [line | {"id": "test_add.py::test_numbers"}, line | {"id": "test_add.py::test_arrays"}]
    path = tmp_path / "lines.json"
    path.write_text("".join(json.dumps(each) + "\n" for each in lines) + '{"id": "test_a')
    assert read_report(path) == lines
    whole = grades_of(problem, lines, "")
    assert [grade.passed for grade in whole.values()] == [True, True]
    cut = grades_of(problem, lines, "took too long")
    assert [grade.passed for grade in cut.values()] == [True, False]
    assert cut["test_add.py::test_arrays"].reason == "took too long"
    skipped = grades_of(problem, [lines[0] | {"outcome": "skipped"}], "")
    assert not any(grade.passed for grade in skipped.values())


def test_the_worst_case_counts_and_a_skipped_one_gives_nothing(tmp_path):
    case = {"id": "t", "outcome": "failed", "text": "", "seconds": 0.1, "seeded": False, "uses": []}
    assert outcomes_of(case | {"share": share} for share in (0.5, 0.2, 1.0))["t"].fraction == 0.2
    path = tmp_path / "lines.json"
    stash = pytest.Stash()
    config = SimpleNamespace(getoption=lambda _: path)
    item = SimpleNamespace(nodeid="test_a.py::test_b", config=config, stash=stash)
    reporting = plugin.pytest_runtest_protocol(item)
    next(reporting)
    stash[plugin.REPORTS].append(SimpleNamespace(failed=False, skipped=True, duration=0.1))
    with pytest.raises(StopIteration):
        reporting.send(None)
    assert json.loads(path.read_text())["share"] == 0


def test_what_was_given_need_not_come_back(tmp_path):
    """A file that all students have is the course's own, unless they hand in theirs."""
    given = {"starter/given.py": "X = 1\n", "starter/other.py": "X = 2\n"}
    staff = tiny_assignment.sums(tmp_path / "a0", given)
    mine = tiny_assignment.write(tmp_path / "ana", {"p0.py": "", "other.py": "X = 3\n"})
    with grading.open_grader(staff) as grader:
        taken = grader.extract(mine).folder
        assert (taken / "given.py").read_text() == "X = 1\n"
        assert (taken / "other.py").read_text() == "X = 3\n"
        assert sorted(path.name for path in taken.iterdir()) == ["given.py", "other.py", "p0.py"]


def tarred(path: Path, files: dict[str, str], mode: str) -> Path:
    """Write a tar archive of text files."""
    with tarfile.open(path, mode) as archive:
        for name, text in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(text.encode())
            archive.addfile(info, io.BytesIO(text.encode()))
    return path


@pytest.mark.parametrize(
    ("ending", "mode"),
    [(".tar", "w"), (".tar.gz", "w:gz"), (".tgz", "w:gz"), (".tar.bz2", "w:bz2"), (".TXZ", "w:xz")],
)
def test_tar_archives_are_submissions(tmp_path, ending, mode):
    files = {"./ada/p0.py": ADD0, "./ada/._p0.py": "of a Mac", "./ada/notes.txt": "x"}
    path = tarred(tmp_path / f"ada{ending}", files, mode)
    assert unpacking.extract(path, ["*.py"], tmp_path / "taken", ["p0.py"]) == ["p0.py"]
    assert (tmp_path / "taken" / "p0.py").read_text() == ADD0
    (tmp_path / "ben").mkdir()
    path.rename(tmp_path / "ben" / path.name)
    assert unpacking.extract(tmp_path / "ben", ["*.py"], tmp_path / "again", ["p0.py"])


def test_dangerous_tar_archives_give_a_reason(tmp_path, monkeypatch):
    for name, reason in (("../p0.py", "a path outside"), ("a\x1bb.py", "unprintable characters")):
        refused(tarred(tmp_path / "x.tar", {name: "1"}, "w"), reason)
    with tarfile.open(tmp_path / "link.tar", "w") as archive:
        info = tarfile.TarInfo("p0.py")
        info.type = tarfile.SYMTYPE
        info.linkname = "/etc/passwd"
        archive.addfile(info)
    refused(tmp_path / "link.tar", "a link or a device")
    refused(tarred(tmp_path / "x.tar", {f"{i}.py": "" for i in range(2001)}, "w"), "more than 2000")
    (tmp_path / "broken.tar.xz").write_bytes(b"\xfd7zXZ\x00 nothing")
    refused(tmp_path / "broken.tar.xz", "cannot be read")
    whole = tarred(tmp_path / "whole.tar.gz", {"p0.py": "x" * 100_000}, "w:gz").read_bytes()
    (tmp_path / "cut.tar.gz").write_bytes(whole[:100])
    refused(tmp_path / "cut.tar.gz", "cannot be read")
    lower(monkeypatch, unpacked_bytes=1 << 20)
    for ending, mode in ((".tar.gz", "w:gz"), (".tar.bz2", "w:bz2"), (".tar.xz", "w:xz")):
        bomb = tarred(tmp_path / f"bomb{ending}", {"p0.py": "0" * (20 << 20)}, mode)
        refused(bomb, "unpacks to more than 1 MiB")


def test_single_files_are_submissions(tmp_path):
    path = tmp_path / "Lovelace_12345_p0-2.py"
    path.write_text(ADD0)
    assert unpacking.extract(path, ["*.py"], tmp_path / "taken", ["p0.py", "p1.py"]) == ["p0.py"]
    assert (tmp_path / "taken" / "p0.py").read_text() == ADD0
    assert unpacking.stem_of(path) == "Lovelace_12345_p0-2"
    other = tmp_path / "mine.py"
    other.write_text(ADD0)
    with pytest.raises(unpacking.Nothing, match=r"must end in one of p0\.py, p1\.py"):
        unpacking.extract(other, ["*.py"], tmp_path / "again", ["p0.py", "p1.py"])


def test_class_folder_with_unknown_files_is_not_graded(tmp_path):
    """A submission that cannot be read must not become a row with 0 points."""
    assignment = tiny_assignment.sums(tmp_path / "a0")
    folder = tmp_path / "class"
    tiny_assignment.write(folder / "ana", {"p0.py": ADD0})
    zipped(folder / "ben.zip", {"p0.py": ADD0})
    tarred(folder / "cem.tar.gz", {"p0.py": ADD0}, "w:gz")
    (folder / "dora_p0.py").write_text(ADD0)
    (folder / ".DS_Store").write_text("")
    sheet = folder / "sheet.csv"
    sheet.write_text("id\n")
    found = classes.submissions_in(folder, assignment, [sheet])
    assert [path.name for path in found] == ["ana", "ben.zip", "cem.tar.gz", "dora_p0.py"]
    for name in ("eva.rar", "finn.7z", "gus.docx"):
        (folder / name).write_text("x")
    with pytest.raises(ValueError, match=r"3 files .*'eva\.rar', 'finn\.7z', 'gus\.docx'"):
        classes.submissions_in(folder, assignment, [sheet])


def test_two_loose_files_of_one_student_are_not_two_students(tmp_path):
    staff = find(tiny_assignment.write(tmp_path / "a0", tiny_assignment.FILES))
    folder = tiny_assignment.write(tmp_path / "class", {"ada_add.py": "", "ada_mean.py": ""})
    with pytest.raises(ValueError, match=r"'ada_add\.py' and 'ada_mean\.py'"):
        classes.submissions_in(folder, staff)


def test_late_days_without_a_rule_are_refused(tmp_path):
    rubric = tiny_assignment.sums(tmp_path / "a0").rubric
    assert rubric.late.lost_per_day == 0
    members = [roster.Member("ana", None), roster.Member("ben", None)]
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("id,late_days\nana,0\nben,\n")
    assert roster.marks(sheet, rubric, members)["ana"].late_days == 0
    sheet.write_text("id,late_days\nana,0\nben,2\n")
    with pytest.raises(ValueError, match=r"late_days = 2 has no effect.*\[late\]"):
        roster.marks(sheet, rubric, members)


@pytest.mark.essential
def test_class_is_graded_and_gone_on_with(tmp_path, home):
    folder = tmp_path / "class"
    tiny_assignment.write(folder / "=ana", {"p0.py": ADD0})
    zipped(folder / "ben.zip", {"add.py": ADD0})
    (folder / "Thumbs.db").write_text("left by an operating system")
    out = folder / "results"
    said = []
    with grading.open_grader(tiny_assignment.sums(tmp_path / "a0")) as grader:
        ana, ben = before = grade_class(grader, folder, out, said.append)
        assert list(ana) == ["submission", "total", "a0.p0", "reason"]
        assert (ana["submission"], ana["total"], ana["reason"]) == ("'=ana", "1", "")
        assert (ben["submission"], ben["total"]) == ("ben.zip", "0")
        assert "p0.py is missing" in ben["reason"]
        assert said[0].startswith("[1/2] =ana: 1 of 1 points")

        assert grade_class(grader, folder, out, said.append) == before
        assert all(line.endswith("graded before") for line in said[2:])
        assert finished(out / "ben.zip.json", grader.assignment.rubric, "of other tests") is None

        (folder / "=ana" / "p0.py").unlink()
        results = json.loads((out / "ben.zip.json").read_text())
        results["extra_data"]["complete"] = False  # as an interrupted run leaves it
        (out / "ben.zip.json").write_text(json.dumps(results))
        again = grade_class(grader, folder, out, said.append)
        assert not any(line.endswith("graded before") for line in said[4:])
        assert [row["total"] for row in again] == ["0", "0"]


def test_interrupted_run_leaves_nothing(assignment, tmp_path, monkeypatch):
    place = tmp_path / "tmp"
    out = tmp_path / "results.json"
    place.mkdir()
    monkeypatch.setenv("TMPDIR", str(place))
    endless = f"import os\nos.system('sleep {SLEEP_S} &')\nwhile True: pass\n"
    folder = tiny_assignment.write(tmp_path / "student", RIGHT | {"add.py": endless})
    words = ["grade", str(assignment.folder), "--submission", str(folder), "-o", str(out)]
    command = [sys.executable, "-m", "tofrender", *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    wait_for(sleepers)
    process.terminate()
    said = process.communicate()[1].splitlines()[-1]
    assert said == "error: interrupted; finished results are kept"
    assert process.returncode == 130
    assert not sleepers()
    assert "score" not in json.loads(out.read_text())
    assert not list(place.iterdir())


def test_a_class_uses_constant_memory(tmp_path, home):
    """It grows by less than 120 kB a submission."""
    for number in range(10):
        tiny_assignment.write(tmp_path / "class" / f"{number:02}", {"p0.py": ADD0})
    used, rss = [], lambda _: used.append(psutil.Process().memory_info().rss)
    with grading.open_grader(tiny_assignment.sums(tmp_path / "a0")) as grader:
        table = grade_class(grader, tmp_path / "class", tmp_path / "out", rss)
    assert [row["total"] for row in table] == ["1"] * 10
    assert used[-1] - used[2] < 7 * 120e3


def test_run_ends_only_what_is_below_it(tmp_path, monkeypatch):
    """The clock reaches the time limit when all processes have started."""
    sleeper = f"sleep {SLEEP_S}1"
    begun = tmp_path / "begun"
    clock = SimpleNamespace(monotonic=lambda: 2.0 * (begun.exists() and bool(sleepers(sleeper))))
    monkeypatch.setattr(processes, "time", SimpleNamespace(**vars(time) | vars(clock)))
    other = subprocess.Popen(["sleep", str(SLEEP_S)])
    try:
        command = ["sh", "-c", f"(setsid {sleeper} &) ; echo begun; > begun; sleep 9999"]
        options = {"memory_bytes": 1 << 30, "cwd": tmp_path, "env": dict(os.environ)}
        ended = processes.run(command, timeout_s=1, **options)
        assert ended.reason == "took more than 1 s"
        assert ended.output == "begun\n"
        assert ended.status == -signal.SIGKILL
        assert other.poll() is None
        assert not sleepers(sleeper)
    finally:
        other.kill()
        other.wait()


HIDING = """
import os, sys, time
if os.fork() == 0:
    os.setsid()
    if os.fork():
        os._exit(0)
    {what}
    time.sleep(9999)
time.sleep(9999)
"""


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("x = b'x' * (400 << 20)", "used more than 0.25 GiB of memory"),
        ("[os.fork() for _ in range(8)]", "started more than 200 processes"),
    ],
)
def test_run_sees_what_hides(tmp_path, what, reason):
    command = [sys.executable, "-I", "-S", "-c", HIDING.format(what=what)]
    ended = processes.run(command, timeout_s=GUARD_S, memory_bytes=1 << 28, cwd=tmp_path, env={})
    assert ended.reason == reason


def test_environment_keeps_no_secrets(monkeypatch, tmp_path):
    monkeypatch.setenv("SECRET_TOKEN", "x")
    environment = grading._environment(tmp_path / "home", tmp_path, tmp_path)
    assert "SECRET_TOKEN" not in environment
    assert environment["HOME"] == str(tmp_path / "home")


def test_grade_command(tmp_path, capsys, home):
    staff = tiny_assignment.sums(tmp_path / "a0").folder
    folder = tiny_assignment.write(tmp_path / "student", {"p0.py": ADD0})
    out = tmp_path / "results.json"
    assert cli.main(["grade", str(staff), "--submission", str(folder), "-o", str(out)]) == 0
    assert capsys.readouterr().out.startswith(f"a0.p0: 1 of 1\n{out}: 1 of 1 points, ")
    assert json.loads(out.read_text())["score"] == 1
