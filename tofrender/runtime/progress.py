"""Progress bars, and stopping long work between two of its steps."""

from __future__ import annotations

import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

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


SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""What asks a process to end: Ctrl-C, a scheduler or `kill`, and a terminal that is closed."""


@dataclass
class Stop:
    """Whether somebody wants the work to stop.

    Attributes:
        by: The signal that asked, 0 if none did.
    """

    by: int = 0

    @property
    def requested(self) -> bool:
        """Whether any did."""
        return bool(self.by)


@contextmanager
def deferred_stop() -> Iterator[Stop]:
    """Turn the first Ctrl-C, SIGTERM or SIGHUP into a request to stop after the step under way.

    A second one does what it does elsewhere: it ends the work at once. Within another such block,
    the first one asks both to stop. Nothing changes in a thread
    other than the main one, nor for signals that are ignored, as Ctrl-C is in a shell script's
    background jobs and SIGHUP under nohup.

    Example:
        >>> with deferred_stop() as stop:
        ...     stop.requested
        False
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    heard = {n: handler for n, handler in before.items() if handler not in (signal.SIG_IGN, None)}

    def as_before():
        for number, handler in heard.items():
            signal.signal(number, handler)

    def request(number, frame):
        stop.by = number
        as_before()
        outer: Any = heard[number]
        if hasattr(outer, "defers"):
            outer(number, frame)

    vars(request)["defers"] = True  # Blocks within this one tell it
    for number in heard:
        signal.signal(number, request)
    try:
        yield stop
    finally:
        if not stop.requested:
            as_before()


class Terminated(KeyboardInterrupt):
    """A signal that ends the process, as an error, so that what is half-written is removed.

    Attributes:
        status: What the process's exit status is then.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise `Terminated` where they would end the process without a word."""

    def end(number, frame):
        raise Terminated(number)

    main = threading.current_thread() is threading.main_thread()
    default = [n for n in SIGNALS if main and signal.getsignal(n) is signal.SIG_DFL]
    for number in default:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in default:
            signal.signal(number, signal.SIG_DFL)
