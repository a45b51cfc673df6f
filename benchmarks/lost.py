"""`make bench-lost`: cost of checkpoints, of films on disk, and of workers.

Each figure is measured in separate processes. The figures are stored in `benchmarks/lost.json`, and
the table of `docs/checkpoints.md` is written. `python -m benchmarks.lost --write` only writes the
table.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

RESULTS = Path(__file__).with_name("lost.json")
LARGE = {"width": 512, "height": 512, "temporal_bins": 2000}
USUAL = {"width": 256, "height": 256, "temporal_bins": 300}
LARGE_SPP = 16
USUAL_SPP = 64
WORKERS_TIMES = 4  # Factor of samples with workers, so that fixed costs of a render are small
INTERVAL_S = 30.0
COST = 0.02
BEGIN = "<!-- made by make bench-lost -->"
MODEL = "<!-- its model -->"
END = "<!-- end -->"
FILMS = 1_000_000
WORKERS = 1000
DISK_MB_PER_S = 1000

Found = dict[str, float]


def box(size: dict[str, int]) -> dict[str, Any]:
    """Describe the Cornell box with bins from 3.5 m to 19.5 m."""
    import tofrender

    return tofrender.cornell_box(**size, start_opl=3.5, bin_width_opl=16 / size["temporal_bins"])


def peak_mb() -> float:
    """Return the peak memory of this process [MB]."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 * 1.048576


# ------------------------------------------------- cases, each in a separate process


def in_memory(size: dict[str, int], spp: int) -> Found:
    """Render in memory."""
    import tofrender

    scene = box(size)
    start = time.perf_counter()
    tofrender.render(scene, spp=spp, progress=False)
    return {"seconds": time.perf_counter() - start, "peak_mb": peak_mb()}


def on_disk(size: dict[str, int], spp: int) -> Found:
    """Render to disk."""
    import tofrender

    scene = box(size)
    folder = tempfile.mkdtemp(dir=".")
    try:
        start = time.perf_counter()
        tofrender.render(scene, spp=spp, out=f"{folder}/film.zarr", progress=False)
        return {"seconds": time.perf_counter() - start, "peak_mb": peak_mb()}
    finally:
        shutil.rmtree(folder)


def saving() -> Found:
    """Measure the time to save a checkpoint of a usual film."""
    import tofrender

    spent: list[float] = []

    class Timed(tofrender.Checkpoint):
        def save(self, *arguments: Any) -> None:
            start = time.perf_counter()
            super().save(*arguments)
            spent.append(time.perf_counter() - start)

    folder = tempfile.mkdtemp(dir=".")
    try:
        checkpoint = Timed(f"{folder}/film.npz", seconds=1e-6)
        tofrender.render(box(USUAL), spp=256, checkpoint=checkpoint, progress=False)
        return {"save_s": median(spent), "saves": len(spent)}
    finally:
        shutil.rmtree(folder)


def by_workers() -> Found:
    """Compare two workers with this process, all with one thread."""
    import drjit as dr

    import tofrender

    scene = box(USUAL)
    window = (3.5, 19.5)
    spp = WORKERS_TIMES * USUAL_SPP
    alone: list[float] = []
    shared: list[float] = []
    dr.set_thread_count(1)
    with tofrender.local_workers(2, threads=1) as client:
        for run in range(4):
            for times, more in ((alone, {}), (shared, {"client": client})):
                start = time.perf_counter()
                tofrender.render(scene, spp=spp, seed=run, window=window, progress=False, **more)
                times.append(time.perf_counter() - start)
    ratios = [a / b for a, b in zip(alone[1:], shared[1:], strict=True)]  # The first runs compile
    return {"speed": median(ratios), "alone_s": median(alone[1:]), "shared_s": median(shared[1:])}


CASES: dict[str, Callable[[], Found]] = {
    "usual film in memory": lambda: in_memory(USUAL, USUAL_SPP),
    "large film in memory": lambda: in_memory(LARGE, LARGE_SPP),
    "large film on disk": lambda: on_disk(LARGE, LARGE_SPP),
    "saving": saving,
    "workers": by_workers,
}


# ------------------------------------------------------------------------------ the table


def film_mb(size: dict[str, int]) -> float:
    """Return the size of a film with float32 RGB bins [MB]."""
    return size["width"] * size["height"] * size["temporal_bins"] * 12 / 1e6


