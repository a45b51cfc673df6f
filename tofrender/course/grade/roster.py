"""Who is in a class, which submission is whose, and what people grade by hand."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..rubric import Rubric
from . import tables

COLUMNS = ("id", "name", "email", "section", "submission")
"""Columns of a roster; only the first must be there."""


@dataclass(frozen=True)
class Member:
    """One of a class.

    Attributes:
        id: What the roster calls them; without a roster the submission's name.
        submission: What they handed in, None if nothing.
        about: What else the roster says, by column.
    """

    id: str
    submission: Path | None
    about: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What to call them."""
        return self.about.get("name") or self.id

    @property
    def folder(self) -> str:
        """A name for what is made for them, on any file system."""
        return re.sub(r"[^\w@+-]|^-", "_", self.id)[:80]


@dataclass(frozen=True)
class Marks:
    """What a person says of a member's work.

    Attributes:
        points: Points by the id of a problem, which replace those of the tests, or of what is
            graded by hand.
        late_days: Days that it came late.
        note: Words for the student.
    """

    points: Mapping[str, float] = field(default_factory=dict)
    late_days: float = 0.0
    note: str = ""


def members(submissions: Sequence[Path], roster: Path | None) -> tuple[list[Member], list[str]]:
    """Who is in a class.

    A submission is that of the row whose column `submission` names it or, without one, of the row
    whose id is its name or a part of it between blanks, `_`, `-` and dots: `12345` owns
    `Lovelace_12345_a2.zip`.

    Args:
        submissions: All that was handed in.
        roster: CSV file with the columns `COLUMNS`; None makes a member of each submission.

    Returns:
        The members in the order of the roster, then one for each submission that nobody owns; and
        the names of these.

    Raises:
        ValueError: The roster is wrong, or a submission has several owners; one line.
    """
    if roster is None:
        return [Member(path.name, path) for path in submissions], []
    rows = tables.by_id(tables.read("--roster", roster, ("id",), COLUMNS))
    owners: dict[str, list[str]] = {path.name: _owners(path, rows) for path in submissions}
    owned: dict[str, Path] = {}
    for path in submissions:
        those = owners[path.name]
        if len(those) > 1:
            raise ValueError(
                f"--roster = {roster}: {path.name[:80]!r} may be of {those[0]!r} and of "
                f"{those[1]!r}; name it in a column 'submission'"
            )
        for owner in those:
            if owner in owned:
                raise ValueError(
                    f"--roster = {roster}: {owner!r} has {owned[owner].name[:80]!r} and "
                    f"{path.name[:80]!r}; name one of them in a column 'submission'"
                )
            owned[owner] = path
    names = {path.name for path in submissions} | {path.stem for path in submissions}
    for row in rows.values():
        named = row.cells.get("submission", "")
        if named and named not in names:
            raise ValueError(f"{row.where}: submission = {named[:80]!r}: must be one of --all")
    found = [Member(name, owned.get(name), row.cells) for name, row in rows.items()]
    nobodys = [path for path in submissions if not owners[path.name]]
    for path in nobodys:
        name = path.name if path.name not in rows else f"{path.name} (nobody's)"
        found.append(Member(name, path))
    return found, [path.name for path in nobodys]


def _owners(path: Path, rows: Mapping[str, tables.Row]) -> list[str]:
    """Ids of the rows whose submission this may be."""
    stem = path.stem if path.suffix.lower() == ".zip" else path.name
    named = [name for name, row in rows.items() if row.cells.get("submission")]
    if those := [n for n in named if rows[n].cells["submission"] in (path.name, stem)]:
        return those
    others = rows.keys() - set(named)
    if stem in others:
        return [stem]
    parts = set(re.split(r"[\s_.-]+", stem))
    return sorted(others & parts)


def marks(sheet: Path, rubric: Rubric, those: Sequence[Member]) -> dict[str, Marks]:
    """What a sheet says, by the members' ids.

    Args:
        sheet: CSV file with the column `id`, and any of `late_days`, `note`, the ids of problems
            (points that replace those of the tests) and of what is graded by hand.
        rubric: Says what each may give at most.
        those: The class.

    Raises:
        ValueError: A column, an id or a number is wrong; one line.
    """
    most = {problem.id: problem.points for problem in rubric.problems}
    most |= {each.id: each.points for each in rubric.by_hand}
    known = ("id", "name", "late_days", "note", *most)
    rows = tables.by_id(tables.read("--sheet", sheet, ("id",), known))
    ids = {member.id for member in those}
    found = {}
    for name, row in rows.items():
        if name not in ids:
            raise ValueError(f"{row.where}: id {name[:80]!r} is not one of the class")
        points = {each: tables.number(row, each, most[each]) for each in most}
        found[name] = Marks(
            {each: value for each, value in points.items() if value is not None},
            tables.number(row, "late_days") or 0.0,
            row.cells.get("note", ""),
        )
    return found
