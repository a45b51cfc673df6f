"""The judge: its reports on correct, wrong and hostile submissions."""

import json
import os
import re
import subprocess
import sys
from contextlib import closing, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from helpers.course_assignment import PULSE, RANGE, RUBRIC, changed, write, write_submission
from helpers.limits import lower
from helpers.processes import GUARD_S, wait_for
from helpers.support import refused

from tofrender.course import rubric
from tofrender.course.judge import expect, processes, running, speed, wire, worker
from tofrender.course.judge.client import NoAnswer, SubmissionLimits, Worker
from tofrender.course.judge.factors import Ratio


@pytest.fixture
def assignment(tmp_path) -> Path:
    return write(tmp_path / "tiny").folder


def run_pytest(assignment: Path, *arguments: str) -> tuple[str, dict[str, dict]]:
    """The output of pytest and the lines of its report, by the tests' ids."""
    report = assignment / "report.jsonl"
    command = [sys.executable, "-m", "pytest", "-q", "--report", str(report), *arguments]
    done = subprocess.run(command, cwd=assignment, capture_output=True, text=True)
    lines = report.read_text().splitlines() if report.exists() else []
    return done.stdout + done.stderr, {
        line["id"] + line["case"]: line for line in map(json.loads, lines)
    }


def test_reference_and_right_submission_pass(assignment, tmp_path):
    for arguments in ((), (f"--submission={write_submission(tmp_path / 'right')}",)):
        (assignment / "report.jsonl").unlink(missing_ok=True)
        output, report = run_pytest(assignment, "-m", "a0_pulse", *arguments)
        assert len(report) == 5, output
        assert {line["outcome"] for line in report.values()} == {"passed"}, output


def test_failure_says_what_was_expected_and_what_came(assignment, tmp_path):
    wrong = write_submission(tmp_path / "wrong", PULSE.replace("self.width_opl * 2.5", "2.5"))
    output, report = run_pytest(assignment, "-m", "a0_pulse", f"--submission={wrong}")
    failed = [name for name, line in report.items() if line["outcome"] == "failed"]
    assert failed == ["test_pulse.py::test_area"]
    text = report["test_pulse.py::test_area"]["text"]
    assert text.splitlines() == [
        "problem a0.pulse, pulse.py",
        "The density integrates to one.",
        "the area",
        "  expected: 1",
        "  actual:   0.05 (0.05 times that)",
        "  hint:     is 1 / (sqrt(2 pi) sigma) there?",
    ]
    assert "Traceback" not in output


def test_marker_selects_a_problem_and_seeds_repeat(assignment):
    _, report = run_pytest(
        assignment, "-m", "a0_range", "--seeds", "3", "tests/test_range_staff.py"
    )
    cases = [name.removeprefix("test_range_staff.py::test_any_frequency") for name in report]
    assert cases == ["seed0", "seed1", "seed2"]


def test_seeds_stay_below_what_handouts_promise(assignment):
    """Also with the largest secret; tests add little to them."""
    seed = (1 << 31) - 1
    (assignment / "secret").write_text(str(seed))
    line = "f = submission.random.uniform"
    check = f"expect.true(0 <= submission.seed < 1 << 31, str(submission.seed))\n    {line}"
    changed(assignment, "tests/test_range_staff.py", (line, check))
    options = ("--seed", str(seed), "--secret", "secret", "-m", "a0_range")
    output, report = run_pytest(assignment, *options, "tests/test_range_staff.py")
    assert [line["outcome"] for line in report.values()] == ["passed"], output


def test_in_a_students_folder_a_failure_leaves_a_picture(assignment, tmp_path):
    write_submission(assignment / "mine", PULSE.replace("-0.5 *", "-0.4 *"))
    with (assignment / "pytest.ini").open("a") as file:
        file.write("submission = mine\n")
    curves = 'density, 2 * density, "the area", x=t, x_label="t [m]"'
    changed(assignment, "tests/test_pulse.py", ('area, 1.0, "the area"', curves))
    output, report = run_pytest(assignment, "-m", "a0_pulse")
    assert "picture:" in output
    assert (assignment / "mine/failures/test_area.png").stat().st_size > 5000
    assert "at t [m] = " in report["test_pulse.py::test_area"]["text"]


def test_without_pytest_no_points_are_told(assignment, monkeypatch):
    monkeypatch.setattr(running, "PYTEST_OPTIONS", ("-p", "no_such_plugin"))
    with pytest.raises(RuntimeError, match=r"pytest failed in .*no_such_plugin"):
        running.run(assignment)
    monkeypatch.setitem(sys.modules, "pytest", None)
    with pytest.raises(ModuleNotFoundError, match="pytest is missing"):
        running.run(assignment)


