"""Checks of an assignment before its release.

| check | passes if |
|---|---|
| structure | rubric, tests, markers, handout, stubs, solutions, notebook and mutants agree |
| edition | the released material contains nothing that is withheld, and works |
| starter | the stubs get no points, and none of them crashes |
| reference | the package itself gets all points, and its notebook runs |
| solutions | the solutions get all points with every seed, and their notebook runs |
| mutants | each wrong solution fails exactly its tests, and a failure contains the expected text |
"""

import shutil
import tempfile
import textwrap
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ...runtime import checks
from ...runtime.backend import cores
from .. import edition, mutants, notebooks
from ..assignments import PACKAGE, Assignment
from ..judge import running
from ..material import points_text
from ..mutants import Mutant
from ..notebooks import NOTEBOOK
from ..rubric import STAFF_TEST
from ..student.folders import start
from . import leaks, structure

CHECKS = ("structure", "edition", "starter", "reference", "solutions", "mutants")
CRASHES = ("the process crashed", "ended itself", "no answer within", "used more than")
"""Texts of failures after which a submission's process has ended."""


@dataclass
class CourseCheck:
    """Result of a check."""

    name: str  # one of `CHECKS`
    reasons: list[str] = field(default_factory=list)  # a line for each error
    detail: str = ""  # summary of what was checked
    seconds: float = 0.0  # duration [s]

    @property
    def ok(self) -> bool:
        """Whether the check passed."""
        return not self.reasons


