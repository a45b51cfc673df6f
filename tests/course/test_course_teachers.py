"""Work of a teacher with a class: rosters, sheets, pages, autograders, new terms, similarity."""

import re
import subprocess
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import tiny_assignment
from helpers.processes import GUARD_S
from helpers.support import refused
from helpers.tiny_assignment import ADD0, RIGHT, grade_class, rows, zipped

pytest.importorskip("resource", reason="a grading machine runs Linux or macOS")

from tofrender.cli import app as cli
from tofrender.course import mutants, pages, rubric
from tofrender.course.assignments import PACKAGE, Assignment, find
from tofrender.course.author import release
from tofrender.course.grade import classes, feedback, grading, overview, roster, similarity
from tofrender.course.grade.results import Grade, Results
from tofrender.course.grade.roster import Marks, Member
from tofrender.course.judge import running, sandbox
from tofrender.course.judge.inputs import Inputs
from tofrender.course.rubric import ByHand, GradedTest, Late, Problem, Rubric

BY_HAND = """
[[by_hand]]
id = "a0.exercises"
title = "Exercises"
points = 4

[late]
free_days = 1
lost_per_day = 0.1
"""
MUTANT = """
[[mutant]]
id = "{}"
problem = "a0.add"
file = "add.py"
why = "{}"
edits = [["a + b", "{}"]]
fails = ["test_add.py::test_numbers", "test_add.py::test_arrays"]
says = "the sum"
"""
MUTANTS = MUTANT.format("takes_the_difference", "It subtracts.", "a - b")
MUTANTS += MUTANT.format("forgets_b", "It forgets b.", "a")
CHECKED = {
    "rubric.toml": tiny_assignment.RUBRIC
    + """
[[problem]]
id = "a0.check"
title = "A test of sums"
file = "check.py"
names = ["check_add"]
tests_of = "a0.add"
timeout_s = 60
takes_s = 1
tests = [{ id = "test_check_staff.py::test_share", points = 4, visibility = "after_published" }]
"""
    + BY_HAND,
    "mutants.toml": MUTANTS,
    "tests/probes.py": tiny_assignment.FILES["tests/probes.py"]
    + """
from tofrender.course.judge import trials

def defines(theirs, name):
    getattr(theirs, name)

def try_add(theirs, name, text):
    return trials.verdict(theirs.check_add, trials.load(name, text).add)
""",
    "tests/test_check_staff.py": tiny_assignment.HEAD.format("check")
    + """
from tofrender.course.judge import trials

OTHER = "def add(a, b):\\n    return -(-a - b)\\n"

def test_share(submission):
    trials.share_found(submission, "try_add", [trials.Solution("other", OTHER)])
""",
    "starter/check.py": "def check_add(add):\n    raise NotImplementedError\n",
    "solutions/check.py": "def check_add(add):\n    assert add(2, 3) == 5\n",
}
FILES = tiny_assignment.FILES | CHECKED


@pytest.fixture(scope="module")
def staff(tmp_path_factory) -> Assignment:
    return find(tiny_assignment.write(tmp_path_factory.mktemp("staff") / "a0_sums", FILES))


@pytest.fixture(scope="module")
def toy() -> Rubric:
    tests = (GradedTest("test_a.py::test_x", 2), GradedTest("test_a.py::test_y", 2))
    bonus = Problem("a0.b", "B", (GradedTest("test_b.py::test_z", 1),), bonus=True)
    problems = (Problem("a0.a", "A", tests), bonus)
    text = ByHand("a0.text", "Text", 4)
    return Rubric("a0", "Toys", problems, by_hand=(text,), late=Late(1, 0.1))


def zips(folder: Path, *names: str) -> list[Path]:
    for name in names:
        zipped(folder / name, {"add.py": RIGHT["add.py"]})
    return sorted(folder.iterdir())


