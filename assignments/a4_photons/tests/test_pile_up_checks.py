"""The test of pile-up that students write, tried on solutions without any pile-up."""

import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_pile_up_checks

NO_PILE_UP = """
import numpy as np


def first_photon(rates):
    return FIRST


def coates(counts, cycles):
    return np.asarray(counts) / cycles


def coates_variance(rates, cycles):
    return np.asarray(rates) / cycles
"""


def test_wrong_ones_are_found(submission):
    """Photons that do not hide others, and probabilities of 0."""
    for name, first in (("no pile-up", "np.asarray(rates)"), ("no light", "0 * np.asarray(rates)")):
        text = NO_PILE_UP.replace("FIRST", first)
        said = submission.ask(
            "try_pile_up", name=name.replace(" ", "_").replace("-", "_"), text=text
        )
        expect.true(said["is"] != "unwritten", "not written yet: check_pile_up")
        expect.true(said["is"] == "fails", f"a wrong solution ({name}) passes your test")
        kind = said["text"].partition(":")[0]
        text = f"what a wrong solution ({name}) raises: an AssertionError; came {kind}"
        expect.true(kind == "AssertionError", text)
