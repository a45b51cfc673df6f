"""Tests side by side, `pytest -n auto`: how many processes, and how many threads in each."""

import gc
import itertools
import os
import signal

import drjit as dr
import pytest

from tofrender.runtime import backend, memory

WORKER_BYTES = 2 << 30  # Memory of a process with tests and of what it starts [bytes]
FULL_COLLECTION = 40  # Tests from one full garbage collection to the next
_tests = itertools.count(1)
MOST = 8  # With more of them, the longest test of all decides


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """As many as there are cores, up to 8, fewer if memory is short; 0 instead of a single one."""
    count = min(cores(), MOST, memory.free_on_host() // WORKER_BYTES)
    return count if count > 1 else 0


def pytest_collection_finish() -> None:
    """Collect garbage between tests only, and spare the collector what collecting tests has made.

    Tests trace kernels of their own: a scene that is collected between two virtual calls of one
    kernel ends the process, see `backend.tracing_lock`.
    """
    gc.collect()
    gc.freeze()
    gc.disable()


def pytest_runtest_logfinish() -> None:
    """Collect what the test has left, now and then all garbage."""
    gc.collect(2 if next(_tests) % FULL_COLLECTION == 0 else 1)


def pytest_sessionstart() -> None:
    """Divide the cores among the processes; hear what background jobs and nohup ignore."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    count = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if count > 1:
        dr.set_thread_count(max(backend.LEAST_THREADS, cores() // count))
