"""Assignments: folders in a checkout's `assignments/`, or inside the student edition."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..runtime import checks
from . import rubric as rubrics

PACKAGE = Path(__file__).parents[1]
SEED = "seed.txt"  # file in an assignment's folder with a fixed seed for the staff's tests
MATERIAL = PACKAGE / "course" / "material"  # folder of the released assignment in a student edition


@dataclass(frozen=True)
class Assignment:
    """Folder of an assignment, with its `rubric.toml`."""

    folder: Path

    @cached_property
    def rubric(self) -> rubrics.Rubric:
        """Problems and points."""
        return rubrics.read(self.folder)

    @property
    def name(self) -> str:
        """Name of the folder, for example "a2_time_of_flight"."""
        return self.folder.name

    @property
    def solutions(self) -> Path:
        """Return the folder of correct solutions, which only the staff has."""
        return self.folder / "solutions"

    @property
    def starter(self) -> Path:
        """Folder of the stubs that students complete."""
        return self.folder / "starter"

    @property
    def provided_files(self) -> list[str]:
        """Names of the complete files in `starter/`, which belong to no problem."""
        stubs = {problem.file for problem in self.rubric.problems}
        return sorted({path.name for path in self.starter.glob("*.py")} - stubs)

    def require_tests(self) -> None:
        """Raise ValueError if this is released material, which lacks the staff's tests."""
        released = any(problem.other_points for problem in self.rubric.problems)
        if released or self.folder.is_relative_to(MATERIAL):
            raise ValueError(
                f"{self.folder} contains only the students' tests. Grade with an assignment of "
                "the course's checkout, not with the student edition"
            )

    def require_staff(self, command: str) -> None:
        """Raise ValueError if the folder `solutions`, which a command needs, is missing."""
        if not self.solutions.is_dir():
            raise ValueError(
                f"{self.folder} does not contain solutions/. Run {command} with an assignment of "
                "the course's checkout, not with the student edition"
            )


def known() -> dict[str, Assignment]:
    """Return all assignments of the checkout and of the student edition, by id."""
    folders = (MATERIAL, PACKAGE.parent / "assignments")
    every = (Assignment(path.parent) for top in folders for path in top.glob("*/rubric.toml"))
    return dict(sorted({assignment.rubric.id: assignment for assignment in every}.items()))


def find(name: str | Path) -> Assignment:
    """Find an assignment by its id ("a2") or its folder.

    Raises:
        ValueError: No assignment has this id, and the folder does not contain `rubric.toml`.
    """
    # An id has precedence over a folder of the same name in the working directory
    if Path(name).name == str(name) and (found := known().get(str(name))):
        return found
    if os.path.isfile(Path(name) / "rubric.toml"):
        return Assignment(Path(name).resolve())
    ids = ", ".join(known()) or "the ids in a checkout or a student edition; none was found here"
    raise ValueError(f"ASSIGNMENT = {str(name)[: checks.LONGEST]}: must be one of {ids}")
