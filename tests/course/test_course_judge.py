"""The judge: what it says of right and wrong submissions, whatever they do to their process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from helpers.judged_pulse import PULSE, RUBRIC, SQUARE, write_assignment, write_submission

from tofrender.course import rubric
from tofrender.course.judge import expect, plugin, processes, wire, worker
from tofrender.course.judge.client import Limits, NoAnswer, Worker
from tofrender.course.judge.factors import Ratio


@pytest.fixture
def assignment(tmp_path) -> Path:
    return write_assignment(tmp_path / "tiny")


def run_pytest(assignment: Path, *arguments: str) -> tuple[str, dict[str, dict]]:
    """The output of pytest and the lines of its report, by the tests' ids."""
    report = assignment / "report.jsonl"
    command = [sys.executable, "-m", "pytest", "-q", "--report", str(report), *arguments]
    done = subprocess.run(command, cwd=assignment, capture_output=True, text=True, timeout=120)
    lines = report.read_text().splitlines() if report.exists() else []
    return done.stdout + done.stderr, {
        line["id"] + line["case"]: line for line in map(json.loads, lines)
    }


def test_reference_and_right_submission_pass(assignment, tmp_path):
    for arguments in ((), (f"--submission={write_submission(tmp_path / 'right')}",)):
        (assignment / "report.jsonl").unlink(missing_ok=True)
        output, report = run_pytest(assignment, *arguments)
        assert len(report) == 3, output
        assert {line["outcome"] for line in report.values()} == {"passed"}, output


def test_failure_says_what_was_expected_and_what_came(assignment, tmp_path):
    wrong = write_submission(tmp_path / "wrong", PULSE.replace("(self.width_opl * dr.sq", "(dr.sq"))
    output, report = run_pytest(assignment, f"--submission={wrong}")
    outcomes = {name: line["outcome"] for name, line in report.items()}
    assert outcomes == {
        "test_pulse.py::test_area": "failed",
        "test_pulse.py::test_draws": "passed",
        "test_square.py::test_one": "passed",
    }
    text = report["test_pulse.py::test_area"]["text"]
    assert text.splitlines() == [
        "problem t1.pulse, pulse.py",
        "The density integrates to one.",
        "the integral",
        "  expected: 1",
        "  came:     0.05 (0.05 times that)",
        "  hint:     is 1/σ there?",
    ]
    assert "Traceback" not in output


def test_marker_selects_a_problem_and_seeds_repeat(assignment):
    _, report = run_pytest(assignment, "-m", "t1_square")
    assert list(report) == ["test_square.py::test_one"]
    _, report = run_pytest(assignment, "-m", "t1_square", "--seeds", "3")
    assert [name.split("::")[1] for name in report] == [
        "test_one",
        "test_oneseed0",
        "test_oneseed1",
        "test_oneseed2",
    ]


def test_in_a_students_folder_a_failure_leaves_a_picture(assignment, tmp_path):
    write_submission(assignment / "mine", PULSE.replace("2 * self.width", "self.width"))
    with (assignment / "pytest.ini").open("a") as file:
        file.write("submission = mine\n")
    area = (assignment / "tests/test_pulse.py").read_text().replace("np.trapezoid(density, t)", "1")
    (assignment / "tests/test_pulse.py").write_text(area)
    output, report = run_pytest(assignment, "-m", "t1_pulse")
    assert "picture:" in output
    assert (assignment / "mine/failures/test_area.png").stat().st_size > 5000
    assert "at t [m] = " in report["test_pulse.py::test_area"]["text"]


def test_missing_rubric_and_submission_are_one_line(assignment):
    output, _ = run_pytest(assignment, "--submission", "nowhere")
    assert "nowhere: no such folder" in output
    (assignment / "rubric.toml").unlink()
    output, _ = run_pytest(assignment)
    assert "an assignment's folder has a rubric.toml" in output


DEATHS = {
    "import os; os._exit(0)": "ended itself with status 0 and gave no answer",
    "import sys; sys.exit(3)": r"called sys.exit\(3\)",
    "import ctypes; ctypes.string_at(0)": "crashed .SIGSEGV.",
    "while True: pass": "no answer within 3 s",
    "x = (": "SyntaxError in line 1",
    "raise NotImplementedError('t1.pulse: do it')": "not written yet: t1.pulse: do it",
    "1 / 0": "ZeroDivisionError: division by zero\n  pulse.py, line 1: 1 / 0",
    "x = 1": "pulse.py defines no GaussianPulse",
    "from tofrender import GaussianPulse": "is defined in tofrender.signals.pulses; "
    "must be written in",
    "import sys; sys.setrecursionlimit(10**9)\n"
    "def f(): return f()\nf()": "Recursion|crashed|memory",
    "class GaussianPulse:\n  def __init__(self, width_opl): pass\n"
    "  def eval(self, t): return object()": "a object cannot be sent",
    "x = bytearray(10**9)\nimport time; time.sleep(9)": "used more than 0.5 GiB of memory",
}


