"""Release, start, submit and verify: what students get, what they do not, what must hold before."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import mitsuba as mi
import pytest
from helpers import course_assignment
from helpers.course_assignment import changed
from helpers.processes import says

import tofrender
from tofrender.cli import app as cli
from tofrender.course import assignments, edition, material, mutants, notebooks, rubric
from tofrender.course.author import contracts, leaks, structure, verify
from tofrender.course.author.release import release
from tofrender.course.judge import running, worker
from tofrender.course.student import cells, folders
from tofrender.course.student.folders import start
from tofrender.runtime import editions


@pytest.fixture
def tiny(tmp_path) -> assignments.Assignment:
    return course_assignment.write(tmp_path / "a0_tiny")


@pytest.fixture(scope="module")
def released(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("released")
    return release(course_assignment.write(folder / "a0_tiny"), folder / "dist")


@pytest.fixture
def run(capsys):
    def call(*arguments: object) -> tuple[int, str, str]:
        status = cli.main(list(map(str, arguments)))
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return call


def test_released_folder(released):
    files = {str(path.relative_to(released)) for path in released.rglob("*") if path.is_file()}
    top = {name for name in files if not name.startswith("package/")}
    assert top == {
        *("README.md", "README.html", "exercises.md", "exercises.html", "figures/one.png"),
        *(".github/workflows/tests.yml", ".devcontainer/devcontainer.json", ".gitignore"),
    }
    page = (released / "README.html").read_text()
    assert '<img src="figures/one.png" alt="One dot"' in page
    json.loads((released / ".devcontainer" / "devcontainer.json").read_text())
    inside = "package/tofrender/course/material/a0_tiny/"
    theirs = {name.removeprefix(inside) for name in files if name.startswith(inside)}
    scenes = {name for name in theirs if name.startswith("scenes/")}
    assert {"scenes/__init__.py", "scenes/cornell_box.xml", "scenes/meshes/bust.ply"} <= scenes
    assert theirs - scenes == {
        *("README.md", "exercises.md", "figures/one.png", "notebook.py", "pytest.ini"),
        *("rubric.toml", "starter/pulse.py", "starter/wrapping.py"),
        *("tests/probes.py", "tests/test_pulse.py", "tests/test_range.py"),
    }
    for name in ("signals/pulses", "nlos/light/confocal", "analysis/unwrapping"):
        assert (assignments.PACKAGE / f"{name}.py").is_file()
        assert f"package/tofrender/{name}.py" not in files
    assert "package/tofrender/py.typed" in files
    readme = (released / "README.md").read_text()
    assert "> **Problem a0.pulse: A pulse**" in readme
    assert "| 5.5 | `pulse.py` | `pytest -m a0_pulse` | 10 s |" in readme
    assert "| 4 bonus |" in readme
    assert "It uses your a0.pulse." in readme
    project = tomllib.loads((released / "package" / "pyproject.toml").read_text())["project"]
    whole = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert project["version"] == f"{tofrender.__version__}+a0"
    for key in ("dependencies", "scripts"):
        assert project[key] == whole[key]
    assert project["optional-dependencies"]["course"] == whole["optional-dependencies"]["course"]


@pytest.mark.essential
def test_names_say_the_problem(tiny, tmp_path):
    edition.copy(tiny, tmp_path)
    script = """
import tofrender, tofrender.analysis
for statement in (
    "from tofrender import GaussianPulse", "tofrender.GaussianPulse",
    "from tofrender.signals.pulses import BoxPulse", "import tofrender.nlos.light.confocal",
    "from tofrender.analysis import unambiguous_range", "from tofrender import TransientPath",
    "tofrender.render('cornell_box', spp=1)",
):
    try:
        exec(statement)
    except ImportError as error:
        print(error)
