"""CSV files that teachers write and read: rosters, sheets, grades."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...runtime import checks
from ...runtime.atomic import replacing
from ..material import points_text
from .results import printable

MAX_BYTES = 16 << 20
MAX_ROWS = 20_000
MAX_TEXT = 200  # characters of an id or a name


@dataclass(frozen=True)
class Row:
    """A row of a table."""

    where: str  # table and line, for messages
    cells: dict[str, str]  # text of each column, stripped


def read(option: str, path: Path, required: Collection[str], known: Collection[str]) -> list[Row]:
    """Read a table in UTF-8 with a header, separated by commas or semicolons.

    `option` names the file in messages. ValueError in one line unless it is such a table with all
    `required` columns and none but the `known`.
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
            text = f"is unknown; must be one of {', '.join(known)}"
            raise ValueError(f"{where}: column {_short(name)} {text}")
    for name in required:
        if name not in header:
            raise ValueError(f"{where}: has no column {name!r}")
    if len(lines) > MAX_ROWS:
        raise ValueError(f"{where}: has more than {MAX_ROWS} lines")
    rows = []
    for number, cells in enumerate(lines[1:], 2):
        line = f"{where}: line {number}"
        if len(cells) > len(header) and any(map(str.strip, cells)):
            raise ValueError(f"{line}: has {len(cells)} cells, must have {len(header)}")
        if any(map(str.strip, cells)):
            cells = map(str.strip, cells)
            rows.append(Row(line, dict(itertools.zip_longest(header, cells, fillvalue=""))))
    return rows


def by_id(rows: Iterable[Row]) -> dict[str, Row]:
    """Rows by their ids; ValueError if one has none, an odd one, or that of another."""
    found: dict[str, Row] = {}
    for row in rows:
        name = row.cells["id"]
        if not name or not name.isprintable() or len(name) > MAX_TEXT:
            text = f"must be 1 to {MAX_TEXT} characters that can be printed"
            raise ValueError(f"{row.where}: id = {_short(name)}: {text}")
        if name in found:
            raise ValueError(f"{row.where}: id {_short(name)} is there more than once")
        found[name] = row
    return found


def number(row: Row, column: str, high: float | None = None) -> float | None:
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


def write(path: Path, rows: Sequence[Mapping[str, str | float | None]]) -> None:
    """Write a table with the keys of its rows as header, whole or not at all."""
    lines = [[*rows[0]], *(map(_cell, row.values()) for row in rows)]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(lines)


def _cell(value: str | float | None) -> str:
    """Text of a cell, which no spreadsheet takes for a formula."""
    if not isinstance(value, str):
        return "" if value is None else points_text(value)
    text = " ".join(printable(value, 2000).split())
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") else text


def _short(text: str) -> str:
    return repr(text[: checks.LONGEST])