def table(results: dict[str, Any]) -> str:
    """Return the table of measurements in Markdown."""
    from .report import digits, rows_of

    found = results["found"]
    usual, disk, memory = (
        found[f"{name}"]
        for name in ("usual film in memory", "large film on disk", "large film in memory")
    )
    saved = found["saving"]
    every_s = max(INTERVAL_S, saved["save_s"] / COST)  # This is the rule of `Checkpoint`
    rows = [
        ["quantity", "target", "measured"],
        [
            "256 x 256 x 300 RGB: time spent on checkpoints",
            "<= 2 %, each 30 s",
            f"{digits(100 * saved['save_s'] / every_s)} %, each {every_s:.0f} s "
            f"(one takes {digits(saved['save_s'])} s)",
        ],
        [
            f"512 x 512 x 2000 RGB ({film_mb(LARGE) / 1000:.1f} GB) on disk: peak memory",
            "< 2 GB",
            f"{disk['peak_mb'] / 1000:.1f} GB (in memory {memory['peak_mb'] / 1000:.1f} GB)",
        ],
        [
            "the same film: time on disk / time in memory",
            "<= 1.3",
            f"{digits(disk['seconds'] / memory['seconds'])} "
            f"({disk['seconds']:.0f} s, {memory['seconds']:.0f} s)",
        ],
        [
            "speed-up of two workers over one process, one thread each",
            ">= 1.9",
            f"{digits(found['workers']['speed'])} in a render of "
            f"{found['workers']['alone_s']:.0f} s",
        ],
        [
            "256 x 256 x 300 RGB: peak memory beyond the result",
            "<= 350 MB",
            f"{usual['peak_mb'] - film_mb(USUAL):.0f} MB",
        ],
    ]
    return rows_of(rows)


def model(results: dict[str, Any]) -> str:
    """Return a table that extrapolates from one film to a million films."""
    from .report import digits, rows_of

    size = film_mb(USUAL)
    one_s = results["found"]["workers"]["alone_s"] / WORKERS_TIMES
    written_s = size / DISK_MB_PER_S
    rows = [
        ["", "a film of 256 x 256 x 300 RGB", "a million of them"],
        ["size", f"{size:.0f} MB", f"{size * FILMS / 1e6:.0f} TB"],
        [
            f"{USUAL_SPP} samples per pixel",
            f"{digits(one_s)} s on one core",
            f"{digits(one_s * FILMS / WORKERS / 3600)} hours on {WORKERS} cores",
        ],
        [
            f"writing to a disk of {DISK_MB_PER_S / 1000:g} GB/s",
            f"{digits(written_s)} s",
            f"{digits(written_s * FILMS / 3600)} hours",
        ],
        [
            f"data rate of {WORKERS} cores",
            f"{digits(size / one_s)} MB/s each",
            f"{digits(WORKERS * size / one_s / 1000)} GB/s",
        ],
    ]
    return rows_of(rows)


def origin(results: dict[str, Any]) -> str:
    """Return where the figures were measured, and at which commit if the results contain it."""
    machine = results["machine"]
    text = f"Measured on {machine['processor']} with {machine['threads']} threads"
    if "commit" in results:
        text += f", at commit {results['commit']}"
    return f"{text}."


def with_tables(text: str, results: dict[str, Any]) -> str:
    """Replace the tables of the page."""
    measured = f"{table(results)}\n\n{origin(results)}"
    for begin, rows in ((BEGIN, measured), (MODEL, model(results))):
        block = f"{begin}\n{rows}\n{END}"
        text = re.sub(f"{begin}.*?{END}", lambda _, block=block: block, text, flags=re.DOTALL)
    return text


def write(results: dict[str, Any]) -> None:
    """Write the tables to the page."""
    page = RESULTS.parents[1] / "docs" / "checkpoints.md"
    page.write_text(with_tables(page.read_text(encoding="utf-8"), results), encoding="utf-8")


def main() -> None:
    """Run the command."""
    # Read the options
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lost", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the table from lost.json")
    parser.add_argument("--runs", type=int, default=3, help="processes of each (3)")
    parser.add_argument("--one", choices=CASES, help=argparse.SUPPRESS)
    options = parser.parse_args()

    # Run one case in this process
    if options.one:
        warnings.simplefilter("ignore")  # Light outside of the window
        print(json.dumps(CASES[options.one]()))
        return
    if not options.write:
        from .full import commit, machine

        # Run each case in separate processes
        runs: dict[str, list[Found]] = {name: [] for name in CASES}
        for _ in range(options.runs):
            for name in CASES:
                command = [sys.executable, "-m", "benchmarks.lost", "--one", name]
                done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
                runs[name].append(json.loads(done.stdout.splitlines()[-1]))
                print(name, runs[name][-1], flush=True)

        # Store the medians
        found = {
            name: {key: median(run[key] for run in its) for key in its[0]}
            for name, its in runs.items()
        }
        text = json.dumps({"machine": machine(), "commit": commit(), "found": found}, indent=1)
        RESULTS.write_text(text + "\n", encoding="utf-8")
    write(json.loads(RESULTS.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
