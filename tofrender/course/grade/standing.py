"""What each of a class gets: the tests' points, a sheet's, and what coming late costs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..material import points_text
from ..rubric import Problem, Rubric
from . import tables
from .roster import Marks, Member

NOTHING = "nothing was handed in"


@dataclass(frozen=True)
class Standing:
    """What a member gets.

    Attributes:
        rubric: The assignment's problems and points.
        member: Whose it is.
        content: `results.json` of what was handed in, None if nothing was.
        marks: What a person says of it.
    """

    rubric: Rubric
    member: Member
    content: Mapping[str, Any] | None
    marks: Marks = field(default_factory=Marks)

    def tested(self, problem: Problem) -> float:
        """What the tests of a problem gave."""
        return 0.0 if self.content is None else self.content["extra_data"]["problems"][problem.id]

    def points(self, problem: Problem) -> float:
        """What a problem gives: what the sheet says or, without it, what the tests gave."""
        return self.marks.points.get(problem.id, self.tested(problem))

    @property
    def before(self) -> float:
        """All points, before what coming late costs."""
        by_hand = (self.marks.points.get(each.id, 0.0) for each in self.rubric.by_hand)
        return math.fsum([*map(self.points, self.rubric.problems), *by_hand])

    @property
    def lost(self) -> float:
        """What coming late costs, in points."""
        return round(self.before * self.rubric.late.lost(self.marks.late_days), 2)

    @property
    def total(self) -> float:
        """What is left."""
        return round(self.before - self.lost, 4)

    @property
    def reason(self) -> str:
        """Why points were lost."""
        return NOTHING if self.content is None else self.content["extra_data"]["summary"]


def write_csv(
    path: Path, rubric: Rubric, class_: Iterable[Standing], *, roster: bool, sheet: bool
) -> None:
    """Write a class: a line for each member.

    Args:
        path: File to write.
        rubric: The assignment's problems.
        class_: What each gets.
        roster: Whether there is a roster, which has ids and more.
        sheet: Whether there is a sheet, which has late days and notes.
    """
    class_ = list(class_)
    about = [name for name in ("name", "email", "section") if _any(class_, name)] if roster else []
    problems = [problem.id for problem in rubric.problems]
    by_hand = [each.id for each in rubric.by_hand]
    header = [*(["id", *about] if roster else []), "submission", "total", *problems, *by_hand]
    header += ["late_days", "lost_late", "note"] if sheet else []
    lines = [[*header, "reason"]]
    for each in class_:
        there = each.member.submission
        line = [tables.cell(each.member.id)] if roster else []
        line += [tables.cell(each.member.about.get(name, "")) for name in about]
        line += [tables.cell(there.name) if there else "", points_text(each.total)]
        line += [points_text(each.points(problem)) for problem in rubric.problems]
        given = [each.marks.points.get(name) for name in by_hand]
        line += ["" if points is None else points_text(points) for points in given]
        if sheet:
            line += [points_text(each.marks.late_days), points_text(each.lost)]
            line += [tables.cell(each.marks.note)]
        lines.append([*line, tables.cell(each.reason)])
    tables.write(path, lines)


def _any(class_: Sequence[Standing], column: str) -> bool:
    return any(each.member.about.get(column) for each in class_)
