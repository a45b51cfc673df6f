"""Progress bars, and stopping long work between two of its steps."""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

DELAY_S = 0.5
"""Work that takes longer [s] is shown, so that something is to be seen within a second."""

REFRESH_S = 0.1
"""A bar is drawn anew so often [s]."""

EVERY_S = 30.0
"""Work between two savings of a checkpoint [s], unless saving takes long."""

STATUS = "{desc} ... {elapsed}"


def is_watched() -> bool:
    """Whether somebody looks at stderr: it is a terminal, or a notebook's, and not a worker's."""
    from multiprocessing import parent_process  # Waits where another thread is importing it

    if parent_process() is not None:
        return False
    return sys.stderr.isatty() or is_notebook()


def is_notebook() -> bool:
    """Whether this process is a notebook's kernel; that ipykernel was imported is not enough."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return shell is not None and "IPKernelApp" in shell.config


_hidden: list[None] = []
_shown: list[Bar] = []  # Those that are open, the innermost last
_lock = threading.RLock()


class Bar:
    """A tqdm bar that appears after `DELAY_S` even if nothing is done until then.

    What is within another one, a bar or a status line, takes its place while it is shown.

    Args:
        description: What is being done.
        total: Number of units; None shows what is being done and for how long.
        unit: What is counted.

    Attributes:
        n: Units that are done.
    """

    def __init__(self, description: str, total: int | None, unit: str, enabled: bool) -> None:
        self.n, self._bar = 0, None
        self._made: dict[str, Any] = {
            "desc": description,
            "total": total,
            "unit": unit,
            "unit_scale": unit == "B",
            "bar_format": STATUS if total is None else None,
        }
        self._end, self._began = threading.Event(), time.monotonic()
        self._enabled = enabled and not _hidden and is_watched()
        if self._enabled and is_notebook():
            with warnings.catch_warnings():  # Which concern all threads
                warnings.simplefilter("ignore")  # Without ipywidgets the bar is text, which is fine
                _tqdm()

    def update(self, count: int = 1) -> None:
        """Count units that are done."""
        self.n += count

    def _keep_shown(self) -> None:
        """Draw the bar until the end, if it is the innermost one."""
        wait = DELAY_S
        while not self._end.wait(wait):
            wait = REFRESH_S if self._made["total"] else 5 * REFRESH_S
            with _lock, suppress(OSError, ValueError):  # stderr may be closed
                if not self._end.is_set():
                    self._draw()

    def _draw(self) -> None:
        inner = _shown[_shown.index(self) + 1 :]
        if any(each._bar is not None for each in inner):
            return
        for outer in _shown[: _shown.index(self)]:
            outer._clear()
        if self._bar is None:
            self._bar = _tqdm()(leave=False, delay=1e-9, **self._made)
            self._bar.start_t -= time.monotonic() - self._began
            self._bar.last_print_t = math.inf  # It takes away only what it knows to be shown
        self._bar.n = self.n
        self._bar.refresh()

    def _clear(self) -> None:
        """Take it from the screen."""
        bar, self._bar = self._bar, None
        if bar is not None:
            bar.total = None  # Else a notebook keeps one that was closed early, in red
            with suppress(OSError, ValueError):
                bar.close()

    def __enter__(self) -> Bar:
        if self._enabled:
            _shown.append(self)
            threading.Thread(target=self._keep_shown, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        if self._enabled:
            with _lock:
                _shown.remove(self)
                self._clear()


def progress_bar(
    description: str, total: int | None, *, unit: str = "frame", enabled: bool = True
) -> Bar:
    """A bar for terminal or notebook that shows up within a second.

    Args:
        description: What is being done.
        total: Number of units, None if unknown.
        unit: What is counted; "B" counts bytes with prefixes.
        enabled: False makes a bar that shows nothing, as does a stderr that is a file or a pipe.
    """
    return Bar(description, total, unit, enabled)


def status(description: str, enabled: bool = True) -> Bar:
    """A line that says what is being done, and for how long, where nothing can be counted.

    Example:
        >>> with status("Loading"):
        ...     sum(range(10))
        45
    """
    return Bar(description, None, "", enabled)


def shown(description: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A decorator of functions that may take long: a status line tells what they do."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def told(*args: P.args, **kwargs: P.kwargs) -> R:
            with status(description):
                return function(*args, **kwargs)

        return told

    return decorate


@contextmanager
def cleared() -> Iterator[None]:
    """Take bars from the screen while something else is written there."""
    with _lock:
        for each in _shown:
            each._clear()
        yield


@contextmanager
def hidden(wanted: bool = True) -> Iterator[None]:
    """Show no bars within the block, if that is `wanted`."""
    if not wanted:
        yield
        return
    _hidden.append(None)
    try:
        yield
    finally:
        _hidden.pop()


def _tqdm() -> Any:
    """The class of bars for terminal or notebook."""
    from tqdm.auto import tqdm

    return tqdm


SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""What asks a process to end: Ctrl-C, a scheduler or `kill`, and a terminal that is closed."""


@dataclass
class Stop:
    """Whether somebody wants the work to stop.

    Attributes:
        by: The signal that asked, 0 if none did.
        passed_on: Whether a block around this one was asked, too.
    """

    by: int = 0
    passed_on: bool = False

    @property
    def requested(self) -> bool:
        """Whether any did."""
        return bool(self.by)

    def take_effect(self) -> None:
        """Do what the signal does without the block, if no block around it has heard of it."""
        if self.by and not self.passed_on:
            signal.raise_signal(self.by)


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
            stop.passed_on = True
            outer(number, frame)

    vars(request)["defers"] = True  # Blocks within this one tell it
    for number in heard:
        signal.signal(number, request)
    try:
        yield stop
    finally:
        if not stop.requested:
            as_before()


@contextmanager
def held_signals() -> Iterator[None]:
    """Let Ctrl-C, SIGTERM and SIGHUP wait for the end of the block.

    Where Mitsuba calls Python, it takes what they raise there for an error of the scene.
    """
    stop = Stop()
    try:
        with deferred_stop() as stop:
            yield
    finally:
        stop.take_effect()


class Terminated(KeyboardInterrupt):
    """A signal that ends the process, as an error, so that what is half-written is removed.

    Attributes:
        status: What the process's exit status is then.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


@contextmanager
def ended_by_signals() -> Iterator[list[int]]:
    """Let Ctrl-C, SIGTERM and SIGHUP raise `Terminated`, and list those that came."""
    came: list[int] = []

    def end(number, frame):
        came.append(number)
        raise Terminated(number)

    usual = (signal.SIG_DFL, signal.default_int_handler)
    main = threading.current_thread() is threading.main_thread()
    before = {n: signal.getsignal(n) for n in SIGNALS if main and signal.getsignal(n) in usual}
    for number in before:
        signal.signal(number, end)
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
