"""What docs/ and CONTRIBUTING.md say: their Python runs, their files exist."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted(ROOT.glob("docs/*.md"))
WITH_PYTHON = [page for page in PAGES if "```python" in page.read_text(encoding="utf-8")]


def test_most_pages_have_python():
    assert len(WITH_PYTHON) >= len(PAGES) - 1  # That of the benchmarks' figures has none


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.stem)
def test_python_of_a_page_runs(page, tmp_path):
    """From top to bottom in one file, as a reader would type it."""
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    program = tmp_path / "page.py"
    program.write_text("\n".join(blocks), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", str(program)], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.stem)
def test_files_that_a_page_names_exist(page):
    named = set(re.findall(r"`([\w./]+/[\w.]*)`", page.read_text(encoding="utf-8")))
    assert named
    places = (ROOT, ROOT / "tofrender", ROOT / "tofrender/course", ROOT / "tofrender/nlos")
    assignment = ROOT / "assignments/a2_time_of_flight"
    missing = [
        name
        for name in sorted(named)
        if not any((place / name).exists() for place in (*places, assignment))
    ]
    assert not missing
