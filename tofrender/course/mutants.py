"""Mutants: wrong solutions, as edits of right ones, with the tests that they must fail."""

from dataclasses import dataclass

from . import toml
from .assignments import Assignment
from .rubric import Rubric

FILE_NAME = "mutants.toml"


@dataclass(frozen=True)
class Mutant:
    """A wrong solution."""

    id: str
    problem: str  # id of the problem that is solved wrongly
    file: str  # edited file: of `solutions/`, a given one, or "notebook.py"
    why: str  # the mistake
    edits: tuple[tuple[str, str], ...]  # text that occurs once, and its replacement
    fails: tuple[str, ...]  # tests that fail, and no others
    says: str  # text of one of these failures: the cause
    unseen_by: tuple[str, ...] = ()  # problems whose students' tests need not find it


def read(assignment: Assignment) -> list[Mutant]:
    """Mutants of an assignment; ValueError in one line if `mutants.toml` is missing or wrong."""
    content = toml.read(assignment.folder / FILE_NAME, FILE_NAME)
    found: dict[str, Mutant] = {}
    for table in content.get("mutant", []):
        where = f"{FILE_NAME}: {table.get('id', table)}"
        mutant = toml.make(Mutant, table, where)
        if not mutant.edits or any(len(edit) != 2 for edit in mutant.edits):
            raise ValueError(f"{where}: edits must be pairs [old, new], one or more")
        if mutant.id in found:
            raise ValueError(f"{where} is there more than once")
        found[mutant.id] = mutant
    return list(found.values())


def apply(assignment: Assignment, mutant: Mutant) -> str:
    """Text of the mutant's file; ValueError if an edit does not fit, or leaves no Python."""
    folder = assignment.starter if mutant.file in assignment.given else assignment.solutions
    path = (assignment.folder if mutant.file == "notebook.py" else folder) / mutant.file
    if not path.is_file():
        raise ValueError(f"{FILE_NAME}: {mutant.id}: {mutant.file} does not exist")
    text = path.read_text(encoding="utf-8")
    for old, new in mutant.edits:
        if text.count(old) != 1:
            raise ValueError(
                f"{FILE_NAME}: {mutant.id}: {old!r} is {text.count(old)} times in "
                f"{mutant.file}, must be once"
            )
        text = text.replace(old, new)
    try:
        compile(text, mutant.file, "exec")
    except SyntaxError as error:
        raise ValueError(f"{FILE_NAME}: {mutant.id}: is no Python: {error}") from None
    return text


def affected(rubric: Rubric, mutant: Mutant) -> list[str]:
    """Tests of the problems that use the mutant's file."""
    wrong = {problem.id for problem in rubric.problems if problem.file == mutant.file}
    wrong.add(mutant.problem)
    return [test for test, p in rubric.problem_by_test.items() if wrong & rubric.needed(p.id)]
