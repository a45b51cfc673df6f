"""`make bench-full`: error at equal time, scene by scene, compared with other renderers.

The measurements are stored in `benchmarks/results.json`. From this file, `docs/performance.md`, its
figure and the table of the README are written. `python -m benchmarks.full --write` only writes
these pages.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
import warnings
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import tofrender

from . import denoising, peers, report
from .case_lights import plain_pixels
from .case_nlos import letter
from .operations import operations, stale
from .six_scenes import SCENES, SIZE, Described, box
from .timing import in_turn, trace

SPP = 256
RESULTS = Path(__file__).with_name("results.json")
OFF = dict.fromkeys(("caustic_photons", "caustic_rays", "chain_rays", "shared_paths"), False)
"""Parameters of the integrator that switch all techniques off."""


def measured(draws: Mapping[str, peers.Draw], seeds: int) -> dict[str, Any]:
    """Render with several seeds, and return variance and mean of each bin, and CPU times."""
    stacks: dict[str, list[np.ndarray]] = {name: [] for name in draws}

    def draw(name: str) -> None:
        stacks[name].append(draws[name](len(stacks[name])))

    times = in_turn({name: partial(draw, name) for name in draws}, seeds)

    # The first render of each stack compiles
    found = {}
    for name, stack in stacks.items():
        cubes = np.stack(stack[1:]).astype(np.float64)
        found[name] = {"variance": cubes.var(axis=0, ddof=1), "mean": cubes.mean(axis=0)}
        found[name]["energies"] = cubes.sum(axis=(1, 2, 3, 4))
        found[name]["seconds"] = float(np.median(times[name].cpu))
    return found


def figures(found: Mapping[str, Any], plain: np.ndarray) -> dict[str, float]:
    """Compute variance times CPU time: all bins, without lamps, and relative to each bin."""
    variance = found["variance"]
    mean = found["mean"]
    seconds = found["seconds"]
    light = (mean[plain] ** 2).sum(axis=(0, 2))
    bins = light > 1e-4 * light.max()  # 1 % of the brightest bin's light
    relative = variance[plain].sum(axis=(0, 2))[bins] / light[bins]
    return {
        "cube": float(variance.mean() * seconds),
        "without lamps": float(variance[plain].mean() * seconds),
        "relative per bin": float(relative.mean() * seconds),
        "seconds": seconds,
    }


def table(seeds: int) -> dict[str, Any]:
    """Measure tofrender and mitransient in each scene."""
    rows = {}
    for name, scene in SCENES.items():
        # Choose the renderers
        described = scene()
        draws = {
            "ours": peers.bins(peers.ours(described), SPP),
            "without techniques": peers.bins(peers.ours(described, **OFF), SPP),
            "one light point": peers.bins(peers.ours(described, light_samples=1, **OFF), SPP),
            "mitransient": peers.bins(peers.mitransient(described), SPP),
        }

        # Measure them, with and without pixels that show a lamp
        found = measured(draws, seeds)
        plain = plain_pixels(tofrender.load_scene(described), lamps_alone=True)
        rows[name] = {who: figures(found[who], plain) for who in draws}
        rows[name]["pixels with lamps"] = int((~plain).sum())
        print(name, rows[name], flush=True)
    return rows


def filtered(seeds: int) -> dict[str, Any]:
    """Measure the gain of `denoise` in each scene."""
    rows = {}
    with TemporaryDirectory() as cache:
        for name in SCENES:
            rows[name] = denoising.measure(name, seeds, Path(cache))
            print(name, rows[name], flush=True)
    return rows


def samplers(seeds: int) -> dict[str, Any]:
    """Measure mitransient with each of Mitsuba's samplers: bias of energy, and error."""
    described = box()
    draws = {"ours": peers.bins(peers.ours(described), SPP)}
    for name in peers.SAMPLERS:
        draws[name] = peers.bins(peers.mitransient(described, name), SPP)
    found = measured(draws, seeds)
    plain = plain_pixels(tofrender.load_scene(described), lamps_alone=True)

    # Compare energies
    truth = found["ours"]["energies"]
    rows = {}
    for name in draws:
        energies = found[name]["energies"]
        rows[name] = figures(found[name], plain) | {
            "bias": float(energies.mean() / truth.mean() - 1),
            "bias error": float(
                np.hypot(energies.std(ddof=1), truth.std(ddof=1)) / seeds**0.5 / truth.mean()
            ),
        }
        print(name, rows[name], flush=True)
    return rows


