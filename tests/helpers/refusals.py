"""Errors of bad input: one line each."""

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

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


def innermost_message(call: Callable[[], Any]) -> str:
    """Return the one line of the first error of a call; Dr.Jit wraps the errors of operations."""
    with pytest.raises((ValueError, TypeError, RuntimeError)) as caught:
        call()

    # Frames hold a scene that tracks gradients
    error: BaseException = caught.value
    traceback.clear_frames(error.__traceback__)
    while error.__cause__ is not None:
        error = error.__cause__
        traceback.clear_frames(error.__traceback__)
    text = str(error)
    assert text
    assert "\n" not in text.strip()
    return text
