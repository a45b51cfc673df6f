"""Wrong solutions that students write: edits of right ones, with the tests that they must fail."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .assignments import Assignment
from .rubric import Rubric


@dataclass(frozen=True)
class Mutant:
    """A wrong solution.

    Attributes:
        id: Its name.
        problem: The problem that it gets wrong.
        file: The file that is edited: of `solutions/`, one that is given, or "notebook.py".
        why: What is wrong with it.
        edits: Pairs of what stands there once, and what replaces it.
        fails: The tests that fail, and no others.
        says: What the text of one of them has to hold: the cause.
        unseen_by: Problems whose students' tests need not find it, as their contract does not ask.
    """

    id: str
    problem: str
    file: str
    why: str
    edits: tuple[tuple[str, str], ...]
    fails: tuple[str, ...]
    says: str
    unseen_by: tuple[str, ...] = ()


def read(assignment: Assignment) -> list[Mutant]:
    """The mutants of an assignment.

    Raises:
        ValueError: `mutants.toml` is missing, or not as it should be; one line.
    """
    path = assignment.folder / "mutants.toml"
    if not path.is_file():
        raise ValueError("mutants.toml: is missing")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"mutants.toml: is not TOML: {error}") from None
    found = [_mutant(entry) for entry in content.get("mutant", [])]
    ids = [mutant.id for mutant in found]
    double = sorted({name for name in ids if ids.count(name) > 1})
    if double:
        raise ValueError(f"mutants.toml: {double[0]} is there more than once")
    return found


def _mutant(entry: dict[str, Any]) -> Mutant:
    where = f"mutants.toml: {entry.get('id', entry)}"
    fields = set(Mutant.__dataclass_fields__) - {"unseen_by"}
    if set(entry) - {"unseen_by"} != fields:
        raise ValueError(f"{where}: must have exactly {', '.join(sorted(fields))}")
    edits = tuple(tuple(edit) for edit in entry["edits"])
    if not edits or any(len(edit) != 2 for edit in edits):
        raise ValueError(f"{where}: edits must be pairs [old, new], one or more")
    unseen = tuple(entry.get("unseen_by", ()))
    return Mutant(**entry | {"edits": edits, "fails": tuple(entry["fails"]), "unseen_by": unseen})


def source(assignment: Assignment, mutant: Mutant) -> Path:
    """The right file that a mutant edits."""
    if mutant.file == "notebook.py":
        return assignment.folder / mutant.file
    folder = assignment.starter if mutant.file in assignment.given else assignment.solutions
    return folder / mutant.file


def apply(assignment: Assignment, mutant: Mutant) -> str:
    """The text of the mutant's file.

    Raises:
        ValueError: An edit does not fit the file, or leaves no Python.
    """
    path = source(assignment, mutant)
    if not path.is_file():
        raise ValueError(f"mutants.toml: {mutant.id}: {mutant.file} does not exist")
    text = path.read_text(encoding="utf-8")
    for old, new in mutant.edits:
        if text.count(old) != 1:
            raise ValueError(
                f"mutants.toml: {mutant.id}: {old!r} is {text.count(old)} times in "
                f"{mutant.file}, must be once"
            )
        text = text.replace(old, new)
    try:
        compile(text, mutant.file, "exec")
    except SyntaxError as error:
        raise ValueError(f"mutants.toml: {mutant.id}: is no Python: {error}") from None
    return text


def affected(rubric: Rubric, mutant: Mutant) -> list[str]:
    """The tests that can tell: those of the problems that use the mutant's file."""
    needs = {problem.id: set(problem.needs) for problem in rubric.problems}
    found = {problem.id for problem in rubric.problems if problem.file == mutant.file}
    found.add(mutant.problem)
    while more := {name for name, uses in needs.items() if uses & found} - found:
        found |= more
    return [test for test, problem in rubric.problem_of.items() if problem.id in found]
