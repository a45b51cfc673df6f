"""Class of students: roster and sheet of marks (CSV), owners of submissions, points of each member.

Points are those of the tests or of the sheet, less those lost by coming late.
"""

import csv
import io
import itertools
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...runtime import checks
from ...runtime.atomic import replacing
from ..material import points_text
from ..rubric import Problem, Rubric
from . import unpacking
from .results import printable

COLUMNS = ("id", "name", "email", "section", "submission")  # only the first must be there
MAX_BYTES = 16 << 20
MAX_ROWS = 20_000
MAX_TEXT = 200  # characters of an id or a name
NOTHING = "nothing was handed in"


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


@dataclass(frozen=True)
class Row:
    """Row of a table."""

    where: str  # table and line, for messages
    cells: dict[str, str]  # text of each column, stripped


def members(submissions: Sequence[Path], roster: Path | None) -> tuple[list[Member], list[str]]:
    """Members of a class, and the names of submissions that nobody owns.

    A submission is that of the row whose column `submission` names it or, without one, of the row
    whose id is its name or a part of it between blanks, `_`, `-` and dots: `12345` owns
    `Lovelace_12345_a2.zip`. Members come in the order of the roster, then one for each submission
    without an owner; without a roster, one for each submission.
    """
    if roster is None:
        return [Member(path.name, path) for path in submissions], []
    rows = _read("--roster", roster, COLUMNS)
    owned: dict[str, Path] = {}
    unowned = []
    for path in submissions:
        name = f"{path.name[:80]!r}"
        owner, *others = _owners(path, rows) or [""]
        fault = ""
        if others:
            fault = f"{name} may be of {owner!r} and of {others[0]!r}; name it"
        elif owner in owned:
            fault = f"{owner!r} has {owned[owner].name[:80]!r} and {name}; name one of them"
        if fault:
            raise ValueError(f"--roster = {roster}: {fault} in a column 'submission'")
        if owner:
            owned[owner] = path
        else:
            unowned.append(path)
    names = {name for path in submissions for name in (path.name, unpacking.stem_of(path))}
    for row in rows.values():
        named = row.cells.get("submission", "")
        if named and named not in names:
            raise ValueError(f"{row.where}: submission = {named[:80]!r}: must be one of --all")
    found = [Member(name, owned.get(name), row.cells) for name, row in rows.items()]
    for path in unowned:
        name = path.name if path.name not in rows else f"{path.name} (nobody's)"
        found.append(Member(name, path))
    return found, [path.name for path in unowned]


def _owners(path: Path, rows: Mapping[str, Row]) -> list[str]:
    """Ids of the rows whose submission this may be."""
    stem = unpacking.stem_of(path)
    named = [name for name, row in rows.items() if row.cells.get("submission")]
    if owners := [n for n in named if rows[n].cells["submission"] in (path.name, stem)]:
        return owners
    others = rows.keys() - set(named)
    if stem in others:
        return [stem]
    parts = set(re.split(r"[\s_.-]+", stem))
    return sorted(others & parts)


def marks(sheet: Path, rubric: Rubric, class_: Sequence[Member]) -> dict[str, Marks]:
    """Marks by the members' ids, of a sheet: `id`, `late_days`, `note`, and points by problem."""
    most = {part.id: part.points for part in (*rubric.problems, *rubric.by_hand)}
    columns = ("id", "name", "late_days", "note", *most)
    ids = {member.id for member in class_}
    found = {}
    for name, row in _read("--sheet", sheet, columns).items():
        if name not in ids:
            raise ValueError(f"{row.where}: id {name[:80]!r} is not one of the class")
        points = {part: _number(row, part, most[part]) for part in most}
        given = {part: value for part, value in points.items() if value is not None}
        late_days = _number(row, "late_days") or 0.0
        if late_days > 0 and rubric.late.lost_per_day == 0:
            raise ValueError(
                f"{row.where}: late_days = {late_days:g} has no effect, because rubric.toml has no "
                "[late] table with lost_per_day. Add the table, or remove the column late_days"
            )
        found[name] = Marks(given, late_days, row.cells.get("note", ""))
    return found


@dataclass(frozen=True)
class Standing:
    """Points of a member, of tests and of the sheet, less the late penalty."""

    rubric: Rubric
    member: Member
    content: Mapping[str, Any] | None  # `results.json`, None if nothing was handed in
    marks: Marks = field(default_factory=Marks)  # given by a person

    @property
    def graded(self) -> bool:
        """Whether there are points: the machine has not failed."""
        return self.content is None or "score" in self.content

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
    def most(self) -> float:
        """Points that can be reached: those of the tests, and of parts that were graded by hand."""
        by_hand = (each.points for each in self.rubric.by_hand if each.id in self.marks.points)
        return self.rubric.points + math.fsum(by_hand)

    @property
    def reason(self) -> str:
        """Why points were lost."""
        return NOTHING if self.content is None else self.content["extra_data"]["summary"]