CHECKS = {
    "finds all": ("def check_add(add):\n    assert add(2, 3) == 5\n", 1.0, ""),
    "finds a half": ("def check_add(add):\n    assert add(2, 3) > 1\n", 0.5, "1 of 2"),
    "finds none": ("def check_add(add):\n    pass\n", 0.0, "0 of 2 wrong solutions"),
    "fails right ones": (
        "def check_add(add):\n    assert 0\n",
        0.0,
        "2 of 2 correct solutions fail",
    ),
    "is a stub": (FILES["starter/check.py"], 0.0, "not written yet: check_add"),
    "ends the process": ("import os\ndef check_add(add):\n    os._exit(0)\n", 0.0, "must end"),
    "is endless": ("def check_add(add):\n    while True: pass\n", 0.0, "must end"),
    "tells our code": (
        "import inspect\n"
        "def check_add(add):\n"
        "    frame = inspect.currentframe()\n"
        "    while 'text' not in frame.f_locals or 'return' not in frame.f_locals['text']:\n"
        "        frame = frame.f_back\n"
        "    raise NotImplementedError(frame.f_locals['text'])\n",
        0.0,
        "not written yet: check_add",
    ),
}


@pytest.mark.parametrize("name", CHECKS)
def test_a_students_test_gets_its_share(staff, tmp_path, name):
    text, share, said = CHECKS[name]
    student = tiny_assignment.write(tmp_path / "student", {"check.py": text})
    test = "test_check_staff.py::test_share"
    outcome = running.run(staff.folder, tests=[test], submission=student)[test]
    assert outcome.fraction == share
    assert said in "".join(outcome.texts)
    assert "return" not in "".join(outcome.texts)
    assert running.points_of(staff.rubric, {test: outcome})["a0.check"] == 4 * share


def test_a_problem_of_tests_names_what_it_tests(tmp_path):
    for old, new in (('tests_of = "a0.add"', 'tests_of = "a0.ad"'), ('["check_add"]', "[]")):
        tiny_assignment.write(tmp_path, {"rubric.toml": FILES["rubric.toml"].replace(old, new)})
        refused("must be a problem of this file, and names must", rubric.read, tmp_path)


