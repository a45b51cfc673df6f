"""Mutants: wrong solutions (edits of correct solutions), and the tests that they must fail."""

from dataclasses import dataclass

from . import toml
from .assignments import Assignment
from .rubric import Rubric

FILE_NAME = "mutants.toml"


@dataclass(frozen=True)
class Mutant:
    """A wrong solution, as edits of a correct one."""

    id: str
    problem: str  # id of the problem that is solved wrongly
    file: str  # edited file: a solution, a provided file, or "notebook.py"
    why: str  # description of the mistake
    edits: tuple[tuple[str, str], ...]  # text that occurs once in the file, and its replacement
    fails: tuple[str, ...]  # ids of the tests that must fail; all others must pass
    says: str  # text that must occur in one of the failures
    unseen_by: tuple[str, ...] = ()  # problems where a student's test need not find the mistake


def read(assignment: Assignment) -> list[Mutant]:
    """Read the mutants of an assignment.

    Raises:
        ValueError: `mutants.toml` is missing or wrong.
    """
    content = toml.read(assignment.folder / FILE_NAME, FILE_NAME)
    found: dict[str, Mutant] = {}
    for table in content.get("mutant", []):
        where = f"{FILE_NAME}: {table.get('id', table)}"
        mutant = toml.make(Mutant, table, where)
        if not mutant.edits or any(len(edit) != 2 for edit in mutant.edits):
            raise ValueError(f"{where}: edits must contain one or more pairs [old, new]")
        if mutant.id in found:
            raise ValueError(f"{where}: the id is used more than once")
        found[mutant.id] = mutant
    return list(found.values())


def apply(assignment: Assignment, mutant: Mutant) -> str:
    """Return the text of the mutant's file, with its edits.

    Raises:
        ValueError: The file is missing, the text of an edit does not occur exactly once, or the
            result is not Python code.
    """
    # Find the file: the notebook, a provided file, or a solution
    folder = assignment.solutions
    if mutant.file == "notebook.py":
        folder = assignment.folder
    elif mutant.file in assignment.provided_files:
        folder = assignment.starter
    path = folder / mutant.file
    if not path.is_file():
        raise ValueError(f"{FILE_NAME}: {mutant.id}: {mutant.file} does not exist")

    # Apply the edits
    text = path.read_text(encoding="utf-8")
    for old, new in mutant.edits:
        if text.count(old) != 1:
            raise ValueError(
                f"{FILE_NAME}: {mutant.id}: {old!r} occurs {text.count(old)} times in "
                f"{mutant.file}, must occur once"
            )
        text = text.replace(old, new)

    # A mutant that cannot be compiled would fail every test
    try:
        compile(text, mutant.file, "exec")
    except SyntaxError as error:
        raise ValueError(f"{FILE_NAME}: {mutant.id}: the result is not Python: {error}") from None
    return text


def affected(rubric: Rubric, mutant: Mutant) -> list[str]:
    """Return the ids of all tests of problems that use the mutant's file."""
    wrong = {problem.id for problem in rubric.problems if problem.file == mutant.file}
    wrong.add(mutant.problem)
    return [test for test, p in rubric.problem_by_test.items() if wrong & rubric.needed(p.id)]
