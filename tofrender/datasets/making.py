"""Make data sets: plan the arrays, render the records here or on workers, and write attributes."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi

from ..integrators.render_loop import stopped
from ..rendering.films_on_disk import require_zarr
from ..rendering.stored_film import check_film
from ..rendering.workers import check_client, distribute, kept_by_worker
from ..runtime import atomic, checks, variants
from ..runtime.progress import ProgressBar, deferred_stop, held_signals
from ..runtime.versions import versions
from ..scenes.fingerprint import file_digest
from ..scenes.packing import packed, unpacked
from .dataset_config import Config, parse_config, read_config
from .layout import DatasetLayout, DatasetPlan, layout_of
from .record import FACTOR, RecordReceipt, make_record
from .record_access import KIND, load_dataset
from .stored_records import StoredRecords

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client


def plan_dataset(
    config: str | os.PathLike[str] | Mapping[str, Any] | Config, only: Iterable[int] | None = None
) -> DatasetPlan:
    """Plan a data set: arrays, shapes and sizes. Nothing is rendered.

    Args:
        config: Name of a TOML file, or a mapping with the same keys, see docs/datasets.md.
        only: Numbers of the records; by default all.

    Returns:
        The plan. `print` shows its arrays.

    Raises:
        ValueError: The configuration is wrong.

    Example:
        >>> given = {"records": 100, "scene": "cornell_box", "outputs": {"depth": True}}
        >>> print(plan_dataset(given | {"render": {"width": 64, "height": 48}}))
        100 records of cornell_box; varied: nothing
        array  axes          shape          size
        depth  record, y, x  100 x 48 x 64  1.172 MiB
        in all 1.172 MiB
    """
    variants.require_vectorized()
    variants.require_unpolarized()
    found = read_config(config)
    records = _numbers(found, only)
    return DatasetPlan(found, records, layout_of(found, records))


def make_dataset(
    config: str | os.PathLike[str] | Mapping[str, Any] | Config,
    out: str | os.PathLike[str],
    *,
    only: Iterable[int] | None = None,
    client: Client | None = None,
    resume: bool = True,
    tell: Callable[[str], None] = print,
    again: str = "",
    progress: bool = True,
) -> xr.Dataset:
    """Render many scenes with varied cameras, lights, materials and objects into one data set.

    The draws and the renders of a record depend only on the seed of the configuration, the number
    of the record and the names of the quantities. Therefore each record can be made again
    separately. See also `load_dataset`.

    Args:
        config: Name of a TOML file, or a mapping with the same keys, see docs/datasets.md.
        out: Name of a new folder that ends in .zarr. The folder appears when all records are
            finished.
        only: Numbers of the records to make; by default all.
        client: A `distributed.Client`. Each of its workers makes one record at a time. The workers
            need access to the folder.
        resume: Whether to resume a run that was stopped or killed. Records with a correct checksum
            are kept. If this is False, an unfinished run is refused.
        tell: Function that is called with the plan, and with an estimate of the remaining time.
        again: How to resume, for the message of a run that was stopped.
        progress: Whether to show a progress bar for work that needs more than two seconds.

    Returns:
        The data set as `load_dataset` opens it.

    Raises:
        ValueError: The configuration is wrong, it differs from the configuration of the unfinished
            run, or a record cannot be made.
        FileExistsError: The folder exists, or `resume` is False and an unfinished run exists.
        OSError: The disk is too small.
        KeyboardInterrupt: The run was stopped. If records are missing, the message describes how to
            resume.
        ConnectionError: The scheduler of the workers was lost. The message is the same.

    Warns:
        UserWarning: Renders of some records issued warnings. The warning contains their number, and
            the first warning.

    Example:
        >>> import tempfile
        >>> given = {"records": 2, "scene": "cornell_box", "outputs": {"steady": True}}
        >>> given["render"] = {"width": 8, "height": 8, "spp": 4}
        >>> given["render"] |= {"temporal_bins": 60, "window": (3, 15)}
        >>> turn = {"turn": "small-box", "distribution": "uniform", "low": -45, "high": 45}
        >>> made = make_dataset(
        ...     given | {"vary": {"turn": turn}}, tempfile.mkdtemp() + "/boxes.zarr", tell=str
        ... )
        >>> dict(made["steady"].sizes)
        {'record': 2, 'y': 8, 'x': 8, 'channel': 3}
    """
    # Is there an unfinished run?
    target = check_film(out)
    require_zarr()
    folder = under_way(target)
    if StoredRecords.planned(folder) and not resume:
        raise FileExistsError(
            f"out = {out}: an unfinished data set is beside it, {folder}; must be gone on with "
            "(resume) or removed"
        )

    # Plan the data set
    plan = plan_dataset(config, only)
    if client is not None:
        check_client(client)
    tell(str(plan))

    with atomic.locked(target, "out"):
        # Is the disk large enough?
        written = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
        if shutil.disk_usage(atomic.existing_parent(folder)).free < plan.bytes - written:
            raise atomic.disk_full(folder, plan.bytes)

        # Find the records that are left
        with held_signals():
            store = StoredRecords.begin(folder, _recipe(plan), plan)
        receipts = {record: store.receipt(record) for record in plan.records}
        left = [record for record in plan.records if receipts[record] is None]
        count = len(plan.records)
        if len(left) < count:
            tell(f"resuming from {count - len(left)} of {count} records")

        # Make the records
        done = _make(plan, store, folder, client, left, receipts)
        started = time.perf_counter()
        with ProgressBar("Making", count, unit="record", enabled=progress) as bar:
            bar.update(count - len(left))
            try:
                for number, (record, receipt) in enumerate(done, 1):
                    receipts[record] = receipt
                    bar.update()
                    if number == 1 and len(left) > 1:
                        tell(_estimate(record, receipt, len(left), started, client))
            except (KeyboardInterrupt, ConnectionError) as error:
                finished = sum(receipt is not None for receipt in receipts.values())
                on = again or f"the same call goes on with {folder}"
                raise stopped(error, finished, count, "records", on) from None

        # Finish the data set, which is fast. If two workers made the same record, the
        # receipt on disk is the valid receipt
        with held_signals():
            found = {record: store.unchecked_receipt(record) for record in plan.records}
            store.finish(plan, found, _attributes(plan, found), target)
    _warn_of_records(found)
    return load_dataset(target)


def require_complete(
    config: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str],
    only: Iterable[int] | None = None,
) -> xr.Dataset:
    """Load a finished data set. Raise an error if its configuration or files have changed.

    Args:
        config: Description of the expected data set.
        out: Folder of the data set.
        only: Numbers of the expected records; by default all.

    Raises:
        ValueError: The configuration, the files, the variant or the records differ.
    """
    found = load_dataset(out)
    plan = plan_dataset(config, only)

    # Compare what the data set was made from
    wanted = {
        "config": json.dumps(plan.config.plain),
        "variant": mi.variant(),
        "checksum": _files_digest(plan),
    }
    other = [f"another {name}" for name, value in wanted.items() if found.attrs[name] != value]
    if found["record"].values.tolist() != plan.records:
        other.append("other records")
    if other:
        raise ValueError(f"out = {out}: is there, with {other[0]}; must be a new folder")
    return found


def under_way(out: str | os.PathLike[str]) -> Path:
    """Return the folder of an unfinished data set."""
    return atomic.sibling(out, ".dataset")


def _numbers(config: Config, only: Iterable[int] | None) -> list[int]:
    """Check and sort the numbers of records."""
    if only is None:
        return list(range(config.records))
    if isinstance(only, str | bytes) or not isinstance(only, Iterable):
        raise ValueError(f"only = {only!r}: must be numbers of records")
    found = sorted({checks.integer("only", record, 0, config.records - 1) for record in only})
    if not found:
        raise ValueError("only = []: must have one number or more")
    return found


def _recipe(plan: DatasetPlan) -> dict[str, Any]:
    """Return the values that must be equal if an unfinished data set is resumed."""
    layout = plan.layout
    return {
        "config": {name: value for name, value in plan.config.plain.items() if name != "records"},
        "records": plan.config.records,
        "checksum of the scene": plan.config.checksum,
        "shapes": {array.name: array.shape for array in layout.arrays},
        "window": layout.window,
        "variant": mi.variant(),
        "versions": json.loads(versions()),
        "only": plan.records,
        "checksum of scene and files": _files_digest(plan),
    }


def _files_digest(plan: DatasetPlan) -> str:
    """Return the checksum of the first scene and of all files that the configuration names."""
    names = sorted({text for text in _texts(plan.config.given) if "." in text})
    files = [plan.config.folder / name for name in names]
    parts = [plan.layout.scene, *(file_digest(file) for file in files if file.is_file())]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()[:16]


def _texts(value: Any) -> Iterator[str]:
    """Yield all texts in nested tables and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for each in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(each)


