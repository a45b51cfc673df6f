"""CSV files that teachers write and read: rosters, sheets, grades."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...runtime import checks
from ...runtime.atomic import replacing
from .results import printable

MAX_BYTES = 16 << 20
MAX_ROWS = 20_000
MAX_TEXT = 200
"""Characters of an id or a name."""


@dataclass(frozen=True)
class Row:
    """A row of a table.

    Attributes:
        where: The table and the line, for messages.
        cells: Text of each column, without blanks at its ends.
    """

    where: str
    cells: dict[str, str]


def read(option: str, path: Path, required: Collection[str], known: Collection[str]) -> list[Row]:
    """Read a table with a header; commas or semicolons stand between its cells.

    Args:
        option: What names the file, for messages.
        path: The file, in UTF-8.
        required: Columns that must be there.
        known: All columns that may be.

    Raises:
        ValueError: It is not such a table; one line.
    """
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
        raise ValueError(f"{where}: is empty; must have a line with {', '.join(required)}")
    header = [name.strip() for name in lines[0]]
    for name in header:
        if header.count(name) > 1:
            raise ValueError(f"{where}: column {_short(name)} is there more than once")
        if name not in known:
            raise ValueError(
                f"{where}: column {_short(name)} is unknown; must be one of {', '.join(known)}"
            )
    for name in required:
        if name not in header:
            raise ValueError(f"{where}: has no column {name!r}")
    if len(lines) > MAX_ROWS:
        raise ValueError(f"{where}: has more than {MAX_ROWS} lines")
    rows = []
    for number, cells in enumerate(lines[1:], 2):
        if any(cell.strip() for cell in cells):
            if len(cells) > len(header):
                raise ValueError(
                    f"{where}: line {number}: has {len(cells)} cells, must have {len(header)}"
                )
            cells = [cell.strip() for cell in cells] + [""] * (len(header) - len(cells))
            rows.append(Row(f"{where}: line {number}", dict(zip(header, cells, strict=True))))
    return rows


def by_id(rows: Iterable[Row]) -> dict[str, Row]:
    """Rows by their ids.

    Raises:
        ValueError: One has none, an odd one, or that of another; one line.
    """
    found: dict[str, Row] = {}
    for row in rows:
        name = row.cells["id"]
        if not name or not name.isprintable() or len(name) > MAX_TEXT:
            raise ValueError(
                f"{row.where}: id = {_short(name)}: must be 1 to {MAX_TEXT} characters that can be "
                "printed"
            )
        if name in found:
            raise ValueError(f"{row.where}: id {_short(name)} is there more than once")
        found[name] = row
    return found


def number(row: Row, column: str, high: float | None = None) -> float | None:
    """The number in a cell, None if it is empty.

    Args:
        row: Its row.
        column: Its column.
        high: Largest that is allowed; 0 is the least.

    Raises:
        ValueError: It holds something else; one line.
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


def write(path: Path, lines: Iterable[Sequence[str]]) -> None:
    """Write a table, whole or not at all."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(lines)


def cell(text: str) -> str:
    """Text that no spreadsheet takes for a formula."""
    text = " ".join(printable(text, 2000).split())
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") else text


def _short(text: str) -> str:
    return repr(text[: checks.LONGEST])
