"""The student edition: this package without the modules that students write themselves.

Whole modules are left out, so nothing has to be cut from a file.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Collection, Iterator
from pathlib import Path

from . import material
from .assignments import PACKAGE, Assignment
from .dependents import dependents, is_in
from .rubric import Rubric


def copy(assignment: Assignment, folder: Path) -> None:
    """Write the edition, unchecked.

    Args:
        assignment: The whole assignment.
        folder: A new or empty folder, which is what a `PYTHONPATH` needs.

    Raises:
        ValueError: The rubric withholds a module that does not exist, or keeps one that needs it.
    """
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
    names = {name: problem.id for name, problem in rubric.home_of.items()}
    text = json.dumps({"modules": modules, "names": names}, indent=1)
    (package / "runtime" / "withheld.json").write_text(text + "\n", encoding="utf-8")
    _mark_version(package / "__init__.py", rubric)
    place = package / "course" / "material" / assignment.name
    place.mkdir(parents=True)
    material.write(assignment, place)
    # where no student's folder is: a submission may import them, too
    material.write_scenes(place / material.SCENES, folder / material.SCENES, ["__init__.py"])


def of_grading(assignment: Assignment, folder: Path) -> None:
    """Write the edition that submissions see; arguments as for `copy`.

    In a student edition, where an autograder runs, that is this package itself.
    """
    if not (PACKAGE / "runtime" / "withheld.json").is_file():
        copy(assignment, folder)
        return
    ignored = shutil.ignore_patterns("__pycache__", ".*")
    shutil.copytree(PACKAGE, folder / "tofrender", ignore=ignored)
    scenes = PACKAGE.parent / material.SCENES
    material.write_scenes(scenes, folder / material.SCENES, ["__init__.py"])


def version(rubric: Rubric) -> str:
    """The edition's own version, "0.1.0+a2"."""
    from tofrender import __version__

    return f"{__version__}+{rubric.id}"


def _mark_version(init: Path, rubric: Rubric) -> None:
    new = version(rubric)
    before, after = (f'__version__ = "{text}"' for text in (new.partition("+")[0], new))
    text = init.read_text(encoding="utf-8")
    if before not in text:
        raise ValueError(f"{init.name}: has no line {before}")
    init.write_text(text.replace(before, after), encoding="utf-8")


def withheld(rubric: Rubric) -> dict[str, str | None]:
    """The modules that an edition does without, with the problem that each solves.

    Those that the rubric chooses, and with them all that cannot be imported without one of them.

    Raises:
        ValueError: One of the rubric's does not exist, or one that it keeps needs one of them.
    """
    modules = chosen(rubric)
    needing = dependents(modules)
    for kept in rubric.keeps:
        path_of(kept)
        if kept in needing:
            raise ValueError(f"rubric.toml: keeps {kept}, which needs {needing[kept]}")
    return modules | dict.fromkeys(needing)


def chosen(rubric: Rubric) -> dict[str, str | None]:
    """The modules and packages that the rubric withholds, with the problem that each solves.

    A package of which it keeps a module stands for the others in it.

    Raises:
        ValueError: One does not exist.
    """
    return {
        part: problem
        for module, problem in rubric.withheld.items()
        for part in _parts(module, path_of(module), rubric.keeps)
    }


def _parts(module: str, path: Path, keeps: Collection[str]) -> Iterator[str]:
    """What of a module or package is not kept."""
    if not any(is_in(kept, [module]) for kept in keeps):
        yield module
    elif module not in keeps:
        for inner in sorted((PACKAGE / path).iterdir()):
            is_module = inner.suffix == ".py" and inner.stem != "__init__"
            if is_module or (inner / "__init__.py").is_file():
                yield from _parts(f"{module}.{inner.stem}", inner.relative_to(PACKAGE), keeps)


def path_of(module: str) -> Path:
    """Where a module or package of the rubric is, from the package's folder."""
    head, *parts = module.split(".")
    path = Path(*parts)
    if head == "tofrender" and parts:
        if (PACKAGE / path / "__init__.py").is_file():
            return path
        if (PACKAGE / path).with_suffix(".py").is_file():
            return path.with_suffix(".py")
    raise ValueError(f"rubric.toml: module {module}: does not exist in the package")
