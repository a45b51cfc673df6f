"""New terms: other numbers for the public tests than last year's answers have."""

from __future__ import annotations

import re
import secrets

from ...runtime.atomic import replacing
from .. import rubric
from ..assignments import Assignment
from ..rubric import FILE_NAME, MAX_TERM

_TERM = re.compile(r"^term *= *\d+ *$", re.MULTILINE)
_HEAD = re.compile(r"^\[assignment\] *\n", re.MULTILINE)


def new_term(assignment: Assignment, term: int | None = None) -> tuple[int, int]:
    """Write another `term` into the rubric; returns the one before, and the new one.

    0 stands for the numbers that the tests were written with; None draws a term. ValueError if
    there are no solutions, or the rubric has no `[assignment]`.
    """
    assignment.require_staff("new-term")
    path = assignment.folder / FILE_NAME
    before = assignment.rubric.term
    if term is None:
        term = 1 + secrets.randbelow(MAX_TERM)
    text = path.read_text(encoding="utf-8")
    line = f"term = {term}"
    if _TERM.search(text):
        text = _TERM.sub(line, text, count=1)
    elif _HEAD.search(text):
        text = _HEAD.sub(f"[assignment]\n{line}\n", text, count=1)
    else:
        raise ValueError(f"{path}: has no line [assignment]")
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
        if rubric.read(temporary).term != term:
            raise ValueError(f"{path}: its term cannot be set; write {line} below [assignment]")
    return before, term