def _make(
    plan: DatasetPlan,
    store: StoredRecords,
    folder: Path,
    client: Client | None,
    left: list[int],
    receipts: Mapping[int, RecordReceipt | None],
) -> Iterator[tuple[int, RecordReceipt]]:
    """Make the remaining records, in this process or on workers.

    If all records share one factor from radiance to photons, they use the factor of record 0.
    """

    def make(records: list[int], factor: float | None) -> Iterator[tuple[int, RecordReceipt]]:
        if client is None:
            return _make_locally(plan, store, records, factor)
        task = _worker_task(plan, folder, factor)
        return distribute(client, partial(_make_on_worker, task), records)

    # Find the common factor
    factor = None
    if plan.config.shares_photons and left:
        # The receipt of each finished record contains the factor
        finished = [receipt for receipt in receipts.values() if receipt is not None]
        if finished:
            factor = finished[0].about[FACTOR]
        elif left[0] == 0:
            for record, receipt in make(left[:1], None):
                factor = receipt.about[FACTOR]
                yield record, receipt
            left = left[1:]
        else:
            factor = make_record(plan.config, plan.layout, 0)[1].about[FACTOR]

    # Make the records
    if left:
        yield from make(left, factor)


def _make_locally(
    plan: DatasetPlan, store: StoredRecords, records: list[int], factor: float | None
) -> Iterator[tuple[int, RecordReceipt]]:
    """Make records in this process."""
    for record in records:
        arrays, receipt = make_record(plan.config, plan.layout, record, factor)
        with deferred_stop() as stop:  # Write and count a complete record, or nothing
            receipt = store.write_part(record, arrays, receipt)
        yield record, receipt
        stop.take_effect()