def columns(texts: Iterable[str], rubric: Rubric) -> dict[str, str]:
    """Fields by the names of their columns, of texts as "SIS Login ID=email"."""
    known = [*COLUMNS, "total", *(part.id for part in (*rubric.problems, *rubric.by_hand))]
    known += ["late_days", "lost_late", "note", "reason"]
    found = {}
    for text in texts:
        name, _, kind = text.rpartition("=")
        if not name or kind not in known or name in found:
            told = f"must be NAME=FIELD, each name once, with FIELD one of {', '.join(known)}"
            raise ValueError(f"--columns = {text[: checks.LONGEST]}: {told}")
        found[name] = kind
    return found


def write_csv(
    path: Path,
    rubric: Rubric,
    class_: Iterable[Standing],
    roster: bool,
    sheet: bool,
    columns: Mapping[str, str] | None = None,
) -> None:
    """Write a line for each member; `roster` adds ids and names, `sheet` late days and notes.

    `columns` are the only ones, if there are any: fields by the names of their columns.
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
        row: dict[str, str | float | None] = {"id": member.id} if roster or columns else {}
        row |= {name: member.about.get(name, "") for name in about}
        row["submission"] = member.submission.name if member.submission else ""
        row["total"] = standing.total if standing.graded else None
        graded = [each for each in rubric.problems if standing.graded or each.id in marks.points]
        row |= dict.fromkeys(problem.id for problem in rubric.problems)
        row |= {problem.id: standing.points(problem) for problem in graded}
        row |= {part.id: marks.points.get(part.id) for part in rubric.by_hand}
        if sheet or columns:
            lost = standing.lost if standing.graded else None
            row |= {"late_days": marks.late_days, "lost_late": lost, "note": marks.note}
        row["reason"] = standing.reason
        rows.append({name: row.get(kind) for name, kind in columns.items()} if columns else row)
    lines = [[*rows[0]], *(map(_cell, row.values()) for row in rows)]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(lines)


def _read(option: str, path: Path, known: Collection[str]) -> dict[str, Row]:
    """Rows by their column `id`, of a table in UTF-8, separated by commas or semicolons."""
    path = checks.path(option, path)
    where = f"{option} = {path}"
    if not path.is_file():
        raise ValueError(f"{where}: must be a CSV file that exists")
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{where}: has more than {MAX_BYTES >> 20} MiB")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{where}: is not UTF-8 text; save it as CSV UTF-8") from None
    first = text.partition("\n")[0]
    delimiter = ";" if first.count(";") > first.count(",") else ","
    try:
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise ValueError(f"{where}: is not CSV: {error}") from None
    if not lines:
        raise ValueError(f"{where}: is empty; must have a line with id")
    header = [name.strip() for name in lines[0]]
    for name in header:
        if header.count(name) > 1:
            raise ValueError(f"{where}: column {_short(name)} is there more than once")
        if name not in known:
            text = f"is unknown; must be one of {', '.join(known)}"
            raise ValueError(f"{where}: column {_short(name)} {text}")
    if "id" not in header:
        raise ValueError(f"{where}: has no column 'id'")
    if len(lines) > MAX_ROWS:
        raise ValueError(f"{where}: has more than {MAX_ROWS} lines")
    rows: dict[str, Row] = {}
    for number, cells in enumerate(lines[1:], 2):
        line, cells = f"{where}: line {number}", [cell.strip() for cell in cells]
        if not any(cells):
            continue
        if len(cells) > len(header):
            raise ValueError(f"{line}: has {len(cells)} cells, must have {len(header)}")
        row = Row(line, dict(itertools.zip_longest(header, cells, fillvalue="")))
        name = row.cells["id"]
        if not name or not name.isprintable() or len(name) > MAX_TEXT:
            text = f"must be 1 to {MAX_TEXT} characters that can be printed"
            raise ValueError(f"{line}: id = {_short(name)}: {text}")
        if name in rows:
            raise ValueError(f"{line}: id {_short(name)} is there more than once")
        rows[name] = row
    return rows


def _number(row: Row, column: str, high: float | None = None) -> float | None:
    """Number in a cell from 0 to `high`, None if it is empty; else ValueError."""
    text = row.cells.get(column, "")
    if not text:
        return None
    allowed = "a number from 0" + ("" if high is None else f" to {high:g}")
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = -1.0
    if not 0 <= value <= (1e6 if high is None else high) or not text.isascii() or "_" in text:
        raise ValueError(f"{row.where}: {column} = {_short(text)}: must be {allowed}, or empty")
    return value


def _cell(value: str | float | None) -> str:
    """Text of a cell, which no spreadsheet takes for a formula."""
    if not isinstance(value, str):
        return "" if value is None else points_text(value)
    text = " ".join(printable(value, 2000).split())
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") else text


def _short(text: str) -> str:
    return repr(text[: checks.LONGEST])
