"""Progress bars appear when they should; Ctrl-C asks first and insists later."""

import signal
import subprocess
import sys
import threading
import time

import pytest
from helpers import processes
from helpers.processes import python

import tofrender
from tofrender.integrators import passes as base
from tofrender.rendering import pieces
from tofrender.runtime import progress
from tofrender.runtime.progress import deferred_stop, held_signals, progress_bar


@pytest.fixture(autouse=True)
def watched(monkeypatch):
    """As if stderr was a terminal."""
    monkeypatch.setattr(progress, "is_watched", lambda: True)


def two_updates(last: float = 0.0, **options) -> None:
    """Short work until 0.3 s, then one more update."""
    with progress_bar("Working", 8, **options) as bar:
        bar.update(1)
        time.sleep(0.15)
        bar.update(1)
        print("early", file=sys.stderr)
        time.sleep(0.3)
        bar.update(1)
        time.sleep(last)


def test_something_is_to_be_seen_within_a_second():
    assert progress.DELAY_S + progress.REFRESH_S < 1


def test_the_bar_comes_after_the_delay(capsys, monkeypatch):
    monkeypatch.setattr(progress, "DELAY_S", 0.3)
    two_updates(last=0.2)
    early, late = capsys.readouterr().err.split("early\n")
    assert "Working" not in early
    assert "Working" in late
    assert "3/8" in late


@pytest.mark.parametrize(("enabled", "delay"), [(True, progress.DELAY_S), (False, 0.0)])
def test_short_work_and_a_disabled_bar_show_nothing(capsys, monkeypatch, enabled, delay):
    monkeypatch.setattr(progress, "DELAY_S", delay)
    two_updates(enabled=enabled)
    assert capsys.readouterr().err == "early\n"


@pytest.mark.parametrize("shown", [True, False])
def test_render_shows_a_bar(capsys, monkeypatch, shown):
    steps = pieces.steps

    def slow(*arguments):
        for done in steps(*arguments):
            time.sleep(0.12)  # The bar shows at most ten times a second
            yield done

    monkeypatch.setattr(pieces, "steps", slow)
    monkeypatch.setattr(progress, "DELAY_S", 0.0)
    monkeypatch.setattr(progress, "REFRESH_S", 0.02)
    monkeypatch.setattr(base, "STEP_SAMPLES", 64 * 64)
    scene = tofrender.cornell_box(width=8, height=8, temporal_bins=120, bin_width_opl=0.25)
    tofrender.render(scene, spp=256, progress=shown)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert ("Rendering" in captured.err, "192/256" in captured.err) == (shown, shown)
    assert shown or captured.err == ""


_NOTEBOOK = """
import sys, time, types, warnings
warnings.simplefilter("error")
sys.modules["ipywidgets"] = None  # Not installed
shell = types.SimpleNamespace(config={"IPKernelApp": {}})
sys.modules["IPython"] = types.ModuleType("IPython")
sys.modules["ipykernel"] = types.ModuleType("ipykernel")
sys.modules["IPython"].get_ipython = lambda: shell
sys.argv = ["tofrender"]  # No variant is needed
from tofrender.runtime import progress
progress.DELAY_S = 0
with progress.progress_bar("Working", 2) as bar:
    bar.update(1)
    time.sleep(0.5)
"""


def test_in_a_notebook_without_ipywidgets():
    result = python(_NOTEBOOK)
    assert result.returncode == 0, result.stderr
    assert "Working" in result.stderr
    assert "Warning" not in result.stderr


@pytest.mark.parametrize(
    ("bar", "shown"),
    [
        # As while kernels are compiled: no step is done, but a bar is there, with its clock
        (lambda: progress_bar("Working", 8), "Working:   0%"),
        (lambda: progress.status("Loading"), "Loading ... 00:00"),
    ],
)
def test_what_is_done_is_shown_though_nothing_is_counted(capsys, monkeypatch, bar, shown):
    monkeypatch.setattr(progress, "DELAY_S", 0.1)
    with bar():
        time.sleep(0.4)
    said = capsys.readouterr().err
    assert shown in said
    assert said.endswith("\r")  # Nothing stays


def test_inner_work_takes_the_place_of_the_outer(capsys, monkeypatch):
    monkeypatch.setattr(progress, "DELAY_S", 0.1)
    monkeypatch.setattr(progress, "REFRESH_S", 0.02)
    with progress.status("Outer"):
        time.sleep(0.25)
        with progress_bar("Inner", 3) as bar:
            bar.update()
            time.sleep(0.25)
            print("within", file=sys.stderr)
            time.sleep(0.1)
        time.sleep(0.25)
    before, after = capsys.readouterr().err.split("within\n")
    assert before.index("Outer") < before.index("Inner")
    assert "Outer" not in before[before.index("Inner") :]
    assert after.rindex("Inner") < after.rindex("Outer")
    assert "\n" not in before + after  # One line at a time


def test_what_is_said_meanwhile_has_a_line_of_its_own(capsys, monkeypatch):
    monkeypatch.setattr(progress, "DELAY_S", 0.0)
    with progress.status("Working"):
        time.sleep(0.2)
        with progress.cleared():
            print("a note", file=sys.stderr)
        time.sleep(0.1)
    line = capsys.readouterr().err.split("\n")[0]
    assert line.rpartition("\r")[2] == "a note"


def test_hidden_bars(capsys, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setattr(progress, "DELAY_S", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress.hidden(), progress_bar("Working", 3):
        time.sleep(0.1)
    assert capsys.readouterr().err == ""
    assert progress.is_watched()


_JUPYTER = """
import time
from tofrender.runtime import progress
progress.DELAY_S = 0.1
with progress.status("Starting"):
    time.sleep(0.4)
    with progress.progress_bar("Working", 8) as bar:
        bar.update(3)
        time.sleep(0.4)
"""


def test_in_a_notebook():
    """Widgets come and go while the cell runs, and none stays, in red, of work that ended early."""
    jupyter = pytest.importorskip("jupyter_client")
    manager = jupyter.KernelManager(kernel_name="python3")
    manager.start_kernel(cwd=str(processes.ROOT), stderr=subprocess.DEVNULL)
    try:
        client = manager.client()
        client.start_channels()
        client.wait_for_ready(60)
        asked = client.execute(_JUPYTER)
        said = []
        while True:
            message = client.get_iopub_msg(timeout=60)
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


def test_threads_end_with_their_bars():
    before = threading.active_count()
    for _ in range(20):
        with progress_bar("Working", 3), progress.status("Within"):
            pass
    time.sleep(0.1)
    assert threading.active_count() <= before


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
    thread.join(10)
    assert seen == [(before, False)]
