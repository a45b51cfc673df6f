"""Renders on many processes or machines: a Dask scheduler hands pieces to workers.

A worker that dies costs the piece that it had, which another takes; one that takes ten times as
long as others is not waited for. The result is that of one process but for rounding.
"""

from __future__ import annotations

import math
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from ..runtime import backend, checks
from ..scenes.packing import packed, unpacked
from .pieces import Piece, Taken, take
from .store import Receipt, Store

if TYPE_CHECKING:
    from distributed import Client, Future

    from .job import Job

PATIENCE, LEAST_WAIT_S = 10.0, 60.0
"""A piece is given to a second worker after so many times the usual time, but not before [s]."""

THREADS = "TOFRENDER_THREADS"
"""Variable of a worker's environment with the number of threads that it renders on."""


@dataclass(frozen=True)
class Order:
    """What a worker needs to make the same job.

    Attributes:
        make: Makes a job of `arguments`; found by its name in the worker's own package.
        arguments: Plain values, by name.
        variant: Mitsuba's variant.
        bins: Number of the bins, their start and width [m].
        fingerprint: Of scene, sensor and integrator.
        key: Tells orders apart.
    """

    make: Callable[..., Job]
    arguments: Mapping[str, Any]
    variant: str
    bins: tuple[int, float, float]
    fingerprint: str
    key: str


def order_of(job: Job) -> Order:
    """A job as workers are told of it.

    Raises:
        ValueError: It holds an object that cannot be sent; one line.
    """
    assert job.origin is not None
    make, arguments = job.origin
    for name in ("integrator", "sampler"):
        if not isinstance(arguments.get(name), str | Mapping | None):
            kind = type(arguments[name]).__name__
            raise ValueError(f"{name} = {kind}: cannot be sent to workers; must be a name")
    film, mark = job.film, job.recipe["fingerprint"]
    bins = film.shape[2], film.start_opl, film.bin_width_opl
    sent = {name: packed(name, value) for name, value in arguments.items()}
    return Order(make, sent, mi.variant() or "", bins, mark, uuid.uuid4().hex)


@contextmanager
def local_workers(count: int, threads: int | None = None) -> Iterator[Client]:
    """A scheduler and workers on this machine, and a client of them.

    Args:
        count: Number of processes, 1 to 1024.
        threads: Threads of each; by default the cores are shared among them.

    Raises:
        ValueError: A number is out of range; one line.
        ImportError: The package distributed is missing; one line.
    """
    checks.integer("workers", count, 1, 1024)
    distributed = require_distributed()
    each = max(1, backend.cores() // count) if threads is None else threads
    with (
        distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            env={THREADS: str(each)},
            silence_logs="ERROR",
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@contextmanager
def workers_of(scheduler: str) -> Iterator[Client]:
    """A client of the workers of a scheduler, by its address.

    Raises:
        ValueError: None answers there; one line.
        ImportError: The package distributed is missing; one line.
    """
    distributed = require_distributed()
    try:
        client = distributed.Client(scheduler, timeout=10)
    except (OSError, ValueError, TimeoutError):
        raise ValueError(
            f"scheduler = {scheduler}: does not answer; must be an address like tcp://10.0.0.1:8786"
        ) from None
    with client:
        yield client


def require_distributed() -> Any:
    """The package distributed.

    Raises:
        ImportError: It is missing; one line that says how to get it.
    """
    try:
        import distributed
    except ImportError:
        raise ImportError("workers need dask: pip install 'tofrender[cluster]'") from None
    return distributed


def check_client(client: Any, versions: str) -> int:
    """The number of a client's workers, all of which have these versions.

    Raises:
        ValueError: There is no worker, or one has other versions; one line.
    """
    if not hasattr(client, "scheduler_info"):
        kind = type(client).__name__
        raise ValueError(f"client = {kind}: must be a distributed.Client")
    found = client.run(_versions_here)
    if not found:
        raise ValueError("client: has no workers; must have one")
    for worker, its in found.items():
        if its != versions:
            raise ValueError(f"client: worker {worker} has {its}; must have {versions}")
    return len(found)


def _versions_here() -> str:
    from .job import versions

    return versions()


def pieces_by_workers(
    client: Client, order: Order, pieces: list[Piece], folder: str | None = None
) -> Iterator[tuple[Piece, Taken | Receipt]]:
    """Have pieces rendered; gives each as it is done.

    Args:
        client: The workers.
        order: The job.
        pieces: What of it.
        folder: A film on disk that workers see too, and write to; without, pieces are sent back.

    Raises:
        RuntimeError: A piece cannot be rendered; one line that says why.
    """
    distributed, workers = require_distributed(), len(client.scheduler_info()["workers"])

    def ask(piece: Piece, again: int = 0) -> Future:
        return client.submit(_render, order, piece, folder, priority=again, pure=False)

    asked = {ask(piece): piece for piece in pieces}
    started, left, usual_s = time.monotonic(), set(pieces), math.inf
    try:
        while left:
            wait = max(LEAST_WAIT_S, PATIENCE * usual_s) if usual_s < math.inf else None
            done = _next(distributed, list(asked), wait)
            if not done:  # All that are out take much longer than the others did
                asked |= {ask(piece, 1): piece for piece in left}
                continue
            for future in done:
                piece = asked.pop(future)
                if future.status != "finished":
                    _raise(future)
                if piece in left:
                    left.remove(piece)
                    gone = time.monotonic() - started
                    usual_s = gone * workers / (len(pieces) - len(left))
                    yield piece, future.result()
    finally:
        client.cancel(list(asked), force=True)


def _next(distributed: Any, futures: list[Future], wait_s: float | None) -> set[Future]:
    """Those of some futures that are done; none if nothing was for a time [s]."""
    try:
        found = distributed.wait(futures, timeout=wait_s, return_when="FIRST_COMPLETED")
    except TimeoutError:
        return set()
    return found.done


def _raise(future: Future) -> None:
    error = future.exception()
    if type(error).__name__ == "KilledWorker":
        raise RuntimeError("several workers died of a piece; is their memory enough?")
    if isinstance(error, ValueError | MemoryError | OSError):
        raise error
    raise RuntimeError(f"a worker failed: {type(error).__name__}: {error}")


# ------------------------------------------------------------------------------- in a worker


def _render(order: Order, piece: Piece, folder: str | None) -> Taken | Receipt:
    """Render a piece here."""
    mi.set_variant(order.variant)
    job = _job(order)
    if folder is None:
        return take(job, piece, progress=False)
    store = Store(Path(folder))
    return store.receipt(piece) or store.put(piece, take(job, piece, progress=False))


_jobs: dict[str, Job] = {}


def _job(order: Order) -> Job:
    """The job of an order, kept for its next piece."""
    if order.key not in _jobs:
        _jobs.clear()
        backend.activate(order.variant)
        job = order.make(**unpacked(order.arguments), bins=order.bins)
        if job.recipe["fingerprint"] != order.fingerprint:
            raise ValueError("scene: differs on this worker's machine; must be the same there")
        if os.environ.get(THREADS):  # Only now, as Mitsuba reads files by several threads
            dr.set_thread_count(int(os.environ[THREADS]))
        _jobs[order.key] = job
    return _jobs[order.key]