def test_class_with_roster_sheet_pages_and_jobs(staff, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    everyone = tmp_path / "class"
    half = "def check_add(add):\n    assert add(2, 3) > 1\n"
    tiny_assignment.write(everyone / "x_ada", RIGHT | {"check.py": half})
    subtracts = "def add(a, b):\n    return a - b\n"
    tiny_assignment.write(everyone / "ben", {"add.py": subtracts, "mean.py": "1 / 0"})
    tiny_assignment.write(everyone / "dora", RIGHT | {"check.py": FILES["solutions/check.py"]})
    zips(everyone, "unknown.zip")
    (tmp_path / "roster.csv").write_text(
        "id,name,section,submission\nada,Ada L.,1\nben,Ben,1\ncarl,Carl,2\n17,Dora,2,dora\n"
    )
    (tmp_path / "sheet.csv").write_text(
        "id;late_days;note;a0.exercises;a0.mean\nada;3;well done;3,5;\nben;;;;4\n"
    )
    words = ["grade", str(staff.folder), "--all", str(everyone), "--csv", str(tmp_path / "g.csv")]
    words += ["--roster", str(tmp_path / "roster.csv"), "--sheet", str(tmp_path / "sheet.csv")]
    words += ["--feedback", str(tmp_path / "pages"), "--jobs", "2"]
    assert cli.main(words) == 0
    shown = capsys.readouterr()
    assert "no student has the submission 'unknown.zip'" in shown.err
    assert "[4/4]" in shown.out
    table = {row["id"]: row for row in rows(tmp_path / "g.csv")}
    assert list(table) == ["ada", "ben", "carl", "17", "unknown.zip"]
    # (7 + 2 of the check + 3.5 by hand), two days of three cost a tenth each
    assert (table["ada"]["total"], table["ada"]["lost_late"]) == ("10", "2.5")
    assert table["ada"]["a0.check"] == "2"
    assert (table["ben"]["a0.mean"], table["ben"]["total"]) == ("4", "4")
    assert table["carl"]["reason"] == roster.NOTHING
    assert (table["carl"]["submission"], table["carl"]["total"]) == ("", "0")
    assert (table["17"]["submission"], table["17"]["total"]) == ("dora", "11")
    assert table["ada"]["note"] == "well done"

    students = tmp_path / "pages" / "students"
    names = {path.name for path in students.iterdir()}
    assert names == {"17", "ada", "ben", "carl", "unknown_zip"}
    for folder in students.iterdir():
        assert {"feedback.md", "feedback.html"} <= {path.name for path in folder.iterdir()}
    ben = (students / "ben" / "feedback.md").read_text()
    assert "the sum\n  expected: 5\n  actual:   -1" in ben
    assert "**Hint:** 2 + 3" in ben
    assert "| Mean | 4 (by hand) | 4 |" in ben
    assert "![Expected and actual values of test_arrays](a0_add-test_arrays_5_.png)" in ben
    assert (students / "ben" / "a0_add-test_arrays_5_.png").stat().st_size > 5000
    assert "<img src=" in (students / "ben" / "feedback.html").read_text()
    assert str(tmp_path) not in ben
    ada = (students / "ada" / "feedback.md").read_text()
    assert "The submission was 3 days late (1 without a penalty): 2.5 points" in ada
    assert "your test does not find: " in ada.replace("\n", " ")
    class_page = (tmp_path / "pages" / "overview.md").read_text()
    assert (
        "4 of 5 students handed in a submission. Points, of 15: mean" in class_page
    )  # with 4 by hand
    assert "`takes_the_difference`: It subtracts." in class_page
    assert "| fails | fails the same tests as | what separates these | students |" in class_page
    assert "| 1: Ben |" in class_page

    canvas = ["Student=name", "ID=id", "Section=section", "A0 (17)=total", "Sum=a0.add"]
    of_canvas = [word for name in canvas for word in ("--columns", name)]
    assert (
        cli.main([*words[:4], "--csv", str(tmp_path / "canvas.csv"), *of_canvas, *words[6:]]) == 0
    )
    assert capsys.readouterr().out.count("graded before") == 0  # other results
    table = rows(tmp_path / "canvas.csv")
    assert list(table[0]) == [text.partition("=")[0] for text in canvas]
    assert list(table[0].values()) == ["Ada L.", "ada", "1", "10", "3"]

    before = {path: path.read_bytes() for path in (tmp_path / "pages").rglob("*.md")}
    assert cli.main(words) == 0
    assert capsys.readouterr().out.count("graded before") == 4
    assert {path: path.read_bytes() for path in (tmp_path / "pages").rglob("*.md")} == before


def test_jobs_give_the_same_points_side_by_side(tmp_path, monkeypatch):
    for number in range(3):
        tiny_assignment.write(tmp_path / "class" / f"{number}", {"p0.py": ADD0})
    tiny_assignment.write(tmp_path / "class" / "wrong", {"p0.py": "def add0(a, b): return a"})
    tables = {}

    class Together(subprocess.Popen):
        """Process that waits until the number of started processes equals the number of jobs."""

        def communicate(self, *arguments, **options):
            met.wait(GUARD_S)
            return super().communicate(*arguments, **options)

    side_by_side = SimpleNamespace(**vars(subprocess) | {"Popen": Together})
    monkeypatch.setattr(classes, "subprocess", side_by_side)
    for jobs in (1, 4):
        met = threading.Barrier(jobs)
        with grading.open_grader(tiny_assignment.sums(tmp_path / "a0")) as grader:
            out = tmp_path / f"out{jobs}"
            tables[jobs] = grade_class(grader, tmp_path / "class", out, jobs=jobs)
    assert tables[1] == tables[4]
    assert [row["total"] for row in tables[4]] == ["1", "1", "1", "0"]


def test_a_process_that_is_lost_costs_one_member(tmp_path, monkeypatch):
    for name in ("a", "b"):
        tiny_assignment.write(tmp_path / "class" / name, {"p0.py": ADD0})
    one = classes.json.dumps
    said = []

    def broken(wishes, **more):
        return "{" if str(wishes.get("out")).endswith("/a.json") else one(wishes, **more)

    with grading.open_grader(tiny_assignment.sums(tmp_path / "a0")) as grader:
        monkeypatch.setattr(classes.json, "dumps", broken)
        table = grade_class(grader, tmp_path / "class", tmp_path / "out", said.append)
    assert [row["total"] for row in table] == ["", "1"]
    assert "not graded; the same command tries again" in said[0]
    assert "not graded: " in table[0]["reason"]


TRIES = """
import os, pathlib, socket
here = pathlib.Path(__file__)
judging = here.parents[1] / "a0_check" / "judging"
tries = {
    "wrong solutions": lambda: (judging / "mutants.toml").read_text(),
    "right solution": lambda: (judging / "solutions" / "add.py").read_text(),
    "test": lambda: (judging / "tests" / "test_check_staff.py").read_text(),
    "neighbor": lambda: (here.parents[2] / "submission-other" / "check.py").read_text(),
    "write": lambda: (judging / "new").write_text("x"),
    "mode": lambda: here.chmod(0o777),
    "socket": lambda: socket.socket(),
    "signal": lambda: os.kill(os.getppid(), 9),
}

def done():
    found = []
    for name, it in tries.items():
        try:
            it()
            found.append(name)
        except PermissionError:
            pass
    return found

assert not done(), done()

def check_add(add):
    if not done():
        assert add(2, 3) == 5
"""


@pytest.mark.skipif(
    sandbox.landlock_version() < 6 or not sandbox.protects_files(),
    reason="this machine protects from less",
)
def test_a_students_test_is_kept_in_as_all_submissions_are(staff, tmp_path):
    student = tiny_assignment.write(tmp_path / "student", RIGHT | {"check.py": TRIES})
    with grading.open_grader(staff) as grader:
        other = tiny_assignment.write(grader.scratch / "submission-other", {"check.py": "1"})
        grading.make_readable(other)
        results = grader.grade(student, tmp_path / "results.json")
    check = results.grades["test_check_staff.py::test_share"]
    assert check.passed, check.reason
    assert results.score == 11


def test_submissions_that_run_together_are_different_users(monkeypatch):
    users = [(1 << 30) + 4711, (1 << 30) + 4712]
    monkeypatch.setattr(sandbox, "spare_users", lambda: users)
    with sandbox.own_user() as a:
        with sandbox.own_user() as b, sandbox.own_user() as c:
            assert ([a, b], c) == (users, None)
        with sandbox.own_user() as b:
            assert b == users[1]
    monkeypatch.setattr(sandbox, "spare_users", list)
    with sandbox.own_user() as a:
        assert a is None


def test_submissions_find_their_owners(tmp_path):
    there = zips(tmp_path / "class", "Lovelace_12_a2.zip", "ben.zip", "c-7.zip", "odd.zip")
    (tmp_path / "r.csv").write_text(
        "\ufeffid,submission,name\n12,,Ada\nben,,Ben\n7,,\nx,odd.zip,\nnone,,N\n", encoding="utf-8"
    )
    members, nobodys = roster.members(there, tmp_path / "r.csv")
    found = {m.id: m.submission and m.submission.name for m in members}
    owners = {"12": "Lovelace_12_a2.zip", "ben": "ben.zip", "7": "c-7.zip", "x": "odd.zip"}
    assert found == owners | {"none": None}
    assert nobodys == []
    assert members[0].name == "Ada"


ROSTERS = {
    "id\n1\n1\n": "line 3: id '1' occurs more than once",
    "id,name\n,x\n": "line 2: id = ''",
    "id,shoe\n1,2\n": "column 'shoe' is unknown; must be one of id, name",
    "id,id\n1,1\n": "column 'id' occurs more than once",
    "name\nx\n": "the column 'id' is missing",
    "id\n1,2\n": "line 2: has 2 cells",
    "": "is empty",
    "id\nben\nzoe\n": "'a_ben_zoe.zip' can belong to 'ben' or to 'zoe'",
    "id\nben\n": "'ben' has",
    "id,submission\nben,nothing.zip\n": "submission = 'nothing.zip': must be a name",
    'id\n"x\n': "is not CSV",
    b"id\n\xff\n": "is not UTF-8",
}


@pytest.mark.parametrize("text", ROSTERS)
def test_bad_rosters_are_one_line(tmp_path, text):
    there = zips(tmp_path / "class", "a_ben_zoe.zip", "b_ben.zip")
    path = tmp_path / "r.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(re.escape(ROSTERS[text]), roster.members, there, path)


SHEETS = {
    "id,late_days\nada,-1\n": "line 2: late_days = '-1': must be a number from 0, or empty",
    "id,late_days\nada,nan\n": "must be a number",
    "id,late_days\nada,1_0\n": "must be a number",
    "id,a0.a\nada,5\n": "line 2: a0.a = '5': must be a number from 0 to 4, or empty",
    "id,a0.text\nada,many\n": "a0.text = 'many': must be a number from 0 to 4",
    "id,a0.c\nada,5\n": "column 'a0.c' is unknown; must be one of id, name, late_days, handed_in",
    "id\nzoe\n": "line 2: id 'zoe' is not one of the class",
    "id\nada\nada\n": "line 3: id 'ada' occurs more than once",
    "id,note\nada,x,y\n": "line 2: has 3 cells",
}


@pytest.mark.parametrize("text", SHEETS)
def test_bad_sheets_are_one_line(tmp_path, toy, text):
    (tmp_path / "s.csv").write_text(text)
    refused(re.escape(SHEETS[text]), roster.marks, tmp_path / "s.csv", toy, [Member("ada", None)])


def test_standing_adds_by_hand_and_takes_off_late_days(toy, tmp_path):
    problems = {"problems": {"a0.a": 4.0, "a0.b": 1.0}, "summary": "=1+1"}
    content = {"score": 5.0, "output": "", "extra_data": problems}
    marks = Marks({"a0.text": 3.0, "a0.a": 2.0}, late_days=3, note="-x")
    each = roster.Standing(toy, Member("ada", tmp_path / "ada"), content, marks)
    assert (each.before, each.lost, each.total) == (6.0, 1.2, 4.8)
    roster.write_csv(tmp_path / "g.csv", toy, [each], roster=True, sheet=True)
    (row,) = rows(tmp_path / "g.csv")
    assert (row["reason"], row["note"]) == ("'=1+1", "'-x")
    assert [toy.late.lost(days) for days in (0, 1, 2, 99)] == [0, 0, 0.1, 1]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("points = 4\n\n[late]", "points = -4\n\n[late]", "points must be 0 or more"),
        ('"a0.exercises"', '"exercises"', "must start with 'a0' and a dot"),
        ("free_days = 1", "free_days = -1", "free_days = -1: must be a number from 0"),
        ("_per_day = 0.1", "_per_day = 10", "lost_per_day = 10: must be a number from 0 to"),
        ('title = "Arithmetic"', 'title = "A"\nterm = -1', "term = -1: must be an integer from 0"),
        ("free_days", "days", "'days' is unknown"),
    ],
)
def test_bad_rubrics_are_one_line(tmp_path, old, new, message):
    assert old in FILES["rubric.toml"]
    (tmp_path / "rubric.toml").write_text(FILES["rubric.toml"].replace(old, new))
    refused(re.escape(message), rubric.read, tmp_path)