def test_missing_rubric_and_submission_are_one_line(assignment):
    output, _ = run_pytest(assignment, "--submission", "nowhere")
    assert "nowhere: the folder does not exist" in output
    (assignment / "rubric.toml").unlink()
    output, _ = run_pytest(assignment)
    assert "rubric.toml does not exist" in output


DEATHS = {
    "import os; os._exit(0)": "ended itself with status 0 and gave no answer",
    "import sys; sys.exit(3)": r"called sys.exit\(3\)",
    "import ctypes; ctypes.string_at(0)": "crashed .SIGSEGV.",
    "while True: pass": "no answer within 3 s",
    "x = (": "SyntaxError in line 1",
    "raise NotImplementedError('a0.pulse: do it')": "not written yet: a0.pulse: do it",
    "1 / 0": "ZeroDivisionError: division by zero\n  pulse.py, line 1: 1 / 0",
    "x = 1": "pulse.py does not define GaussianPulse",
    "from tofrender import GaussianPulse": "is defined in tofrender.signals.pulses; must be w",
    "import sys; sys.setrecursionlimit(10**9)\n"
    "def f(): return f()\nf()": "Recursion|crashed|memory",
    "class GaussianPulse:\n  def __init__(self, width_opl): pass\n"
    "  def eval(self, t): return object()": "a object cannot be sent",
    "x = bytearray(10**9)\nimport time; time.sleep(999)": "used more than 0.5 GiB of memory",
}


@pytest.mark.parametrize("code", DEATHS)
def test_whatever_a_submission_does_the_next_answer_is_right(code, assignment, tmp_path):
    submission = write_submission(tmp_path / "bad", code)
    with closing(
        Worker(assignment, submission, limits=SubmissionLimits(memory_bytes=2**29))
    ) as limited:
        limit_s = 3 if "within 3 s" in DEATHS[code] else GUARD_S
        with pytest.raises(NoAnswer, match=DEATHS[code]):
            limited.ask("density", {"width_opl": 0.1, "t": np.zeros(1)}, limit_s)
        assert limited.ask("wrap", {"frequency_hz": 1.0}, GUARD_S) == 149896229


SLEEP = f"{86_400 + os.getpid()}.5"  # what a process sleeps that a test starts and should end


def is_asleep() -> bool:
    processes = psutil.process_iter(["cmdline"])
    return any(each.info["cmdline"] == ["sleep", SLEEP] for each in processes)


def test_missing_file_printed_output_and_what_hides(assignment, tmp_path):
    hides = f"import os; os.system('setsid sleep {SLEEP} &')\n"
    text = f"{hides}print('here'); raise ValueError('no')"
    submission = write_submission(tmp_path / "half", None, text)
    with closing(Worker(assignment, submission)) as asked:
        with pytest.raises(NoAnswer, match=r"pulse\.py is missing \(problem a0\.pulse\)"):
            asked.ask("density", {"width_opl": 0.1, "t": np.zeros(1)}, GUARD_S)
        with pytest.raises(NoAnswer, match="ValueError: no"):
            asked.ask("wrap", {"frequency_hz": 1.0}, GUARD_S)
        wait_for(is_asleep)
        wait_for(lambda: "here" in asked._running.output())  # beside the answer
    assert not asked._scratch.exists()
    assert not is_asleep()


def test_questions_do_not_fill_the_disk(assignment, tmp_path, monkeypatch):
    """Files of answered questions are removed, so a worker can answer any number of questions."""
    question = {"width_opl": 0.1, "t": np.zeros(200_000)}
    disk = SimpleNamespace(free=0)
    with closing(Worker(assignment, write_submission(tmp_path / "right"))) as asked:
        first = asked.ask("density", question, GUARD_S)
        running = asked._running
        lower(monkeypatch, judge_written_bytes=4 << 20)
        monkeypatch.setattr(processes.shutil, "disk_usage", lambda _: disk)
        assert running.excess(None, asked._folder) == ""
        for _ in range(5):
            np.testing.assert_array_equal(asked.ask("density", question, GUARD_S), first)
        disk.free = -(1 << 30)
        assert running.excess(None, asked._folder) == ""
        assert asked._running is running
        assert [path.name for path in asked._folder.glob("*/*.npz")] == []


def test_helpers_of_a_submission_may_be_called_as_the_judges(assignment, tmp_path):
    (assignment / "tests/worlds.py").write_text("scale = 2.0\n")
    scaled = ("return theirs.un", "return worlds.scale * theirs.un")
    changed(assignment, "tests/probes.py", ("import", "import worlds\nimport"), scaled)
    names = ("probes", "formulas", "test_range", "worlds", "expect", "range_test")
    imports = "".join(f"from {name} import mine\n" for name in names)
    submission = write_submission(tmp_path / "x", wrapping=imports + RANGE)
    for name in names:
        (submission / f"{name}.py").write_text("mine = 1\ndef wrap(*_, **__):\n    return 0\n")
    with closing(Worker(assignment, submission)) as asked:
        assert asked.ask("wrap", {"frequency_hz": 1.0}, GUARD_S) == 2 * 149896229


