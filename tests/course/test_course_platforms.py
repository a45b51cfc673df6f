"""Autograders that are installed and run as each platform does, and the formats of results."""

import json
import os
import shutil
import stat
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
from helpers import tiny_assignment
from helpers.support import refused
from helpers.tiny_assignment import FILES, RIGHT

pytest.importorskip("resource", reason="a grading machine runs Linux or macOS")

from tofrender.course.assignments import Assignment, find
from tofrender.course.grade import autograders, formats
from tofrender.course.grade.results import Grade, Results

RUN = {
    "CLASSROOM": "c",
    "ASSIGNMENT": "a0",
    "USERNAME": "ada",
    "SUBMISSION_TAG": "submit/1",
    "COMMIT_URL": "https://example.invalid/commit",
    "RELEASE_URL": "https://example.invalid/release",
}


@pytest.fixture
def staff(tmp_path) -> Assignment:
    return find(tiny_assignment.write(tmp_path / "a0_sums", FILES))


def unpacked(archive: Path, target: Path) -> Path:
    """The zip's files with their modes."""
    with zipfile.ZipFile(archive) as file:
        for entry in file.infolist():
            path = Path(file.extract(entry, target))
            path.chmod(stat.S_IMODE(entry.external_attr >> 16))
    return target


def clean(top: Path, **more: str) -> dict[str, str]:
    """Environment of a container: an empty home, and how pip reaches its index."""
    (top / "home").mkdir(exist_ok=True)
    kept = {n: text for n, text in os.environ.items() if n.startswith(("PIP_", "PATH", "LANG"))}
    return kept | {"HOME": str(top / "home")} | more


def done(command: list, cwd: Path, environment: dict[str, str]) -> None:
    result = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.fixture(scope="module")
def venv(tmp_path_factory) -> Path:
    """Empty environment: the first archive's setup.sh fills it, others add their edition."""
    top = tmp_path_factory.mktemp("shared")
    done(["python3", "-m", "venv", top / "venv"], top, clean(top))
    return top / "venv"


@pytest.mark.parametrize("name", ["a1", "a2", "a3", "a4"])
def test_gradescope_installs_and_grades_each_assignment(name, venv, tmp_path):
    assignment, root = find(name), tmp_path / "autograder"
    autograders.write(assignment, tmp_path / "x.zip")
    source = unpacked(tmp_path / "x.zip", root / "source")
    (source / "course" / ".venv").symlink_to(venv)
    environment = clean(tmp_path, AUTOGRADER=str(root))
    done(["bash", source / "setup.sh"], root, environment)
    shutil.copy(source / "run_autograder", root)
    shutil.copytree(assignment.solutions, root / "submission")
    (root / "results").mkdir()
    done([root / "run_autograder"], root, environment)
    content = json.loads((root / "results" / "results.json").read_text())
    assert content["extra_data"]["complete"]
    assert len(content["tests"]) == len(assignment.rubric.problem_by_test)
    failed = [test for test in content["tests"] if test["status"] != "passed"]
    assert all("deliverables/" in test["output"] for test in failed), failed  # no notebook has run
    assert content["score"] > 0.8 * content["extra_data"]["max_score"]
    shutil.rmtree(root / "submission")
    (root / "submission").mkdir()
    done([root / "run_autograder"], root, environment)
    content = json.loads((root / "results" / "results.json").read_text())
    assert (content["score"], content["extra_data"]["complete"]) == (0, True)


def test_prairielearn_installs_and_grades(staff, tmp_path):
    autograders.write(staff, tmp_path / "x.zip", "prairielearn")
    grader, top = unpacked(tmp_path / "x.zip", tmp_path / "grader"), tmp_path / "grade"
    described = json.loads((grader / "info.json").read_text())["externalGradingOptions"]
    assert (described["timeout"], described["enableNetworking"]) == (600, False)
    assert "COPY . /grader\nRUN bash /grader/setup.sh" in (grader / "Dockerfile").read_text()
    done(["bash", grader / "setup.sh"], tmp_path, clean(tmp_path))
    tiny_assignment.write(top / "student", RIGHT)
    offline = ["unshare", "-n"] if os.geteuid() == 0 and shutil.which("unshare") else []
    done([*offline, grader / "grade.sh"], tmp_path, clean(tmp_path, GRADE=str(top)))
    content = json.loads((top / "results" / "results.json").read_text())
    assert (content["gradable"], content["score"]) == (True, 1)
    assert (top / "results" / "results.json").stat().st_size < 1 << 20