def test_pages_show_what_students_wrote_as_text(tmp_path):
    text = "# T\n\n" + pages.plain("<script>a</script> [x](javascript:1) $a$ | b") + "\n\n"
    text += pages.verbatim("```\n<script>\n# no title $x$\n````") + "\n\n$a < b$\n"
    page = pages.page(text)
    assert "<script>a" not in page
    assert "<script>\n" not in page
    assert "href" not in page
    assert '<math alttext="a &lt; b"' in page
    assert "http" not in page.replace("http://www.w3.org/1998/Math/MathML", "")
    assert "$x$" in page
    assert '<html lang="en">' in page


def test_a_page_says_a_missing_file_and_a_day_once(tmp_path):
    tests = tuple(GradedTest(f"test_a.py::test_{name}", 2) for name in "xyz")
    problem = Problem("a0.a", "A", tests, file="a.py")
    toys = Rubric("a0", "Toys", (problem,), late=Late(0, 0.1))
    text = "problem a0.a, a.py\nTest of {}.\na.py is missing (problem a0.a)"
    missing = {test: Grade(False, text.format(test)) for test in toys.problem_by_test}
    content = Results(toys, missing, complete=True).gradescope()
    found = {test["extra_data"]["test"]: test for test in content["tests"]}
    standing = roster.Standing(toys, Member("ada", None), content, Marks({"a0.a": 4}, 1))
    page = feedback.page(standing, found, tmp_path)
    assert (
        page.count("`a.py` is missing, therefore these tests fail: `test_x`, `test_y`, `test_z`.")
        == 1
    )
    assert page.count("is missing") == 1
    assert "The submission was 1 day late: 0.4 points are deducted." in page


