"""Progress bars appear when they should; Ctrl-C asks first and insists later."""

import os
import pty
import queue
import select
import signal
import subprocess
import sys
import threading
import time
import types
from typing import ClassVar

import pytest
from helpers import processes
from helpers.limits import lower
from helpers.processes import python

import tofrender
from tofrender.rendering import work_items
from tofrender.runtime import progress
from tofrender.runtime.progress import ProgressBar, deferred_stop, held_signals

IS_WATCHED = progress.is_watched


class Ticks(threading.Event):
    """What a bar's thread waits for: time that is over when the test says so."""

    made: ClassVar[list] = []

    def __init__(self) -> None:
        super().__init__()
        self.asked, self.over = queue.Queue(), queue.Queue()
        self.made.append(self)

    def wait(self, timeout=None) -> bool:
        self.asked.put(timeout)
        self.over.get()
        return self.is_set()

    def set(self) -> None:
        super().set()
        self.over.put(None)

    def tick(self) -> float:
        """Let a wait be over, and what follows be done; how long the wait was to be."""
        seconds = self.asked.get()
        self.over.put(None)
        self.asked.put(self.asked.get())  # The thread waits again
        return seconds


@pytest.fixture(autouse=True)
def ticks(monkeypatch):
    """As if stderr was a terminal; the waits of the bars that are made."""
    monkeypatch.setattr(progress, "is_watched", lambda: True)
    monkeypatch.setattr(Ticks, "made", [])
    faked = types.SimpleNamespace(**vars(threading) | {"Event": Ticks})
    monkeypatch.setattr(progress, "threading", faked)
    return Ticks.made


def test_something_is_to_be_seen_within_a_second_but_not_of_short_work(capsys, ticks):
    assert progress.DELAY_S + progress.REFRESH_S < 1
    with ProgressBar("Working", 8) as bar:
        bar.update(2)
    assert capsys.readouterr().err == ""
    with ProgressBar("Working", 8) as bar:
        bar.update(2)
        assert ticks[1].tick() == progress.DELAY_S
        assert "2/8" in capsys.readouterr().err
        bar.update(1)
        assert ticks[1].tick() == progress.REFRESH_S
        assert "3/8" in capsys.readouterr().err
    assert capsys.readouterr().err.endswith("\r")  # Nothing stays


def test_disabled_and_hidden_bars(monkeypatch):
    with ProgressBar("Working", 8, enabled=False):
        assert progress._open == []
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(progress, "is_watched", IS_WATCHED)
    with progress.without_bars(), ProgressBar("Working", 3):
        assert progress._open == []
    with ProgressBar("Working", 3):
        assert len(progress._open) == 1


@pytest.mark.parametrize("shown", [True, False])
def test_render_shows_a_bar(capsys, monkeypatch, ticks, shown):
    steps = work_items.steps

    def watched(*arguments):
        for done in steps(*arguments):
            yield done
            if shown:
                ticks[-1].tick()

    monkeypatch.setattr(work_items, "steps", watched)
    lower(monkeypatch, step_samples=64 * 64)
    scene = tofrender.cornell_box(width=8, height=8, temporal_bins=120, bin_width_opl=0.25)
    tofrender.render(scene, spp=256, progress=shown)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert ("Rendering" in captured.err, "192/256" in captured.err) == (shown, shown)
    assert shown or captured.err == ""


# The bars of notebooks are drawn by their own threads, as soon as they may be
_DRAWN = """
import time
from tofrender.runtime import progress
progress.DELAY_S = 0
def drawn(bar):
    while bar._bar is None or bar._bar.n != bar.n:  # The bar may be drawn before its update
        time.sleep(0.01)
"""
_WITHOUT_IPYWIDGETS = f"""
import sys, types, warnings
warnings.simplefilter("error")
sys.modules["ipywidgets"] = None  # Not installed
shell = types.SimpleNamespace(config={{"IPKernelApp": {{}}}})
sys.modules["IPython"] = types.ModuleType("IPython")
sys.modules["ipykernel"] = types.ModuleType("ipykernel")
sys.modules["IPython"].get_ipython = lambda: shell
sys.argv = ["tofrender"]  # No variant is needed
{_DRAWN}
with progress.ProgressBar("Working", 2) as bar:
    drawn(bar)
"""


def test_in_a_notebook_without_ipywidgets():
    result = python(_WITHOUT_IPYWIDGETS)
    assert result.returncode == 0, result.stderr
    assert "Working" in result.stderr
    assert "Warning" not in result.stderr


@pytest.mark.parametrize(
    ("bar", "shown"),
    [
        # As while kernels are compiled: no step is done, but a bar is there, with its clock
        (lambda: ProgressBar("Working", 8), "Working:   0%"),
        (lambda: progress.status("Loading"), "Loading ... 01:0"),
    ],
)
def test_what_is_done_is_shown_though_nothing_is_counted(capsys, monkeypatch, ticks, bar, shown):
    now = [1000.0]
    clock = types.SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(progress, "time", clock)
    with bar():
        now[0] += 62  # From when the work began, not the bar
        ticks[0].tick()
    said = capsys.readouterr().err
    assert shown in said
    assert said.endswith("\r")  # Nothing stays


