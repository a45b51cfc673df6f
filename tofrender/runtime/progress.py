"""Progress bars, and stopping long work between two of its steps."""

from __future__ import annotations

import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

DELAY_S = 2.0
"""A bar appears only for work that takes longer than this [s]."""


def is_watched() -> bool:
    """Whether somebody looks at stderr: it is a terminal, or a notebook's."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules


def progress_bar(description: str, total: int | None, *, unit: str = "frame", enabled: bool = True):
    """A tqdm bar, for terminal or notebook, that shows up after two seconds.

    Args:
        description: What is being done.
        total: Number of units, None if unknown.
        unit: What is counted; "B" counts bytes with prefixes.
        enabled: False makes a bar that shows nothing, as does a stderr that is a file or a pipe.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Without ipywidgets the bar is text, which is fine
        from tqdm.auto import tqdm

    return tqdm(
        desc=description,
        total=total,
        unit=unit,
        unit_scale=unit == "B",
        delay=DELAY_S,
        disable=not (enabled and is_watched()),
        leave=False,
    )


@dataclass
class Stop:
    """Whether the user wants to stop.

    Attributes:
        requested: Ctrl-C was pressed.
    """

    requested: bool = False


@contextmanager
def deferred_stop() -> Iterator[Stop]:
    """Turn the first Ctrl-C into a request to stop after the step under way.

    A second Ctrl-C interrupts at once. Nothing changes in a thread other than the main one, nor
    where Ctrl-C is ignored, as in a shell script's background jobs.

    Example:
        >>> with deferred_stop() as stop:
        ...     stop.requested
        False
    """
    stop = Stop()
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is signal.SIG_IGN:
        yield stop
        return

    def request(number, frame):
        stop.requested = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, request)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