print(tofrender.__version__, tofrender.SPEED_OF_LIGHT)
"""
    pulse = "yours to write: problem a0.pulse"
    integrator = "tofrender.integrators.transient_path"
    assert says(script, PYTHONPATH=str(tmp_path), PYTHONSAFEPATH="1") == [
        f"tofrender.GaussianPulse is {pulse}",
        f"tofrender.GaussianPulse is {pulse}",
        f"tofrender.signals.pulses is {pulse}",
        "tofrender.nlos.light.confocal is not part of the student edition",
        "tofrender.analysis.unambiguous_range is yours to write: problem a0.range",
        f"tofrender.TransientPath: {integrator} is not part of the student edition",
        "tofrender.render: tofrender.rendering.renderer is not part of the student edition",
        f"{tofrender.__version__}+a0 299792458.0",
    ]


def test_release_overwrites_nothing(tiny, tmp_path, run):
    place = tmp_path / "dist" / "a0_tiny"
    place.mkdir(parents=True)
    (place / "mine").write_text("x")
    status, _, said = run("release", tiny.folder, "-o", tmp_path / "dist")
    assert status == 2
    assert said.startswith(f"error: {place} exists")
    assert said.count("\n") == 1
    assert [path.name for path in place.parent.rglob("*")] == ["a0_tiny", "mine"]


def test_release_fails_closed(tiny, tmp_path, run):
    source = (assignments.PACKAGE / "nlos/light/confocal.py").read_text()
    probes = tiny.folder / "tests" / "probes.py"
    probes.write_text(probes.read_text() + "\n\n" + source.replace("# ", "# Changed: "))
    status, out, said = run("release", tiny.folder, "-o", tmp_path / "dist")
    assert (status, out) == (1, "")
    where = "tofrender/course/material/a0_tiny/tests/probes.py"
    assert said.startswith(f"error: {where}: ")
    assert "of light/confocal.py, which is withheld" in said
    assert list((tmp_path / "dist").iterdir()) == []


def test_what_an_edition_is_refused_for(tiny, released, tmp_path):
    folder = tmp_path / "edition"
    edition.copy(tiny, folder)
    (folder / "tofrender" / "runtime" / "edition.json").write_text('{"modules": {}}')
    (folder / "tofrender" / "signals" / "pulses.py").write_text("class BoxPulse:\n    pass\n")
    (folder / "tofrender" / "course" / "test_a_staff.py").write_text("")
    assert leaks.leaks(tiny, folder) == [
        "tofrender/signals/pulses.py: tofrender.signals.pulses is withheld",
        "tofrender/course/test_a_staff.py: is a file of the staff",
    ]
    assert leaks.leaks(tiny, released) == []
    (folder / "tofrender" / "signals" / "pulses.py").unlink()
    assert leaks.smoke_test(tiny, folder)[0].startswith("the edition cannot be tested: ")


def test_withheld_modules_must_exist(tiny, tmp_path):
    changed(tiny.folder, "rubric.toml", ("tofrender.nlos.light.confocal", "tofrender.conrer"))
    with pytest.raises(ValueError, match=r"module tofrender\.conrer: does not exist"):
        edition.copy(tiny, tmp_path / "edition")


def test_a_withheld_package_takes_all_in_it_along(monkeypatch):
    without = {
        "tofrender.paths": "is yours to write: problem a0.walk",
        "tofrender.nlos.light": "is not part of the student edition",
    }
    monkeypatch.setattr(editions, "_MODULES", without)
    walk = "tofrender.paths.walk"
    confocal = "tofrender.nlos.light.confocal"
    assert editions.refusal(walk) == f"{walk} is yours to write: problem a0.walk"
    assert editions.refusal(confocal) == f"{confocal} is not part of the student edition"
    assert editions.refusal("tofrender.nlos") is editions.refusal("tofrender.pathsome") is None


def test_a_package_is_withheld_but_for_what_is_kept(tiny):
    def keeping(*keeps: str) -> rubric.Rubric:
        return dataclasses.replace(
            tiny.rubric, also_withhold=("tofrender.paths", "tofrender.integrators"), keeps=keeps
        )

    modules = set(edition.chosen(keeping("tofrender.paths.camera")))
    assert {"tofrender.integrators", "tofrender.paths.walk"} <= modules
    assert not {"tofrender.paths", "tofrender.paths.camera"} & modules
    message = r"rubric\.toml: keeps tofrender\.integrators\.base, which imports tofrender\."
    with pytest.raises(ValueError, match=message):
        edition.withheld(keeping("tofrender.integrators.base"))


def test_dependents():
    found = edition.dependents(["tofrender.rendering.arrivals"])
    directly = {name for name, why in found.items() if why == "tofrender.rendering.arrivals"}
    assert directly == {"tofrender.rendering.job", "tofrender.rendering.time_window"}
    assert {"tofrender.rendering.renderer", "tofrender.nlos.capturing"} <= set(found)
    assert set(edition.dependents(["tofrender.rendering.job"])) <= set(found)
    assert edition.dependents(["tofrender.cli"]) == {"tofrender.__main__": "tofrender.cli.app"}
    with_pulses = set(edition.dependents(["tofrender.signals.pulses"]))
    assert "tofrender.integrators.path_tracer" in with_pulses
    others = {"tofrender", "tofrender.films.transient", "tofrender.paths.endpoints"}
    assert not others & with_pulses


def test_rubric_of_students(tiny, tmp_path):
    material.write(tiny, tmp_path)
    theirs = rubric.read(tmp_path)
    tests = [test.id.removeprefix("test_pulse.py::") for test in theirs.problems[0].tests]
    assert tests == ["test_area", "test_fall_off", "test_peak"]
    assert theirs.points == tiny.rubric.points == 5.5
    again = tmp_path / "again"
    again.mkdir()
    material.write(assignments.Assignment(tmp_path), again)
    for name in ("rubric.toml", "README.md"):
        assert (again / name).read_text() == (tmp_path / name).read_text()


def test_handout_names_only_problems(tiny):
    with pytest.raises(
        ValueError, match=r"\[\[a0\.pluse\]\]: the rubric does not contain this problem"
    ):
        material.handout("[[a0.pluse]]\n", tiny.rubric)
    assert material.handout("see [[a0.pulse]] here", tiny.rubric) == "see [[a0.pulse]] here"


def test_handout_has_all_points_and_the_late_rule(tiny):
    talk = rubric.ByHand("a0.talk", "Talk", 6)
    late = rubric.Late(1, 0.25)
    rules = dataclasses.replace(tiny.rubric, by_hand=(talk,), late=late)
    text = material.handout("# A\n\n[[points]]\n", rules)
    for problem in rules.problems:
        points = material.points_text(problem.points) + " bonus" * problem.bonus
        assert f"| {problem.title} | tests | {points} |" in text
    assert "| Talk | hand | 6 |" in text
    assert f"| **sum** | | **{material.points_text(rules.points + 6)}** |" in text
    assert "The first day after the deadline costs nothing. Each further day costs 25 %" in text
    strict = dataclasses.replace(rules, late=rubric.Late(0, 0.1))
    assert "Each day after the deadline costs 10 % of the points." in material.points_table(strict)


@pytest.mark.parametrize("name", ["a1", "a2", "a3", "a4"])
def test_points_by_hand_stand_in_the_handout(name, tmp_path):
    staff = assignments.find(name)
    ids = [part.id for part in staff.rubric.by_hand]
    assert f"{name}.exercises" in ids
    has_questions = "# **Questions" in (staff.folder / "notebook.py").read_text()
    assert (f"{name}.questions" in ids) == has_questions
    material.write(staff, tmp_path)
    text = (tmp_path / "README.md").read_text()
    for part in staff.rubric.by_hand:
        assert f"| {part.title} | hand | {material.points_text(part.points)} |" in text


def test_students_folder(tiny, tmp_path, run, monkeypatch):
    folder = tmp_path / "my-a0"
    status, out, said = run("start", tiny.folder, folder)
    assert (status, said) == (0, "")
    assert "pytest -m a0_pulse" in out
    assert sorted(path.name for path in folder.iterdir()) == [
        *(".tofrender-cells.json", "README.md", "exercises.md", "figures", "notebook.ipynb"),
        *("pulse.py", "pytest.ini", "rubric.toml", "scenes", "tests", "wrapping.py"),
    ]
    script = "from scenes import cornell_box\nprint(cornell_box()['type'])"
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout == "scene\n"
    assert (folder / "pytest.ini").read_text().endswith("\nsubmission = .\n")
    names = {path.name for path in (folder / "tests").iterdir()}
    assert names == {"probes.py", "test_pulse.py", "test_range.py"}
    notebook = json.loads((folder / "notebook.ipynb").read_text())
    sources = ["".join(cell["source"]) for cell in notebook["cells"]]
    assert sources[1].startswith("%load_ext tofrender.course.student\n")
    stub = (tiny.starter / "pulse.py").read_text()
    assert sources[2] == f"%%solution pulse.py\n{stub.rstrip()}"
    assert sources[3].startswith("%%test pulse.py\n# ")
    status, _, said = run("start", tiny.folder, folder)
    assert status == 2
    assert "is not empty; pass a new folder" in said
    status, _, said = run("verify", folder)
    assert status == 2
    assert "does not contain solutions" in said
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    with pytest.raises(FileExistsError, match="is the current folder"):
        start(tiny, Path("."))
    monkeypatch.chdir(tmp_path)
    assert cells.save(start(tiny, empty) / "pulse.py", "x = 1") == "wrote pulse.py"
    assert not list(empty.glob("*.py.*"))  # A stub is no edit of the student's


@pytest.fixture
def student(tiny, tmp_path) -> Path:
    return start(tiny, tmp_path / "my-a0")


def test_archive(tiny, student, tmp_path):
    (student / "notes.txt").write_text("mine")
    (student / "pulse.py").write_text("# mine\n")
    handed = folders.pack(tiny, student, tmp_path / "my-a0.zip")
    assert handed.files == ("notebook.ipynb", "pulse.py", "wrapping.py")
    assert handed.missing == ("deliverables/*",)
    assert handed.unchanged == ("wrapping.py",)
    with zipfile.ZipFile(handed.archive) as archive:
        assert tuple(archive.namelist()) == handed.files
        assert archive.read("pulse.py") == b"# mine\n"
    first = handed.archive.read_bytes()
    os.utime(student / "pulse.py", (1e9, 1e9))
    assert folders.pack(tiny, student, tmp_path / "my-a0.zip").archive.read_bytes() == first


def test_what_cannot_be_handed_in(tiny, student, tmp_path, run):
    (student / "wrapping.py").unlink()
    assert folders.check(tiny, student)[1] == ["deliverables/*", "wrapping.py"]
    (student / "wrapping.py").symlink_to("/etc/hostname")
    status, _, said = run("submit", tiny.folder, student)
    assert status == 2
    assert said.startswith(f"error: {student}/wrapping.py is a link")
    assert said.count("\n") == 1
    (student / "wrapping.py").unlink()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "x.npz").write_text("")
    (student / "deliverables").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match=r"deliverables.* is a link"):
        folders.check(tiny, student)
    said = run("submit", tiny.folder, tmp_path / "none")[2]
    assert f"FOLDER = {tmp_path / 'none'}: does not exist" in said
    (tmp_path / "bare").mkdir()
    with pytest.raises(ValueError, match=r"FOLDER = .*bare: contains none of pulse\.py"):
        folders.check(tiny, tmp_path / "bare")
    assert not list(tmp_path.glob("*.zip"))


def test_submit_shows_points(tiny, student, run):
    (student / "pulse.py").write_text((tiny.solutions / "pulse.py").read_text())
    status, out, said = run("submit", tiny.folder, student)
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert status == 0
    assert "A pulse 4 of 4, 1.5 from tests that are not public" in lines
    assert "The range 0 of 4 bonus" in lines
    assert "not written yet: 1 tests" in lines
    assert "warning: wrapping.py was not changed" in said
    assert (student.parent / "my-a0.zip").is_file()


def test_cell_keeps_what_an_editor_wrote(tmp_path):
    path = tmp_path / "pulse.py"
    assert cells.save(path, "a = 1\n") == "wrote pulse.py"
    assert cells.save(path, "a = 2") == "wrote pulse.py"
    assert cells.save(path, "a = 2\n\n") == "pulse.py has the text of this cell already"
    for number, text in enumerate(("a = 3\n", "a = 4\n"), 1):
        path.write_text(text)
        said = cells.save(path, f"a = -{number}")
        assert said.endswith(f"the old text is in pulse.py.{number}")
        assert path.with_name(f"pulse.py.{number}").read_text() == text
        assert path.read_text() == f"a = -{number}\n"
    path.write_text("a = 5\n")
    said = cells.save(path, "a = -2")
    assert said.startswith("pulse.py was changed outside of this cell and is kept")
    assert path.read_text() == "a = 5\n"
    path.unlink()
    assert cells.save(path, "a = -2") == "wrote pulse.py"


def test_cells_test_their_file(tiny, student):
    solution = (tiny.solutions / "pulse.py").read_text()
    (student / "pulse.py").write_text(solution.replace("2.50662827", "2.6"))
    said = cells.run_tests(student, "pulse.py", "# a comment\n-k 'area or peak'")
    assert [line.split()[:2] for line in said.splitlines() if line[0] != " "] == [
        ["failed", "test_area"],
        ["failed", "test_peak"],
    ]
    assert "is 1 / (sqrt(2 pi) sigma) there?" in said
    assert cells.run_tests(student, "a0.range", "-k nothing") == "no tests were chosen"
    with pytest.raises(ValueError, match=r"%%test x\.py: must be one of pulse\.py, wrapping\.py"):
        cells.run_tests(student, "x.py")
    assert cells.run_tests(student / "figures", "").endswith("figures does not contain tests")


def test_new_code_is_used_at_once(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "first_module.py").write_text("def f():\n    return 1\n")
    (tmp_path / "second_module.py").write_text(
        "from first_module import f\n\ndef g():\n    return f() + 1\n"
    )
    names: dict = {}
    exec("import first_module, os\nfrom second_module import g\nfrom first_module import f", names)
    names["mine"] = 5
    cells.save(tmp_path / "first_module.py", "def f():\n    return 10")
    cells.refresh(tmp_path / "first_module.py", names)
    assert (names["f"](), names["g"](), names["first_module"].f()) == (10, 11, 10)
    assert (names["mine"], names["os"]) == (5, os)
    for name in ("first_module", "second_module"):
        del sys.modules[name]


def test_notebook_needs_its_files(tiny, tmp_path):
    with pytest.raises(ValueError, match=r"\[solution\] pulse\.py: .* does not exist"):
        notebooks.write((tiny.folder / "notebook.py").read_text(), tmp_path, tmp_path / "x.ipynb")


def test_notebook_runs_and_says_what_fails(tiny, tmp_path):
    text = (tiny.folder / "notebook.py").read_text()
    right = tmp_path / "right" / "notebook.ipynb"
    stubs = tmp_path / "stubs" / "notebook.ipynb"
    for files, notebook in ((tiny.solutions, right), (tiny.starter, stubs)):
        notebook.parent.mkdir()
        notebooks.write(text, files, notebook)
    notebooks.execute(right)
    assert right.with_name("deliverables").joinpath("x.npz").is_file()
    assert "1.499" in right.read_text()
    with pytest.raises(RuntimeError, match=r"a0\.range: write unambiguous_range"):
        notebooks.execute(stubs)


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ('raise NotImplementedError("a0.x: write it")', "not written yet: a0.x: write it"),
        ("1 / 0", "ZeroDivisionError: division by zero\n  plugin.py, line 7: 1 / 0"),
    ],
)
def test_what_a_plugin_raises_when_mitsuba_makes_it(tmp_path, body, text):
    lines = ["import mitsuba as mi", "", "class Broken(mi.SamplingIntegrator):"]
    lines += ["    def __init__(self, props):", "        super().__init__(props)", "        # here"]
    path = tmp_path / "plugin.py"
    path.write_text("\n".join([*lines, f"        {body}", ""]))
    names: dict = {"__name__": "plugin"}
    exec(compile(path.read_text(), path, "exec"), names)
    mi.register_integrator("broken", names["Broken"])

    def load(depth: int) -> None:  # however deep it is called
        if depth:
            load(depth - 1)
        mi.load_dict({"type": "scene", "integrator": {"type": "broken"}})

    for depth in (0, 100):
        with pytest.raises(RuntimeError) as caught:
            load(depth)
        assert worker.explain(caught.value, tmp_path) == text


def test_structure_finds_what_does_not_agree(tiny):
    folder = tiny.folder
    text = "[[a0.pulse]]\n[[a0.pulse]]\nA pulse (5 points).\n![x](no.png)\n"
    (folder / "README.md").write_text(text)
    (folder / "solutions/extra.py").write_text("")
    (folder / "tests" / "test_pulse_staff.py").rename(folder / "tests" / "test_even.py")
    (folder / "exercises.md").unlink()
    changed(tiny.folder, "rubric.toml", ("test_peak", "test_paek"))
    changed(tiny.folder, "tests/test_range.py", ("a0_range", "a0_pulse"))
    changed(tiny.folder, "notebook.py", ("[solution] wrapping.py", "[solution] w.py"))
    changed(tiny.folder, "mutants.toml", ("-0.5 * x * x", "-0.6 * x"))
    found = sorted(structure.check(assignments.Assignment(folder)))
    assert found == sorted(
        [
            "README.md: line [[a0.pulse]] occurs 2 times, must occur once",
            "README.md: line [[a0.range]] occurs 0 times, must occur once",
            "README.md: picture no.png does not exist",
            "README.md: picture no.png needs a description of two or more words",
            "README.md: states points ('(5 points)'); only rubric.toml may do so",
            "exercises.md: is missing",
            "solutions/extra.py: belongs to no problem; move provided files to starter/",
            "mutants.toml: no_half: '-0.6 * x' occurs 0 times in pulse.py, must occur once",
            "mutants.toml: no_norm: the rubric has no test test_pulse.py::test_peak",
            "notebook.py: [solution] w.py: the file is missing in solutions/",
            "notebook.py: the cell [solution] wrapping.py is missing",
            "rubric.toml: test_pulse.py::test_paek: the test does not exist",
            "rubric.toml: test_pulse_staff.py::test_even: the test does not exist",
            "test_even.py::test_even: is missing in the rubric",
            "test_pulse.py::test_peak: is missing in the rubric",
            "test_range.py::test_range: has the markers ['a0_pulse'], must have a0_range",
            "test_range.py::test_results: has the markers ['a0_pulse'], must have a0_range",
        ]
    )


def test_which_tests_a_mutant_can_fail(tiny):
    those = {mutant.id: mutant for mutant in mutants.read(tiny)}
    assert len(mutants.affected(tiny.rubric, those["no_half"])) == 7
    of_range = [test.id for test in tiny.rubric.problems[1].tests]
    assert mutants.affected(tiny.rubric, those["quarter"]) == of_range
    assert "= 0.25 *" not in mutants.apply(tiny, those["no_half"])
    assert "return 0.25 *" in mutants.apply(tiny, those["quarter"])
    broken = dataclasses.replace(those["quarter"], edits=(("return 0.5", "return ("),))
    with pytest.raises(ValueError, match="quarter: the result is not Python"):
        mutants.apply(tiny, broken)


def test_submission_is_not_taken_for_the_tests(tiny, student):
    result = running.pytest(tiny.folder, ["--submission", str(student)])
    assert result.returncode != 0
    assert "write --submission=DIR" in result.stdout + result.stderr


def test_verify(tiny, run):
    status, out, said = run("verify", tiny.folder, "--seeds", 2)
    assert (status, said) == (0, ""), out
    lines = [line.split() for line in out.splitlines()]
    assert [line[:2] for line in lines] == [["ok", name] for name in verify.CHECKS]
    assert "3 of which ran with 2 seeds" in out


def test_verify_says_what_does_not_hold(tiny, run):
    shutil.copy(tiny.solutions / "pulse.py", tiny.starter)
    (tiny.starter / "wrapping.py").write_text("import os\nos._exit(3)\n")
    changed(tiny.folder, "solutions/pulse.py", ("x = t ", "x = (t + 1e-3) "))
    other = ('["test_range.py::test_range", ', '["test_range.py::test_results", ')
    changed(tiny.folder, "mutants.toml", ('"half the square"', '"a third"'), other)
    checks = [part for name in ("starter", "solutions", "mutants") for part in ("--only", name)]
    status, out, _ = run("verify", tiny.folder, *checks)
    assert status == 1
    reasons = [line.strip() for line in out.splitlines() if line.startswith("  ")]
    for start_of_line, count in {
        "test_pulse.py::test_area: passed, must fail (a0.pulse)": 1,
        "test_range.py::test_range: problem a0.range, wrapping.py the process ended itself": 1,
        "test_pulse.py::test_fall_off: failed (2 of 2 cases): problem a0.pulse": 1,
        "test_range.py::test_range: failed": 0,
        "no_half: no failure contains 'a third'; the failures contain": 1,
        "there_and_back: test_range.py::test_results passes, must fail (It is there_and_back": 1,
        "there_and_back: test_range.py::test_range fails, must pass: problem a0.range": 1,
        "quarter:": 0,
    }.items():
        found = sum(line.startswith(start_of_line) for line in reasons)
        assert found == count, (start_of_line, out)


@pytest.mark.parametrize("name", list(assignments.known()))
def test_assignments_hold_together(name):
    found = assignments.find(name)
    bad = [v for v in verify.verify(found, only=("structure", "edition")) if not v.ok]
    assert not bad, "\n".join(reason for verdict in bad for reason in verdict.reasons)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('says = ["A pulse."]', "says = []", "a0.pulse: no contract or remark for 'A pulse.'"),
        ('says = "In meters."', 'says = "In feet."', "no text of a0.range contains 'In feet.'"),
        ('"test_range.py::test_range"', '"test_range.py::test_x"', "a0.range has no test"),
        ('mutants = ["quarter"]', "mutants = []", "must name a test and a mutant"),
        ('mutants = ["quarter"]', 'mutants = ["third"]', "mutants.toml has no mutant third"),
        ('mutants = ["quarter"]', 'mutants = ["no_half"]', "no_half fails none of its tests"),
        ('problem = "a0.range"', 'problem = "a0.ring"', "the rubric has no problem a0.ring"),
        ("[[remark]]", "[[word]]", "[[word]]: must be [[contract]] or [[remark]]"),
        ("[[contract]]", "[[remark]]", "'tests' is unknown; must be one of problem, says"),
        ("[[contract]]", "[[contract", "contracts.toml: is not TOML"),
    ],
)
def test_what_the_table_of_contracts_lacks_is_told(tiny, old, new, text):
    changed(tiny.folder, contracts.FILE_NAME, (old, new))
    assert text in "\n".join(contracts.check(tiny))


def test_new_sentences_need_a_contract(tiny):
    def told():
        return list(contracts.check(tiny))

    assert told() == []
    changed(tiny.folder, "starter/wrapping.py", ('"""In meters.', '"""In meters. Never negative.'))
    none = "contracts.toml: a0.{}: no contract or remark for '{}'"
    assert told() == [none.format("range", "Never negative.")]
    text = "\n*Contract.* One; two.\n*Common mistakes.* Three.\n"
    changed(tiny.folder, "README.md", ("\nText.\n", text))
    assert none.format("pulse", "*Contract.* One; two.") in told()
    assert not any("Three" in line for line in told())
    (tiny.folder / contracts.FILE_NAME).unlink()
    assert told() == ["contracts.toml: is missing"]


@pytest.mark.parametrize("name", ["a1", "a2", "a3", "a4"])
def test_the_grading_key_assigns_the_points_of_the_written_exercises(name):
    """Each exercise of the key has as many points, and together they are those of the rubric."""
    assignment = assignments.find(name)
    key = (assignment.solutions / "exercises.md").read_text(encoding="utf-8")
    exercises = re.split(r"^## \d+\. ", key, flags=re.MULTILINE)[1:]
    assigned = [
        sum(map(float, re.findall(r":\s([\d.]*\d)(?=[.;])", part.partition("*Points.*")[2])))
        for part in exercises
    ]
    assert assigned == pytest.approx([2.0] * len(exercises))
    whole = {part.id: part.points for part in assignment.rubric.by_hand}
    assert sum(assigned) == pytest.approx(whole[f"{name}.exercises"])


@pytest.mark.parametrize("name", ["a1", "a2", "a3"])
def test_no_edition_holds_a_solution_of_a_later_assignment(name, tmp_path):
    staff = assignments.find(name)
    edition.copy(staff, tmp_path)
    assert leaks.later_leaks(staff, tmp_path) == []

    # A copied solution and a module of the last assignment are found
    text = (assignments.find("a4").solutions / "pile_up.py").read_text()
    (tmp_path / "tofrender" / "sensors" / "counting.py").write_text(text)
    (tmp_path / "tofrender" / "sensors" / "dead_time.py").write_text("")
    found = "\n".join(leaks.later_leaks(staff, tmp_path))
    assert "counting.py: coates is coates of solutions/pile_up.py, which is withheld" in found
    assert "dead_time.py: tofrender.sensors.dead_time is withheld" in found


def test_copied_solutions_are_leaks(tmp_path):
    for name in assignments.known():
        assignment = assignments.find(name)
        folder = tmp_path / name / "mine"
        shutil.copytree(assignment.solutions, folder, ignore=shutil.ignore_patterns("__pycache__"))
        found = {line.partition(":")[0] for line in leaks.leaks(assignment, folder)}
        assert found == {path.name for path in folder.glob("*.py")}


def test_a_stub_whose_test_is_skipped_is_told(tiny, tmp_path, monkeypatch):
    tests = tiny.rubric.problem_by_test
    skipped = {name: running.TestOutcome("skipped") for name in tests}
    monkeypatch.setattr(running, "run", lambda *_, **__: skipped)
    work = verify._Checks(tiny, tmp_path, 1, (), None, print)
    vars(work)["_edition"] = tmp_path
    check = verify.CourseCheck("starter")
    work.starter(check)
    assert len(check.reasons) == len(tests)