@pytest.mark.parametrize("code", DEATHS)
def test_whatever_a_submission_does_the_next_answer_is_right(code, assignment, tmp_path):
    submission = write_submission(tmp_path / "bad", code)
    limited = Worker(assignment, submission, limits=Limits(memory_bytes=2**29))
    try:
        with pytest.raises(NoAnswer, match=DEATHS[code]):
            limited.ask("density", {"width": 0.1, "t": np.zeros(1)}, 3)
        assert limited.ask("one", {"opl": 0.0}, 5) == [1.0]
    finally:
        limited.close()


HIDING = """
import os
if os.fork() == 0:
    os.setsid()
    if os.fork():
        os._exit(0)
    os.execvp("sleep", ["sleep", "86398.5"])
"""


def test_what_hides_from_the_worker_ends_with_it_and_nothing_else_does(assignment, tmp_path):
    other = subprocess.Popen(["sleep", "86398.25"])
    submission = write_submission(tmp_path / "hiding", HIDING + PULSE)
    asked = Worker(assignment, submission)

    def sleeping() -> list[str]:
        lines = [process.info["cmdline"] for process in psutil.process_iter(["cmdline"])]
        return sorted(line[1] for line in lines if line and line[0] == "sleep" and len(line) == 2)

    try:
        asked.ask("density", {"width": 0.1, "t": np.zeros(1)}, 10)
        deadline = time.monotonic() + 10  # It starts whenever it gets a turn
        while "86398.5" not in sleeping() and time.monotonic() < deadline:
            time.sleep(0.02)
        assert "86398.5" in sleeping()
        asked.close()
        assert "86398.5" not in sleeping()
        assert other.poll() is None
    finally:
        asked.close()
        other.kill()
        other.wait()


def test_missing_file_and_printed_output(assignment, tmp_path):
    submission = write_submission(tmp_path / "half", None, "print('here'); raise ValueError('no')")
    asked = Worker(assignment, submission)
    try:
        with pytest.raises(NoAnswer, match=r"pulse\.py is missing \(problem t1\.pulse\)"):
            asked.ask("density", {"width": 0.1, "t": np.zeros(1)}, 3)
        with pytest.raises(NoAnswer, match="ValueError: no"):
            asked.ask("one", {"opl": 0.0}, 3)
        deadline = time.monotonic() + 5  # it comes on another way than the answer
        while "here" not in asked.output and time.monotonic() < deadline:
            time.sleep(0.01)
        assert "here" in asked.output
    finally:
        asked.close()
    assert not asked._scratch.exists()


def test_questions_do_not_fill_the_disk(assignment, tmp_path, monkeypatch):
    """The limit is that of what stays, however many questions a worker answers."""
    asked = Worker(assignment, write_submission(tmp_path / "right"))
    try:
        first = asked.ask("density", {"width": 0.1, "t": np.zeros(200_000)}, 10)
        running = asked._running
        disk = SimpleNamespace(free=0)
        monkeypatch.setattr(processes, "MAX_WRITTEN", 4 << 20)
        monkeypatch.setattr(processes.shutil, "disk_usage", lambda _: disk)
        assert running.excess(None, asked._place) == ""
        for _ in range(5):
            again = asked.ask("density", {"width": 0.1, "t": np.zeros(200_000)}, 10)
            np.testing.assert_array_equal(again, first)
        disk.free = -(1 << 30)
        assert running.excess(None, asked._place) == ""
        assert asked._running is running
        assert [path.name for path in asked._place.glob("*/*.npz")] == []
    finally:
        asked.close()


def test_helpers_of_a_submission_may_be_called_as_the_judges(assignment, tmp_path):
    probes = assignment / "tests/probes.py"
    (assignment / "tests/worlds.py").write_text("scale = 2.0\n")
    probes.write_text(
        "import worlds\n"
        + probes.read_text().replace("return theirs.AM", "return worlds.scale * theirs.AM")
    )
    submission = write_submission(tmp_path / "x", square="from worlds import mine\n" + SQUARE)
    (submission / "worlds.py").write_text("mine = 1\n")
    asked = Worker(assignment, submission)
    try:
        assert asked.ask("one", {"opl": 0.0}, 20) == [2.0]
    finally:
        asked.close()


CHAIN = """
def fails():
    try:
        raise ValueError("the cause")
    except ValueError as error:
        raise RuntimeError("in the middle") from error.with_traceback(None)

def outer():
    try:
        fails()
    except RuntimeError as error:
        raise RuntimeError("outside") from error
"""


