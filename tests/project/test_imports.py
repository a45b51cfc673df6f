"""Imports between modules of the package and of the benchmarks."""

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def modules(root: Path, package: str) -> dict[str, Path]:
    """Find the files of a package's modules by their dotted names."""
    found = {}
    for path in sorted((root / package).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts).removesuffix(".__init__")] = path
    return found


def imported(name: str, path: Path) -> Iterator[tuple[str, str]]:
    """Find the imports of a module, also those for type checkers and those in functions.

    Yields:
        A module, and what is imported from the module, which may be a module, too.
    """
    is_package = path.name == "__init__.py"
    package = name.split(".") if is_package else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parent = package[: len(package) + 1 - node.level] if node.level else []
            source = ".".join([*parent, *filter(None, [node.module])])
            yield from ((source, alias.name) for alias in node.names)


def imports(files: Mapping[str, Path]) -> dict[str, set[str]]:
    """Find which modules each module imports."""
    found: dict[str, set[str]] = {}
    for name, path in files.items():
        pairs = [(source, f"{source}.{what}") for source, what in imported(name, path)]
        targets = {module if module in files else source for source, module in pairs}
        found[name] = (targets & files.keys()) - {name}
    return found


def in_circles(graph: Mapping[str, set[str]]) -> set[str]:
    """Find the modules that import themselves by way of others.

    Modules that import no others, and modules that no others import, are removed until none is
    left of these. The rest are circles, and modules between circles.
    """
    left = {name: set(targets) for name, targets in graph.items()}
    while True:
        targets = set().union(*left.values()) if left else set()
        kept = {name for name, others in left.items() if others and name in targets}
        if kept == left.keys():
            return kept
        left = {name: left[name] & kept for name in kept}


@pytest.mark.parametrize("package", ["tofrender", "benchmarks"])
def test_no_circles_of_imports(package):
    graph = imports(modules(ROOT, package))
    assert sum(map(len, graph.values())) > 50
    assert in_circles(graph) == set()


def test_test_files_do_not_import_each_other():
    found = {
        (name, source)
        for name, path in modules(ROOT, "tests").items()
        for source, _ in imported(name, path)
        if source.rpartition(".")[2].startswith("test_")
    }
    assert found == set()


CIRCLES = {
    "at the top": {"a": "from . import b", "b": "from .c import x", "c": "from .a import y"},
    "in a function": {"a": "from .b import x", "b": "def f():\n    from p.a import y"},
    "for type checkers": {"a": "import p.b", "b": "if TYPE_CHECKING:\n    from .a import y"},
}


@pytest.mark.parametrize("sources", CIRCLES.values(), ids=CIRCLES)
def test_circles_are_found(tmp_path, sources):
    package = tmp_path / "p"
    package.mkdir()
    for name, source in {"__init__": "", "other": "from .a import x", **sources}.items():
        (package / f"{name}.py").write_text(source)
    graph = imports(modules(tmp_path, "p"))
    assert in_circles(graph) == {f"p.{name}" for name in sources}
