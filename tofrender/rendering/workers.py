"""Renders on several processes or machines: a Dask scheduler sends work items to workers.

If a worker dies, another worker renders its item again. If an item needs ten times as long as
usual, a second worker also renders it. The result equals the result of one process up to rounding.
"""

from __future__ import annotations

import math
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import drjit as dr
import mitsuba as mi

from ..runtime import backend, checks, gpu
from ..runtime.child_processes import safe_children
from ..runtime.versions import versions
from ..scenes.packing import packed, unpacked
from .job import WorkItem, WorkResult
from .settings import MAX_WORKERS, SETTINGS
from .stored_film import StoredFilm, TileReceipt

if TYPE_CHECKING:
    from distributed import Client, Future

    from .job import Job

# An item is sent to a second worker after this multiple of the usual time
PATIENCE = 10.0

# Shortest time before an item is sent to a second worker [s]
LEAST_WAIT_S = 60.0

# Longest time until a scheduler answers [s]
ANSWER_S = 10.0

# Lowest level of log messages of workers that are printed
SILENT = "CRITICAL"

# Time between two checks whether any worker is alive, while no item is finished [s]
POLL_S = 2.0

# Time until a worker that does not start again is removed
RESTART_TIMEOUT = "10 minutes"

Item = TypeVar("Item")
Result = TypeVar("Result")
Made = TypeVar("Made")

# Environment variable of a worker that contains its number of threads
THREADS = "TOFRENDER_THREADS"


@dataclass(frozen=True)
class Order:
    """Description of a job that is sent to workers, which make the same job from it."""

    # Functions that make a job from `arguments`, and render an item of the job. They are pickled by
    # name, so workers use the functions of their installed package
    make: Callable[..., Job]
    render_item: Callable[[Job, Any], Any]

    # Arguments of `make` as plain values, by name
    arguments: Mapping[str, object]

    # Mitsuba's variant
    variant: str

    # Number, start and width [m] of the time bins
    axis: tuple[int, float, float]

    # Fingerprint of scene, sensor and integrator
    fingerprint: str

    # Film on disk that the workers write to. Without a folder, the workers return their results
    folder: str | None

    # Unique text for each order
    key: str

    @classmethod
    def of(cls, job: Job, folder: Path | None, render_item: Callable[[Job, Any], Any]) -> Order:
        """Return the order for a job.

        Args:
            job: The job.
            folder: Film on disk that the workers write to, or None.
            render_item: Function that renders an item of the job.

        Raises:
            ValueError: An argument of the job cannot be sent to workers.
        """
        # Can the integrator and the sampler be sent?
        make, arguments = job.origin
        for name in ("integrator", "sampler"):
            if not isinstance(arguments.get(name), str | Mapping | None):
                kind = type(arguments[name]).__name__
                raise ValueError(f"{name} = {kind}: cannot be sent to workers; must be a name")

        film = job.film
        return cls(
            make=make,
            render_item=render_item,
            arguments={name: packed(name, value) for name, value in arguments.items()},
            variant=mi.variant() or "",
            axis=(film.shape[2], film.start_opl, film.bin_width_opl),
            fingerprint=job.recipe["fingerprint"],
            folder=None if folder is None else str(folder.resolve()),
            key=uuid.uuid4().hex,
        )

    def render(self, item: WorkItem) -> WorkResult | TileReceipt:
        """Render a work item in a worker. Return its result, or the receipt of its tile on disk."""
        job = kept_by_worker(self.key, self.variant, self._make_job)
        if self.folder is None:
            return self.render_item(job, item)

        # Another worker may have rendered the tile already
        store = StoredFilm(Path(self.folder))
        return store.receipt(item) or store.write(item, self.render_item(job, item))

    def _make_job(self) -> Job:
        """Make the job in a worker.

        Raises:
            ValueError: The worker's scene differs from the client's scene, for example because a
                file has other contents.
        """
        job = self.make(**unpacked(self.arguments), axis=self.axis)
        if job.recipe["fingerprint"] != self.fingerprint:
            raise ValueError("scene: differs on this worker's machine; must be the same there")
        return job


