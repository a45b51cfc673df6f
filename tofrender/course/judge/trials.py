"""Problems that ask students for a test, which must distinguish correct from wrong solutions.

`tests_of = "a2.gaussian_pulse"` in the rubric marks such a problem. Its file defines one function,
which gets a solution of the other problem and raises an exception if the solution is wrong. The
messages of the student's test are not reported, because they could quote the solutions.
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

# Results of a student's test
PASSES = "passes"
FAILS = "fails"
UNWRITTEN = "unwritten"


@dataclass(frozen=True)
class Solution:
    """A solution that a student's test is applied to."""

    name: str
    text: str  # content of the solution's file
    why: str = ""  # description of the mistake, "" if the solution is correct


def solutions(assignment: Assignment, problem: Problem) -> list[Solution]:
    """Return the correct solution and the wrong solutions that a student's test must distinguish.

    Args:
        assignment: Assignment with solutions and mutants.
        problem: Problem that asks for the test.
    """
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
    """Award points for a student's test, by the fraction of wrong solutions that it finds.

    The correct solution comes from `solutions/`, the wrong solutions from `mutants.toml`.

    Args:
        submission: The fixture.
        probe: Name of a probe that gets `name` and `text` of a solution and returns a `verdict`.
        more: Further solutions.

    Raises:
        Failure: The test is not written, ends the process, rejects a correct solution, or misses
            a wrong one. In the last case, the failure gives a fraction of the points.
    """
    # Load the student's test before it can quote a solution
    problem = submission.problem
    assert problem is not None
    submission.ask("defines", name=problem.names[0])

    # Apply the test to all solutions, in random order and under neutral names
    tried = [*solutions(submission.assignment, problem), *more]
    fails = {}
    for number in np.random.default_rng(submission.seed).permutation(len(tried)):
        solution = tried[number]
        try:
            result = submission.ask(probe, name=f"solution_{number}", text=solution.text)["is"]
        except NoAnswer:
            raise Failure("your test must end, and must not end the process") from None
        true(result != UNWRITTEN, f"not written yet: {problem.names[0]}")
        fails[solution] = result == FAILS

    # Correct solutions must pass
    failed = [fails[solution] for solution in tried if not solution.why]
    true(
        not any(failed),
        f"{sum(failed)} of {len(failed)} correct solutions fail your test",
        hint="every correct solution must pass your test, also one in single precision",
    )

    # Points depend on the wrong solutions that fail
    wrong = [solution for solution in tried if solution.why]
    missed = [solution.why for solution in wrong if not fails[solution]]
    submission.award(1 - len(missed) / len(wrong))
    true(
        not missed,
        f"your test finds {len(wrong) - len(missed)} of {len(wrong)} wrong solutions",
        hint="your test does not find: " + " ".join(missed[:3]),
    )


def load(name: str, text: str) -> ModuleType:
    """Import a text as a module; the temporary file is removed afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{name}.py")
        path.write_text(text, encoding="utf-8")
        return load_file(path)


def verdict(check: Callable[..., Any], *arguments: Any) -> dict[str, str]:
    """Run a student's test and return its result ("is") and message ("text").

    Any exception is a failure of the test, except NotImplementedError, which means that the test
    is not written.
    """
    try:
        check(*arguments)
    except NotImplementedError:
        return {"is": UNWRITTEN, "text": ""}
    except Exception as error:
        return {"is": FAILS, "text": f"{type(error).__name__}: {error}"[:1000]}
    return {"is": PASSES, "text": ""}
