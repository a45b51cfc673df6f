"""Check that each sentence of a contract has a test that fails when a solution breaks it.

The file `contracts.toml` in an assignment's folder lists the sentences. Students do not get it::

    [[contract]]
    problem = "a1.disk"
    says = "the density per area, 0 off the disk"  # quote from the handout or a stub's docstring
    tests = ["test_disk.py::test_density"]  # tests that fail for solutions that break the sentence
    mutants = ["disk_without_end"]  # wrong solutions that break it and fail one of these tests

    [[remark]]  # sentences without a requirement
    problem = "a1.disk"
    says = ["The radius is that of the unit disk."]

The file must quote each sentence of the docstrings in a problem's stub. It must also quote each
sentence of the paragraphs in the problem's section of the handout that start with `*Contract.*` or
`**Write**`. Quoting a part of a sentence is enough.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

from .. import material, mutants, toml
from ..assignments import Assignment
from ..rubric import Problem

FILE_NAME = "contracts.toml"
# Beginning of paragraphs in the handout that contain requirements
REQUIREMENTS = re.compile(r"\s*(\*Contract\.\*|\*\*Write\*\*)")
MISTAKES = "*Common mistakes.*"  # end of the requirements in such a paragraph
END_OF_PARAGRAPH = re.compile(r"\n\s*\n")
END_OF_SENTENCE = re.compile(r"(?<=[.;!?])\s+(?=[A-Z`\[(*$0-9]|and |or )")
HEADS = "(Args|Returns|Raises|Attributes|Example|Yields):"


@dataclass(frozen=True)
class Entry:
    """Sentences of a problem. Without the fields of a `Contract`, a test cannot check them."""

    problem: str
    says: str | tuple[str, ...]  # quoted sentences, or parts of sentences

    @property
    def sentences(self) -> list[str]:
        """Quoted sentences with single spaces."""
        return [plain(text) for text in ([self.says] if isinstance(self.says, str) else self.says)]

    @property
    def where(self) -> str:
        """Beginning of error messages about this entry."""
        return f"{FILE_NAME}: {' / '.join(self.sentences)[:60]!r}"


@dataclass(frozen=True)
class Contract(Entry):
    """A sentence with a requirement, which tests can check."""

    tests: tuple[str, ...]  # tests that fail for solutions that break the sentence
    mutants: tuple[str, ...]  # wrong solutions that break the sentence


def read(assignment: Assignment) -> list[Entry]:
    """Read the contracts and remarks of an assignment.

    Raises:
        ValueError: `contracts.toml` is missing or wrong.
    """
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
    """Yield a message for each error in `contracts.toml`."""
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
        of_problem = [entry for entry in entries if entry.problem == problem.id]
        yield from _check_sentences(assignment, problem, of_problem)
        for entry in of_problem:
            if isinstance(entry, Contract):
                yield from _check_tests(entry, problem, known)


def _check_tests(
    contract: Contract, problem: Problem, known: dict[str, mutants.Mutant]
) -> Iterator[str]:
    """Check that a contract's tests exist, and that each of its mutants fails one of them."""
    where = contract.where
    tests = {test.id for test in problem.tests}
    if not contract.tests or not contract.mutants:
        yield f"{where}: must name a test and a mutant"
    for name in contract.tests:
        if name not in tests:
            yield f"{where}: {problem.id} has no test {name}"
    for name in contract.mutants:
        if name not in known:
            yield f"{where}: mutants.toml has no mutant {name}"
        elif not set(contract.tests) & set(known[name].fails):
            yield f"{where}: {name} fails none of its tests"


def _check_sentences(
    assignment: Assignment, problem: Problem, entries: list[Entry]
) -> Iterator[str]:
    """Check that each quote is in a text of the problem, and each required sentence is quoted."""
    quoted = {sentence: entry for entry in entries for sentence in entry.sentences}
    handout = _handout(assignment, problem)
    docstrings = _docstrings(assignment, problem)

    # Quotes that are in no text
    texts = list(map(plain, (handout, *docstrings)))
    for part, entry in quoted.items():
        if not any(part in text for text in texts):
            yield f"{entry.where}: no text of {problem.id} contains {part!r:.80}"

    # Sentences that are not quoted
    paragraphs = END_OF_PARAGRAPH.split(handout)
    required = [each.partition(MISTAKES)[0] for each in paragraphs if REQUIREMENTS.match(each)]
    required += [paragraph for text in docstrings for paragraph in END_OF_PARAGRAPH.split(text)]
    for sentence in (sentence for text in required for sentence in sentences(text)):
        if not any(part in sentence or sentence in part for part in quoted):
            yield f"{FILE_NAME}: {problem.id}: no contract or remark for {sentence!r:.200}"


def _handout(assignment: Assignment, problem: Problem) -> str:
    """Return the section of a problem in the handout, up to the next problem or heading."""
    text = (assignment.folder / "README.md").read_text(encoding="utf-8")
    parts = material.BLOCK.split(text)
    after = dict(zip(parts[1::2], parts[2::2], strict=True))
    return re.split(r"^#", after.get(problem.id, ""), maxsplit=1, flags=re.MULTILINE)[0]


def _docstrings(assignment: Assignment, problem: Problem) -> list[str]:
    """Return the docstrings in a problem's stub."""
    path = assignment.starter / problem.file
    if not problem.file or not path.is_file():
        return []
    return [
        ast.get_docstring(node) or ""
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    ]


def sentences(text: str) -> list[str]:
    r"""Split a text into sentences with single spaces.

    Items of lists and lines of tables start new sentences. Headings such as "Args:" are removed.

    Example:
        >>> sentences("One is e.g.\n  here. Args:\n    x: Two; `three`.\n\n| a | b |")
        ['One is e.g. here.', 'x: Two;', '`three`.', '| a | b |']
    """
    # Join the lines of each paragraph or list item
    lines: list[str] = []
    for line in text.splitlines():
        starts = re.match(r"\s*([-*|]|\d+\.|\*?\w+(, \w+)*:)\s", line)
        if starts or not lines or lines[-1].startswith("|"):
            lines.append(line.strip())
        else:
            lines[-1] += f" {line.strip()}"

    # Split them into sentences, and drop parts without words
    found = (plain(part) for line in lines for part in END_OF_SENTENCE.split(line))
    return [part for text in found if re.search(r"\w", part := re.sub(rf"\s*{HEADS}$", "", text))]


def plain(text: str) -> str:
    """Replace all white space in a text by single spaces."""
    return " ".join(text.split())
