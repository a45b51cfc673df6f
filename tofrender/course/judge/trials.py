"""Problems whose task is to write a test: it has to tell right solutions from wrong ones.

In the rubric, `tests_of = "a2.gaussian_pulse"` makes a problem one. Its file defines one function,
which gets a solution of that other problem and raises if it is wrong. Nobody gets the messages of
the student's test, since they may quote these solutions.
"""

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
from .worker import load_file

if TYPE_CHECKING:
    from .plugin import Submission

PASSES, FAILS, UNWRITTEN = "passes", "fails", "unwritten"


@dataclass(frozen=True)
class Solution:
    """A solution that a student's test is tried on."""

    name: str
    text: str  # of its file
    why: str = ""  # the mistake, "" if it is right


def solutions(assignment: Assignment, problem: Problem) -> list[Solution]:
    """Right solution and wrong ones that a problem's file has to tell apart."""
    other = next(p for p in assignment.rubric.problems if p.id == problem.tests_of)
    right = (assignment.solutions / other.file).read_text(encoding="utf-8")
    wrong = [
        Solution(mutant.id, mutants.apply(assignment, mutant), mutant.why)
        for mutant in mutants.read(assignment)
        if (mutant.problem, mutant.file) == (other.id, other.file)
        and problem.id not in mutant.unseen_by
    ]
    return [Solution("right", right), *wrong]


def share_found(submission: "Submission", probe: str, more: Iterable[Solution] = ()) -> None:
    """Award the fraction of the wrong solutions that the student's test finds, if right ones pass.

    The probe gets `name` and `text` of a solution, and returns a `verdict`. Right solutions are
    those of `solutions/`, wrong ones those of `mutants.toml`; `more` are of either kind.
    """
    problem = submission.problem
    assert problem is not None
    submission.ask("defines", name=problem.names[0])  # before it can quote a solution
    tried = [*solutions(submission.assignment, problem), *more]
    fails = {}
    for number in np.random.default_rng(submission.seed).permutation(len(tried)):
        solution = tried[number]
        try:
            result = submission.ask(probe, name=f"solution_{number}", text=solution.text)["is"]
        except NoAnswer:
            raise Failure("your test has to end, and to leave the process running") from None
        true(result != UNWRITTEN, f"not written yet: {problem.names[0]}")
        fails[solution] = result == FAILS
    failed = [fails[solution] for solution in tried if not solution.why]
    true(
        not any(failed),
        f"{sum(failed)} of {len(failed)} right solutions fail your test",
        hint="what it asks for must hold for every right solution, to single precision",
    )
    wrong = [solution for solution in tried if solution.why]
    missed = [solution.why for solution in wrong if not fails[solution]]
    submission.award(1 - len(missed) / len(wrong))
    true(
        not missed,
        f"your test finds {len(wrong) - len(missed)} of {len(wrong)} wrong solutions",
        hint="it does not notice: " + " ".join(missed[:3]),
    )


def load(name: str, text: str) -> ModuleType:
    """Module with this text; its file is gone when this returns."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{name}.py")
        path.write_text(text, encoding="utf-8")
        return load_file(path)


def verdict(check: Callable[..., Any], *arguments: Any) -> dict[str, str]:
    """Result of a student's test, and its message: any exception is a failure."""
    try:
        check(*arguments)
    except NotImplementedError:
        return {"is": UNWRITTEN, "text": ""}
    except Exception as error:
        return {"is": FAILS, "text": f"{type(error).__name__}: {error}"[:1000]}
    return {"is": PASSES, "text": ""}
