"""Check that the parts of an assignment agree.

The parts are rubric, tests, handout, stubs, solutions, notebook, mutants and contracts.
"""

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
LEAST_MUTANTS = 2  # mutants that each problem needs


def check(assignment: Assignment) -> Iterator[str]:
    """Yield a message for each error in an assignment."""
    for part in (_files, _handout, _tests, _notebook, _mutants, contracts.check):
        yield from part(assignment)


def collect(folder: Path, package: Path | None = None) -> dict[str, list[str]]:
    """Collect the tests of an assignment.

    Args:
        folder: Folder of the assignment, or of a student.
        package: Folder with the package that the tests import; by default this package.

    Returns:
        Markers of each test, by the test's id.

    Raises:
        RuntimeError: pytest fails.
    """
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "collected.json"
        result = running.pytest(folder, ["--collect-only", f"--collected={target}"], package)
        if result.returncode not in (running.OK, running.NONE_COLLECTED):
            raise RuntimeError(f"the tests cannot be collected: {running.last_lines(result)}")
        return json.loads(target.read_text(encoding="utf-8"))


def _files(assignment: Assignment) -> Iterator[str]:
    """Check the files of each problem.

    Each problem needs a stub and a solution, which import only what the rubric allows. Its file
    must be handed in.
    """
    rubric = assignment.rubric
    stubs = {path.name for path in assignment.starter.glob("*.py")}
    solutions = {path.name for path in assignment.solutions.glob("*.py")}
    problems = [problem for problem in rubric.problems if problem.file]
    stems = {Path(problem.file).stem for problem in problems}
    for problem in problems:
        # Stub and solution exist, and the rubric covers the file
        for kind, names in (("starter", stubs), ("solutions", solutions)):
            if problem.file not in names:
                yield f"{kind}/{problem.file}: is missing (problem {problem.id})"
        if not any(fnmatch(problem.file, pattern) for pattern in rubric.submit):
            yield f"rubric.toml: submit does not cover {problem.file} (problem {problem.id})"
        if not any(other.names for other in problems if other.file == problem.file):
            yield f"rubric.toml: problem {problem.id}: add the names that {problem.file} defines"
        if problem.file in stubs and problem.id not in _read(assignment.starter / problem.file):
            yield f"starter/{problem.file}: does not name its problem {problem.id}"
        if problem.other_points:
            where = f"rubric.toml: problem {problem.id}"
            yield f"{where}: remove other_points, which is for released rubrics only"

        # The solution imports only files of problems that the rubric allows
        text = _read(assignment.solutions / problem.file) if problem.file in solutions else ""
        for module in stems.intersection(_imported(ast.parse(text))):
            owners = {p.id for p in problems if Path(p.file).stem == module}
            if not owners & rubric.needed(problem.id):
                yield f"solutions/{problem.file}: imports {module}, not in needs of {problem.id}"

    # Other files
    for name in sorted(solutions - {problem.file for problem in problems}):
        yield f"solutions/{name}: belongs to no problem; move provided files to starter/"
    for name in ("exercises.md", "solutions/exercises.md", "README.md", "pytest.ini"):
        if not (assignment.folder / name).is_file():
            yield f"{name}: is missing"