@contextmanager
def local_workers(count: int, threads: int | None = None) -> Iterator[Client]:
    """Start a scheduler and workers on this machine, and yield a client.

    The processes listen only on the loopback interface. They use TLS with a temporary certificate.
    Without this certificate, other processes cannot connect. With a `cuda_*` variant, each worker
    uses one GPU.

    Args:
        count: Number of processes, 1 to 1024. With GPUs, at most the number of GPUs.
        threads: Threads of each process, 1 to 1024. By default, the processes share the cores.

    Raises:
        ValueError: A number is out of range.
        ImportError: The package distributed or cryptography is missing.
        RuntimeError: A worker cannot start. One line describes the cause.
    """
    # Check the arguments
    checks.integer("count", count, 1, MAX_WORKERS)
    if threads is not None:
        checks.integer("threads", threads, 1, MAX_WORKERS)
    visible = visible_devices(count)
    distributed = require_distributed()
    import dask.config

    # Configure Dask. The web servers cannot be disabled, so remove all their pages
    each = max(1, backend.cores() // count) if threads is None else threads
    settings = {
        "distributed.deploy.lost-worker-timeout": RESTART_TIMEOUT,
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))

        # Child processes must not import from the working folder: workers, their resource tracker,
        # and workers that start again later
        stack.enter_context(safe_children())

        # Start the workers, and report the first cause of an error
        try:
            cluster = _cluster([{THREADS: str(each)} | each_visible for each_visible in visible])
        except RuntimeError as error:
            cause: BaseException = error
            while cause.__cause__ is not None:
                cause = cause.__cause__
            raise RuntimeError(f"workers: cannot start: {cause}") from None
        yield stack.enter_context(distributed.Client(stack.enter_context(cluster)))


def visible_devices(count: int) -> list[dict[str, str]]:
    """Return environment variables for each worker, so that no two workers share a GPU.

    The variables are empty under variants that render on the CPU.

    Raises:
        ValueError: There are fewer GPUs than workers.
    """
    backend_name = gpu.backend_of(mi.variant())
    if backend_name is None:
        return [{} for _ in range(count)]

    # Metal uses one GPU, and CUDA uses all GPUs that are visible to this process
    devices = gpu.devices() if backend_name == gpu.CUDA else ["0"]
    if count > max(1, len(devices)):
        raise ValueError(
            f"workers = {count}: must be at most {max(1, len(devices))}, the number of GPUs; a GPU "
            "is not faster with more workers. Use fewer, or an llvm_* variant"
        )
    if backend_name == gpu.METAL or not devices:
        return [{} for _ in range(count)]
    return [{"CUDA_VISIBLE_DEVICES": device} for device in devices[:count]]


def _cluster(environments: Sequence[Mapping[str, str]]) -> Any:
    """Start a scheduler and a worker for each environment, on the loopback interface."""
    distributed = require_distributed()
    from distributed.system import MEMORY_LIMIT

    # Options of the scheduler and of all workers
    shared = {
        "host": "127.0.0.1",
        "protocol": "tls://",
        "security": distributed.Security.temporary(),
        "dashboard": False,
    }

    # Without an address, the scheduler would use port 8787, which may be occupied
    scheduler = shared | {"port": 0, "dashboard_address": "127.0.0.1:0"}
    worker = shared | {
        "nthreads": 1,
        "memory_limit": MEMORY_LIMIT // len(environments),
        "preload": [_START.format(mi.variant())],
        "silence_logs": SILENT,
    }

    # A worker that dies starts again with its own environment
    workers = {
        number: {"cls": distributed.Nanny, "options": worker | {"env": dict(environment)}}
        for number, environment in enumerate(environments)
    }
    return distributed.SpecCluster(
        workers=workers,
        scheduler={"cls": distributed.Scheduler, "options": scheduler},
        security=shared["security"],
        silence_logs=SILENT,
    )


