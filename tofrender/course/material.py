"""Released material of an assignment: all but the solutions, mutants and the staff's tests."""

import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from . import toml
from .assignments import PACKAGE, Assignment
from .rubric import STAFF_TEST, Problem, Rubric

BLOCK = re.compile(r"^\[\[([\w.]+)\]\][ \t]*$", re.MULTILINE)
"""Line of the handout that stands for a problem's block."""

FILES = ("README.md", "exercises.md", "notebook.py", "pytest.ini")
SCENES = "scenes"
"""Folder of the scenes, from which `from scenes import cornell_box` works beside it."""
SCENE_FILES = ("__init__.py", "*.xml", "*/*.xml", "meshes/*.ply")


def write(assignment: Assignment, folder: Path) -> None:
    """Write the released material of an assignment, or of released material, into a folder."""
    import tomlkit

    source = assignment.folder
    for name in FILES:
        _copy(source, folder, name)
    readme = folder / "README.md"
    if readme.is_file():
        text = handout(readme.read_text(encoding="utf-8"), assignment.rubric)
        readme.write_text(text, encoding="utf-8")
    content = toml.read(source / "rubric.toml")
    (folder / "rubric.toml").write_text(tomlkit.dumps(visible(content)), encoding="utf-8")
    _copy(source / "starter", folder / "starter", "*.py")
    _copy(source / "tests", folder / "tests", "*", without=STAFF_TEST)
    _copy(source / "figures", folder / "figures", "*", without="*.py")
    scenes = source / SCENES
    write_scenes(scenes if scenes.is_dir() else PACKAGE.parent / SCENES, folder / SCENES)


def write_scenes(source: Path, target: Path, patterns: Iterable[str] = SCENE_FILES) -> None:
    """Write the scenes' builders and files, if there are any."""
    for pattern in patterns:
        _copy(source, target, pattern)


def _copy(source: Path, target: Path, pattern: str, without: str = "/") -> None:
    """Copy files of a folder that match a pattern."""
    for file in source.glob(pattern):
        if file.is_file() and not file.name.startswith(".") and not file.match(without):
            copy_file(file, target / file.relative_to(source))


def copy_file(source: Path, target: Path) -> None:
    """Copy a file, and make the folders of its copy."""
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def handout(text: str, rubric: Rubric) -> str:
    """Replace each `[[id]]` line by its problem's block; ValueError if there is no such problem."""
    problems = {problem.id: problem for problem in rubric.problems}

    def fill(match: re.Match) -> str:
        if match[1] not in problems:
            raise ValueError(f"README.md: [[{match[1]}]]: the rubric has no such problem")
        return block(problems[match[1]])

    return BLOCK.sub(fill, text)


def block(problem: Problem) -> str:
    """Table of a problem in the handout: points, file, marker, time.

    Example:
        >>> print(block(Problem("a0.pulse", "A pulse", (), file="pulse.py", takes_s=4)))
        > **Problem a0.pulse: A pulse**
        >
        > | points | file | check | takes |
        > |---|---|---|---|
        > | 0 | `pulse.py` | `pytest -m a0_pulse` | 4 s |
    """
    points = f"{points_text(problem.points)}{' bonus' if problem.bonus else ''}"
    file = f"`{problem.file}`" if problem.file else "the notebook's results"
    uses = ""
    if problem.needs:
        names = " and ".join([*filter(None, [", ".join(problem.needs[:-1])]), problem.needs[-1]])
        uses = f"\n>\n> It uses your {names}."
    return (
        f"> **Problem {problem.id}: {problem.title}**\n>\n"
        "> | points | file | check | takes |\n> |---|---|---|---|\n"
        f"> | {points} | {file} | `pytest -m {problem.marker}` | {problem.takes_s:g} s |{uses}"
    )


def points_text(points: float) -> str:
    """Points without a needless fraction: 4, 2.5."""
    return f"{points:.10g}"


def visible(content: Mapping[str, Any]) -> dict[str, Any]:
    """Content of a rubric without non-visible tests, whose points are summed."""
    problems = []
    for problem in content["problem"]:
        seen = [t for t in problem["tests"] if t.get("visibility", "visible") == "visible"]
        others = sum(t["points"] for t in problem["tests"] if t not in seen)
        others += problem.get("other_points", 0)
        more = {"other_points": others} if others else {}
        problems.append(problem | more | {"tests": seen})
    return {**content, "problem": problems}
