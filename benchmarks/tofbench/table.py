"""Table of all cases."""

from __future__ import annotations

from .cases import Case
from .closed import CASES
from .references import reference_cases


def all_cases() -> list[Case]:
    """Return all cases. The references are last."""
    return [*CASES, *reference_cases()]