@contextmanager
def workers_of(scheduler: str) -> Iterator[Client]:
    """Connect to a scheduler by its address, and yield a client.

    Raises:
        ValueError: The scheduler does not answer.
    """
    distributed = require_distributed()
    from distributed.utils import silence_logging_cmgr

    with silence_logging_cmgr("CRITICAL"):
        try:
            client = distributed.Client(scheduler, timeout=ANSWER_S)
        except (OSError, ValueError, TimeoutError):
            raise ValueError(
                f"scheduler = {scheduler}: does not answer; must be an address like "
                "tcp://10.0.0.1:8786"
            ) from None
        with client:
            yield client


def workers_for(
    workers: int | None, scheduler: str | None
) -> AbstractContextManager[Client | None]:
    """Return a context with a client of local processes, or of the workers of a scheduler.

    The context contains None if both arguments are None.
    """
    if workers is not None:
        return local_workers(workers)
    return nullcontext() if scheduler is None else workers_of(scheduler)


def check_workers(**given: object) -> bool:
    """Return whether one of `workers`, `scheduler` and `client` is set, and check its value.

    Raises:
        ValueError: More than one of the three is set, or the value is wrong.
    """
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise ValueError(f"{names[1]}: must be left out with `{names[0]}`")
    for name in names:
        if name in SETTINGS:
            SETTINGS[name].check(name, given[name])
        else:
            require_client(given[name])
    return bool(names)


def require_distributed() -> Any:
    """Return the package distributed.

    Raises:
        ImportError: The package distributed or cryptography is not installed.
    """
    try:
        import cryptography  # noqa: F401  # for certificates
        import distributed
    except ImportError as error:
        raise ImportError(f"workers need {error.name}: pip install 'tofrender[cluster]'") from None
    return distributed


def require_client(client: object) -> Any:
    """Return the client if it is connected; otherwise raise a ValueError."""
    kind = require_distributed().Client
    found = checks.instance("client", client, kind, "a distributed.Client")
    if found.asynchronous or found.status != "running":
        raise ValueError(f"client = {checks.quote(found)}: must be connected, and not asynchronous")
    return found


def check_client(client: object) -> int:
    """Check that all workers of a client can render, and return the number of workers.

    Workers that end during the check are ignored, because they start again.

    Raises:
        ValueError: The client has no workers, or package versions of a worker differ.
        RuntimeError: A worker cannot render.
    """
    # Ask all workers for their versions, and ignore workers that were lost
    checked = require_client(client)
    lost = require_distributed().comm.CommClosedError
    own = versions()
    found = checked.run(versions, on_error="return")
    found = {worker: its for worker, its in found.items() if not isinstance(its, lost)}
    if not found:
        raise ValueError("client: has no workers; must have one")

    # Are the versions equal?
    for worker, its in found.items():
        if not isinstance(its, Exception) and its != own:
            raise ValueError(f"client: worker {worker} has {its}; must have {own}, as the client")

    # Can all workers activate the variant?
    active = checked.run(backend.activate, mi.variant(), on_error="return")
    for worker, its in [*found.items(), *active.items()]:
        if isinstance(its, Exception) and not isinstance(its, lost):
            raise RuntimeError(f"client: worker {worker} cannot render: {its}")
    return len(found)


def render_by_workers(
    client: Client,
    job: Job,
    items: Sequence[Item],
    render_item: Callable[[Any, Item], Any],
    folder: Path | None = None,
) -> Iterator[tuple[Item, Any]]:
    """Let workers render the items of a job.

    Args:
        client: The client of the workers.
        job: The job.
        items: The items.
        render_item: Function that renders an item of the job. It must be importable by name.
        folder: Film on disk that the workers write to. With a folder, the results are receipts.

    Yields:
        Each item with its result, when it is finished.
    """
    return distribute(client, partial(Order.render, Order.of(job, folder, render_item)), items)


