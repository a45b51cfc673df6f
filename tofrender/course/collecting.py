"""A pytest plugin that writes down which tests there are, with their markers.

pytest -p tofrender.course.collecting --collect-only --collected FILE
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from .judge import test_id


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--collected`."""
    parser.addoption("--collected", metavar="FILE", help="write the tests and their markers")


def pytest_collection_finish(session: pytest.Session) -> None:
    """Write them, a list of markers for each test's id."""
    target = session.config.getoption("--collected")
    if target:
        tests: dict[str, set[str]] = {}
        for item in session.items:
            marks = {mark.name for mark in item.iter_markers()}
            tests.setdefault(test_id(item.nodeid), set()).update(marks)
        text = json.dumps({name: sorted(marks) for name, marks in tests.items()})
        Path(target).write_text(text, encoding="utf-8")
