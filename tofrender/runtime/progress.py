"""Progress bars, and signals that stop long work between two steps."""

import math
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

DELAY_S = 0.5  # Until a bar appears
REFRESH_S = 0.1  # Between two draws of a bar
EVERY_S = 30.0  # Between two saves of a checkpoint, unless saving takes long
STATUS = "{desc} ... {elapsed}"
SIZE = {"ncols": 80, "nrows": 24}  # Of a terminal that reports none, as those of containers


def is_watched() -> bool:
    """Whether stderr is a terminal or a notebook's, and not a worker's."""
    from multiprocessing import parent_process  # Waits where another thread is importing it

    if parent_process() is not None:
        return False
    return sys.stderr.isatty() or is_notebook()


def is_notebook() -> bool:
    """Whether this process is a notebook's kernel; an imported ipykernel is not enough."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return shell is not None and "IPKernelApp" in shell.config


_hidden = 0  # Number of blocks that hide bars
_open: "list[ProgressBar]" = []  # The innermost last
_lock = threading.RLock()


class ProgressBar:
    """Bar of tqdm that appears after `DELAY_S` even if nothing is done until then.

    A bar or a status line within another one replaces it while it is shown. `n` counts the units
    that are done; the unit "B" counts bytes with prefixes. The bar is hidden if it is not
    `enabled`, or if stderr is a file or a pipe.
    """

    def __init__(
        self, description: str, total: int | None, unit: str = "frame", enabled: bool = True
    ) -> None:
        self.n, self._bar = 0, None
        self._options: dict[str, Any] = {
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

    def _refresh(self) -> None:
        """Draw the bar again and again until its end."""
        wait = DELAY_S
        while not self._end.wait(wait):
            wait = REFRESH_S if self._options["total"] else 5 * REFRESH_S
            with _lock, suppress(OSError, ValueError):  # stderr may be closed
                if not self._end.is_set():
                    self._draw()

    def _draw(self) -> None:
        """Draw the bar in place of outer ones, unless an inner one is drawn."""
        level = _open.index(self)
        if any(inner._bar is not None for inner in _open[level + 1 :]):
            return
        for outer in _open[:level]:
            outer._clear()
        if self._bar is None:
            self._bar = _tqdm()(leave=False, delay=1e-9, **self._options | _size())
            self._bar.start_t -= time.monotonic() - self._began
            self._bar.last_print_t = math.inf  # tqdm clears only bars that it has printed
        self._bar.n = self.n
        self._bar.refresh()

    def _clear(self) -> None:
        """Remove the bar from the screen."""
        bar, self._bar = self._bar, None
        if bar is not None:
            bar.total = None  # Else a notebook keeps a bar that was closed early, in red
            with suppress(OSError, ValueError):
                bar.close()

    def __enter__(self) -> "ProgressBar":
        if self._enabled:
            _open.append(self)
            threading.Thread(target=self._refresh, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        if self._enabled:
            with _lock:
                _open.remove(self)
                self._clear()


@contextmanager
def status(description: str, enabled: bool = True) -> Iterator[ProgressBar]:
    """Show a line with a description and the elapsed time, in a block or a decorated function."""
    with ProgressBar(description, None, "", enabled) as bar:
        yield bar


@contextmanager
def bars_cleared() -> Iterator[None]:
    """Remove bars from the screen while something else is written there."""
    with _lock:
        for each in _open:
            each._clear()
        yield


@contextmanager
def without_bars(wanted: bool = True) -> Iterator[None]:
    """Show no bars within the block, if that is `wanted`."""
    global _hidden
    _hidden += wanted
    try:
        yield
    finally:
        _hidden -= wanted


def _size() -> dict[str, int]:
    """`SIZE` if the terminal reports none, for which tqdm draws nothing; else tqdm finds it."""
    with suppress(OSError, ValueError):  # Not a terminal
        return {} if os.get_terminal_size(sys.stderr.fileno()).columns else SIZE
    return {}


def _tqdm() -> Any:
    """Class of bars for terminal or notebook."""
    from tqdm.auto import tqdm

    return tqdm


# Sent by Ctrl-C, by a scheduler or `kill`, and by a terminal that is closed
SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@dataclass
class Stop:
    """Request to stop the work."""

    by: int = 0  # Signal that requested it, 0 if none did
    passed_on: bool = False  # Whether an enclosing block has received the signal, too

    @property
    def requested(self) -> bool:
        """Whether a signal was received."""
        return bool(self.by)

    def take_effect(self) -> None:
        """Raise the signal again, unless an enclosing block has received it."""
        if self.by and not self.passed_on:
            signal.raise_signal(self.by)


@contextmanager
def deferred_stop() -> Iterator[Stop]:
    """Turn the first Ctrl-C, SIGTERM or SIGHUP into a request to stop after the current step.

    A second one has its usual effect: it ends the work at once. In nested blocks, the first one
    requests all to stop. Nothing changes in a thread other than the main one, nor for signals that
    are ignored, as Ctrl-C is in a shell script's background jobs and SIGHUP under nohup.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    handled = {n: handler for n, handler in before.items() if handler not in (signal.SIG_IGN, None)}

    def restore():
        for number, handler in handled.items():
            signal.signal(number, handler)

    def request(number, frame):
        stop.by = number
        restore()
        outer: Any = handled[number]
        if hasattr(outer, "defers"):
            stop.passed_on = True
            outer(number, frame)

    vars(request)["defers"] = True  # Blocks within this one call it
    for number in handled:
        signal.signal(number, request)
    try:
        yield stop
    finally:
        if not stop.requested:
            restore()


@contextmanager
def held_signals() -> Iterator[None]:
    """Delay Ctrl-C, SIGTERM and SIGHUP until the end of the block.

    Raised where Mitsuba calls Python, they would be reported as errors of the scene.
    """
    stop = Stop()
    try:
        with deferred_stop() as stop:
            yield
    finally:
        stop.take_effect()


class Terminated(KeyboardInterrupt):
    """Error raised by a signal that ends the process, so that incomplete files are removed."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number  # Exit status of the process


@contextmanager
def ended_by_signals() -> Iterator[list[int]]:
    """Raise `Terminated` on Ctrl-C, SIGTERM and SIGHUP, and list the signals received."""
    received: list[int] = []

    def end(number, frame):
        received.append(number)
        raise Terminated(number)

    default = (signal.SIG_DFL, signal.default_int_handler)
    main = threading.current_thread() is threading.main_thread()
    before = {n: signal.getsignal(n) for n in SIGNALS if main and signal.getsignal(n) in default}
    for number in before:
        signal.signal(number, end)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