def test_classroom50_installs_and_grades(staff, tmp_path):
    autograders.write(staff, tmp_path / "x.zip", "classroom50")
    inside = unpacked(tmp_path / "x.zip", tmp_path / "bundle")
    assert not list(inside.rglob("seed.txt"))  # the bundle is public
    student = tiny_assignment.write(tmp_path / "repository", RIGHT)
    environment = clean(tmp_path, **RUN)
    done(["python3", inside / "autograder.py"], student, environment)
    content = json.loads((student / "result.json").read_text())
    assert (content["score"], content["max-score"]) == (700, 700)


def test_formats_of_a_results_file(staff, tmp_path, monkeypatch):
    for name, text in RUN.items():
        monkeypatch.setenv(name, text)
    right = {test: Grade(True) for test in staff.rubric.problem_by_test}
    right["test_add.py::test_numbers"] = Grade(False, "the sum <is> wrong", 0.5, 0.5)
    right["test_add.py::test_arrays"] = Grade(False, "a secret")
    content = Results(staff.rubric, right, complete=True).gradescope()
    made = json.loads(formats.prairielearn(content))
    assert made["score"] == pytest.approx(5 / 7)  # with the bonus of 0.5
    assert [test["points"] for test in made["tests"]] == [0.5, 0, 3, 1, 0.5]
    assert made["tests"][0]["message"] == "the sum <is> wrong"
    assert made["tests"][1]["message"] == "What this test asks for is not shown."
    made = json.loads(formats.classroom50(content))
    assert made["schema"] == "classroom50/result/v1"
    assert (made["score"], made["max-score"]) == (450, 700)  # without it
    assert (made["classroom"], made["usernames"]) == ("c", ["ada"])
    assert made["review"] == made["commit"] == RUN["COMMIT_URL"]
    assert made["tests"][0] == {
        **{"test-name": "a0.add: test_numbers", "passed": False},
        **{"score": 50, "max-score": 100},
    }
    suite = ElementTree.fromstring(formats.junit(content))
    assert (suite.get("tests"), suite.get("failures")) == ("5", "2")
    assert suite[0].get("classname") == "a0.add"
    assert suite[0].find("failure").text == "the sum <is> wrong"
    assert suite[1].find("failure").text == "What this test asks for is not shown."
    assert "a secret" not in formats.junit(content) + formats.prairielearn(content)


def test_no_format_makes_a_grade_of_a_failure_of_the_machine(staff):
    results = Results(staff.rubric, remarks=["not graded: the disk is full"])
    content = results.gradescope()
    assert "score" not in content
    assert content["tests"] == []
    made = json.loads(formats.prairielearn(content))
    assert made == {"gradable": False, "format_errors": ["not graded: the disk is full"]}
    assert formats.classroom50(content) == ""
    suite = ElementTree.fromstring(formats.junit(content))
    assert (suite.get("tests"), suite.get("errors")) == ("1", "1")
    assert suite[0].find("error").get("message") == "not graded: the disk is full"


@pytest.mark.essential
def test_an_archive_holds_what_it_needs_and_no_more(staff, tmp_path):
    (staff.folder / "seed.txt").write_text("5\n")
    for name in ("a.zip", "b.zip"):
        names = autograders.write(staff, tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    inside = "course/assignment/a0_sums/"
    needed = ("setup.sh", "run_autograder", "course/.ci/setup", "course/pyproject.toml")
    assert {*needed, f"{inside}tests/test_mean_staff.py", f"{inside}seed.txt"} <= set(names)
    assert f"{inside}solutions/mean.py" not in names
    assert not any(name.startswith("course/tofrender/integrators") for name in names)
    with zipfile.ZipFile(tmp_path / "a.zip") as file:
        assert file.read(f"{inside}seed.txt") == b"5\n"
        assert stat.S_IMODE(file.getinfo(f"{inside}seed.txt").external_attr >> 16) == 0o600
        pins = file.read("course/.ci/requirements.txt").decode()
        assert "\nmitsuba==" in pins
        assert "playwright==" not in pins
    refused(
        "time-limit = 541: must be 540 or less",
        autograders.write,
        staff,
        tmp_path / "c.zip",
        "prairielearn",
        time_limit_s=541,
    )
