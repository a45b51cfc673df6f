"""The test of pulses that students write."""

import pytest

from tofrender.course.judge import expect
from tofrender.course.judge.inputs import Inputs

pytestmark = pytest.mark.a2_pulse_checks

inputs = Inputs(__file__)
WIDTHS = (
    inputs.number("narrow checked pulse", 0.004, low=0.003, high=0.009),
    inputs.number("wide checked pulse", 0.6, low=0.3, high=1.5),
)


def test_right_pulses_pass(submission):
    """A hat and a decay keep the contract, however wide they are."""
    for name in ("Hat", "Decay"):
        for width in WIDTHS:
            said = submission.ask("check_pulse", name=name, width_opl=width)
            expect.true(said["is"] != "unwritten", "not written yet: check_pulse")
            expect.true(
                said["is"] == "passes",
                f"a right pulse ({name} of width {width} m) fails your test: {said['text']}",
                hint="is the tolerance for single precision, and does it scale with the width?",
            )
    said = submission.ask("check_pulse", name="Loud", width_opl=WIDTHS[0])
    expect.true(said["is"] == "fails", "a density that integrates to 2 passes your test, too")


def test_wrong_pulses_are_found(submission):
    """A density that integrates to 2, and samples that do not follow it."""
    for name in ("Loud", "Late"):
        for width in WIDTHS:
            said = submission.ask("check_pulse", name=name, width_opl=width)
            expect.true(said["is"] != "unwritten", "not written yet: check_pulse")
            expect.true(
                said["is"] == "fails",
                f"a wrong pulse ({name} of width {width} m) passes your test",
                hint="tests/pulses_to_check.py says what is wrong with it",
            )
            kind = said["text"].partition(":")[0]
            expect.true(
                kind == "AssertionError",
                f"what a wrong pulse ({name}) raises: an AssertionError; came {kind}",
            )
