"""Checks of an assignment before its release.

| check | holds if |
|---|---|
| structure | rubric, tests, markers, handout, stubs, solutions, notebook and mutants agree |
| edition | nothing withheld is in the released material, and all else of it works |
| starter | the stubs get no point, and none of them crashes |
| reference | the package itself gets all points; its notebook runs |
| solutions | independent right solutions get all points, under every seed; their notebook runs |
| mutants | each wrong solution fails exactly its tests, and one of them says why |
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


@dataclass
class Check:
    """Result of a check."""

    name: str  # of `CHECKS`
    reasons: list[str] = field(default_factory=list)  # why it does not hold, a line each
    detail: str = ""  # the parts that were checked
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the check holds."""
        return not self.reasons


def verify(
    assignment: Assignment,
    *,
    seeds: int = 1,
    only: Collection[str] = (),
    wrong: int | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Iterator[Check]:
    """Run checks of an assignment and yield each when it is done; see the table above.

    Right solutions must pass tests that draw random numbers under all `seeds`. `only` has some of
    `CHECKS`, and ids of mutants; `wrong` is the number of mutants to try, evenly spread.
    """
    assignment.require_staff("verify")
    chosen = set(only).intersection(CHECKS)
    if ids := set(only) - chosen:
        known = {mutant.id for mutant in mutants.read(assignment)}
        for name in sorted(ids - known):
            text = f"must be one of {', '.join(CHECKS)}, or the id of a mutant"
            raise ValueError(f"--only = {name[: checks.LONGEST]}: {text}")
        chosen.add("mutants")
    with tempfile.TemporaryDirectory(prefix="tofrender-verify-") as folder:
        work = _Checks(assignment, Path(folder), seeds, only, wrong, say)
        for name in CHECKS:
            if name in chosen or not chosen:
                say(name)
                check, begin = Check(name), time.monotonic()
                try:
                    getattr(work, name)(check)
                except (ValueError, RuntimeError, OSError) as error:
                    check.reasons += str(error).splitlines()
                check.seconds = time.monotonic() - begin
                yield check


@dataclass
class _Checks:
    """Implementation of the checks, with the edition and the right solutions that they share."""

    assignment: Assignment
    folder: Path
    seeds: int
    only: Collection[str]
    wrong: int | None
    say: Callable[[str], None]

    @cached_property
    def _edition(self) -> Path:
        edition.copy(self.assignment, self.folder / "edition")
        return self.folder / "edition"

    @cached_property
    def _right(self) -> Path:
        """Folder of the independent solutions, with the files their notebook has written."""
        self.say("solutions: running the notebook")
        target = self._given_files("right")
        shutil.copytree(self.assignment.solutions, target, dirs_exist_ok=True)
        self._solve_notebook(target, self._edition)
        return target

    def _given_files(self, name: str) -> Path:
        """Make a folder of the files that students build on."""
        (self.folder / name).mkdir()
        for file in self.assignment.provided_files:
            shutil.copy(self.assignment.starter / file, self.folder / name)
        return self.folder / name

    def _run(self, submission: Path, **options: Any) -> dict[str, running.Outcome]:
        folder, edition = self.assignment.folder, self._edition
        return running.run(folder, submission=submission, edition=edition, **options)

    @staticmethod
    def _not_passed(tests: Iterable[str], outcomes: dict[str, running.Outcome]) -> Iterator[str]:
        """Tests that right code does not pass."""
        for name in tests:
            outcome = outcomes.get(name)
            if outcome is None:
                yield f"{name}: did not run"
            elif outcome.outcome != "passed":
                several = f" ({len(outcome.texts)} of {outcome.cases} cases)"
                text = _one_line("".join(outcome.texts[:1]))
                yield f"{name}: {outcome.outcome}{several * (outcome.cases > 1)}: {text}"

    def structure(self, check: Check) -> None:
        """Check that the parts agree."""
        check.reasons += structure.check(self.assignment)
        rubric = self.assignment.rubric
        count = sum(len(problem.tests) for problem in rubric.problems)
        bonus = sum(problem.points for problem in rubric.problems) - rubric.points
        check.detail = (
            f"{len(rubric.problems)} problems, {count} tests, {points_text(rubric.points)} points"
            + f" + {points_text(bonus)}" * (bonus > 0)
        )

    def edition(self, check: Check) -> None:
        """Check that nothing leaks, the rest works, and a student can start with it."""
        folder = self._edition
        check.reasons += leaks.leaks(self.assignment, folder)
        check.reasons += leaks.smoke_test(self.assignment, folder)
        check.detail = f"without {len(edition.withheld(self.assignment.rubric))} modules"
        material = folder / "tofrender" / "course" / "material" / self.assignment.name
        student = start(Assignment(material), self.folder / "student")
        there = set(structure.collect(student, folder))
        check.reasons += [
            f"{name}: students {'have it, must not' if name in there else 'do not have it'}"
            for name in sorted(there.symmetric_difference(self.assignment.rubric.public_tests))
        ]

    def starter(self, check: Check) -> None:
        """Check that stubs get no points and do not crash."""
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

    def reference(self, check: Check) -> None:
        """Check that the package, with its solved notebook, gets all points."""
        outcomes = running.run(self.assignment.folder)
        files = [name for name, outcome in outcomes.items() if outcome.outcome == "skipped"]
        if files:
            self.say("reference: running the notebook")
            folder = self._given_files("reference")
            for problem in self.assignment.rubric.problems:
                if problem.names:  # others share the file of one that has some
                    with (folder / problem.file).open("a", encoding="utf-8") as file:
                        file.write(f"from {problem.reference} import {', '.join(problem.names)}\n")
            self._solve_notebook(folder, PACKAGE.parent)
            outcomes |= running.run(self.assignment.folder, tests=files, submission=folder)
        check.reasons += self._not_passed(self.assignment.rubric.problem_by_test, outcomes)
        check.detail = f"{len(outcomes)} tests, {len(files)} of them of the notebook's results"

    def solutions(self, check: Check) -> None:
        """Check that independent solutions get all points, under every seed."""
        right = self._right
        outcomes = self._run(right)
        check.reasons += self._not_passed(self.assignment.rubric.problem_by_test, outcomes)
        check.reasons += self._faults_of_tests(outcomes)
        check.detail = f"{len(outcomes)} tests"
        noisy = sorted(name for name, outcome in outcomes.items() if outcome.seeded)
        if self.seeds > 1 and noisy:
            self.say(f"solutions: {len(noisy)} tests under {self.seeds} seeds")
            again = self._repeat(noisy, right)
            check.reasons += self._not_passed(noisy, again)
            check.detail += f", {len(noisy)} of them under {self.seeds} seeds"

    def _repeat(self, tests: list[str], right: Path) -> dict[str, running.Outcome]:
        """Run tests under many seeds, in as many processes as there are cores."""
        parts = [part for k in range(cores()) if (part := tests[k :: cores()])]
        found: dict[str, running.Outcome] = {}
        with ThreadPoolExecutor(len(parts)) as pool:
            for run in [pool.submit(self._run, right, tests=p, seeds=self.seeds) for p in parts]:
                found |= run.result()
        return found

    def _faults_of_tests(self, outcomes: dict[str, running.Outcome]) -> Iterator[str]:
        """Problems whose needs, time or random numbers are not as they must be."""
        rubric = self.assignment.rubric
        for problem in rubric.problems:
            ran = [(test, outcomes[test.id]) for test in problem.tests if test.id in outcomes]
            for test, outcome in ran:
                owners = {
                    rubric.problem_by_name[name].id
                    for name in outcome.uses & rubric.problem_by_name.keys()
                }
                text = f"which {problem.id} does not need in rubric.toml"
                for other in sorted(owners - rubric.needed(problem.id)):
                    yield f"{test.id}: uses {other}, {text}"
            seconds = sum(outcome.seconds for _, outcome in ran)
            if seconds > 3 * problem.takes_s + 10:
                yield f"{problem.id}: takes {seconds:.0f} s, takes_s says {problem.takes_s:g}"
            # Otherwise a table of answers would pass
            drawn = any(test.is_staff and outcome.seeded for test, outcome in ran)
            if problem.file and not drawn:
                yield f"{problem.id}: must have a test in {STAFF_TEST} that draws what it asks for"

    def mutants(self, check: Check) -> None:
        """Check that each wrong solution fails exactly its tests."""
        every = mutants.read(self.assignment)
        chosen = [mutant for mutant in every if mutant.id in self.only]
        if not chosen:
            count = min(len(every), self.wrong or len(every))
            chosen = [every[k * len(every) // count] for k in range(count)]
        _ = self._right  # made once, before there are threads
        with ThreadPoolExecutor(cores()) as pool:
            runs = {pool.submit(self._judge_mutant, mutant): mutant for mutant in chosen}
            for done, run in enumerate(as_completed(runs), 1):
                check.reasons += [f"{runs[run].id}: {text}" for text in run.result()]
                self.say(f"mutants: {done} of {len(chosen)}")
        check.reasons.sort()
        part = f" of {len(every)}" * (len(chosen) < len(every))
        check.detail = f"{len(chosen)}{part} wrong solutions"

    def _judge_mutant(self, mutant: Mutant) -> list[str]:
        """Run the tests on a mutant; a line for each deviation from `mutants.toml`."""
        rubric, folder = self.assignment.rubric, self.folder / "mutants" / mutant.id
        tests = mutants.affected(rubric, mutant)
        try:
            shutil.copytree(self._right, folder)
            text = mutants.apply(self.assignment, mutant)
            (folder / mutant.file).write_text(text, encoding="utf-8")
            if any(p.id == mutant.problem and not p.file for p in rubric.problems):
                self._solve_notebook(folder, self._edition)  # which writes the mistake
            outcomes = self._run(folder, tests=tests)
        except (RuntimeError, ValueError) as error:
            return [str(error)]
        failed = {n for n in tests if n not in outcomes or outcomes[n].outcome != "passed"}
        texts = {name: " ".join(outcomes[name].texts) for name in failed & outcomes.keys()}
        expected = set(mutant.fails)
        reasons = [f"{n} passes, must fail ({mutant.why})" for n in sorted(expected - failed)]
        for name in sorted(failed - expected):
            reasons.append(f"{name} fails, must pass: {_one_line(texts.get(name, ''))}")
        if not any(mutant.says in text for text in texts.values()):
            found = _one_line(" ".join(texts.values())) or "nothing"
            reasons.append(f"no failure says {mutant.says!r}; they say {found}")
        return reasons

    def _solve_notebook(self, folder: Path, package: Path) -> None:
        """Run the notebook in a folder of solutions, whose own `notebook.py` has precedence."""
        own = folder / "notebook.py"
        path = own if own.is_file() else self.assignment.folder / "notebook.py"
        if path.is_file():
            notebooks.write(path.read_text(encoding="utf-8"), folder, folder / NOTEBOOK)
            notebooks.execute(folder / NOTEBOOK, PYTHONPATH=str(package))


def _one_line(text: str) -> str:
    return textwrap.shorten(text, 300, placeholder=" ...")
