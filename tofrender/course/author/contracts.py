"""Whether each sentence of a contract has a test that fails when it is broken.

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
handout that start with `*Contract.*` or `**Write**`, must be in it. What is quoted need not be all
of the sentence.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from .. import material, mutants
from ..assignments import Assignment
from ..rubric import Problem

FILE_NAME = "contracts.toml"
DEMANDING = ("*Contract.*", "**Write**")
"""What paragraphs of the handout start with that ask for something."""
MISTAKES = "*Common mistakes.*"
"""Where they stop to do so."""


END_OF_SENTENCE = re.compile(r"(?<=[.;!?])\s+(?=[A-Z`\[(*$0-9]|and |or )")
HEADS = "(Args|Returns|Raises|Attributes|Example|Yields):"


@dataclass(frozen=True)
class Contract:
    """A sentence that a solution has to keep.

    Attributes:
        problem: The problem.
        says: The sentence, or a part of it.
        tests: Tests that fail when it is broken.
        mutants: Wrong solutions that break it.
    """

    problem: str
    says: str
    tests: tuple[str, ...]
    mutants: tuple[str, ...]


@dataclass(frozen=True)
class Remark:
    """Sentences that ask for nothing that a test could find broken.

    Attributes:
        problem: The problem.
        says: The sentences, or parts of them.
    """

    problem: str
    says: tuple[str, ...]


def read(assignment: Assignment) -> tuple[list[Contract], list[Remark]]:
    """The table of an assignment.

    Raises:
        ValueError: `contracts.toml` is missing, or not as it should be; one line.
    """
    path = assignment.folder / FILE_NAME
    if not path.is_file():
        raise ValueError(f"{FILE_NAME}: is missing")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{FILE_NAME}: is not TOML: {error}") from None
    for name in content.keys() - {"contract", "remark"}:
        raise ValueError(f"{FILE_NAME}: [[{name}]]: must be [[contract]] or [[remark]]")
    contracts = [_made(Contract, each) for each in content.get("contract", [])]
    return contracts, [_made(Remark, each) for each in content.get("remark", [])]


def _made(kind: type, entry: dict[str, Any]) -> Any:
    if entry.keys() != kind.__dataclass_fields__.keys():
        fields = ", ".join(kind.__dataclass_fields__)
        raise ValueError(f"{FILE_NAME}: {entry.get('says')!r:.80}: must have exactly {fields}")
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()})


def check(assignment: Assignment) -> Iterator[str]:
    """What is missing or wrong in the table, a line each."""
    try:
        contracts, remarks = read(assignment)
        those = {mutant.id: mutant for mutant in mutants.read(assignment)}
    except ValueError as error:
        yield str(error)
        return
    problems = {problem.id: problem for problem in assignment.rubric.problems}
    for each in (*contracts, *remarks):
        if each.problem not in problems:
            yield f"{FILE_NAME}: {_shown(each)}: the rubric has no problem {each.problem}"
    for problem in problems.values():
        own = [each for each in contracts if each.problem == problem.id]
        explained = [each for each in remarks if each.problem == problem.id]
        yield from _sentences(assignment, problem, own, explained)
        for contract in own:
            yield from _kept(contract, problem, those)


def _kept(contract: Contract, problem: Problem, those: dict[str, mutants.Mutant]) -> Iterator[str]:
    """Whether tests of the problem find it broken, as mutants show."""
    where = f"{FILE_NAME}: {_shown(contract)}"
    tests = {test.id for test in problem.tests}
    if not contract.tests or not contract.mutants:
        yield f"{where}: must name a test and a mutant"
    for name in contract.tests:
        if name not in tests:
            yield f"{where}: {problem.id} has no test {name}"
    for name in contract.mutants:
        if name not in those:
            yield f"{where}: there is no mutant {name}"
        elif not set(contract.tests) & set(those[name].fails):
            yield f"{where}: {name} fails none of its tests"


def _sentences(
    assignment: Assignment, problem: Problem, contracts: list[Contract], remarks: list[Remark]
) -> Iterator[str]:
    """Whether the sentences of a problem are in the table, and those of the table in the texts."""
    said = {plain(contract.says): contract for contract in contracts}
    said |= {plain(text): remark for remark in remarks for text in remark.says}
    texts = [_handout(assignment, problem), *_docstrings(assignment, problem)]
    texts = [plain(text) for text in texts]
    for quoted, entry in said.items():
        if not any(quoted in text for text in texts):
            yield f"{FILE_NAME}: {_shown(entry)}: no text of {problem.id} says {quoted!r:.80}"
    for text in _demands(assignment, problem):
        for sentence in sentences(text):
            if not any(quoted in sentence or sentence in quoted for quoted in said):
                yield f"{FILE_NAME}: {problem.id}: no test and no remark for {sentence!r:.200}"


def _demands(assignment: Assignment, problem: Problem) -> Iterator[str]:
    """The texts whose sentences have to be in the table."""
    for paragraph in re.split(r"\n\s*\n", _handout(assignment, problem)):
        if paragraph.strip().startswith(DEMANDING):
            yield paragraph.partition(MISTAKES)[0]
    for docstring in _docstrings(assignment, problem):
        yield from re.split(r"\n\s*\n", docstring)


def _handout(assignment: Assignment, problem: Problem) -> str:
    """A problem's section of the handout: to the next problem, or the next heading."""
    text = (assignment.folder / "README.md").read_text(encoding="utf-8")
    parts = material.BLOCK.split(text)
    after = dict(zip(parts[1::2], parts[2::2], strict=True))
    return re.split(r"^#", after.get(problem.id, ""), maxsplit=1, flags=re.MULTILINE)[0]


def _docstrings(assignment: Assignment, problem: Problem) -> list[str]:
    """The docstrings of a problem's stub."""
    path = assignment.starter / problem.file
    if not problem.file or not path.is_file():
        return []
    found = [
        ast.get_docstring(node)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    ]
    return [text for text in found if text]


def sentences(text: str) -> list[str]:
    r"""The sentences of a paragraph, with single spaces; lines of lists and tables begin new ones.

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
    found = []
    for line in lines:
        found += map(plain, END_OF_SENTENCE.split(line))
    found = [re.sub(rf"\s*{HEADS}$", "", part) for part in found]
    return [part for part in found if re.search(r"\w", part)]


def plain(text: str) -> str:
    """Text with single spaces."""
    return " ".join(text.split())


def _shown(entry: Contract | Remark) -> str:
    text = entry.says if isinstance(entry, Contract) else " / ".join(entry.says)
    return repr(plain(text)[:60])
