"""Right solutions that are written in other ways than the course's own keep their points."""

import shutil
from pathlib import Path

import pytest

from tofrender.course.assignments import find
from tofrender.course.judge import running

EXCHANGED = (
    "return mi.Point2f(dr.copysign(distance, s))",
    "t = dr.copysign(distance, s)\n    return mi.Point2f(t.y, t.x)",
)
WEIGHT = "dr.ones(mi.Float, dr.width(t))"
CASES = {
    "x from v, y from u": ("a1", "tent.py", EXCHANGED, ("test_tent", "test_tent_staff")),
    "a weight of 1.0": ("a2", "gaussian_pulse.py", (WEIGHT, "1.0"), ("test_gaussian_pulse",)),
    "one weight": ("a2", "gaussian_pulse.py", (WEIGHT, "mi.Float(1)"), ("test_gaussian_pulse",)),
    "the clips themselves unseen": (
        "a3", "lens.py", ("(z <= self.far_clip)", "(z < self.far_clip)"),
        ("test_lens.py::test_what_is_not_seen",),
    ),
    "an evaluated loop": (
        "a1", "path_tracer_mats.py", ("while active:", 'while dr.hint(active, mode="evaluated"):'),
        ("test_path_tracer_mats.py::test_mirror",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_right_solutions_keep_their_points(name, tmp_path):
    assignment, file, (old, new), asked = CASES[name]
    found = find(assignment)
    student = Path(shutil.copytree(found.solutions, tmp_path / "student"))
    text = (student / file).read_text(encoding="utf-8")
    assert text.count(old) == 1
    (student / file).write_text(text.replace(old, new), encoding="utf-8")
    tests = [test for test in found.rubric.problem_by_test if test.startswith(asked)]
    outcomes = running.run(found.folder, tests=tests, submission=student)
    wrong = {test: each.texts for test, each in outcomes.items() if each.outcome != "passed"}
    assert not wrong
    assert outcomes.keys() == set(tests)
