"""Which packages a change touches, and which packages import those, by the graph of imports."""

import subprocess
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).parents[2]
WHOLE = pytest.StashKey[tuple[list[str], list[str]]]()
"""The packages whose tests all run: those that have changed, and those that import them."""


def package_of(path: str) -> str:
    """Return the package that a module or a test file belongs to, or "" for other files.

    >>> package_of("tests/films/test_film.py"), package_of("tofrender/nlos/light/corner.py")
    ('films', 'nlos')
    >>> package_of("tests/conftest.py"), package_of("README.md")
    ('', '')
    """
    parts = PurePosixPath(path).parts
    is_inside = len(parts) > 2 and parts[0] in ("tofrender", "tests")
    return parts[1] if is_inside else ""


def touched(since: str, root: Path = ROOT) -> set[str]:
    """Return the packages with a file that differs from a commit.

    Raises:
        ValueError: Git does not know the commit.
    """
    command = ["git", "diff", "--name-only", since, "--"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True)
    if done.returncode:
        raise ValueError(f"{since} is not a commit of this repository")
    return {package_of(line) for line in done.stdout.splitlines()} - {""}


def importers(packages: Iterable[str]) -> set[str]:
    """Return the other packages that import one of these.

    >>> "integrators" in importers({"paths"}), "signals" in importers({"paths"})
    (True, False)
    """
    import grimp

    # Treat each package as one module of the graph.
    graph = grimp.build_graph("tofrender", cache_dir=None, exclude_type_checking_imports=True)
    for package in graph.find_children("tofrender"):
        graph.squash_module(package)

    found: set[str] = set()
    for package in packages:
        if f"tofrender.{package}" in graph.modules:
            found |= graph.find_modules_that_directly_import(f"tofrender.{package}")
    names = {module.partition(".")[2] for module in found}
    return names - {""} - set(packages)
