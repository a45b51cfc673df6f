"""Student edition: this package without the modules that students write themselves.

Only whole modules are left out, so no file has to be changed inside.
"""

import ast
import json
import shutil
from collections.abc import Collection, Iterator
from contextlib import suppress
from importlib.util import resolve_name
from pathlib import Path

import tomlkit

from ..runtime import editions
from . import material, toml
from .assignments import PACKAGE, Assignment
from .rubric import Rubric

DESCRIPTION = "Light in flight on Mitsuba 3: the student edition"
COPIED_KEYS = ("name", "license", "license-files", "requires-python", "dependencies", "scripts")
"""Keys of the checkout's `pyproject.toml` that are copied to the edition."""


MARKER = editions.FILE.relative_to(PACKAGE)
"""File that only editions contain, relative to the package's folder."""


def copy(assignment: Assignment, folder: Path) -> None:
    """Write the edition of an assignment into a new or empty folder.

    A `PYTHONPATH` with this folder uses the edition. The edition is not checked here.
    """
    from tofrender import __version__

    rubric = assignment.rubric
    modules = withheld(rubric)
    withheld_paths = set(map(path_of, modules))
    package = folder / "tofrender"

    def ignored_names(parent: str, names: list[str]) -> set[str]:
        """Select the names in a folder that `shutil.copytree` leaves out."""
        inside = Path(parent).relative_to(PACKAGE)
        ignored = {name for name in names if name.startswith(".") or name == "__pycache__"}
        ignored |= {name for name in names if inside / name in withheld_paths}
        if inside == Path("course"):
            ignored.add("material")
        return ignored

    # Copy the package
    shutil.copytree(PACKAGE, package, ignore=ignored_names)

    # Record the withheld modules, so that their import names the problem
    content = {
        "modules": {name: _refusal(problem) for name, problem in modules.items()},
        "names": {name: _refusal(each.id) for name, each in rubric.problem_by_name.items()},
        "remedy": "import your file before loading the scene",
    }
    text = json.dumps(content, indent=1)
    (package / MARKER).write_text(text + "\n", encoding="utf-8")

    # Replace the version
    init = package / "__init__.py"
    old_line = f'__version__ = "{__version__}"'
    new_line = f'__version__ = "{version(rubric)}"'
    text = init.read_text(encoding="utf-8")
    if old_line not in text:
        raise ValueError(f"{init.name} does not contain the line {old_line}")
    init.write_text(text.replace(old_line, new_line), encoding="utf-8")

    # Add the released material
    released = package / "course" / "material" / assignment.name
    released.mkdir(parents=True)
    material.write(assignment, released)

    # Graded submissions may import the scenes, but do not run in a student's folder
    material.write_scenes(released / material.SCENES, folder / material.SCENES, ["__init__.py"])


def _refusal(problem: str | None) -> str:
    """Return the text that follows the name of a module in the error of its import."""
    if problem is None:
        return "is not part of the student edition"
    return f"is yours to write: problem {problem}"


def of_grading(assignment: Assignment, folder: Path) -> None:
    """Write the edition that graded submissions import.

    On a platform this package is a student edition already; then it is copied.
    """
    if not (PACKAGE / MARKER).is_file():
        copy(assignment, folder)
        return
    ignored = shutil.ignore_patterns("__pycache__", ".*")
    shutil.copytree(PACKAGE, folder / "tofrender", ignore=ignored)
    scenes = PACKAGE.parent / material.SCENES
    material.write_scenes(scenes, folder / material.SCENES, ["__init__.py"])


def make_installable(folder: Path, rubric: Rubric) -> None:
    """Add the license and a `pyproject.toml` with the checkout's dependencies to an edition."""
    checkout = PACKAGE.parent
    if not (checkout / "pyproject.toml").is_file():
        raise ValueError(f"{checkout} does not contain pyproject.toml; use the course's checkout")
    shutil.copyfile(checkout / "LICENSE", folder / "LICENSE")
    settings = toml.read(checkout / "pyproject.toml")
    project = settings["project"]
    content = {
        "build-system": settings["build-system"],
        "project": {name: project[name] for name in COPIED_KEYS}
        | {"version": version(rubric), "description": DESCRIPTION}
        | {"optional-dependencies": {"course": project["optional-dependencies"]["course"]}},
        "tool": {"hatch": {"build": {"targets": {"wheel": {"packages": ["tofrender"]}}}}},
    }
    (folder / "pyproject.toml").write_text(tomlkit.dumps(content), encoding="utf-8")