def test_inner_work_takes_the_place_of_the_outer(capsys, ticks):
    with progress.status("Outer"):
        ticks[0].tick()
        with ProgressBar("Inner", 3) as bar:
            bar.update()
            for each in (1, 0, 1):
                ticks[each].tick()
            print("within", file=sys.stderr)
            ticks[1].tick()
        ticks[0].tick()
    before, after = capsys.readouterr().err.split("within\n")
    assert before.index("Outer") < before.index("Inner")
    assert "Outer" not in before[before.index("Inner") :]
    assert after.rindex("Inner") < after.rindex("Outer")
    assert "\n" not in before + after  # One line at a time


def test_what_is_said_meanwhile_has_a_line_of_its_own(capsys, ticks):
    with progress.status("Working"):
        ticks[0].tick()
        with progress.bars_cleared():
            print("a note", file=sys.stderr)
        ticks[0].tick()
    line = capsys.readouterr().err.split("\n")[0]
    assert line.rpartition("\r")[2] == "a note"


_JUPYTER = f"""
{_DRAWN}
with progress.status("Starting") as starting:
    drawn(starting)
    with progress.ProgressBar("Working", 8) as bar:
        bar.update(3)
        drawn(bar)
"""


def test_in_a_notebook():
    """Widgets come and go while the cell runs, and none stays, in red, of work that ended early."""
    jupyter = pytest.importorskip("jupyter_client")
    manager = jupyter.KernelManager(kernel_name="python3")
    manager.start_kernel(cwd=str(processes.ROOT), stderr=subprocess.DEVNULL)
    try:
        client = manager.client()
        client.start_channels()
        client.wait_for_ready(None)
        asked = client.execute(_JUPYTER)
        said = []
        while True:
            message = client.get_iopub_msg()
            if message["parent_header"].get("msg_id") != asked:
                continue
            content = message["content"]
            if message["msg_type"] == "status" and content["execution_state"] == "idle":
                break
            assert message["msg_type"] != "error", content
            said.append(str(content))
        client.stop_channels()
    finally:
        manager.shutdown_kernel(now=True)
    text = "".join(said)
    assert text.index("Starting ...") < text.index("3/8")
    assert "danger" not in text


_IN_A_TERMINAL = f"""
{_DRAWN}
with progress.ProgressBar("Working", 8) as bar:
    bar.update(3)
    drawn(bar)
"""


def test_a_terminal_that_reports_no_size_shows_bars_too():
    ours, theirs = pty.openpty()  # 0 x 0, as in containers and under `script`
    try:
        command = [sys.executable, "-c", _IN_A_TERMINAL]
        subprocess.run(command, stderr=theirs, check=True, cwd=processes.ROOT)
        assert select.select([ours], [], [], 1)[0], "nothing was drawn"
        assert b"3/8" in os.read(ours, 1 << 16)
    finally:
        os.close(ours)
        os.close(theirs)


def test_threads_end_with_their_bars():
    before = threading.active_count()
    for _ in range(20):
        with ProgressBar("Working", 3), progress.status("Within"):
            pass
    while threading.active_count() > before:  # Until the time limit of tests
        time.sleep(0.01)


def test_one_ctrl_c_asks_and_two_interrupt():
    before = signal.getsignal(signal.SIGINT)
    with deferred_stop() as stop:
        assert not stop.requested
        signal.raise_signal(signal.SIGINT)
        assert stop.requested
        assert signal.getsignal(signal.SIGINT) is before
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(RuntimeError), deferred_stop():
        raise RuntimeError
    assert signal.getsignal(signal.SIGINT) is before


def test_an_ignored_ctrl_c_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with deferred_stop() as stop:
            signal.raise_signal(signal.SIGINT)
            assert not stop.requested
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("fails", [False, True])
def test_a_held_ctrl_c_takes_effect_at_the_end_of_the_block(fails):
    went_on = []

    def work():
        with held_signals():
            signal.raise_signal(signal.SIGINT)
            went_on.append(True)
            if fails:
                raise RuntimeError("KeyboardInterrupt")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert went_on


def test_a_held_ctrl_c_is_told_to_a_block_that_waits_for_it():
    with deferred_stop() as stop:
        with held_signals():
            signal.raise_signal(signal.SIGINT)
        assert stop.requested


_HELD = """
import signal
from tofrender.runtime.progress import held_signals
with held_signals():
    signal.raise_signal(signal.SIGTERM)
    print('held', flush=True)
print('never')
"""


def test_a_held_signal_ends_the_process_where_nothing_hears_it():
    done = python(_HELD)
    assert (done.returncode, done.stdout) == (-signal.SIGTERM, "held\n")


def test_another_thread_keeps_the_handler():
    before, seen = signal.getsignal(signal.SIGINT), []

    def work():
        with deferred_stop() as stop:
            seen.append((signal.getsignal(signal.SIGINT), stop.requested))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [(before, False)]


def test_ctrl_c_in_a_terminal_is_answered_at_once(monkeypatch):
    """A pipe gets no line, and the second Ctrl-C interrupts."""
    ours, theirs = os.openpty()
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with deferred_stop() as stop:
            signal.raise_signal(signal.SIGINT)
            assert stop.requested
            assert b"press Ctrl-C again" in os.read(ours, 1000)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
    os.close(ours)
