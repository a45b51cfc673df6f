"""Check that an assignment's parts agree: rubric, tests, handout, stubs, solutions and mutants."""

import ast
import json
import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

from .. import material, mutants, notebooks
from ..assignments import Assignment
from ..judge import running
from ..rubric import STAFF_TEST
from . import contracts

POINTS_IN_TEXT = re.compile(
    r"\(\s*[\d.]+\s*(?:bonus )?(?:points?|pts?\.?)\s*\)|\bworth [\d.]+ |\bfor [\d.]+ points"
    r"|[\d.]+ bonus points",
    re.IGNORECASE,
)
LEAST_MUTANTS = 2


def check(assignment: Assignment) -> Iterator[str]:
    """Faults of an assignment, a line each."""
    for part in (_files, _handout, _tests, _notebook, _mutants, contracts.check):
        yield from part(assignment)


def collect(folder: Path, package: Path | None = None) -> dict[str, list[str]]:
    """Tests of an assignment's folder, each with its markers; RuntimeError if pytest fails."""
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "collected.json"
        result = running.pytest(folder, ["--collect-only", f"--collected={target}"], package)
        if result.returncode not in (running.OK, running.NONE_COLLECTED):
            raise RuntimeError(f"the tests cannot be collected: {running.last_lines(result)}")
        return json.loads(target.read_text(encoding="utf-8"))


def _files(assignment: Assignment) -> Iterator[str]:
    """Check stubs and solutions of each problem, their imports, and that they are handed in."""
    rubric = assignment.rubric
    stubs = {path.name for path in assignment.starter.glob("*.py")}
    solutions = {path.name for path in assignment.solutions.glob("*.py")}
    problems = [problem for problem in rubric.problems if problem.file]
    stems = {Path(problem.file).stem for problem in problems}
    for problem in problems:
        for kind, names in (("starter", stubs), ("solutions", solutions)):
            if problem.file not in names:
                yield f"{kind}/{problem.file}: is missing (problem {problem.id})"
        if not any(fnmatch(problem.file, pattern) for pattern in rubric.submit):
            yield f"rubric.toml: submit does not cover {problem.file} (problem {problem.id})"
        if not any(other.names for other in problems if other.file == problem.file):
            yield f"rubric.toml: problem {problem.id}: no problem names what {problem.file} defines"
        if problem.file in stubs and problem.id not in _read(assignment.starter / problem.file):
            yield f"starter/{problem.file}: does not name its problem {problem.id}"
        if problem.other_points:
            yield f"rubric.toml: problem {problem.id}: other_points is for released rubrics"
        text = _read(assignment.solutions / problem.file) if problem.file in solutions else ""
        for module in stems.intersection(_imported(ast.parse(text))):
            owners = {p.id for p in problems if Path(p.file).stem == module}
            if not owners & rubric.needed(problem.id):
                yield f"solutions/{problem.file}: imports {module}, not in needs of {problem.id}"
    for name in sorted(solutions - {problem.file for problem in problems}):
        yield f"solutions/{name}: is no problem's file; what is given belongs in starter/ alone"
    for name in ("exercises.md", "solutions/exercises.md", "README.md", "pytest.ini"):
        if not (assignment.folder / name).is_file():
            yield f"{name}: is missing"


def _imported(tree: ast.Module) -> Iterator[str]:
    """First names of the modules that a file imports, wherever in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (alias.name for alias in node.names if node.module is None)
            yield (node.module or "").partition(".")[0]


def _handout(assignment: Assignment) -> Iterator[str]:
    """Check that each problem has its block, and no text states points."""
    readme = assignment.folder / "README.md"
    if not readme.is_file():
        return
    text = _read(readme)
    blocks = Counter(material.BLOCK.findall(text))
    ids = {problem.id for problem in assignment.rubric.problems}
    for problem in sorted(ids | blocks.keys()):
        if problem not in ids:
            yield f"README.md: [[{problem}]]: the rubric has no such problem"
        elif blocks[problem] != 1:
            yield f"README.md: line [[{problem}]] is there {blocks[problem]} times, must be once"
    texts = [assignment.folder / name for name in ("README.md", "exercises.md", "notebook.py")]
    for path in (*texts, *sorted(assignment.starter.glob("*.py"))):
        name = path.relative_to(assignment.folder)
        for match in POINTS_IN_TEXT.finditer(_read(path) if path.is_file() else ""):
            yield f"{name}: states points ({match[0].strip()!r}); only rubric.toml may"
    for match in re.finditer(r"!\[([^\]]*)\]\(([^)]+)\)", text):
        if len(match[1].split()) < 2:
            yield f"README.md: picture {match[2]} has no text that says what is on it"
        if "://" not in match[2] and not (assignment.folder / match[2]).is_file():
            yield f"README.md: picture {match[2]} does not exist"


def _tests(assignment: Assignment) -> Iterator[str]:
    """Check that the rubric has every test and no other; markers and visibilities agree."""
    problems = assignment.rubric.problems
    found = collect(assignment.folder)
    graded = {test.id: (test, problem) for problem in problems for test in problem.tests}
    for name in sorted(graded.keys() - found.keys()):
        yield f"rubric.toml: {name}: there is no such test"
    for name in sorted(found.keys() - graded.keys()):
        yield f"{name}: is in no problem of the rubric"
    markers = {problem.marker for problem in problems}
    for name in sorted(found.keys() & graded.keys()):
        test, problem = graded[name]
        has = markers & set(found[name])
        if has != {problem.marker}:
            yield f"{name}: has the markers {sorted(has)}, must have {problem.marker}"
        if test.is_staff == (test.visibility == "visible"):
            text = f"visible tests must not be in {STAFF_TEST}, all others must"
            yield f"{name}: is {test.visibility}; {text}"


def _notebook(assignment: Assignment) -> Iterator[str]:
    """Check that the solution cells are the problems' files."""
    path = assignment.folder / "notebook.py"
    if not path.is_file():
        yield "notebook.py: is missing"
        return
    cells = notebooks.solution_files(_read(path))
    files = {problem.file for problem in assignment.rubric.problems if problem.file}
    for name in sorted(files - set(cells)):
        yield f"notebook.py: has no cell [solution] {name}"
    for name in sorted(set(cells) - {p.name for p in assignment.solutions.glob("*.py")}):
        yield f"notebook.py: [solution] {name}: solutions/ has no such file"


def _mutants(assignment: Assignment) -> Iterator[str]:
    """Check that there are enough mutants, and each fits its file and the rubric."""
    rubric = assignment.rubric
    try:
        known = mutants.read(assignment)
    except ValueError as error:
        yield str(error)
        return
    count = Counter(mutant.problem for mutant in known)
    ids = [problem.id for problem in rubric.problems]
    for name in ids:
        if count[name] < LEAST_MUTANTS:
            yield f"mutants.toml: {name} has {count[name]}, must have {LEAST_MUTANTS}"
    for mutant in known:
        where = f"mutants.toml: {mutant.id}"
        if mutant.problem not in ids:
            yield f"{where}: the rubric has no problem {mutant.problem}"
        for name in mutant.fails:
            if name not in rubric.problem_by_test:
                yield f"{where}: the rubric has no test {name}"
        if not mutant.fails:
            yield f"{where}: fails no test"
        if not mutant.says.strip():
            yield f"{where}: says nothing"
        try:
            mutants.apply(assignment, mutant)
        except ValueError as error:
            yield str(error)


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8")
