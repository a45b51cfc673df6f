"""Check that each sentence of a contract has a test that fails when it is broken.

`contracts.toml` of an assignment's folder, which students do not get, is the table::

    [[contract]]
    problem = "a1.disk"
    says = "the density per area, 0 off the disk"  # as the handout or a stub's docstring has it
    tests = ["test_disk.py::test_density"]  # fail when it is broken
    mutants = ["disk_without_end"]  # break it, and fail one of these tests

    [[remark]]  # sentences that ask for nothing
    problem = "a1.disk"
    says = ["The radius is that of the unit disk."]

Each sentence of the docstrings in a problem's stub, and of the paragraphs of its section in the
handout that start with `*Contract.*` or `**Write**`, must be in it. A part of a sentence is enough.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

from .. import material, mutants, toml
from ..assignments import Assignment
from ..rubric import Problem

FILE_NAME = "contracts.toml"
DEMANDING = re.compile(r"\s*(\*Contract\.\*|\*\*Write\*\*)")  # starts paragraphs of the handout
MISTAKES = "*Common mistakes.*"  # ends their part that demands something
END_OF_PARAGRAPH = re.compile(r"\n\s*\n")
END_OF_SENTENCE = re.compile(r"(?<=[.;!?])\s+(?=[A-Z`\[(*$0-9]|and |or )")
HEADS = "(Args|Returns|Raises|Attributes|Example|Yields):"


@dataclass(frozen=True)
class Entry:
    """Sentences that ask for nothing that a test could find broken, unless a `Contract`."""

    problem: str
    says: str | tuple[str, ...]  # the sentences, or parts of them

    @property
    def sentences(self) -> list[str]:
        """Sentences with single spaces."""
        return [plain(text) for text in ([self.says] if isinstance(self.says, str) else self.says)]

    @property
    def where(self) -> str:
        """Beginning of messages about it."""
        return f"{FILE_NAME}: {' / '.join(self.sentences)[:60]!r}"


@dataclass(frozen=True)
class Contract(Entry):
    """A sentence that a solution has to keep."""

    tests: tuple[str, ...]  # tests that fail when it is broken
    mutants: tuple[str, ...]  # wrong solutions that break it


def read(assignment: Assignment) -> list[Entry]:
    """Contracts and remarks of an assignment; ValueError if the file is missing or wrong."""
    content = toml.read(assignment.folder / FILE_NAME, FILE_NAME)
    kinds = {"contract": Contract, "remark": Entry}
    for name in content.keys() - kinds:
        raise ValueError(f"{FILE_NAME}: [[{name}]]: must be [[contract]] or [[remark]]")
    return [
        toml.make(kind, table, f"{FILE_NAME}: {table.get('says')!r:.80}")
        for name, kind in kinds.items()
        for table in content.get(name, [])
    ]


def check(assignment: Assignment) -> Iterator[str]:
    """Faults of the table, a line each."""
    try:
        entries = read(assignment)
        known = {mutant.id: mutant for mutant in mutants.read(assignment)}
    except ValueError as error:
        yield str(error)
        return
    problems = {problem.id: problem for problem in assignment.rubric.problems}
    for entry in entries:
        if entry.problem not in problems:
            yield f"{entry.where}: the rubric has no problem {entry.problem}"
    for problem in problems.values():
        own = [entry for entry in entries if entry.problem == problem.id]
        yield from _sentences(assignment, problem, own)
        for entry in own:
            if isinstance(entry, Contract):
                yield from _unproved(entry, problem, known)


def _unproved(
    contract: Contract, problem: Problem, known: dict[str, mutants.Mutant]
) -> Iterator[str]:
    """Faults of a contract: its tests must exist, and its mutants must fail one of them."""
    where = contract.where
    tests = {test.id for test in problem.tests}
    if not contract.tests or not contract.mutants:
        yield f"{where}: must name a test and a mutant"
    for name in contract.tests:
        if name not in tests:
            yield f"{where}: {problem.id} has no test {name}"
    for name in contract.mutants:
        if name not in known:
            yield f"{where}: there is no mutant {name}"
        elif not set(contract.tests) & set(known[name].fails):
            yield f"{where}: {name} fails none of its tests"


def _sentences(assignment: Assignment, problem: Problem, entries: list[Entry]) -> Iterator[str]:
    """Sentences of a problem that the table lacks, and those of the table in no text."""
    quoted = {sentence: entry for entry in entries for sentence in entry.sentences}
    handout, docstrings = _handout(assignment, problem), _docstrings(assignment, problem)
    texts = list(map(plain, (handout, *docstrings)))
    for part, entry in quoted.items():
        if not any(part in text for text in texts):
            yield f"{entry.where}: no text of {problem.id} says {part!r:.80}"
    paragraphs = END_OF_PARAGRAPH.split(handout)
    demands = [each.partition(MISTAKES)[0] for each in paragraphs if DEMANDING.match(each)]
    demands += [paragraph for text in docstrings for paragraph in END_OF_PARAGRAPH.split(text)]
    for sentence in (sentence for text in demands for sentence in sentences(text)):
        if not any(part in sentence or sentence in part for part in quoted):
            yield f"{FILE_NAME}: {problem.id}: no test and no remark for {sentence!r:.200}"


def _handout(assignment: Assignment, problem: Problem) -> str:
    """Section of a problem in the handout: to the next problem, or the next heading."""
    text = (assignment.folder / "README.md").read_text(encoding="utf-8")
    parts = material.BLOCK.split(text)
    after = dict(zip(parts[1::2], parts[2::2], strict=True))
    return re.split(r"^#", after.get(problem.id, ""), maxsplit=1, flags=re.MULTILINE)[0]


def _docstrings(assignment: Assignment, problem: Problem) -> list[str]:
    """Docstrings of a problem's stub."""
    path = assignment.starter / problem.file
    if not problem.file or not path.is_file():
        return []
    return [
        ast.get_docstring(node) or ""
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    ]


def sentences(text: str) -> list[str]:
    r"""Sentences of a text, with single spaces; lines of lists and tables begin new ones.

    Example:
        >>> sentences("One is e.g.\n  here. Args:\n    x: Two; `three`.\n\n| a | b |")
        ['One is e.g. here.', 'x: Two;', '`three`.', '| a | b |']
    """
    lines: list[str] = []
    for line in text.splitlines():
        starts = re.match(r"\s*([-*|]|\d+\.|\*?\w+(, \w+)*:)\s", line)
        if starts or not lines or lines[-1].startswith("|"):
            lines.append(line.strip())
        else:
            lines[-1] += f" {line.strip()}"
    found = (plain(part) for line in lines for part in END_OF_SENTENCE.split(line))
    return [part for text in found if re.search(r"\w", part := re.sub(rf"\s*{HEADS}$", "", text))]


def plain(text: str) -> str:
    """Text with single spaces."""
    return " ".join(text.split())
