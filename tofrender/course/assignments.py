"""Where assignments are: in a checkout's `assignments/`, or inside the student edition."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..runtime import checks
from . import rubric as rubrics

PACKAGE = Path(__file__).parents[1]
FOLDERS = (PACKAGE.parent / "assignments", PACKAGE / "course" / "material")
"""Folders that hold assignments: all of each, or what students get."""

STAFF_TEST = "*_staff.py"


@dataclass(frozen=True)
class Assignment:
    """An assignment's folder.

    Attributes:
        folder: What holds `rubric.toml`.
    """

    folder: Path

    @cached_property
    def rubric(self) -> rubrics.Rubric:
        """Its problems and points."""
        return rubrics.read(self.folder)

    @property
    def name(self) -> str:
        """The folder's name: "a2_time_of_flight"."""
        return self.folder.name

    @property
    def solutions(self) -> Path:
        """Folder of independent right solutions, which only teachers have."""
        return self.folder / "solutions"

    @property
    def starter(self) -> Path:
        """Folder of the stubs."""
        return self.folder / "starter"

    @property
    def given(self) -> list[str]:
        """Names of the files beside the stubs that no problem asks for, which students build on."""
        asked = {problem.file for problem in self.rubric.problems}
        return sorted({path.name for path in self.starter.glob("*.py")} - asked)

    def require_tests(self) -> None:
        """Refuse to grade with the tests that students have.

        Raises:
            ValueError: It is what students get; one line.
        """
        released = any(problem.other_points for problem in self.rubric.problems)
        if released or self.folder.is_relative_to(FOLDERS[1]):
            raise ValueError(
                f"{self.folder}: has the students' tests only; grading needs the course's "
                "checkout, not the student edition"
            )

    def require_staff(self, what: str) -> None:
        """Refuse what needs the solutions.

        Args:
            what: What is refused.

        Raises:
            ValueError: There are none; one line.
        """
        if not self.solutions.is_dir():
            raise ValueError(
                f"{self.folder}: has no solutions/; {what} needs the course's checkout, "
                "not the student edition"
            )


def known() -> dict[str, Assignment]:
    """All assignments by their id, in the order of their folders."""
    found = {}
    for parent in reversed(FOLDERS):
        for path in sorted(parent.glob("*/rubric.toml")):
            assignment = Assignment(path.parent)
            found[assignment.rubric.id] = assignment
    return dict(sorted(found.items()))


def find(name: str | Path) -> Assignment:
    """The assignment of this id, or in this folder.

    Args:
        name: "a2", or the path of a folder with `rubric.toml`.

    Raises:
        ValueError: There is none; says which there are.
    """
    is_id = Path(name).name == str(name)  # even where a student has called a folder so
    assignments = known() if is_id else {}
    if str(name) not in assignments:
        if os.path.isfile(Path(name) / "rubric.toml"):
            return Assignment(Path(name).resolve())
        assignments = known()
        there = ", ".join(assignments) or "none; run this in a checkout, or in a student edition"
        raise ValueError(f"ASSIGNMENT = {str(name)[: checks.LONGEST]}: must be one of {there}")
    return assignments[str(name)]
