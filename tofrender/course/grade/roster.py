"""Members of a class: roster and sheet of marks (CSV), owners of submissions, and points.

The points of a member are the points of the tests, or of the sheet of marks, minus the late
penalty.
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

COLUMNS = ("id", "name", "email", "section", "submission")  # only "id" is required
MAX_BYTES = 16 << 20  # largest size of a table [bytes]
MAX_ROWS = 20_000
MAX_TEXT = 200  # longest id [characters]
NOTHING = "nothing was handed in"


@dataclass(frozen=True)
class Member:
    """A member of a class."""

    id: str  # id in the roster; without a roster, the name of the submission
    submission: Path | None  # None if nothing was handed in
    about: Mapping[str, str] = field(default_factory=dict)  # columns of the roster

    @property
    def name(self) -> str:
        """Name of the member, or the id if the roster does not contain names."""
        return self.about.get("name") or self.id


def folder_name(text: str) -> str:
    """Convert a text to a folder name that all file systems accept."""
    return re.sub(r"[^\w@+-]|^-", "_", text)[:80]


@dataclass(frozen=True)
class Marks:
    """Row of the sheet of marks."""

    # by id: points of a problem, which replace the tests' points, or of a part graded by hand
    points: Mapping[str, float] = field(default_factory=dict)
    late_days: float = 0.0
    note: str = ""  # text for the student


@dataclass(frozen=True)
class Row:
    """Row of a table."""

    where: str  # table and line, for error messages
    cells: dict[str, str]  # text of each column, without white space around it


def members(submissions: Sequence[Path], roster: Path | None) -> tuple[list[Member], list[str]]:
    """Find the members of a class and their submissions.

    A submission belongs to the row that names it in the column `submission`. If no row names it,
    it belongs to the row with an id that is its name, or a part of its name between blanks, `_`,
    `-` and dots: `12345` owns `Lovelace_12345_a2.zip`.

    Args:
        submissions: Paths of the submissions.
        roster: CSV file of the class, or None.

    Returns:
        The members, and the names of submissions without an owner. The members have the order of
        the roster, and a further member follows for each submission without an owner. Without a
        roster, each submission is a member.

    Raises:
        ValueError: The roster is wrong, or the owner of a submission is ambiguous.
    """
    if roster is None:
        return [Member(path.name, path) for path in submissions], []
    rows = _read("--roster", roster, COLUMNS)

    # Find the owner of each submission
    owned: dict[str, Path] = {}
    unowned = []
    for path in submissions:
        name = f"{path.name[:80]!r}"
        owner, *others = _owners(path, rows) or [""]
        problem = ""
        if others:
            problem = f"{name} can belong to {owner!r} or to {others[0]!r}; name it"
        elif owner in owned:
            problem = f"{owner!r} has {owned[owner].name[:80]!r} and {name}; name one of them"
        if problem:
            raise ValueError(f"--roster = {roster}: {problem} in a column 'submission'")
        if owner:
            owned[owner] = path
        else:
            unowned.append(path)

    # Each submission that the roster names must exist
    names = {name for path in submissions for name in (path.name, unpacking.stem_of(path))}
    for row in rows.values():
        named = row.cells.get("submission", "")
        if named and named not in names:
            text = "must be a name in the folder of --all"
            raise ValueError(f"{row.where}: submission = {named[:80]!r}: {text}")

    # Collect the members
    found = [Member(name, owned.get(name), row.cells) for name, row in rows.items()]
    for path in unowned:
        name = path.name if path.name not in rows else f"{path.name} (nobody's)"
        found.append(Member(name, path))
    return found, [path.name for path in unowned]


def _owners(path: Path, rows: Mapping[str, Row]) -> list[str]:
    """Return the ids of the rows that may own a submission, see `members`."""
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
    """Read a sheet of marks.

    The columns are `id`, `late_days` or `handed_in`, `note`, and points by problem. `handed_in` is
    a time stamp, which is compared with the deadline in the rubric.

    Args:
        sheet: CSV file.
        rubric: Rubric with the problems and the parts graded by hand.
        class_: Members of the class.

    Returns:
        Marks by the members' ids.

    Raises:
        ValueError: The sheet is wrong, or names an id that is not in the class.
    """
    most = {part.id: part.points for part in (*rubric.problems, *rubric.by_hand)}
    columns = ("id", "name", "late_days", "handed_in", "note", *most)
    ids = {member.id for member in class_}
    found = {}
    for name, row in _read("--sheet", sheet, columns).items():
        if name not in ids:
            raise ValueError(f"{row.where}: id {name[:80]!r} is not one of the class")
        cells = {part: _number(row, part, most[part]) for part in most}
        points = {part: value for part, value in cells.items() if value is not None}
        late_days = _number(row, "late_days")
        handed_in = row.cells.get("handed_in", "")
        if handed_in:
            try:
                counted = rubric.late.days(handed_in)
            except ValueError as error:
                raise ValueError(f"{row.where}: handed_in: {error}") from None
            # A number of days in the sheet replaces the time stamp
            late_days = float(counted) if late_days is None else late_days
        late_days = late_days or 0.0
        if late_days > 0 and rubric.late.lost_per_day == 0:
            raise ValueError(
                f"{row.where}: late_days = {late_days:g} has no effect, because rubric.toml has no "
                "[late] table with lost_per_day. Add the table, or remove the column late_days"
            )
        found[name] = Marks(points, late_days, row.cells.get("note", ""))
    return found


@dataclass(frozen=True)
class Standing:
    """Points of a member, from the tests and the sheet of marks, minus the late penalty."""

    rubric: Rubric
    member: Member
    content: Mapping[str, Any] | None  # content of `results.json`, None if nothing was handed in
    marks: Marks = field(default_factory=Marks)  # row of the sheet of marks

    @property
    def graded(self) -> bool:
        """Whether the tests gave points; False if the machine failed."""
        return self.content is None or "score" in self.content

    def points(self, problem: Problem) -> float:
        """Return the points of a problem. Points of the sheet replace the points of the tests."""
        tested = {} if self.content is None else self.content["extra_data"]["problems"]
        return self.marks.points.get(problem.id, tested.get(problem.id, 0.0))

    @property
    def before(self) -> float:
        """Sum of all points before the late penalty."""
        by_hand = (self.marks.points.get(each.id, 0.0) for each in self.rubric.by_hand)
        return math.fsum([*map(self.points, self.rubric.problems), *by_hand])

    @property
    def lost(self) -> float:
        """Late penalty in points."""
        return round(self.before * self.rubric.late.lost(self.marks.late_days), 2)

    @property
    def total(self) -> float:
        """Points after the late penalty."""
        return round(self.before - self.lost, 4)

    @property
    def most(self) -> float:
        """Maximum points of the tests and of the parts that were graded by hand."""
        by_hand = (each.points for each in self.rubric.by_hand if each.id in self.marks.points)
        return self.rubric.points + math.fsum(by_hand)

    @property
    def reason(self) -> str:
        """Reasons for lost points, as text."""
        return NOTHING if self.content is None else self.content["extra_data"]["summary"]


def columns(texts: Iterable[str], rubric: Rubric) -> dict[str, str]:
    """Read the option `--columns`.

    Args:
        texts: Texts such as "SIS Login ID=email", each with the name of a column and a field.
        rubric: Rubric; the ids of its problems are fields, too.

    Returns:
        Fields by the names of their columns.

    Raises:
        ValueError: A text has another form, an unknown field, or a repeated name.
    """
    known = [*COLUMNS, "total", *(part.id for part in (*rubric.problems, *rubric.by_hand))]
    known += ["late_days", "lost_late", "note", "reason"]
    found = {}
    for text in texts:
        name, _, kind = text.rpartition("=")
        if not name or kind not in known or name in found:
            allowed = f"must be NAME=FIELD, each name once, with FIELD one of {', '.join(known)}"
            raise ValueError(f"--columns = {text[: checks.LONGEST]}: {allowed}")
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
    """Write a CSV table with a line for each member.

    Args:
        path: Path of the table.
        rubric: Rubric; each problem has a column.
        class_: Points of the members.
        roster: Write ids, and names and other columns of the roster.
        sheet: Write late days, late penalties and notes.
        columns: Fields by the names of their columns. If there are any, only these columns are
            written.
    """
    # Columns of the roster that are not empty
    class_ = list(class_)
    about = [
        name
        for name in ("name", "email", "section")
        if roster and any(standing.member.about.get(name) for standing in class_)
    ]
    rows = []
    for standing in class_:
        # Member and submission
        member = standing.member
        marks = standing.marks
        row: dict[str, str | float | None] = {"id": member.id} if roster or columns else {}
        row |= {name: member.about.get(name, "") for name in about}
        row["submission"] = member.submission.name if member.submission else ""

        # Points; a cell without a grade is empty
        row["total"] = standing.total if standing.graded else None
        graded = [each for each in rubric.problems if standing.graded or each.id in marks.points]
        row |= dict.fromkeys(problem.id for problem in rubric.problems)
        row |= {problem.id: standing.points(problem) for problem in graded}
        row |= {part.id: marks.points.get(part.id) for part in rubric.by_hand}

        # Sheet of marks
        if sheet or columns:
            lost = standing.lost if standing.graded else None
            row |= {"late_days": marks.late_days, "lost_late": lost, "note": marks.note}
        row["reason"] = standing.reason
        rows.append({name: row.get(kind) for name, kind in columns.items()} if columns else row)

    # Write the table
    lines = [[*rows[0]], *(map(_cell, row.values()) for row in rows)]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(lines)


def _read(option: str, path: Path, known: Collection[str]) -> dict[str, Row]:
    """Read a CSV table in UTF-8 that is separated by commas or semicolons.

    Args:
        option: Option that passes the table, for error messages.
        path: Path of the table.
        known: Allowed columns.

    Returns:
        Rows by the text in their column `id`.

    Raises:
        ValueError: The table cannot be read, or a column or an id is wrong.
    """
    # Read the file
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

    # Split the lines; the header shows the separator
    first = text.partition("\n")[0]
    delimiter = ";" if first.count(";") > first.count(",") else ","
    try:
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise ValueError(f"{where}: is not CSV: {error}") from None
    if not lines:
        raise ValueError(f"{where}: is empty; write a line with the column id")

    # Check the header
    header = [name.strip() for name in lines[0]]
    for name in header:
        if header.count(name) > 1:
            raise ValueError(f"{where}: column {_short(name)} occurs more than once")
        if name not in known:
            text = f"is unknown; must be one of {', '.join(known)}"
            raise ValueError(f"{where}: column {_short(name)} {text}")
    if "id" not in header:
        raise ValueError(f"{where}: the column 'id' is missing")

    # Read the rows; empty rows are ignored
    if len(lines) > MAX_ROWS:
        raise ValueError(f"{where}: has more than {MAX_ROWS} lines")
    rows: dict[str, Row] = {}
    for number, texts in enumerate(lines[1:], 2):
        line = f"{where}: line {number}"
        cells = [cell.strip() for cell in texts]
        if not any(cells):
            continue
        if len(cells) > len(header):
            raise ValueError(f"{line}: has {len(cells)} cells, must have {len(header)}")

        # Check the id
        row = Row(line, dict(itertools.zip_longest(header, cells, fillvalue="")))
        name = row.cells["id"]
        if not name or not name.isprintable() or len(name) > MAX_TEXT:
            text = f"must have 1 to {MAX_TEXT} printable characters"
            raise ValueError(f"{line}: id = {_short(name)}: {text}")
        if name in rows:
            raise ValueError(f"{line}: id {_short(name)} occurs more than once")
        rows[name] = row
    return rows


def _number(row: Row, column: str, high: float | None = None) -> float | None:
    """Return the number in a cell, None if the cell is empty.

    Args:
        row: Row of the table.
        column: Name of the column.
        high: Largest allowed number; by default one million.

    Raises:
        ValueError: The cell does not contain a number from 0 to `high`.
    """
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
    """Return the text of a cell. Spreadsheets must not interpret the text as a formula."""
    if not isinstance(value, str):
        return "" if value is None else points_text(value)
    text = " ".join(printable(value, 2000).split())
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") else text


def _short(text: str) -> str:
    """Quote and shorten a text for an error message."""
    return repr(text[: checks.LONGEST])