def test_points_of_the_sheet_replace_points_of_the_tests():
    problems = tuple(
        Problem(f"a0.{name}", name, (GradedTest(f"test_{name}.py::test_it", 5),), file="a.py")
        for name in "abc"
    )
    toys = Rubric("a0", "Toys", problems, late=Late(0, 0.1))
    content = {"extra_data": {"problems": {"a0.a": 5.0, "a0.b": 4.0, "a0.c": 3.0}, "summary": ""}}
    marks = Marks({"a0.a": 0.0, "a0.b": 1.5}, late_days=2)
    standing = roster.Standing(toys, Member("ada", None), content, marks)
    assert [standing.points(problem) for problem in problems] == [0.0, 1.5, 3.0]
    assert (standing.before, standing.lost) == (4.5, 0.9)


def test_overview_lists_all_mutants_that_fail_the_same_tests(staff):
    problem = staff.rubric.problems[0]
    known = mutants.read(staff)
    both = {test.id: "the sum" for test in problem.tests}
    assert "takes_the_difference" in [m.id for m in overview.candidates(both, problem, known)]
    names = tuple(both)
    twin = replace(known[0], id="twin", problem=problem.id, fails=names, says="the sum")
    other = replace(twin, id="other", fails=names[:-1], says="never")
    found = overview.candidates(dict.fromkeys(names[:-1], "the sum"), problem, [twin, other])
    assert found == [other, twin]  # the same tests come before the text
    assert overview.candidates({"no test": "x"}, problem, [twin]) == []
    separating = overview.separating([twin, other], staff.rubric)
    assert separating == f"only `twin` fails `{names[-1].partition('::')[2]}`"
    assert overview.separating([twin], staff.rubric) == ""
    missing = overview.Result("x", {}, dict.fromkeys(both, "add.py is missing"))
    assert overview.failures_of(missing, problem) == {}


