"""Members of a class, their submissions, and points given by hand."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..rubric import Rubric
from . import tables

COLUMNS = ("id", "name", "email", "section", "submission")  # only the first must be there


@dataclass(frozen=True)
class Member:
    """A member of a class."""

    id: str  # of the roster; without a roster the submission's name
    submission: Path | None  # None if nothing was handed in
    about: Mapping[str, str] = field(default_factory=dict)  # other columns of the roster

    @property
    def name(self) -> str:
        """Name for people to read."""
        return self.about.get("name") or self.id


def folder_name(text: str) -> str:
    """Folder name for any file system."""
    return re.sub(r"[^\w@+-]|^-", "_", text)[:80]


@dataclass(frozen=True)
class Marks:
    """Row of the sheet of marks."""

    # by the id of a problem (instead of the tests' points) or of a part graded by hand
    points: Mapping[str, float] = field(default_factory=dict)
    late_days: float = 0.0
    note: str = ""  # for the student


def members(submissions: Sequence[Path], roster: Path | None) -> tuple[list[Member], list[str]]:
    """Members of a class, and the names of submissions that nobody owns.

    A submission is that of the row whose column `submission` names it or, without one, of the row
    whose id is its name or a part of it between blanks, `_`, `-` and dots: `12345` owns
    `Lovelace_12345_a2.zip`. Members come in the order of the roster, a CSV file with `COLUMNS`,
    then one for each submission without an owner; without a roster, one for each submission.

    ValueError in one line if the roster is wrong, or a submission has several owners.
    """
    if roster is None:
        return [Member(path.name, path) for path in submissions], []
    rows = tables.by_id(tables.read("--roster", roster, ("id",), COLUMNS))
    owned: dict[str, Path] = {}
    nobodys = []
    for path in submissions:
        name = f"{path.name[:80]!r}"
        owner, *others = _owners(path, rows) or [""]
        if others:
            text = f"{name} may be of {owner!r} and of {others[0]!r}; name it"
            raise ValueError(f"--roster = {roster}: {text} in a column 'submission'")
        if owner in owned:
            text = f"{owner!r} has {owned[owner].name[:80]!r} and {name}; name one of them"
            raise ValueError(f"--roster = {roster}: {text} in a column 'submission'")
        if owner:
            owned[owner] = path
        else:
            nobodys.append(path)
    names = {name for path in submissions for name in (path.name, path.stem)}
    for row in rows.values():
        named = row.cells.get("submission", "")
        if named and named not in names:
            raise ValueError(f"{row.where}: submission = {named[:80]!r}: must be one of --all")
    found = [Member(name, owned.get(name), row.cells) for name, row in rows.items()]
    for path in nobodys:
        name = path.name if path.name not in rows else f"{path.name} (nobody's)"
        found.append(Member(name, path))
    return found, [path.name for path in nobodys]


def _owners(path: Path, rows: Mapping[str, tables.Row]) -> list[str]:
    """Ids of the rows whose submission this may be."""
    stem = path.stem if path.suffix.lower() == ".zip" else path.name
    named = [name for name, row in rows.items() if row.cells.get("submission")]
    if owners := [n for n in named if rows[n].cells["submission"] in (path.name, stem)]:
        return owners
    others = rows.keys() - set(named)
    if stem in others:
        return [stem]
    parts = set(re.split(r"[\s_.-]+", stem))
    return sorted(others & parts)


def marks(sheet: Path, rubric: Rubric, class_: Sequence[Member]) -> dict[str, Marks]:
    """Marks by the members' ids.

    The sheet is a CSV file with the column `id`, and any of `late_days`, `note`, the ids of
    problems (points that replace those of the tests) and of parts graded by hand. ValueError in one
    line if a column, an id or a number is wrong.
    """
    most = {part.id: part.points for part in (*rubric.problems, *rubric.by_hand)}
    columns = ("id", "name", "late_days", "note", *most)
    ids = {member.id for member in class_}
    found = {}
    for name, row in tables.by_id(tables.read("--sheet", sheet, ("id",), columns)).items():
        if name not in ids:
            raise ValueError(f"{row.where}: id {name[:80]!r} is not one of the class")
        points = {part: tables.number(row, part, most[part]) for part in most}
        given = {part: value for part, value in points.items() if value is not None}
        late_days = tables.number(row, "late_days") or 0.0
        found[name] = Marks(given, late_days, row.cells.get("note", ""))
    return found