CHAIN = """
def fails():
    try:
        raise ValueError("the cause")
    except ValueError as error:
        raise RuntimeError("in the middle") from error.with_traceback(None)

try:
    fails()
except RuntimeError as error:
    raise RuntimeError("outside") from error
"""


def test_students_line_is_named_along_all_causes(tmp_path):
    path = tmp_path / "student.py"
    path.write_text(CHAIN)
    with pytest.raises(RuntimeError) as caught:
        exec(compile(CHAIN, str(path), "exec"), {})
    text = worker.explain(caught.value, tmp_path)
    assert text.splitlines()[0] == "ValueError: the cause"
    assert "student.py, line 6: raise RuntimeError" in text


def test_theirs_knows_the_rubrics_names_only(assignment):
    theirs = worker.SubmittedNames(rubric.read(assignment), None)
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
        with pytest.raises(ValueError, match=r"z\.npz is not an answer"):
            wire.read(tmp_path / "z.npz")


def test_rubric_adds_points_and_names_homes(assignment):
    read = rubric.read(assignment)
    assert [problem.points for problem in read.problems] == [5.5, 4]
    assert read.problem_by_name["unambiguous_range"].id == "a0.range"
    assert read.problem_by_test["test_pulse.py::test_peak"].marker == "a0_pulse"
    assert read.withheld["tofrender.signals.pulses"] == "a0.pulse"


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("points = 3", "points = -3", "'test_range.py::test_range': points must be 0 or more"),
        ("points = 3", "pionts = 3", "'pionts' is unknown; must be one of id, points, visibility"),
        ("title", "titel", "'titel' is unknown"),
        ('id = "a0.range"', 'id = "a0.pulse"', "problem 'a0.pulse' is defined more"),
        ('id = "a0.range"', 'id = "a1.range"', "must start with 'a0' and a dot"),
        ("test_range.py::test_range", "test_pulse.py::test_area", "more than once"),
        ("bonus = true", "timeout_s = 0", "timeout_s = 0: must be above 0"),
        ('needs = ["a0.pulse"]', "needs = ['a0.x']", "needs 'a0.x', which is not a problem of"),
        ("[[problem]]", "[[problem]", "is not TOML"),
        ('title = "Tiny"', "", "missing 1 required positional argument: 'title'"),
    ],
)
def test_bad_rubric_is_refused_in_one_line(old, new, text, tmp_path):
    assert old in RUBRIC
    (tmp_path / "rubric.toml").write_text(RUBRIC.replace(old, new))
    refused(rf"rubric\.toml.*{re.escape(text)}", rubric.read, tmp_path)


def test_exact_comparisons():
    expect.close(1.00005, 1, "x")
    expect.close([[1, 2]], 1.5, "x", atol=0.5)
    for came, wanted, says in (
        (1.001, 1, "actual:   1.001 (1.001 times that)"),
        ([1, 2], [1, 2, 3], r"shape (2,)"),
        ([1, np.nan], [1, 2], "1 that are NaN or infinite, the first at [1]"),
        ("text", 1, "'text'"),
        ([[0, 1]], [[0, 0]], "at [0, 1]"),
    ):
        failure = fails(expect.close, came, wanted, hint="look here", says=says)
        assert "hint:     look here" in str(failure)
    fails(expect.true, False, says="what")


def test_each_element_has_a_tolerance_of_its_own():
    """A small element next to a large one must be as precise, relative to itself."""
    expect.close([[50.004, 0.00100005]], [[50.0, 0.001]], "x")
    for came in ([[50.0, 0.003]], [[50.0, 0.0010002]], [[50.02, 0.001]]):
        fails(expect.close, came, [[50.0, 0.001]])
    expect.close([[50.0, 0.003]], [[50.0, 0.001]], "x", atol=0.0021)


def fails(compare, *arguments, says: str | None = None, **options) -> expect.Failure:
    """Return the failure of a comparison that must fail with this text."""
    with pytest.raises(expect.Failure, match=says and re.escape(says)) as failure:
        compare(*arguments, "what", **options)
    return failure.value


def test_a_message_shows_two_different_numbers():
    for came, wanted in ((1 + 1e-8, 1.0), (0.1 + 2e-9, 0.1), (1e9 + 1, 1e9)):
        failure = fails(expect.close, came, wanted, rtol=1e-12)
        shown = dict(line.strip().split(": ") for line in str(failure).splitlines()[1:])
        actual = shown["actual"].partition(" (")[0].strip()
        assert actual != shown["expected"].strip()
        assert float(actual) == pytest.approx(came, rel=1e-12)
        assert "1 times that" not in str(failure)
    samples = np.array([[1.0], [-1.0]]) * np.sqrt(0.5) * (1 + 1e-9)
    text = str(fails(expect.noise, samples, 1.0))
    assert text.split("at most ")[1].split()[0] != text.split("actual:   ")[1].split()[0]