def test_students_line_is_named_along_all_causes(tmp_path):
    path = tmp_path / "student.py"
    path.write_text(CHAIN)
    names: dict = {}
    exec(compile(CHAIN, str(path), "exec"), names)
    with pytest.raises(RuntimeError) as caught:
        names["outer"]()
    text = worker.explain(caught.value, tmp_path)
    assert text.splitlines()[0] == "ValueError: the cause"
    assert "student.py, line 6: raise RuntimeError" in text


def test_theirs_knows_the_rubrics_names_only(assignment):
    theirs = worker.Theirs(rubric.read(assignment), None)
    assert theirs.GaussianPulse(0.1).width_opl == 0.1
    with pytest.raises(AttributeError, match="no problem of the rubric has this name"):
        _ = theirs.Nothing


def test_data_survive_the_wire(tmp_path):
    value = {"a": [1, 2.5, None, True, "x"], "b": {"c": np.eye(2), "d": np.float32(3)}}
    wire.write(tmp_path / "x.npz", value)
    back = wire.read(tmp_path / "x.npz")
    assert back["a"] == value["a"]
    np.testing.assert_array_equal(back["b"]["c"], np.eye(2))
    assert back["b"]["d"] == 3
    with pytest.raises(TypeError, match="a object cannot be sent"):
        wire.write(tmp_path / "y.npz", [object()])
    with pytest.raises(TypeError, match="array of object"):
        wire.write(tmp_path / "y.npz", np.array([object()]))
    for junk in (b"", b"PK\3\4 junk", b"no"):
        (tmp_path / "z.npz").write_bytes(junk)
        with pytest.raises(ValueError, match=r"z\.npz: is not an answer"):
            wire.read(tmp_path / "z.npz")


def test_rubric_adds_points_and_names_homes(assignment):
    read = rubric.read(assignment)
    assert (read.points, [p.points for p in read.problems]) == (6, [3, 3])
    assert read.home_of["AMCWPulse"].id == "t1.square"
    assert read.problem_of["test_pulse.py::test_draws"].marker == "t1_pulse"
    assert read.withheld == {"tofrender.signals.pulses": "t1.pulse"}


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("points = 3", "points = -3", "'test_square.py::test_one': points must be 0 or more"),
        ("points = 3", "pionts = 3", "'pionts' is unknown; must be one of id, points, visibility"),
        ("title", "titel", "'titel' is unknown"),
        ('id = "t1.square"', 'id = "t1.pulse"', "problem 't1.pulse' is there more than once"),
        ('id = "t1.square"', 'id = "t2.square"', "must start with 't1' and a dot"),
        ("test_square.py::test_one", "test_pulse.py::test_area", "more than once"),
        ("timeout_s = 3", "timeout_s = 0", "timeout_s = 0: must be above 0"),
        ("timeout_s = 3", "needs = ['t1.x']", "needs 't1.x', which is no problem of this file"),
        ("[[problem]]", "[[problem]", "is not TOML"),
        ('title = "Tiny"', "", "missing 1 required positional argument: 'title'"),
    ],
)
def test_bad_rubric_is_refused_in_one_line(old, new, text, tmp_path):
    assert old in RUBRIC
    (tmp_path / "rubric.toml").write_text(RUBRIC.replace(old, new))
    with pytest.raises(ValueError, match=r"rubric\.toml") as error:
        rubric.read(tmp_path)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_exact_comparisons():
    expect.close(1.00005, 1, "x")
    expect.close([[1, 2]], 1.5, "x", atol=0.5)
    for came, wanted, text in (
        (1.001, 1, "came:     1.001 (1.001 times that)"),
        ([1, 2], [1, 2, 3], r"shape (2,)"),
        ([1, np.nan], [1, 2], "1 that are NaN or infinite, the first at [1]"),
        ("text", 1, "'text'"),
        ([[0, 1]], [[0, 0]], "at [0, 1]"),
    ):
        with pytest.raises(expect.Failure) as failure:
            expect.close(came, wanted, "what", hint="look here")
        assert text in str(failure.value)
        assert "hint:     look here" in str(failure.value)
    with pytest.raises(expect.Failure, match="it holds"):
        expect.true(False, "it holds")


def test_nothing_is_no_answer():
    for compare in (
        lambda: expect.close([], 1.0, "x"),
        lambda: expect.close(np.zeros((0, 3)), np.zeros((0, 3)), "x"),
        lambda: expect.finite([], "x"),
        lambda: expect.estimate(np.zeros((8, 0)), 1.0, "x"),
        lambda: expect.noise(np.zeros((8, 0)), 1.0, "x"),
    ):
        with pytest.raises(expect.Failure, match="none: an array of shape"):
            compare()