@pytest.mark.parametrize("name", ["a1", "a2", "a3", "a4"])
def test_the_mistake_is_among_the_mutants_of_the_overview(name):
    """Also if a variant of the mistake passes or fails one test more."""
    assignment = find(name)
    rubric = assignment.rubric
    known = mutants.read(assignment)
    hits = []
    for mutant in known:
        problem = next(p for p in rubric.problems if p.id == mutant.problem)
        tests = {test.id for test in problem.tests}
        fails = tests & set(mutant.fails)
        variants = [fails, *(fails ^ {test} for test in tests)]
        for variant in filter(None, variants):
            found = overview.candidates(dict.fromkeys(variant, ""), problem, known)
            hits.append(mutant in found)
    assert np.mean(hits) >= 0.9


def test_points_by_hand_and_a_late_rule_do_not_grade_again(tmp_path):
    folder = tiny_assignment.write(tmp_path / "a0_sums", FILES)
    path = folder / "rubric.toml"
    text = path.read_text()

    def fingerprint(old, new, seed=4):
        assert old in text
        path.write_text(text.replace(old, new, 1))
        return grading.Grader(Assignment(folder), tmp_path, seed=seed).fingerprint

    before = fingerprint("", "")
    assert fingerprint("lost_per_day = 0.1", "lost_per_day = 0.2") == before
    assert fingerprint('title = "Exercises"\npoints = 4', 'title = "Talk"\npoints = 5') == before
    assert fingerprint("[[by_hand]]", "# Exercises\n[[by_hand]]") == before
    assert fingerprint("points = 2", "points = 2.5") != before
    assert fingerprint("timeout_s = 60", "timeout_s = 61") != before
    assert fingerprint("", "", seed=5) != before


