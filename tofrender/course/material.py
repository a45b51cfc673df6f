"""Released material of an assignment: without solutions, mutants and the staff's tests."""

import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from . import toml
from .assignments import PACKAGE, Assignment
from .rubric import STAFF_TEST, Problem, Rubric

BLOCK = re.compile(r"^\[\[([\w.]+)\]\][ \t]*$", re.MULTILINE)
"""Line `[[id]]` of the handout, which is replaced by the table of the problem with this id."""
POINTS = "points"
"""The line `[[points]]` is replaced by the table of all points, and the rule for late days."""

FILES = ("README.md", "exercises.md", "notebook.py", "pytest.ini")
SCENES = "scenes"
"""Folder of the scenes. In its parent folder, `from scenes import cornell_box` works."""
SCENE_FILES = ("__init__.py", "*.xml", "*/*.xml", "meshes/*.ply")


def write(assignment: Assignment, folder: Path) -> None:
    """Write the material of an assignment that students get into a folder.

    The assignment may be released material itself; then the material is copied.
    """
    import tomlkit

    # Texts: the handout's lines [[id]] become tables of the problems
    source = assignment.folder
    for name in FILES:
        _copy(source, folder, name)
    readme = folder / "README.md"
    if readme.is_file():
        text = handout(readme.read_text(encoding="utf-8"), assignment.rubric)
        readme.write_text(text, encoding="utf-8")

    # Rubric, stubs, public tests and figures
    content = toml.read(source / "rubric.toml")
    (folder / "rubric.toml").write_text(tomlkit.dumps(visible(content)), encoding="utf-8")
    _copy(source / "starter", folder / "starter", "*.py")
    _copy(source / "tests", folder / "tests", "*", without=STAFF_TEST)
    _copy(source / "figures", folder / "figures", "*", without="*.py")

    # Scenes of released material, or those of the checkout
    scenes = source / SCENES
    write_scenes(scenes if scenes.is_dir() else PACKAGE.parent / SCENES, folder / SCENES)


def write_scenes(source: Path, target: Path, patterns: Iterable[str] = SCENE_FILES) -> None:
    """Copy the scenes' builders and files, if there are any."""
    for pattern in patterns:
        _copy(source, target, pattern)


def _copy(source: Path, target: Path, pattern: str, without: str = "/") -> None:
    """Copy the files of a folder that match `pattern` and do not match `without`."""
    for file in source.glob(pattern):
        if file.is_file() and not file.name.startswith(".") and not file.match(without):
            copy_file(file, target / file.relative_to(source))


def copy_file(source: Path, target: Path) -> None:
    """Copy a file, and make the folders of the copy."""
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def handout(text: str, rubric: Rubric) -> str:
    """Replace each line `[[id]]` of a handout by the table of the problem with this id.

    The line `[[points]]` is replaced by the table of all points, see `points_table`.

    Raises:
        ValueError: The rubric does not contain one of these ids.
    """
    problems = {problem.id: problem for problem in rubric.problems}

    def fill(match: re.Match) -> str:
        if match[1] == POINTS:
            return points_table(rubric)
        if match[1] not in problems:
            raise ValueError(f"README.md: [[{match[1]}]]: the rubric does not contain this problem")
        return block(problems[match[1]])

    return BLOCK.sub(fill, text)


def block(problem: Problem) -> str:
    """Return the table of a problem in the handout: points, file, pytest command, time.

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
        # "a", "a and b", "a, b and c"
        first = ", ".join(problem.needs[:-1])
        last = problem.needs[-1]
        uses = f"\n>\n> It uses your {f'{first} and {last}' if first else last}."
    return (
        f"> **Problem {problem.id}: {problem.title}**\n>\n"
        "> | points | file | check | takes |\n> |---|---|---|---|\n"
        f"> | {points} | {file} | `pytest -m {problem.marker}` | {problem.takes_s:g} s |{uses}"
    )


def points_table(rubric: Rubric) -> str:
    """Return the table of all points of a rubric, and a sentence on late submissions.

    The table contains the problems, the parts that are graded by hand, and the sum without bonus
    problems.

    Example:
        >>> from tofrender.course.rubric import ByHand, GradedTest, Late
        >>> problem = Problem("a0.pulse", "A pulse", (GradedTest("test_pulse.py::test_area", 4),))
        >>> talk = ByHand("a0.talk", "Talk", 6)
        >>> print(
        ...     points_table(Rubric("a0", "Toys", (problem,), by_hand=(talk,), late=Late(2, 0.1)))
        ... )
        | part | graded by | points |
        |---|---|---|
        | A pulse | tests | 4 |
        | Talk | hand | 6 |
        | **sum** | | **10** |
        <BLANKLINE>
        The first 2 days after the deadline cost nothing. Each further day costs 10 % of the points.
    """
    lines = ["| part | graded by | points |", "|---|---|---|"]
    for problem in rubric.problems:
        bonus = " bonus" * problem.bonus
        lines.append(f"| {problem.title} | tests | {points_text(problem.points)}{bonus} |")
    for part in rubric.by_hand:
        lines.append(f"| {part.title} | hand | {points_text(part.points)} |")
    total = rubric.points + sum(part.points for part in rubric.by_hand)
    lines.append(f"| **sum** | | **{points_text(total)}** |")

    # The rule for late submissions
    late = rubric.late
    if late.lost_per_day:
        days = "day" if late.free_days == 1 else f"{points_text(late.free_days)} days"
        cost = "costs" if late.free_days == 1 else "cost"
        percent = points_text(round(100 * late.lost_per_day, 6))
        rule = f"Each day after the deadline costs {percent} % of the points."
        if late.free_days:
            rule = f"The first {days} after the deadline {cost} nothing. Each further day costs "
            rule += f"{percent} % of the points."
        if late.deadline:
            rule = f"The deadline is {late.deadline}. {rule}"
    else:
        rule = "Your course states the rule for late submissions."
    return "\n".join([*lines, "", rule])


def points_text(points: float) -> str:
    """Format points without trailing zeros, for example "4" or "2.5"."""
    return f"{points:.10g}"


def visible(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a rubric with the visible tests only.

    The points of all other tests of a problem are summed in its field `other_points`.
    """
    problems = []
    for problem in content["problem"]:
        shown = [t for t in problem["tests"] if t.get("visibility", "visible") == "visible"]
        others = sum(t["points"] for t in problem["tests"] if t not in shown)
        others += problem.get("other_points", 0)
        released = problem | {"tests": shown}
        if others:
            released["other_points"] = others
        problems.append(released)
    return {**content, "problem": problems}