def _imported(tree: ast.Module) -> Iterator[str]:
    """Yield the top-level names of the modules that a file imports anywhere."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (alias.name for alias in node.names if node.module is None)
            yield (node.module or "").partition(".")[0]


def _handout(assignment: Assignment) -> Iterator[str]:
    """Check the texts for students.

    The handout needs one line `[[id]]` for each problem. No text may state points, and each
    picture needs a file and a description.
    """
    readme = assignment.folder / "README.md"
    if not readme.is_file():
        return

    # Lines [[id]]
    text = _read(readme)
    blocks = Counter(material.BLOCK.findall(text))
    ids = {problem.id for problem in assignment.rubric.problems}
    if (assignment.rubric.by_hand or material.POINTS in blocks) and blocks.pop(
        material.POINTS, 0
    ) != 1:
        yield "README.md: needs one line [[points]], because rubric.toml has points by hand"
    for problem in sorted(ids | blocks.keys()):
        if problem not in ids:
            yield f"README.md: [[{problem}]]: the rubric does not contain this problem"
        elif blocks[problem] != 1:
            count = blocks[problem]
            yield f"README.md: line [[{problem}]] occurs {count} times, must occur once"

    # Points
    texts = [assignment.folder / name for name in ("README.md", "exercises.md", "notebook.py")]
    for path in (*texts, *sorted(assignment.starter.glob("*.py"))):
        name = path.relative_to(assignment.folder)
        for match in POINTS_IN_TEXT.finditer(_read(path) if path.is_file() else ""):
            yield f"{name}: states points ({match[0].strip()!r}); only rubric.toml may do so"

    # Pictures
    for match in re.finditer(r"!\[([^\]]*)\]\(([^)]+)\)", text):
        if len(match[1].split()) < 2:
            yield f"README.md: picture {match[2]} needs a description of two or more words"
        if "://" not in match[2] and not (assignment.folder / match[2]).is_file():
            yield f"README.md: picture {match[2]} does not exist"


def _tests(assignment: Assignment) -> Iterator[str]:
    """Check that rubric and test files contain the same tests, with the same properties."""
    # Both contain the same tests
    problems = assignment.rubric.problems
    found = collect(assignment.folder)
    graded = {test.id: (test, problem) for problem in problems for test in problem.tests}
    for name in sorted(graded.keys() - found.keys()):
        yield f"rubric.toml: {name}: the test does not exist"
    for name in sorted(found.keys() - graded.keys()):
        yield f"{name}: is missing in the rubric"

    # Markers and visibilities agree
    markers = {problem.marker for problem in problems}
    for name in sorted(found.keys() & graded.keys()):
        test, problem = graded[name]
        has = markers & set(found[name])
        if has != {problem.marker}:
            yield f"{name}: has the markers {sorted(has)}, must have {problem.marker}"
        if test.is_staff == (test.visibility == "visible"):
            text = f"visible tests must not be in {STAFF_TEST}, all other tests must be"
            yield f"{name}: is {test.visibility}; {text}"


def _notebook(assignment: Assignment) -> Iterator[str]:
    """Check that the notebook has a solution cell for each file of a problem, and no other."""
    path = assignment.folder / "notebook.py"
    if not path.is_file():
        yield "notebook.py: is missing"
        return
    cells = notebooks.solution_files(_read(path))
    files = {problem.file for problem in assignment.rubric.problems if problem.file}
    for name in sorted(files - set(cells)):
        yield f"notebook.py: the cell [solution] {name} is missing"
    for name in sorted(set(cells) - {p.name for p in assignment.solutions.glob("*.py")}):
        yield f"notebook.py: [solution] {name}: the file is missing in solutions/"


def _mutants(assignment: Assignment) -> Iterator[str]:
    """Check that each problem has enough mutants, and that each mutant can be made."""
    rubric = assignment.rubric
    try:
        known = mutants.read(assignment)
    except ValueError as error:
        yield str(error)
        return

    # Number of mutants
    count = Counter(mutant.problem for mutant in known)
    ids = [problem.id for problem in rubric.problems]
    for name in ids:
        if count[name] < LEAST_MUTANTS:
            yield f"mutants.toml: {name} has {count[name]} mutants, must have {LEAST_MUTANTS}"

    # Each mutant
    for mutant in known:
        where = f"mutants.toml: {mutant.id}"
        if mutant.problem not in ids:
            yield f"{where}: the rubric has no problem {mutant.problem}"
        for name in mutant.fails:
            if name not in rubric.problem_by_test:
                yield f"{where}: the rubric has no test {name}"
        if not mutant.fails:
            yield f"{where}: fails must name a test"
        if not mutant.says.strip():
            yield f"{where}: says must contain text of a failure"
        try:
            mutants.apply(assignment, mutant)
        except ValueError as error:
            yield str(error)


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8")