def test_late_days_come_from_time_stamps(toy, tmp_path):
    late = Late(1, 0.1, "2027-01-31 23:59 +01:00")
    toys = replace(toy, late=late)
    class_ = [Member(name, None) for name in ("ada", "ben", "carl")]
    sheet = tmp_path / "sheet.csv"
    sheet.write_text(
        "id,handed_in,late_days\n"
        "ada,2027-01-31 22:58:00 +0000,\n"
        "ben,2027-02-02T00:00:00+01:00,\n"
        "carl,2027-02-09 12:00 UTC,1\n"
    )
    found = roster.marks(sheet, toys, class_)
    assert [found[m.id].late_days for m in class_] == [0, 2, 1]
    for text, cause in (("2027-02-02 00:00", "with its offset"), ("late", "with its offset")):
        sheet.write_text(f"id,handed_in\nada,{text}\n")
        refused(cause, roster.marks, sheet, toys, class_)
    refused("no deadline", roster.marks, sheet, toy, class_)


def test_items_that_separate():
    scores = np.array([[1, 0, 1], [1, 1, 1], [0, 1, 1], [0, 1, 1.0]])
    separates = overview.separation(scores)
    assert separates[0] < 0
    assert np.isnan(separates[2])


def test_programs_are_put_where_jplag_looks(staff, tmp_path, capsys):
    there = tmp_path / "class"
    zips(there, "ada.zip")
    zipped(there / "empty.zip", {"notes.txt": ""})
    tiny_assignment.write(there / "ada", RIGHT | {"conftest.py": "", "notes/x.py": ""})
    out = tmp_path / "jplag"
    zips(tmp_path / "last_year", "carl.zip")
    words = ["similarity", str(staff.folder), "--all", str(there), "-o", str(out)]
    words += ["--old", str(tmp_path / "last_year")]
    assert cli.main(words) == 0
    shown = capsys.readouterr()
    files = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
    assert files == {
        *("base/add.py", "base/check.py", "base/mean.py"),
        *("submissions/ada/add.py", "submissions/ada/mean.py", "submissions/ada_1/add.py"),
        *(f"old/staff_solutions/{path.name}" for path in staff.solutions.glob("*.py")),
        *("old/package/nlos/light/__init__.py", "old/carl/add.py"),
    } | {
        f"old/package/{path.relative_to(PACKAGE).as_posix()}"
        for path in (PACKAGE / "nlos" / "light").rglob("*.py")
    }
    assert "'empty.zip': contains none of add.py, mean.py, check.py" in shown.err
    assert (
        f"-l python3 -bc {out}/base -r {out}/result -old {out}/old {out}/submissions" in shown.out
    )
    assert cli.main(words) == 2
    assert "exists; pass a new folder" in capsys.readouterr().err
    assert similarity.command(Path("a b")).count("'a b/base'") == 1


