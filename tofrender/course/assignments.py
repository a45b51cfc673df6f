"""Assignments: folders in a checkout's `assignments/`, or inside the student edition."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..runtime import checks
from . import rubric as rubrics

PACKAGE = Path(__file__).parents[1]
SEED = "seed.txt"  # file of an assignment's folder: the seed of the staff's tests, if it is fixed
MATERIAL = PACKAGE / "course" / "material"  # of a student edition: the released assignment


@dataclass(frozen=True)
class Assignment:
    """Folder of an assignment, which holds `rubric.toml`."""

    folder: Path

    @cached_property
    def rubric(self) -> rubrics.Rubric:
        """Problems and points."""
        return rubrics.read(self.folder)

    @property
    def name(self) -> str:
        """Name of the folder: "a2_time_of_flight"."""
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
        """Names of files beside the stubs that belong to no problem; students build on them."""
        stubs = {problem.file for problem in self.rubric.problems}
        return sorted({path.name for path in self.starter.glob("*.py")} - stubs)

    def require_tests(self) -> None:
        """Raise ValueError for released material, which lacks the staff's tests."""
        released = any(problem.other_points for problem in self.rubric.problems)
        if released or self.folder.is_relative_to(MATERIAL):
            raise ValueError(
                f"{self.folder}: has the students' tests only; grading needs the course's "
                "checkout, not the student edition"
            )

    def require_staff(self, command: str) -> None:
        """Raise ValueError if there are no solutions, which a command needs."""
        if not self.solutions.is_dir():
            raise ValueError(
                f"{self.folder}: has no solutions/; {command} needs the course's checkout, "
                "not the student edition"
            )


def known() -> dict[str, Assignment]:
    """All assignments by id."""
    folders = (MATERIAL, PACKAGE.parent / "assignments")
    every = (Assignment(path.parent) for top in folders for path in top.glob("*/rubric.toml"))
    return dict(sorted({assignment.rubric.id: assignment for assignment in every}.items()))


def find(name: str | Path) -> Assignment:
    """Assignment of this id ("a2"), or in this folder with a `rubric.toml`; else ValueError."""
    # An id, even where a student has called a folder so
    if Path(name).name == str(name) and (found := known().get(str(name))):
        return found
    if os.path.isfile(Path(name) / "rubric.toml"):
        return Assignment(Path(name).resolve())
    there = ", ".join(known()) or "none; run this in a checkout, or in a student edition"
    raise ValueError(f"ASSIGNMENT = {str(name)[: checks.LONGEST]}: must be one of {there}")