def test_time_limits_grow_on_a_slow_machine(monkeypatch):
    speed.slowness.cache_clear()
    assert speed.slowness() >= 1
    for nominal_s, expected in ((1e9, 1.0), (1e-9, speed.MOST)):
        lower(monkeypatch, judge_nominal_s=nominal_s)
        speed.slowness.cache_clear()
        assert speed.slowness() == expected
    speed.slowness.cache_clear()


def test_nothing_is_no_answer():
    none = "an empty array of shape"
    fails(expect.close, [], 1.0, says=none)
    fails(expect.close, np.zeros((0, 3)), np.zeros((0, 3)), says=none)
    fails(expect.finite, [], says=none)
    fails(expect.estimate, np.zeros((8, 0)), 1.0, says=none)
    fails(expect.noise, np.zeros((8, 0)), 1.0, says=none)


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
        says = f"factor:   {name} times the expected value, everywhere"
        failure = fails(
            expect.close, right * factor, right, says=says, hint="look here", ratios=ratios
        )
        assert f"hint:     {hint}" in str(failure)
        assert failure.fraction == share
    for came in (right * 1.7, np.zeros(4), right * [2, 2, 1, 1]):
        failure = fails(expect.close, came, right, ratios=ratios)
        assert "factor:" not in str(failure)
        assert failure.fraction == 0
    for wanted in (1.0, np.ones(5), np.array([1.0, 2.0, 2.0, 0.0])):  # less than three numbers
        assert fails(expect.close, wanted * np.pi, wanted, says="factor:   π").fraction == 0
    # a bound so wide that several fit
    assert fails(expect.close, right * 2, right, rtol=0.4).fraction == 0


@pytest.mark.statistical
def test_a_factor_is_found_through_noise():
    expect.configure(comparisons=10)
    noise = np.random.default_rng(3).normal(1, 0.05, (32, 6))
    far = np.arange(1.0, 7)
    near = np.linspace(1, 1.05, 6)
    for numbers, share in ((far, 0.5), (near, 0)):  # numbers that noise does not keep apart
        right = noise * numbers
        for compare, wanted in ((expect.estimate, numbers), (expect.same, right[::-1])):
            failure = fails(compare, right * np.pi, wanted, says="factor:   π times")
            assert failure.fraction == share
    assert fails(expect.estimate, noise * 1.2, 1.0).fraction == 0
    one = noise[:, 0] * np.pi
    assert fails(expect.estimate, one, 1.0, says="factor:   π times").fraction == 0


@pytest.mark.statistical
def test_scatter_beyond_that_of_a_good_solution_fails():
    noise = np.random.default_rng(4).normal(1, 0.1, (64, 5))
    expect.noise(noise, 0.2, "mean")
    says = "standard deviation of what\n  expected: at most"
    fails(expect.noise, 1 + 3 * (noise - 1), 0.2, says=says, hint="few samples?")
    fails(expect.noise, noise * np.nan, 0.2, says="NaN")


@pytest.mark.statistical
def test_comparisons_with_noise_find_errors_and_pass_right_ones():
    expect.configure(comparisons=10)
    rng = np.random.default_rng(5)
    noise = rng.normal(1, 0.1, (16, 20))
    expect.estimate(noise, 1, "mean")
    expect.same(noise, rng.normal(1, 0.1, (16, 20)), "mean")
    chances = np.full(10, 0.09)  # a tenth falls into no bin
    expect.histogram(rng.multinomial(10000, [*chances, 0.1])[:-1], chances, "counts")
    fails(expect.estimate, noise * 1.2, 1)
    fails(expect.estimate, np.where(noise < 0.8, np.nan, noise), 1)
    fails(expect.same, noise, noise * 1.2)
    fails(expect.histogram, [1000] * 9 + [2000], chances)
    fails(expect.histogram, [1000, 1], [1, 0])
    fails(expect.histogram, [0, 0], [0.5, 0.5])


@pytest.mark.statistical
def test_false_alarms_are_as_rare_as_stated(monkeypatch):
    """At a share of 1e-2 of 1000 comparisons of right samples about ten fail."""
    expect.configure(comparisons=1)
    rng = np.random.default_rng(11)
    passed = 0
    lower(monkeypatch, judge_alpha=1e-2)
    for _ in range(1000):
        with suppress(expect.Failure):
            expect.estimate(rng.normal(size=(16, 5)), 0, "mean")
            passed += 1
    expect.configure(comparisons=100)
    assert 1 <= 1000 - passed <= 24
