"""What students get of an assignment: all but the solutions, mutants and the staff's tests."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from .assignments import PACKAGE, STAFF_TEST, Assignment
from .rubric import Problem, Rubric

BLOCK = re.compile(r"^\[\[([\w.]+)\]\][ \t]*$", re.MULTILINE)
"""A line of the handout that stands for a problem's block."""

FILES = ("README.md", "exercises.md", "notebook.py", "pytest.ini")
SCENES = "scenes"
"""Folder of the scenes, from which `from scenes import cornell_box` works beside it."""
SCENE_FILES = ("__init__.py", "*.xml", "*/*.xml", "meshes/*.ply")
HANDED_OUT = ("README.md", "exercises.md", "figures")
"""What students read before they install anything."""


def write(assignment: Assignment, folder: Path) -> None:
    """Write what students get of an assignment into `folder`.

    Args:
        assignment: The whole assignment, or one that is already what students get.
        folder: A folder to fill, which exists.

    Raises:
        ValueError: The handout asks for a problem that the rubric does not have.
    """
    source = assignment.folder
    for name in FILES:
        if (source / name).is_file():
            shutil.copyfile(source / name, folder / name)
    readme = folder / "README.md"
    if readme.is_file():
        text = handout(readme.read_text(encoding="utf-8"), assignment.rubric)
        readme.write_text(text, encoding="utf-8")
    content = tomllib.loads((source / "rubric.toml").read_text(encoding="utf-8"))
    (folder / "rubric.toml").write_text(toml(visible(content)), encoding="utf-8")
    _copy(source / "starter", folder / "starter", "*.py")
    _copy(source / "tests", folder / "tests", "*", without=STAFF_TEST)
    _copy(source / "figures", folder / "figures", "*", without="*.py")
    scenes = source / SCENES
    write_scenes(scenes if scenes.is_dir() else PACKAGE.parent / SCENES, folder / SCENES)


def write_scenes(source: Path, target: Path, patterns: Iterable[str] = SCENE_FILES) -> None:
    """Write the scenes' builders and files; nothing where there are none."""
    for pattern in patterns:
        for file in sorted(source.glob(pattern)):
            place = target / file.relative_to(source)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, place)


def _copy(source: Path, target: Path, pattern: str, without: str = "") -> None:
    """Copy a folder's files, not those of folders inside it."""
    files = [
        file
        for file in sorted(source.glob(pattern))
        if file.is_file() and not file.name.startswith(".") and not file.match(without or "/")
    ]
    for file in files:
        target.mkdir(exist_ok=True)
        shutil.copyfile(file, target / file.name)


# ----------------------------------------------------------------------------------- handout


def handout(text: str, rubric: Rubric) -> str:
    """The handout with each problem's block in the place of its `[[id]]` line.

    Raises:
        ValueError: There is no such problem; names the line.
    """
    problems = {problem.id: problem for problem in rubric.problems}

    def fill(match: re.Match) -> str:
        if match[1] not in problems:
            raise ValueError(f"README.md: [[{match[1]}]]: the rubric has no such problem")
        return block(problems[match[1]])

    return BLOCK.sub(fill, text)


def block(problem: Problem) -> str:
    """What the handout says of a problem besides its text.

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
    uses = f"\n>\n> It uses your {_list(problem.needs)}." if problem.needs else ""
    return (
        f"> **Problem {problem.id}: {problem.title}**\n>\n"
        "> | points | file | check | takes |\n> |---|---|---|---|\n"
        f"> | {points} | {file} | `pytest -m {problem.marker}` | {problem.takes_s:g} s |{uses}"
    )


def points_text(points: float) -> str:
    """Points without a needless fraction.

    Example:
        >>> points_text(4.0), points_text(2.5)
        ('4', '2.5')
    """
    return f"{points:.10g}"


def _list(names: Iterable[str]) -> str:
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last


# ------------------------------------------------------------------------------------ rubric


def visible(content: Mapping[str, Any]) -> dict[str, Any]:
    """A rubric's content without the tests that students do not see, but with their points.

    And without the seed of these tests.
    """
    problems = []
    for problem in content["problem"]:
        seen = [t for t in problem["tests"] if t.get("visibility", "visible") == "visible"]
        others = sum(t["points"] for t in problem["tests"] if t not in seen)
        others += problem.get("other_points", 0)
        more = {"other_points": others} if others else {}
        problems.append(problem | more | {"tests": seen})
    head = {name: value for name, value in content["assignment"].items() if name != "seed"}
    return {**content, "assignment": head, "problem": problems}


def toml(content: Mapping[str, Any]) -> str:
    """A rubric's content as TOML.

    Example:
        >>> print(toml({"assignment": {"id": "a0"}, "problem": [{"tests": [{"points": 2}]}]}))
        [assignment]
        id = "a0"
        <BLANKLINE>
        [[problem]]
        tests = [
          { points = 2 },
        ]
        <BLANKLINE>
    """
    lines = []
    for name, value in content.items():
        for table in value if isinstance(value, list) else [value]:
            lines.append(f"[[{name}]]" if isinstance(value, list) else f"[{name}]")
            lines += [f"{key} = {_value(entry)}" for key, entry in table.items()]
            lines.append("")
    return "\n".join(lines)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_value(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        return "[\n" + "".join(f"  {_value(entry)},\n" for entry in value) + "]"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)  # JSON's texts, numbers and booleans are TOML's too
