"""Errors of bad input: one line each."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


def one_line(error: pytest.ExceptionInfo) -> str:
    """The text of an error, which is one line."""
    text = str(error.value)
    assert text
    assert "\n" not in text
    return text


@contextmanager
def refused(match: str, kind=ValueError) -> Iterator[pytest.ExceptionInfo]:
    """Expect an error with a text of one line."""
    with pytest.raises(kind, match=match) as error:
        yield error
    one_line(error)