def version(rubric: Rubric) -> str:
    """Return the version of the edition, for example "0.1.0+a2"."""
    from tofrender import __version__

    return f"{__version__}+{rubric.id}"


def withheld(rubric: Rubric) -> dict[str, str | None]:
    """Return all modules that the edition lacks, with the id of the problem that each solves.

    These are the modules that the rubric chooses, and all modules that import them. The value is
    None for modules that solve no single problem.

    Raises:
        ValueError: The rubric keeps a module that imports a withheld module.
    """
    modules = chosen(rubric)
    needing = dependents(modules)
    for name in rubric.keeps:
        path_of(name)
        if name in needing:
            raise ValueError(f"rubric.toml: keeps {name}, which imports {needing[name]}")
    return modules | dict.fromkeys(needing)


def chosen(rubric: Rubric) -> dict[str, str | None]:
    """Return the modules and packages that the rubric withholds, with the problem of each.

    If the rubric keeps one module of a package, the remaining modules of the package are listed.
    """
    return {
        part: problem
        for module, problem in rubric.withheld.items()
        for part in _without_kept(module, path_of(module), rubric.keeps)
    }


def _without_kept(module: str, path: Path, keeps: Collection[str]) -> Iterator[str]:
    """Yield a module or package, or the parts of the package that are not kept."""
    if not any(is_in(name, [module]) for name in keeps):
        yield module
    elif module not in keeps:
        for inner in sorted((PACKAGE / path).iterdir()):
            is_module = inner.suffix == ".py" and inner.stem != "__init__"
            if is_module or (inner / "__init__.py").is_file():
                inner_path = inner.relative_to(PACKAGE)
                yield from _without_kept(f"{module}.{inner.stem}", inner_path, keeps)


def path_of(module: str) -> Path:
    """Return the path of a module or package, relative to the package's folder.

    Raises:
        ValueError: The package does not contain this module.
    """
    head, *parts = module.split(".")
    path = Path(*parts)
    if head == "tofrender" and parts:
        if (PACKAGE / path / "__init__.py").is_file():
            return path
        if (PACKAGE / path).with_suffix(".py").is_file():
            return path.with_suffix(".py")
    raise ValueError(f"rubric.toml: module {module}: does not exist in the package")


def dependents(withheld: Collection[str]) -> dict[str, str]:
    """Find the modules that cannot be imported without the withheld modules.

    Imports inside functions and for type checkers do not count, because they do not run with the
    module.

    Args:
        withheld: Names of modules and packages.

    Returns:
        For each module found, the name of the missing module that it imports. This is a withheld
        module, or another module of the result.

    Example:
        >>> dependents(["tofrender.rendering.arrivals"])["tofrender.rendering.job"]
        'tofrender.rendering.arrivals'
    """
    imports = {_module(path): set(_imports(path)) for path in sorted(PACKAGE.rglob("*.py"))}
    found: dict[str, str] = {}

    # Repeat until no further module imports a missing one
    grew = True
    while grew:
        grew = False
        missing = {*withheld, *found}
        for module in imports:
            cause = next((name for name in sorted(imports[module]) if is_in(name, missing)), None)
            if cause is not None and not is_in(module, missing):
                found[module] = cause
                grew = True
    return dict(sorted(found.items()))


def is_in(module: str, packages: Collection[str]) -> bool:
    """Return whether a module is in a list of modules and packages, or inside one of them."""
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def _module(path: Path) -> str:
    """Return the name of a file's module."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def _imports(path: Path) -> Iterator[str]:
    """Yield the modules that a file imports as soon as it is imported."""
    module = _module(path)
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in _statements_at_import(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
            continue
        base = resolve_name("." * node.level + (node.module or ""), package)
        yield base

        # `from package import name` imports a module if the name is one
        for alias in node.names:
            with suppress(ValueError):
                path_of(f"{base}.{alias.name}")
                yield f"{base}.{alias.name}"


def _statements_at_import(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Yield the import statements that run when the module is imported."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            yield from (n for part in child.orelse for n in _statements_at_import(part))
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _statements_at_import(child)
