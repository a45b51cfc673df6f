"""Points of each member of a class: of tests, of a sheet, less those lost by coming late."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..rubric import Problem, Rubric
from . import tables
from .roster import Marks, Member

NOTHING = "nothing was handed in"


@dataclass(frozen=True)
class Standing:
    """Points of a member."""

    rubric: Rubric
    member: Member
    content: Mapping[str, Any] | None  # `results.json`, None if nothing was handed in
    marks: Marks = field(default_factory=Marks)  # given by a person

    def points(self, problem: Problem) -> float:
        """Points of a problem: those of the sheet or, without them, of the tests."""
        tested = {} if self.content is None else self.content["extra_data"]["problems"]
        return self.marks.points.get(problem.id, tested.get(problem.id, 0.0))

    @property
    def before(self) -> float:
        """All points, before the late penalty."""
        by_hand = (self.marks.points.get(each.id, 0.0) for each in self.rubric.by_hand)
        return math.fsum([*map(self.points, self.rubric.problems), *by_hand])

    @property
    def lost(self) -> float:
        """Late penalty, in points."""
        return round(self.before * self.rubric.late.lost(self.marks.late_days), 2)

    @property
    def total(self) -> float:
        """Points after the late penalty."""
        return round(self.before - self.lost, 4)

    @property
    def reason(self) -> str:
        """Why points were lost."""
        return NOTHING if self.content is None else self.content["extra_data"]["summary"]


def write_csv(
    path: Path, rubric: Rubric, class_: Iterable[Standing], *, roster: bool, sheet: bool
) -> None:
    """Write a class of one member or more, a line for each.

    `roster` adds ids, names, emails and sections, `sheet` late days and notes.
    """
    class_ = list(class_)
    about = [
        name
        for name in ("name", "email", "section")
        if roster and any(standing.member.about.get(name) for standing in class_)
    ]
    rows = []
    for standing in class_:
        member, marks = standing.member, standing.marks
        row: dict[str, str | float | None] = {"id": member.id} if roster else {}
        row |= {name: member.about.get(name, "") for name in about}
        row |= {"submission": member.submission.name if member.submission else ""}
        row |= {"total": standing.total}
        row |= {problem.id: standing.points(problem) for problem in rubric.problems}
        row |= {part.id: marks.points.get(part.id) for part in rubric.by_hand}
        if sheet:
            row |= {"late_days": marks.late_days, "lost_late": standing.lost, "note": marks.note}
        rows.append(row | {"reason": standing.reason})
    tables.write(path, rows)
