"""Student edition: this package without the modules that students write themselves.

Whole modules are left out, so nothing has to be cut from a file.
"""

import ast
import json
import shutil
from collections.abc import Collection, Iterator
from contextlib import suppress
from importlib.util import resolve_name
from pathlib import Path

import tomlkit

from . import material, toml
from .assignments import PACKAGE, Assignment
from .rubric import Rubric

DESCRIPTION = "Light in flight on Mitsuba 3: the student edition"
SAME = ("name", "license", "license-files", "requires-python", "dependencies", "scripts")
"""Keys of the checkout's `pyproject.toml` that the edition has, too."""


def copy(assignment: Assignment, folder: Path) -> None:
    """Write the edition, unchecked, into a new or empty folder that a `PYTHONPATH` can name."""
    from tofrender import __version__

    rubric = assignment.rubric
    modules = withheld(rubric)
    skipped = set(map(path_of, modules))
    package = folder / "tofrender"

    def left_out(parent: str, names: list[str]) -> set[str]:
        inside = Path(parent).relative_to(PACKAGE)
        bad = {name for name in names if name.startswith(".") or name == "__pycache__"}
        bad |= {name for name in names if inside / name in skipped}
        return bad | ({"material"} if inside == Path("course") else set())

    shutil.copytree(PACKAGE, package, ignore=left_out)
    names = {name: problem.id for name, problem in rubric.problem_by_name.items()}
    text = json.dumps({"modules": modules, "names": names}, indent=1)
    (package / "runtime" / "withheld.json").write_text(text + "\n", encoding="utf-8")
    init = package / "__init__.py"
    before, after = (f'__version__ = "{text}"' for text in (__version__, version(rubric)))
    text = init.read_text(encoding="utf-8")
    if before not in text:
        raise ValueError(f"{init.name}: has no line {before}")
    init.write_text(text.replace(before, after), encoding="utf-8")
    released = package / "course" / "material" / assignment.name
    released.mkdir(parents=True)
    material.write(assignment, released)
    # where no student's folder is: a submission may import them, too
    material.write_scenes(released / material.SCENES, folder / material.SCENES, ["__init__.py"])


def of_grading(assignment: Assignment, folder: Path) -> None:
    """Write the edition that submissions import; in an autograder, a copy of this package."""
    if not (PACKAGE / "runtime" / "withheld.json").is_file():
        copy(assignment, folder)
        return
    ignored = shutil.ignore_patterns("__pycache__", ".*")
    shutil.copytree(PACKAGE, folder / "tofrender", ignore=ignored)
    scenes = PACKAGE.parent / material.SCENES
    material.write_scenes(scenes, folder / material.SCENES, ["__init__.py"])


def make_installable(folder: Path, rubric: Rubric) -> None:
    """Write the checkout's licence, and a `pyproject.toml` with its dependencies."""
    checkout = PACKAGE.parent
    if not (checkout / "pyproject.toml").is_file():
        raise ValueError(f"{checkout}: has no pyproject.toml; must be the course's checkout")
    shutil.copyfile(checkout / "LICENSE", folder / "LICENSE")
    given = toml.read(checkout / "pyproject.toml")
    project = given["project"]
    content = {
        "build-system": given["build-system"],
        "project": {name: project[name] for name in SAME}
        | {"version": version(rubric), "description": DESCRIPTION}
        | {"optional-dependencies": {"course": project["optional-dependencies"]["course"]}},
        "tool": {"hatch": {"build": {"targets": {"wheel": {"packages": ["tofrender"]}}}}},
    }
    (folder / "pyproject.toml").write_text(tomlkit.dumps(content), encoding="utf-8")


def version(rubric: Rubric) -> str:
    """Version of the edition: "0.1.0+a2"."""
    from tofrender import __version__

    return f"{__version__}+{rubric.id}"


def withheld(rubric: Rubric) -> dict[str, str | None]:
    """Modules that the rubric chooses, with the problem each solves, and all that need them."""
    modules = chosen(rubric)
    needing = dependents(modules)
    for name in rubric.keeps:
        path_of(name)
        if name in needing:
            raise ValueError(f"rubric.toml: keeps {name}, which needs {needing[name]}")
    return modules | dict.fromkeys(needing)


def chosen(rubric: Rubric) -> dict[str, str | None]:
    """Modules and packages that the rubric withholds, with the problem that each solves.

    A package of which it keeps a module stands for the others in it.
    """
    return {
        part: problem
        for module, problem in rubric.withheld.items()
        for part in _parts(module, path_of(module), rubric.keeps)
    }


def _parts(module: str, path: Path, keeps: Collection[str]) -> Iterator[str]:
    """Modules of a module or package that are not kept."""
    if not any(is_in(name, [module]) for name in keeps):
        yield module
    elif module not in keeps:
        for inner in sorted((PACKAGE / path).iterdir()):
            is_module = inner.suffix == ".py" and inner.stem != "__init__"
            if is_module or (inner / "__init__.py").is_file():
                yield from _parts(f"{module}.{inner.stem}", inner.relative_to(PACKAGE), keeps)


def path_of(module: str) -> Path:
    """Path of a module or package in the package's folder; ValueError if there is none."""
    head, *parts = module.split(".")
    path = Path(*parts)
    if head == "tofrender" and parts:
        if (PACKAGE / path / "__init__.py").is_file():
            return path
        if (PACKAGE / path).with_suffix(".py").is_file():
            return path.with_suffix(".py")
    raise ValueError(f"rubric.toml: module {module}: does not exist in the package")


def dependents(withheld: Collection[str]) -> dict[str, str]:
    """Modules that import a withheld one as soon as they are imported, and which one.

    Imports inside functions and for type checkers do not count. The one that a module needs is
    withheld, or another of this list.

    Example:
        >>> dependents(["tofrender.rendering.arrivals"])["tofrender.rendering.job"]
        'tofrender.rendering.arrivals'
    """
    needs = {_module(path): set(_imports(path)) for path in sorted(PACKAGE.rglob("*.py"))}
    found: dict[str, str] = {}
    grew = True
    while grew:
        grew, gone = False, {*withheld, *found}
        for module in needs:
            cause = next((need for need in sorted(needs[module]) if is_in(need, gone)), None)
            if cause is not None and not is_in(module, gone):
                found[module], grew = cause, True
    return dict(sorted(found.items()))


def is_in(module: str, packages: Collection[str]) -> bool:
    """Whether a module is one of these modules and packages, or inside one."""
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def _module(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def _imports(path: Path) -> Iterator[str]:
    """Modules of the package that a file imports when it runs."""
    module = _module(path)
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in _at_import(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
            continue
        base = resolve_name("." * node.level + (node.module or ""), package)
        yield base
        for alias in node.names:
            with suppress(ValueError):  # no module of this package
                path_of(f"{base}.{alias.name}")
                yield f"{base}.{alias.name}"


def _at_import(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Import statements that run with the module."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            yield from (n for part in child.orelse for n in _at_import(part))
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _at_import(child)
