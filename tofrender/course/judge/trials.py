"""Problems whose task is to write a test: it has to tell right solutions from wrong ones.

In the rubric, `tests_of = "a2.gaussian_pulse"` makes a problem one. Its file defines one function,
which gets a solution of that other problem and raises if it is wrong. The right solution is that of
`solutions/`, the wrong ones are those of `mutants.toml`; the points are the share of wrong ones
that the student's test finds, and none unless right ones pass::

    def test_share(submission):  # in a staff's test
        trials.share_found(submission, "try_pulse")


    def try_pulse(theirs, name, text):  # in probes.py
        made = trials.load(name, text).GaussianPulse(width_opl=0.05)
        return trials.verdict(theirs.check_pulse, made)

What the student's code says of these solutions goes to nobody, since it may be their text.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import mutants
from ..assignments import Assignment
from ..rubric import Problem
from .client import NoAnswer
from .expect import Failure, true

if TYPE_CHECKING:
    from .plugin import Submission

PASSES, FAILS, UNWRITTEN = "passes", "fails", "unwritten"


@dataclass(frozen=True)
class Solution:
    """A solution that a student's test gets to see.

    Attributes:
        name: A name for it.
        text: Its file.
        why: What is wrong with it, "" if it is right.
    """

    name: str
    text: str
    why: str = ""


# ------------------------------------------------------------------------------ for tests


def solutions(assignment: Assignment, problem: Problem) -> list[Solution]:
    """The right solution and the wrong ones that a problem's file has to tell apart.

    Args:
        assignment: With its solutions and mutants.
        problem: One with `tests_of`.
    """
    other = next(p for p in assignment.rubric.problems if p.id == problem.tests_of)
    right = (assignment.solutions / other.file).read_text(encoding="utf-8")
    return [
        Solution("right", right),
        *(
            Solution(mutant.id, mutants.apply(assignment, mutant), mutant.why)
            for mutant in mutants.read(assignment)
            if (mutant.problem, mutant.file) == (other.id, other.file)
            and problem.id not in mutant.unseen_by
        ),
    ]


def share_found(submission: Submission, probe: str, more: Iterable[Solution] = ()) -> None:
    """Give the share of the wrong solutions that the student's test finds.

    Args:
        submission: Holds the student's test.
        probe: A probe that gets `name` and `text` of a solution, and returns a `verdict`.
        more: Solutions besides those of `solutions/` and `mutants.toml`.

    Raises:
        Failure: It does not find all of them, or a right one fails it.
    """
    __tracebackhide__ = True
    problem = submission.problem
    assert problem is not None
    submission.ask("defines", name=problem.names[0])  # before it can say anything of ours
    those = [*solutions(submission.assignment, problem), *more]
    said = {}
    for number in np.random.default_rng(submission.seed).permutation(len(those)):
        each = those[number]
        try:
            said[each] = submission.ask(probe, name=f"solution_{number}", text=each.text)["is"]
        except NoAnswer:
            raise Failure("your test has to end, and to leave the process running") from None
        true(said[each] != UNWRITTEN, f"not written yet: {problem.names[0]}")
    right = [each for each in those if not each.why]
    failed = sum(said[each] == FAILS for each in right)
    true(
        not failed,
        f"{failed} of {len(right)} right solutions fail your test",
        hint="what it asks for must hold for every right solution, to single precision",
    )
    wrong = [each for each in those if each.why]
    missed = [each for each in wrong if said[each] != FAILS]
    submission.award(1 - len(missed) / len(wrong))
    true(
        not missed,
        f"your test finds {len(wrong) - len(missed)} of {len(wrong)} wrong solutions",
        hint="it does not notice: " + " ".join(each.why for each in missed[:3]),
    )


# ------------------------------------------------------------------------------ for probes


def load(name: str, text: str) -> ModuleType:
    """A module with this text; its file is gone when this returns."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{name}.py")
        path.write_text(text, encoding="utf-8")
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return module


def verdict(check: Callable[..., Any], *arguments: Any) -> dict[str, str]:
    """What a student's test says of something, and its text: any exception is a failure."""
    try:
        check(*arguments)
    except NotImplementedError:
        return {"is": UNWRITTEN, "text": ""}
    except Exception as error:
        return {"is": FAILS, "text": f"{type(error).__name__}: {error}"[:1000]}
    return {"is": PASSES, "text": ""}
