"""The table of docs/gradients.md: every row, beside the closed forms as they are now."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.gradient_cases import TABLE

from benchmarks.misuka_sphere import FREQUENCIES, closed_form
from tofrender.integrators.derivatives import MOST_KEPT

PAGE = Path(__file__).parents[2] / "docs/gradients.md"
TENTH_OF_A_PERCENT, STANDARD_ERRORS, ROUNDING = 1e-3, 3, 2e-4


def table() -> dict[tuple[str, str, str], list[str]]:
    """Parameter, scene and measure -> closed form, forward and reverse, as text."""
    text = PAGE.read_text(encoding="utf-8")
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    start = next(k for k, cells in enumerate(lines) if cells[:2] == ["parameter", "scene"])
    end = next(k for k, cells in enumerate(lines) if cells[0] == "misuka")
    return {tuple(cells[:3]): cells[3:6] for cells in lines[start + 1 : end]}


def read(cell: str) -> tuple[float, float]:
    """A number and its standard error, of 0.0325040(12)."""
    digits, error = re.fullmatch(r"(-?[\d.]+)(?:\((\d+)\))?", cell).groups()
    return float(digits), int(error or 0) * 10.0 ** -len(digits.partition(".")[2])


def test_the_page_has_all_rows():
    rows = {(case.row, case.scene, what) for case in TABLE for what in case.weights()}
    assert set(table()) == rows
    assert len({row for row, _, _ in rows}) == 10


@pytest.mark.parametrize("case", TABLE, ids=lambda case: case.name)
def test_rows_of_the_page_are_the_closed_forms(case):
    _, change = case.expected()
    for what, weights in case.weights().items():
        exact = float(weights @ change)
        form, *found = map(read, table()[case.row, case.scene, what])
        assert form[0] == pytest.approx(exact, rel=1e-5)
        for value, error in found:
            off = abs(value - exact)
            assert off < TENTH_OF_A_PERCENT * abs(exact)
            assert off < STANDARD_ERRORS * error + ROUNDING * abs(exact)


def test_the_page_says_how_long_paths_may_be():
    assert f"`max_depth` from 1 to {MOST_KEPT}" in PAGE.read_text(encoding="utf-8")


def test_rows_of_misuka_are_its_scenes():
    text = PAGE.read_text(encoding="utf-8")
    found = [
        (row["by"], row["of"], row["bands"], f"{closed_form(row['by'])[row['of']]:.6g}")
        for row in re.finditer(
            r"^\| (?P<by>radius|albedo) \| (?P<of>sum|moment) \| (?P<bands>[\d, ]+) \|", text, re.M
        )
    ]
    assert len(found) == 4 * len(FREQUENCIES)
    for cells in found:
        assert cells[2] in FREQUENCIES
        assert "| " + " | ".join(cells) + " |" in text