def captures(seeds: int) -> dict[str, Any]:
    """Measure captures of a hidden letter, with all bounces."""
    rows = {}
    for mode, name in ((1, "single"), (2, "confocal")):
        own = tofrender.load_scene(letter("tofrender_", SIZE, mode), optimize=False)
        theirs = mi.load_dict(letter("", SIZE, mode), optimize=False)
        draws = {"ours": peers.bins(own, SPP), "mitransient": peers.bins(theirs, SPP)}
        found = measured(draws, seeds)
        everywhere = np.ones((SIZE, SIZE), dtype=bool)
        rows[name] = {who: figures(found[who], everywhere) for who in draws}
        print(name, rows[name], flush=True)
    return rows


def times(runs: int) -> dict[str, Any]:
    """Measure CPU time relative to `path`, for several sizes, bins and samples."""

    def ratios(described: Described, spp: int) -> dict[str, float]:
        scenes = {
            "path": peers.path(described),
            "one light point": peers.ours(described, light_samples=1, **OFF),
            "ours": peers.ours(described),
            "mitransient": peers.mitransient(described),
        }
        found = in_turn({name: trace(scene, spp) for name, scene in scenes.items()}, runs)
        return {name: found[name].ratio(found["path"])[1] for name in scenes}

    # Vary one quantity at a time
    rows: dict[str, Any] = {"size": {}, "bins": {}, "spp": {}}
    for size in (32, 64, 128, 256):
        rows["size"][size] = ratios(box(width=size, height=size), 64)
    for bins in (30, 300, 3000):
        more = {"temporal_bins": bins, "bin_width_opl": 6.0 / bins}
        rows["bins"][bins] = ratios(box(**more), 64)
    for spp in (16, 64, 256, 1024):
        rows["spp"][spp] = ratios(box(), spp)

    # Crop the film to the lower half, without the lamp
    lower = box(width=256, height=512)
    lower["sensor"]["film"] |= {"crop_offset_y": 256, "crop_width": 256, "crop_height": 256}
    rows["no lamp in view"] = ratios(lower, 64)
    print(rows, flush=True)
    return rows


def kernels() -> dict[str, list[int]]:
    """Count the operations of the large kernels of each scene, which show if figures are stale."""
    return {name: operations(peers.ours(scene())) for name, scene in SCENES.items()}


def commit() -> str:
    """Return the short hash of the present commit, with + if files have changed."""
    git = partial(subprocess.run, cwd=RESULTS.parent, check=True, capture_output=True, text=True)
    changed = git(["git", "status", "--porcelain", "--untracked-files=no"]).stdout
    return git(["git", "rev-parse", "--short=10", "HEAD"]).stdout.strip() + "+" * bool(changed)


def machine() -> dict[str, Any]:
    """Describe the machine and the versions."""
    from importlib.metadata import version

    processor = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        processor = models[0].partition(":")[2].strip() if models else processor
    packages = ["mitsuba", "drjit", "mitransient"]
    return {
        "processor": processor,
        "threads": dr.thread_count(),
        "cores": os.cpu_count(),
        "variant": mi.variant(),
        "versions": {"tofrender": tofrender.__version__}
        | {name: version(name) for name in packages},
    }


def main() -> None:
    """Run the command."""
    # Read the options
    parser = argparse.ArgumentParser(prog="python -m benchmarks.full", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the pages from results.json")
    parser.add_argument("--check", action="store_true", help="fail if the figures are stale")
    parser.add_argument("--kernels", action="store_true", help="print operations of kernels")
    parser.add_argument("--seeds", type=int, default=7, help="renders of each (7)")
    options = parser.parse_args()
    if options.seeds < 2:
        parser.exit(2, f"{parser.prog}: error: --seeds = {options.seeds}: must be 2 or more\n")
    warnings.simplefilter("ignore")  # Light outside of the window

    # Print or check operations
    if options.kernels:
        print(json.dumps(kernels()))
        return
    if options.check:
        changed = stale(json.loads(RESULTS.read_text(encoding="utf-8"))["operations"], kernels())
        if changed:
            parser.exit(
                1, "\n".join([f"{report.PAGE}: is stale; run `make bench-full`", *changed, ""])
            )
        return

    # Measure
    if not options.write and not peers.has("mitransient"):
        parser.exit(1, f"{parser.prog}: error: mitransient is not installed; run `make setup`\n")
    if not options.write:
        mi.set_log_level(mi.LogLevel.Error)
        start = time.perf_counter()
        results: dict[str, Any] = {"machine": machine(), "scenes": table(options.seeds)}
        results |= {"times": times(options.seeds), "samplers": samplers(options.seeds)}
        results |= {"captures": captures(options.seeds), "filtered": filtered(options.seeds)}
        alone = [sys.executable, "-m", "benchmarks.full", "--kernels"]  # Without other scenes
        output = subprocess.run(alone, check=True, capture_output=True, text=True).stdout
        results |= {"operations": json.loads(output), "commit": commit()}
        results["minutes"] = (time.perf_counter() - start) / 60
        RESULTS.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")

    # Write the pages
    report.write(json.loads(RESULTS.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