def _estimate(record: int, receipt: RecordReceipt, count: int, started: float, client: Any) -> str:
    """Return a line with the time of the first record and an estimate of the remaining time."""
    rest_s = (count - 1) * receipt.seconds
    if client is not None:
        rest_s /= max(1, len(client.scheduler_info()["workers"]))
    elif (elapsed := time.perf_counter() - started) > receipt.seconds:
        rest_s = (count - 1) * elapsed
    return f"record {record} took {receipt.seconds:.1f} s; the others take about {_time(rest_s)}"


def _time(seconds: float) -> str:
    """Format a time in a suitable unit."""
    for unit, of in (("s", 60.0), ("min", 60.0), ("h", 48.0)):
        if seconds < of * 1.5:
            return f"{seconds:.2g} {unit}" if seconds < 9.5 else f"{seconds:.0f} {unit}"
        seconds /= 60 if unit != "h" else 24
    return f"{seconds:.0f} days"


def _attributes(plan: DatasetPlan, receipts: Mapping[int, RecordReceipt]) -> dict[str, Any]:
    """Return the attributes of a finished data set."""
    config = plan.config
    window = plan.layout.window
    found: dict[str, Any] = {
        "kind": KIND,
        "config": json.dumps(config.plain),
        "parameters": " ".join(config.varied),
        "seed": config.seed,
        "variant": mi.variant(),
        "versions": versions(),
        "checksum": _files_digest(plan),
        "render_seconds": sum(receipt.seconds for receipt in receipts.values()),
    }
    if window is not None:
        found |= {"start_opl": window[0], "bin_width_opl": window[1]}
    if config.outputs.capture is not None:
        found["capture_mode"] = plan.layout.capture_mode
    return found


def _warn_of_records(receipts: Mapping[int, RecordReceipt]) -> None:
    """Warn if renders issued warnings, with the first of the warnings."""
    texts = {record: receipt.warnings for record, receipt in receipts.items() if receipt.warnings}
    if texts:
        first = min(texts)
        warnings.warn(
            f"{len(texts)} of {len(receipts)} records came with warnings, which made_with has; the "
            f"first, of record {first}: {texts[first][0]}",
            stacklevel=3,
        )


@dataclass(frozen=True)
class WorkerTask:
    """Input of a worker that makes records."""

    given: Mapping[str, Any]  # configuration before the checks
    base: str  # folder to which names of files are relative
    layout: DatasetLayout
    folder: str  # folder of the unfinished data set
    checksum: str  # checksum of the scene
    photons_per_radiance: float | None  # factor of all records; None for a factor of each record
    variant: str = field(default_factory=lambda: mi.variant() or "")
    key: str = field(default_factory=lambda: uuid.uuid4().hex)


def _worker_task(plan: DatasetPlan, folder: Path, photons_per_radiance: float | None) -> WorkerTask:
    """Describe the work on the records of a plan."""
    config = plan.config
    given = {name: packed(name, value) for name, value in config.given.items()}
    if not isinstance(config.scene, Mapping):
        given["scene"] = str(config.scene)
    return WorkerTask(
        given=given,
        base=str(config.folder),
        layout=plan.layout,
        folder=str(folder.resolve()),
        checksum=config.checksum,
        photons_per_radiance=photons_per_radiance,
    )


def _make_on_worker(task: WorkerTask, record: int) -> RecordReceipt:
    """Make and store a record in a worker, unless another worker has stored the record."""
    config = kept_by_worker(task.key, task.variant, partial(_config_of, task))
    store = StoredRecords(Path(task.folder))
    receipt = store.receipt(record)
    if receipt is not None:
        return receipt
    arrays, receipt = make_record(config, task.layout, record, task.photons_per_radiance)
    return store.write_part(record, arrays, receipt)


def _config_of(task: WorkerTask) -> Config:
    """Read the configuration of a task in a worker."""
    given = {name: unpacked(value) for name, value in task.given.items()}
    config = parse_config(given, Path(task.base))
    if config.checksum != task.checksum:
        raise ValueError("scene: differs on this worker's machine; must be the same there")
    return config