def distribute(
    client: Client, work: partial[Result], items: Sequence[Item]
) -> Iterator[tuple[Item, Result]]:
    """Let workers process items, and yield each item with its result when it is finished.

    Args:
        client: The client of the workers.
        work: Function of an item.
        items: The items.

    Raises:
        ConnectionError: The scheduler or all workers are lost.
        RuntimeError: A worker failed.
    """
    workers = len(client.scheduler_info()["workers"])

    def submit(item: Item, priority: int = 0) -> Future:
        """Send an item to the scheduler."""
        return client.submit(work.func, *work.args, item, priority=priority, pure=False)

    pending = {submit(item): item for item in items}

    # The usual time of an item is unknown until the first item is finished
    started = time.monotonic()
    left = set(items)
    usual_s = math.inf
    try:
        while left:
            # Wait for the next items
            wait = max(LEAST_WAIT_S, PATIENCE * usual_s) if usual_s < math.inf else None
            done = _next(client, list(pending), wait)

            # If the remaining items need much longer than usual, send them to other workers too
            if not done:
                pending |= {submit(item, 1): item for item in left}
                continue

            for future in done:
                item = pending.pop(future)
                if future.status == "error":
                    _raise(future)
                if future.status != "finished":
                    # The worker died, and the scheduler sends the item to another worker
                    pending[future] = item
                elif item in left:
                    # Yield the first result of the item, and update the usual time
                    left.remove(item)
                    usual_s = (time.monotonic() - started) * workers / (len(items) - len(left))
                    yield item, future.result()
    except Exception as error:
        # Was the connection lost?
        if client.status == "running" and not isinstance(error, CancelledError):
            raise
        raise ConnectionError("the scheduler of the workers is lost") from None
    finally:
        # Cancel items that a second worker still renders
        if client.status == "running":
            client.cancel(list(pending), force=True)


def _next(client: Client, futures: list[Future], wait_s: float | None) -> set[Future]:
    """Wait for a future, and return all futures that are done.

    Args:
        client: The client of the workers.
        futures: The futures.
        wait_s: Longest time [s]. Afterwards, the function returns an empty set. None for no limit.
    """
    distributed = require_distributed()
    until = time.monotonic() + (math.inf if wait_s is None else wait_s)
    while (left_s := until - time.monotonic()) > 0:
        try:
            wait = distributed.wait(futures, min(POLL_S, left_s), return_when="FIRST_COMPLETED")
            return wait.done
        except TimeoutError:
            # Is any worker alive?
            _require_workers(client)
    return set()


def _require_workers(client: Client) -> None:
    """Raise a ConnectionError if all workers of this machine have ended and cannot start again."""
    cluster: Any = client.cluster
    if isinstance(cluster, require_distributed().SpecCluster) and all(
        worker.status.name in ("closed", "failed") for worker in cluster.workers.values()
    ):
        raise ConnectionError("all workers are lost, and none can start again")


def _raise(future: Future) -> None:
    """Raise the error of a future as an error with one line."""
    error = future.exception()
    if type(error).__name__ == "KilledWorker":
        raise RuntimeError("several workers died of a piece; is their memory enough?")
    if isinstance(error, ValueError | MemoryError | OSError):
        raise error
    raise RuntimeError(f"a worker failed: {type(error).__name__}: {error}")


# Preload script of a local worker. If the command `tofrender` started the worker, the script sees
# its `sys.argv`, so an import of tofrender does not activate a variant
_START = """
refused = None
try:
    from tofrender.runtime import backend
    backend.activate({!r})
except Exception as error:
    refused = str(error)
if refused is not None:  # Its own error cannot be sent: the package could not be imported
    raise RuntimeError(refused)
"""

# Job of the current order in this worker, by the order's key
_kept: dict[str, Any] = {}


def kept_by_worker(key: str, variant: str, make: Callable[[], Made]) -> Made:
    """Return an object that a worker makes once for all items with the same key.

    Args:
        key: Key of the items. The object of another key is deleted.
        variant: Mitsuba's variant, which is activated.
        make: Function that loads what the items need, for example a job.
    """
    if key not in _kept:
        _kept.clear()
        backend.activate(variant)
        made = make()

        # Mitsuba reads files with several threads, so the number is set afterwards
        if os.environ.get(THREADS):
            dr.set_thread_count(int(os.environ[THREADS]))
        _kept[key] = made
    mi.set_variant(variant)
    return _kept[key]