def test_a_factor_is_named_hints_and_leaves_a_part():
    right = np.array([1.0, 2.0, 0.0, 5.0])
    cos = np.array([0.5, 0.25, 0.1, 0.9])
    ratios = {"π": "divide by π", "1/cos": Ratio(1 / cos, "the cosine is missing")}
    for factor, name, hint, share in (
        (np.pi, "π", "divide by π", 0.5),
        (-1, "-1", "look here", 0.5),
        (0.5, "1/2", "look here", 0.5),
        (1 / cos, "1/cos", "the cosine is missing", 0),
    ):
        with pytest.raises(expect.Failure) as failure:
            expect.close(right * factor, right, "x", hint="look here", ratios=ratios)
        text = str(failure.value)
        assert f"which is: {name} times what is right, everywhere" in text
        assert f"hint:     {hint}" in text
        assert failure.value.share == share
    for came in (right * 1.7, np.zeros(4), right * [2, 2, 1, 1]):
        with pytest.raises(expect.Failure) as failure:
            expect.close(came, right, "x", ratios=ratios)
        assert "which is" not in str(failure.value)
        assert failure.value.share == 0
    for came, share in ((2.0, 0), (np.pi, 0.5)):  # in one number, 2 may be chance
        with pytest.raises(expect.Failure, match="which is: ") as failure:
            expect.close(came, 1.0, "x")
        assert failure.value.share == share
    with pytest.raises(expect.Failure) as failure:  # a bound so wide that several fit
        expect.close(right * 2, right, "x", rtol=0.4)
    assert failure.value.share == 0


@pytest.mark.statistical
def test_a_factor_is_found_through_noise():
    expect.configure(comparisons=10)
    noise = np.random.default_rng(3).normal(1, 0.05, (32, 6))
    for compare in (
        lambda: expect.estimate(noise * np.pi, 1.0, "mean"),
        lambda: expect.same(noise * np.pi, noise[::-1], "mean"),
    ):
        with pytest.raises(expect.Failure, match="which is: π times") as failure:
            compare()
        assert failure.value.share == 0.5
    with pytest.raises(expect.Failure) as failure:
        expect.estimate(noise * 1.2, 1.0, "mean")
    assert failure.value.share == 0


@pytest.mark.statistical
def test_scatter_beyond_that_of_a_good_solution_fails():
    noise = np.random.default_rng(4).normal(1, 0.1, (64, 5))
    expect.noise(noise, 0.2, "mean")
    with pytest.raises(expect.Failure, match=r"standard deviation of mean\n  expected: at most"):
        expect.noise(1 + 3 * (noise - 1), 0.2, "mean", hint="few samples?")
    with pytest.raises(expect.Failure, match="NaN"):
        expect.noise(noise * np.nan, 0.2, "mean")


@pytest.mark.statistical
def test_comparisons_with_noise_find_errors_and_pass_right_ones():
    expect.configure(comparisons=10)
    rng = np.random.default_rng(5)
    noise = rng.normal(1, 0.1, (16, 20))
    expect.estimate(noise, 1, "mean")
    expect.same(noise, rng.normal(1, 0.1, (16, 20)), "mean")
    chances = np.full(10, 0.09)  # a tenth falls into no bin
    expect.histogram(rng.multinomial(10000, [*chances, 0.1])[:-1], chances, "counts")
    for wrong in (
        lambda: expect.estimate(noise * 1.2, 1, "mean"),
        lambda: expect.estimate(np.where(noise < 0.8, np.nan, noise), 1, "mean"),
        lambda: expect.same(noise, noise * 1.2, "mean"),
        lambda: expect.histogram([1000] * 9 + [2000], chances, "counts"),
        lambda: expect.histogram([1000, 1], [1, 0], "counts"),
        lambda: expect.histogram([0, 0], [0.5, 0.5], "counts"),
    ):
        with pytest.raises(expect.Failure):
            wrong()


@pytest.mark.statistical
def test_false_alarms_are_as_rare_as_stated():
    """At a share of 1e-2 of 1000 comparisons of right samples about ten fail."""
    expect.configure(comparisons=1)
    rng = np.random.default_rng(11)
    alarms, expect_alpha = 0, expect.ALPHA
    expect.ALPHA = 1e-2
    try:
        for _ in range(1000):
            try:
                expect.estimate(rng.normal(size=(16, 5)), 0, "mean")
            except expect.Failure:
                alarms += 1
    finally:
        expect.ALPHA = expect_alpha
        expect.configure(comparisons=100)
    assert 1 <= alarms <= 24


def test_ids_of_tests():
    assert plugin.rubric_id("a/tests/test_x.py::test_y[case-1]") == "test_x.py::test_y"