def verify(
    assignment: Assignment,
    *,
    seeds: int = 1,
    only: Collection[str] = (),
    wrong: int | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Iterator[CourseCheck]:
    """Run the checks of an assignment, and yield each result when it is available.

    Args:
        assignment: Assignment of a checkout, with solutions.
        seeds: Number of seeds for tests that draw random numbers. The solutions must pass them
            with every seed.
        only: Names of checks, and ids of mutants, to run; by default all.
        wrong: Number of mutants to try, evenly spread over the list; by default all.
        say: Function that reports progress.

    Raises:
        ValueError: `only` contains an unknown name, or the assignment lacks solutions.
    """
    assignment.require_staff("verify")

    # Choose the checks; an id of a mutant chooses the check "mutants"
    chosen = set(only).intersection(CHECKS)
    if ids := set(only) - chosen:
        known = {mutant.id for mutant in mutants.read(assignment)}
        for name in sorted(ids - known):
            text = f"must be one of {', '.join(CHECKS)}, or the id of a mutant"
            raise ValueError(f"--only = {name[: checks.LONGEST]}: {text}")
        chosen.add("mutants")

    # Run them; an exception is an error of the check
    with tempfile.TemporaryDirectory(prefix="tofrender-verify-") as folder:
        work = _Checks(assignment, Path(folder), seeds, only, wrong, say)
        for name in CHECKS:
            if name in chosen or not chosen:
                say(name)
                check = CourseCheck(name)
                begin = time.monotonic()
                try:
                    getattr(work, name)(check)
                except (ValueError, RuntimeError, OSError) as error:
                    check.reasons += str(error).splitlines()
                check.seconds = time.monotonic() - begin
                yield check


@dataclass
class _Checks:
    """Methods for all checks, which share the student edition and the solved notebook."""

    assignment: Assignment
    folder: Path  # temporary folder
    seeds: int
    only: Collection[str]
    wrong: int | None
    say: Callable[[str], None]

    @cached_property
    def _edition(self) -> Path:
        """Folder of the student edition."""
        edition.copy(self.assignment, self.folder / "edition")
        return self.folder / "edition"

    @cached_property
    def _solved(self) -> Path:
        """Folder of the solutions, with the files that their notebook writes."""
        self.say("solutions: running the notebook")
        target = self._with_provided_files("solved")
        shutil.copytree(self.assignment.solutions, target, dirs_exist_ok=True)
        self._solve_notebook(target, self._edition)
        return target

    def _with_provided_files(self, name: str) -> Path:
        """Make a folder with the complete files that students get."""
        (self.folder / name).mkdir()
        for file in self.assignment.provided_files:
            shutil.copy(self.assignment.starter / file, self.folder / name)
        return self.folder / name

    def _run(self, submission: Path, **options: Any) -> dict[str, running.TestOutcome]:
        """Run the assignment's tests on a submission that imports the student edition."""
        folder = self.assignment.folder
        return running.run(folder, submission=submission, edition=self._edition, **options)

    @staticmethod
    def _not_passed(
        tests: Iterable[str], outcomes: dict[str, running.TestOutcome]
    ) -> Iterator[str]:
        """Yield a message for each test that did not pass."""
        for name in tests:
            outcome = outcomes.get(name)
            if outcome is None:
                yield f"{name}: did not run"
            elif outcome.outcome != "passed":
                several = f" ({len(outcome.texts)} of {outcome.cases} cases)"
                text = _one_line("".join(outcome.texts[:1]))
                yield f"{name}: {outcome.outcome}{several * (outcome.cases > 1)}: {text}"

    def structure(self, check: CourseCheck) -> None:
        """Check that the parts of the assignment agree, see `structure.check`."""
        check.reasons += structure.check(self.assignment)
        rubric = self.assignment.rubric
        count = sum(len(problem.tests) for problem in rubric.problems)
        bonus = sum(problem.points for problem in rubric.problems) - rubric.points
        check.detail = (
            f"{len(rubric.problems)} problems, {count} tests, {points_text(rubric.points)} points"
            + f" + {points_text(bonus)}" * (bonus > 0)
        )

    def edition(self, check: CourseCheck) -> None:
        """Check that the edition contains no solution and works, and that students can start."""
        # Contents of the edition
        folder = self._edition
        check.reasons += leaks.leaks(self.assignment, folder)
        check.reasons += leaks.later_leaks(self.assignment, folder)
        check.reasons += leaks.smoke_test(self.assignment, folder)
        check.detail = f"without {len(edition.withheld(self.assignment.rubric))} modules"

        # A student's folder contains exactly the public tests
        material = folder / "tofrender" / "course" / "material" / self.assignment.name
        student = start(Assignment(material), self.folder / "student")
        released = set(structure.collect(student, folder))
        public = set(self.assignment.rubric.public_tests)
        check.reasons += [
            f"{name}: students {'must not get' if name in released else 'do not get'} this test"
            for name in sorted(released ^ public)
        ]

    def starter(self, check: CourseCheck) -> None:
        """Check that the stubs fail every test because they are not written, without a crash."""
        outcomes = self._run(self.assignment.starter)
        for name, problem in self.assignment.rubric.problem_by_test.items():
            outcome = outcomes.get(name)
            if outcome is None or outcome.outcome != "failed":
                state = outcome.outcome if outcome else "did not run"
                check.reasons.append(f"{name}: {state}, must fail ({problem.id})")
                continue
            for text in outcome.texts:
                crash = next((crash for crash in CRASHES if crash in text), None)
                if crash or not ("not written yet" in text or "is missing" in text):
                    check.reasons.append(f"{name}: {_one_line(text)}")
        check.detail = f"{len(outcomes)} tests fail"

    def reference(self, check: CourseCheck) -> None:
        """Check that the package itself gets all points."""
        # Tests of files that the notebook writes are skipped for the package
        outcomes = running.run(self.assignment.folder)
        files = [name for name, outcome in outcomes.items() if outcome.outcome == "skipped"]
        if files:
            # Make a submission that imports the package, and run the notebook there
            self.say("reference: running the notebook")
            folder = self._with_provided_files("reference")
            for problem in self.assignment.rubric.problems:
                if problem.names:  # A problem without names shares the file of another problem
                    with (folder / problem.file).open("a", encoding="utf-8") as file:
                        file.write(f"from {problem.reference} import {', '.join(problem.names)}\n")
            self._solve_notebook(folder, PACKAGE.parent)
            outcomes |= running.run(self.assignment.folder, tests=files, submission=folder)
        check.reasons += self._not_passed(self.assignment.rubric.problem_by_test, outcomes)
        check.detail = f"{len(outcomes)} tests, {len(files)} of which judge the notebook's results"

    def solutions(self, check: CourseCheck) -> None:
        """Check that the solutions get all points, with every seed."""
        # All tests
        solved = self._solved
        outcomes = self._run(solved)
        check.reasons += self._not_passed(self.assignment.rubric.problem_by_test, outcomes)
        check.reasons += self._faults_of_tests(outcomes)
        check.detail = f"{len(outcomes)} tests"

        # Tests with random numbers, with further seeds
        noisy = sorted(name for name, outcome in outcomes.items() if outcome.seeded)
        if self.seeds > 1 and noisy:
            self.say(f"solutions: {len(noisy)} tests with {self.seeds} seeds")
            again = self._repeat(noisy, solved)
            check.reasons += self._not_passed(noisy, again)
            check.detail += f", {len(noisy)} of which ran with {self.seeds} seeds"

    def _repeat(self, tests: list[str], solved: Path) -> dict[str, running.TestOutcome]:
        """Run tests with many seeds, in one process per core."""
        parts = [part for k in range(cores()) if (part := tests[k :: cores()])]
        found: dict[str, running.TestOutcome] = {}
        with ThreadPoolExecutor(len(parts)) as pool:
            for run in [pool.submit(self._run, solved, tests=p, seeds=self.seeds) for p in parts]:
                found |= run.result()
        return found

    def _faults_of_tests(self, outcomes: dict[str, running.TestOutcome]) -> Iterator[str]:
        """Check the problems that tests use, their duration, and that they draw random numbers."""
        rubric = self.assignment.rubric
        for problem in rubric.problems:
            # The tests use only the problem and the problems that it needs
            ran = [(test, outcomes[test.id]) for test in problem.tests if test.id in outcomes]
            for test, outcome in ran:
                owners = {
                    rubric.problem_by_name[name].id
                    for name in outcome.uses & rubric.problem_by_name.keys()
                }
                text = f"which {problem.id} does not need in rubric.toml"
                for other in sorted(owners - rubric.needed(problem.id)):
                    yield f"{test.id}: uses {other}, {text}"

            # The time is roughly the time in the rubric
            seconds = sum(outcome.seconds for _, outcome in ran)
            if seconds > 3 * problem.takes_s + 10:
                yield f"{problem.id}: takes {seconds:.0f} s, but takes_s is {problem.takes_s:g}"

            # Without random inputs, a submission with a table of answers would pass
            drawn = any(test.is_staff and outcome.seeded for test, outcome in ran)
            if problem.file and not drawn:
                yield f"{problem.id}: needs a test in {STAFF_TEST} with random inputs"

    def mutants(self, check: CourseCheck) -> None:
        """Check that each wrong solution fails exactly its tests."""
        # Choose mutants by id, or evenly spread
        every = mutants.read(self.assignment)
        chosen = [mutant for mutant in every if mutant.id in self.only]
        if not chosen:
            count = min(len(every), self.wrong or len(every))
            chosen = [every[k * len(every) // count] for k in range(count)]

        # Judge them in parallel; solve the notebook before threads start
        _ = self._solved
        with ThreadPoolExecutor(cores()) as pool:
            runs = {pool.submit(self._judge_mutant, mutant): mutant for mutant in chosen}
            for done, run in enumerate(as_completed(runs), 1):
                check.reasons += [f"{runs[run].id}: {text}" for text in run.result()]
                self.say(f"mutants: {done} of {len(chosen)}")
        check.reasons.sort()
        part = f" of {len(every)}" * (len(chosen) < len(every))
        check.detail = f"{len(chosen)}{part} wrong solutions"

    def _judge_mutant(self, mutant: Mutant) -> list[str]:
        """Run the tests on a mutant.

        Returns:
            A message for each difference from the results that `mutants.toml` predicts.
        """
        # Run the tests
        rubric = self.assignment.rubric
        folder = self.folder / "mutants" / mutant.id
        tests = mutants.affected(rubric, mutant)
        try:
            shutil.copytree(self._solved, folder)
            text = mutants.apply(self.assignment, mutant)
            (folder / mutant.file).write_text(text, encoding="utf-8")
            if any(p.id == mutant.problem and not p.file for p in rubric.problems):
                self._solve_notebook(folder, self._edition)  # The mistake is in its results
            outcomes = self._run(folder, tests=tests)
        except (RuntimeError, ValueError) as error:
            return [str(error)]

        # Compare the failed tests with the prediction
        failed = {n for n in tests if n not in outcomes or outcomes[n].outcome != "passed"}
        texts = {name: " ".join(outcomes[name].texts) for name in failed & outcomes.keys()}
        expected = set(mutant.fails)
        reasons = [f"{n} passes, must fail ({mutant.why})" for n in sorted(expected - failed)]
        for name in sorted(failed - expected):
            reasons.append(f"{name} fails, must pass: {_one_line(texts.get(name, ''))}")

        # One failure must contain the predicted text
        if not any(mutant.says in text for text in texts.values()):
            found = _one_line(" ".join(texts.values())) or "no text"
            reasons.append(f"no failure contains {mutant.says!r}; the failures contain: {found}")
        return reasons

    def _solve_notebook(self, folder: Path, package: Path) -> None:
        """Run the notebook in a folder of solutions.

        If the folder contains a `notebook.py`, such as a mutant's, it replaces the assignment's.
        """
        path = folder / "notebook.py"
        if not path.is_file():
            path = self.assignment.folder / "notebook.py"
        if path.is_file():
            notebooks.write(path.read_text(encoding="utf-8"), folder, folder / NOTEBOOK)
            notebooks.execute(folder / NOTEBOOK, PYTHONPATH=str(package))


def _one_line(text: str) -> str:
    """Shorten a text to one line of at most 300 characters."""
    return textwrap.shorten(text, 300, placeholder=" ...")
