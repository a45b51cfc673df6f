"""What must hold of an assignment before anybody gets it.

| check | holds if |
|---|---|
| structure | rubric, tests, markers, handout, stubs, solutions, notebook and mutants agree |
| edition | nothing withheld is in what students get, and all else of it works |
| starter | the stubs get no point, and none of them crashes |
| reference | the package itself gets all points; its notebook runs |
| solutions | independent right solutions get all points, under every seed; their notebook runs |
| mutants | each wrong solution fails exactly its tests, and one of them says why |
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from ...runtime import checks
from .. import edition, mutants
from ..assignments import PACKAGE, STAFF_TEST, Assignment
from ..judge import running
from ..material import points_text
from ..student.start import start
from . import leaks, structure, trying

CHECKS = ("structure", "edition", "starter", "reference", "solutions", "mutants")
CRASHES = ("the process crashed", "ended itself", "no answer within", "used more than")


@dataclass
class Check:
    """What came of a check.

    Attributes:
        name: One of `CHECKS`.
        reasons: Why it does not hold, a line each; none if it does.
        detail: What was looked at.
        seconds: How long it took [s].
    """

    name: str
    reasons: list[str] = field(default_factory=list)
    detail: str = ""
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether it holds."""
        return not self.reasons


def verify(
    assignment: Assignment,
    *,
    seeds: int = 1,
    only: Collection[str] = (),
    wrong: int | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Iterator[Check]:
    """Check an assignment; see the table above.

    Args:
        assignment: The whole assignment.
        seeds: Seeds under which right solutions must pass the tests that draw random numbers.
        only: Some of `CHECKS`, and ids of mutants; all if empty.
        wrong: How many wrong solutions are tried, evenly spread over the file; None for all.
        say: Gets a line about what happens now.

    Yields:
        The checks, as they come.

    Raises:
        ValueError: There are no solutions, or `only` names what does not exist.
    """
    assignment.require_staff("verify")
    chosen = _choose(assignment, only)
    with tempfile.TemporaryDirectory(prefix="tofrender-verify-") as folder:
        work = _Work(assignment, Path(folder), seeds, only, wrong, say)
        for name in CHECKS:
            if name in chosen:
                say(name)
                check, begin = Check(name), time.monotonic()
                try:
                    getattr(work, name)(check)
                except (ValueError, RuntimeError, OSError) as error:
                    check.reasons += str(error).splitlines()
                check.seconds = time.monotonic() - begin
                yield check


def _choose(assignment: Assignment, only: Collection[str]) -> set[str]:
    chosen = {name for name in only if name in CHECKS}
    others = set(only) - chosen
    if others:
        known = {mutant.id for mutant in mutants.read(assignment)}
        for name in sorted(others - known):
            raise ValueError(
                f"--only = {name[: checks.LONGEST]}: must be one of {', '.join(CHECKS)}, or the id "
                "of a mutant"
            )
        chosen.add("mutants")
    return chosen or set(CHECKS)


@dataclass
class _Work:
    """The checks, and what several of them need: the edition and the right solutions' folder."""

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
        """The independent solutions, with what their notebook has written."""
        self.say("solutions: running the notebook")
        target = self.folder / "right"
        shutil.copytree(self.assignment.solutions, target, dirs_exist_ok=True)
        for name in self.assignment.given:
            shutil.copy(self.assignment.starter / name, target)
        trying.solve_notebook(self.assignment, target, self._edition)
        return target

    @staticmethod
    def _not_passed(tests: Iterable[str], outcomes: dict[str, running.Outcome]) -> Iterator[str]:
        """Tests that right code does not pass."""
        for name in tests:
            outcome = outcomes.get(name)
            if outcome is None:
                yield f"{name}: did not run"
            elif outcome.outcome != "passed":
                several = f" ({len(outcome.texts)} of {outcome.cases} cases)"
                text = trying.one_line(outcome.texts[0] if outcome.texts else "")
                yield f"{name}: {outcome.outcome}{several * (outcome.cases > 1)}: {text}"

    # ------------------------------------------------------------------------------ checks

    def structure(self, check: Check) -> None:
        """Parts agree."""
        check.reasons += structure.check(self.assignment)
        rubric = self.assignment.rubric
        count = sum(len(problem.tests) for problem in rubric.problems)
        bonus = sum(problem.points for problem in rubric.problems) - rubric.points
        check.detail = (
            f"{len(rubric.problems)} problems, {count} tests, {points_text(rubric.points)} points"
            + f" + {points_text(bonus)}" * (bonus > 0)
        )

    def edition(self, check: Check) -> None:
        """Nothing leaks, the rest works, and a student can start with it."""
        folder = self._edition
        check.reasons += leaks.leaks(self.assignment, folder)
        check.reasons += leaks.smoke_test(self.assignment, folder)
        check.detail = f"without {len(edition.withheld(self.assignment.rubric))} modules"
        material = folder / "tofrender" / "course" / "material" / self.assignment.name
        student = start(Assignment(material), self.folder / "student")
        there = set(structure.collect(student, folder))
        rubric = self.assignment.rubric
        seen = {t.id for p in rubric.problems for t in p.tests if t.visibility == "visible"}
        check.reasons += [
            f"{name}: students {'have it, must not' if name in there else 'do not have it'}"
            for name in sorted(there ^ seen)
        ]

    def starter(self, check: Check) -> None:
        """No points, no crash."""
        outcomes = running.run(
            self.assignment.folder, submission=self.assignment.starter, edition=self._edition
        )
        for name, problem in self.assignment.rubric.problem_of.items():
            outcome = outcomes.get(name)
            if outcome is None or outcome.outcome != "failed":
                said = outcome.outcome if outcome else "did not run"
                check.reasons.append(f"{name}: {said}, must fail ({problem.id})")
                continue
            for text in outcome.texts:
                crash = next((crash for crash in CRASHES if crash in text), None)
                if crash or not ("not written yet" in text or "is missing" in text):
                    check.reasons.append(f"{name}: {trying.one_line(text)}")
        check.detail = f"{len(outcomes)} tests fail"

    def reference(self, check: Check) -> None:
        """All points for the package, whose files are made by the solved notebook."""
        outcomes = running.run(self.assignment.folder)
        files = [name for name, outcome in outcomes.items() if outcome.outcome == "skipped"]
        if files:
            self.say("reference: running the notebook")
            folder = self.folder / "reference"
            folder.mkdir()
            for name in self.assignment.given:
                shutil.copy(self.assignment.starter / name, folder)
            for problem in self.assignment.rubric.problems:
                if problem.names:  # others share the file of one that has some
                    with (folder / problem.file).open("a", encoding="utf-8") as file:
                        file.write(f"from {problem.reference} import {', '.join(problem.names)}\n")
            trying.solve_notebook(self.assignment, folder, PACKAGE.parent)
            outcomes |= running.run(self.assignment.folder, tests=files, submission=folder)
        check.reasons += self._not_passed(self.assignment.rubric.problem_of, outcomes)
        check.detail = f"{len(outcomes)} tests, {len(files)} of them of the notebook's results"

    def solutions(self, check: Check) -> None:
        """All points for independent solutions, under every seed."""
        right = self._right
        outcomes = running.run(self.assignment.folder, submission=right, edition=self._edition)
        check.reasons += self._not_passed(self.assignment.rubric.problem_of, outcomes)
        check.reasons += self._uses(outcomes)
        check.reasons += self._is_slow(outcomes)
        check.reasons += self._is_known(outcomes)
        check.detail = f"{len(outcomes)} tests"
        noisy = sorted(name for name, outcome in outcomes.items() if outcome.seeded)
        if self.seeds > 1 and noisy:
            self.say(f"solutions: {len(noisy)} tests under {self.seeds} seeds")
            again = self._repeat(noisy, right)
            check.reasons += self._not_passed(noisy, again)
            check.detail += f", {len(noisy)} of them under {self.seeds} seeds"

    def _repeat(self, tests: list[str], right: Path) -> dict[str, running.Outcome]:
        """Tests under many seeds, in as many processes as there are cores."""
        parts = [part for k in range(_cores()) if (part := tests[k :: _cores()])]

        def run(part: list[str]) -> dict[str, running.Outcome]:
            return running.run(
                self.assignment.folder,
                tests=part,
                submission=right,
                edition=self._edition,
                seeds=self.seeds,
            )

        found: dict[str, running.Outcome] = {}
        with ThreadPoolExecutor(len(parts)) as pool:
            for outcomes in pool.map(run, parts):
                found |= outcomes
        return found

    def _uses(self, outcomes: dict[str, running.Outcome]) -> Iterator[str]:
        """Tests that use the code of problems that theirs does not need."""
        rubric = self.assignment.rubric
        for name, problem in rubric.problem_of.items():
            used = outcomes[name].uses if name in outcomes else frozenset()
            owners = {rubric.home_of[each].id for each in used if each in rubric.home_of}
            for other in sorted(owners - structure.needed(rubric, problem.id)):
                yield f"{name}: uses {other}, which {problem.id} does not need in rubric.toml"

    def _is_known(self, outcomes: dict[str, running.Outcome]) -> Iterator[str]:
        """Problems whose answers could be a table, since no test that students lack draws any."""
        for problem in self.assignment.rubric.problems:
            staffs = [
                t.id for t in problem.tests if Path(t.id.partition("::")[0]).match(STAFF_TEST)
            ]
            drawn = any(outcomes[name].seeded for name in staffs if name in outcomes)
            if problem.file and not drawn:
                yield f"{problem.id}: must have a test in {STAFF_TEST} that draws what it asks for"

    def _is_slow(self, outcomes: dict[str, running.Outcome]) -> Iterator[str]:
        """Problems that take far longer than students are told."""
        for problem in self.assignment.rubric.problems:
            seconds = sum(outcomes[t.id].seconds for t in problem.tests if t.id in outcomes)
            if seconds > 3 * problem.takes_s + 10:
                yield f"{problem.id}: takes {seconds:.0f} s, takes_s says {problem.takes_s:g}"

    def mutants(self, check: Check) -> None:
        """Each wrong solution fails exactly its tests."""
        those = mutants.read(self.assignment)
        named = [mutant for mutant in those if mutant.id in self.only]
        whole = len(those)
        if not named and self.wrong is not None and self.wrong < whole:
            those = [those[k * whole // self.wrong] for k in range(self.wrong)]
        those = named or those
        right, package = self._right, self._edition
        (self.folder / "mutants").mkdir()

        def judge(mutant: mutants.Mutant) -> list[str]:
            folder = self.folder / "mutants" / mutant.id
            return trying.judge(self.assignment, mutant, right, folder, package)

        with ThreadPoolExecutor(_cores()) as pool:
            runs = [pool.submit(judge, mutant) for mutant in those]
            for done, run in enumerate(as_completed(runs), 1):
                check.reasons += run.result()
                self.say(f"mutants: {done} of {len(those)}")
        check.reasons.sort()
        part = f" of {whole}" * (len(those) < whole)
        check.detail = f"{len(those)}{part} wrong solutions"


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