def test_a_new_term_draws_other_inputs(tmp_path, capsys):
    staff = find(tiny_assignment.write(tmp_path / "a0", FILES))
    file = str(staff.folder / "tests" / "test_add.py")
    assert Inputs(file).number("width", 0.5, low=1, high=2) == 0.5
    assert release.new_term(staff, 7) == (0, 7)
    first = Inputs(file).number("width", 0.5, low=1, high=2)
    assert 1 <= first <= 2
    assert Inputs(file).number("width", 0.5, low=1, high=2) == first
    assert Inputs(file).number("height", 0.5, low=1, high=2) != first
    assert 3 <= Inputs(file).integer("count", 1, low=3, high=4) <= 4
    assert cli.main(["new-term", str(staff.folder)]) == 0
    assert "a0: changed the term from 7 to " in capsys.readouterr().out
    drawn = rubric.read(staff.folder).term
    assert drawn > 0
    assert Inputs(file).number("width", 0.5, low=1, high=2) != first
    text = (staff.folder / "rubric.toml").read_text()
    assert text.replace(f"term = {drawn}\n", "") == FILES["rubric.toml"]


def test_a_new_term_computes_what_the_tests_expect_or_stays(tmp_path):
    script = "import pathlib\nfrom tofrender.course import rubric\n"
    script += "pathlib.Path('tests/expected.txt').write_text(str(rubric.read('.').term))\n"
    written = FILES | {"tests/expected_staff.py": script}
    staff = find(tiny_assignment.write(tmp_path / "a0", written))
    release.new_term(staff, 7)
    assert (staff.folder / "tests" / "expected.txt").read_text() == "7"
    (staff.folder / "tests" / "expected_staff.py").write_text("raise KeyError('width')\n")
    with pytest.raises(ValueError, match=r"expected_staff.py failed, .* still 7: KeyError"):
        release.new_term(Assignment(staff.folder), 8)
    assert rubric.read(staff.folder).term == 7


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("grade a0", "pass either --submission PATH or --all DIR"),
        ("grade a0 --submission . ", "--out is missing"),
        ("grade a0 --submission . -o .", "--out = . is a folder"),
        ("grade a0 --all nowhere --csv x.csv", "--all = nowhere is not a folder"),
        ("grade a0 --all . ", "--csv is missing"),
        ("grade a0 --all . --csv .", "--csv = . is a folder"),
        ("grade a0 --all . --csv x.csv --jobs 200", "--jobs = 200: must be "),
        *(
            (f"grade a0 --submission . -o r --{name} 2", f"--{name} = 2 requires --all")
            for name in ("csv", "jobs", "roster", "sheet", "feedback", "columns")
        ),
        ("grade a2 --all @ --csv x.csv --roster no.csv", "--roster = no.csv: must be a CSV file"),
        ("grade a2 --all @ --csv x.csv --sheet no.csv", "--sheet = no.csv: must be a CSV file"),
        ("gradescope a2 -o .", "--out = . is a folder"),
        ("prairielearn a2 -o x.tar", "--out = x.tar: must end in .zip"),
        ("grade a2 --all @ --csv x.csv --columns x", "--columns = x: must be NAME=FIELD"),
        ("grade a2 --all @ --csv x.csv --columns x=y", "--columns = x=y: must be NAME=FIELD"),
        (
            "grade a2 --all @ --csv x.csv --format junit",
            "--format = junit cannot be combined with --all",
        ),
        ("similarity a2 --all no -o x", "--all = no is not a folder"),
        ("similarity a2 --all . -o x", "--all = .: contains no submissions"),
    ],
)
def test_bad_use_in_one_line(words, message, tmp_path, monkeypatch, capsys):
    (tmp_path / "here").mkdir()
    zips(tmp_path / "class", "a.zip")
    monkeypatch.chdir(tmp_path / "here")
    arguments = [str(tmp_path / "class") if word == "@" else word for word in words.split()]
    assert cli.main(arguments) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith(f"error: {message}"), shown.err
    assert shown.err.count("\n") == 1
    assert not list(Path.cwd().iterdir())
