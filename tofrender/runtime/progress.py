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

DELAY_S = 0.5  # time until a bar appears [s]
REFRESH_S = 0.1  # time between two updates of a bar [s]
EVERY_S = 30.0  # time between two checkpoints, unless saving is slow [s]
STATUS = "{desc} ... {elapsed}"
SIZE = {"ncols": 80, "nrows": 24}
"""Size of a terminal that does not report its size, for example in a container."""


def is_watched() -> bool:
    """Return whether somebody watches stderr: a terminal or a notebook, and no worker process."""
    from multiprocessing import parent_process  # Waits while another thread imports the module

    if parent_process() is not None:
        return False
    return sys.stderr.isatty() or is_notebook()


def is_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return shell is not None and "IPKernelApp" in shell.config


_hidden = 0  # number of open blocks that hide bars
_open: "list[ProgressBar]" = []  # open bars, from the outermost to the innermost
_lock = threading.RLock()


class ProgressBar:
    """Progress bar that appears after `DELAY_S`, also before the first unit is finished.

    An inner bar replaces the outer bar on the screen while the inner bar is open. Bars are hidden
    if stderr is a file or a pipe.

    Args:
        description: Text in front of the bar.
        total: Number of units; None shows the description and the elapsed time only.
        unit: Name of a unit. The unit "B" counts bytes with prefixes.
        enabled: Whether the bar is shown.

    Attributes:
        n: Number of finished units.
    """

    def __init__(
        self, description: str, total: int | None, unit: str = "frame", enabled: bool = True
    ) -> None:
        self.n = 0
        self._bar = None
        self._options: dict[str, Any] = {
            "desc": description,
            "total": total,
            "unit": unit,
            "unit_scale": unit == "B",
            "bar_format": STATUS if total is None else None,
        }
        self._end = threading.Event()
        self._began = time.monotonic()
        self._enabled = enabled and not _hidden and is_watched()
        if self._enabled and is_notebook():
            # Import tqdm now: filters of warnings affect all threads, so the thread that draws
            # must not change them. Without ipywidgets, tqdm warns and draws text.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                _tqdm()

    def update(self, count: int = 1) -> None:
        """Add finished units."""
        self.n += count

    def _refresh(self) -> None:
        """Draw the bar repeatedly until it is closed."""
        wait = DELAY_S
        while not self._end.wait(wait):
            wait = REFRESH_S if self._options["total"] else 5 * REFRESH_S
            with _lock, suppress(OSError, ValueError):  # stderr may be closed
                if not self._end.is_set():
                    self._draw()

    def _draw(self) -> None:
        """Draw the bar, unless an inner bar is visible. Outer bars are removed."""
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
        bar = self._bar
        self._bar = None
        if bar is not None:
            bar.total = None  # A notebook would keep a bar below its total on the screen, in red
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
    """Hide bars within the block if `wanted` is set."""
    global _hidden
    _hidden += wanted
    try:
        yield
    finally:
        _hidden -= wanted


def _size() -> dict[str, int]:
    """Return `SIZE` if the terminal reports no columns, because tqdm then draws nothing.

    Otherwise tqdm finds the size itself.
    """
    with suppress(OSError, ValueError):  # stderr is not a terminal
        return {} if os.get_terminal_size(sys.stderr.fileno()).columns else SIZE
    return {}


def _tqdm() -> Any:
    """Return the class of bars for terminals or notebooks."""
    from tqdm.auto import tqdm

    return tqdm


# Sent by Ctrl-C, by `kill` or a scheduler, and when a terminal is closed
SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@dataclass
class Stop:
    """Request to stop the work."""

    by: int = 0  # signal of the request, 0 before a request
    passed_on: bool = False  # whether an enclosing block has received the signal as well

    @property
    def requested(self) -> bool:
        """Return whether a signal was received."""
        return bool(self.by)

    def take_effect(self) -> None:
        """Raise the signal again, unless an enclosing block has received it."""
        if self.by and not self.passed_on:
            signal.raise_signal(self.by)


FINISHING = b"\nfinishing this step; press Ctrl-C again to stop now\n"
"""Answer to the first Ctrl-C in a terminal."""


class _Deferring:
    """Signal handler that requests a stop, and then restores the handlers before it.

    Inner blocks recognize the handler by its class and call it.
    """

    def __init__(self, stop: Stop, before: dict[int, Any]) -> None:
        self.stop = stop
        self.before = before

    def restore(self) -> None:
        """Restore the handlers of all signals."""
        for number, handler in self.before.items():
            signal.signal(number, handler)

    def __call__(self, number: int, frame: Any) -> None:
        """Handle a signal."""
        self.stop.by = number
        self.restore()
        outer = self.before[number]
        if isinstance(outer, _Deferring):
            self.stop.passed_on = True
            outer(number, frame)
        elif number == signal.SIGINT and sys.stderr.isatty():
            # A handler may interrupt a print, which `os.write` does not disturb
            os.write(sys.stderr.fileno(), FINISHING)


@contextmanager
def deferred_stop() -> Iterator[Stop]:
    """Turn the first Ctrl-C, SIGTERM or SIGHUP into a request to stop after the current step.

    In a terminal, Ctrl-C prints a line at once. A second signal ends the work at once. In nested
    blocks, the first signal is a request to all blocks. The block has no effect outside of the main
    thread, and for signals that the process ignores, for example Ctrl-C in background jobs of a
    shell script and SIGHUP under nohup.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    handled = {n: handler for n, handler in before.items() if handler not in (signal.SIG_IGN, None)}
    request = _Deferring(stop, handled)
    for number in handled:
        signal.signal(number, request)
    try:
        yield stop
    finally:
        if not stop.requested:
            request.restore()


@contextmanager
def held_signals() -> Iterator[None]:
    """Delay Ctrl-C, SIGTERM and SIGHUP until the end of the block.

    If they were raised in a function that Mitsuba calls, Mitsuba would report an error of the
    scene.
    """
    stop = Stop()
    try:
        with deferred_stop() as stop:
            yield
    finally:
        stop.take_effect()


class Terminated(KeyboardInterrupt):
    """Error of a signal that ends the process. Blocks remove incomplete files on the way."""

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
