"""The case `gradients`: derivatives compared with closed forms, differences and other renderers."""

from __future__ import annotations

import json
import logging
import math
import multiprocessing
import subprocess
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from . import peers
from .misuka_sphere import closed_form
from .timing import Row

COLUMNS = (
    "parameter",
    "scene",
    "of",
    "closed form",
    "forward",
    "reverse",
    "differences",
    "mitransient",
)
NOISY_DIFFERENCES = {"index": 64}
"""Factors of the samples of differences. With another index, samples may change their branch."""


def gradients(runs: int, quick: bool) -> list[Row]:
    """Compare forward mode with closed forms [%], and print a table in Markdown.

    The table contains means over seeds, with the standard error of the last digits in brackets.
    mitransient renders the same scenes if it supports them. misuka renders a separate sphere.
    """
    from tofrender.integrators.differentiable import VisibilityWarning

    warnings.simplefilter("ignore", VisibilityWarning)  # The scenes have no edges in view
    seeds = range(1, 3 if quick else max(runs, 16) + 1)
    rows: list[Row] = []
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    for case in _table():
        case_rows = _rows(case, seeds)
        for name, cells, off in case_rows:
            print("| " + " | ".join([case.row, case.scene, name, *cells]) + " |", flush=True)
            rows.append((f"{case.name}, {name}: forward off its form [%]", off, 0.5))
    print(_misuka(len(seeds)), flush=True)
    return rows


def _table() -> Any:
    """Import the scenes and the closed forms of the tests."""
    folder = str(Path(__file__).parents[1] / "tests")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    from helpers.gradient_cases import TABLE

    return TABLE


def _rows(case: Any, seeds: range) -> list[tuple[str, list[str], float]]:
    """Return name, cells of the table, and deviation [%] for each measure of a case."""
    from helpers.gradient_of import differences, forward, reverse

    # Estimate by forward mode, by differences and by mitransient
    _, change = case.expected()
    weights = case.weights()
    more = NOISY_DIFFERENCES.get(case.row, 1)
    ahead = _samples(lambda seed: forward(case, seed=seed), seeds)
    apart = _samples(lambda seed: differences(case, more * case.spp, seed), seeds[:8])
    theirs = _apart(case.name, seeds)

    # Estimate each measure in reverse mode, and compare with the closed form
    rows = []
    for name, each in weights.items():
        exact = float(each @ change)
        back = _samples(lambda seed, each=each: np.array(reverse(case, each, seed=seed)), seeds)
        cells = [f"{exact:.6g}"]
        cells += [_cell(found, each) for found in (ahead, back, apart, theirs)]
        off = math.nan
        if not isinstance(ahead, str):
            off = abs((ahead @ each).mean() / exact - 1) * 100
        rows.append((name, cells, off))
    return rows


def _samples(estimate: Callable[[int], np.ndarray], seeds: range) -> np.ndarray | str:
    """Return the estimates of all seeds, or one line with the reason for missing estimates."""
    try:
        return np.stack([estimate(seed) for seed in seeds])
    except Exception as error:  # Another renderer may raise anything
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        text = (str(cause).strip().splitlines() or [type(cause).__name__])[0]
        return "none: " + ("nothing is attached" if "not attached" in text else text[:60])


def _apart(name: str, seeds: range) -> np.ndarray | str:
    """Estimate a case with mitransient in a separate process.

    Otherwise its scenes would stay in memory, and Dr.Jit would ask all of them for changes.
    """
    spawned = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(1, spawned) as pool:
            return pool.submit(_theirs, name, seeds, str(mi.variant())).result()
    except BrokenProcessPool:
        return "none: its process ended"


def _theirs(name: str, seeds: range, variant: str) -> np.ndarray | str:
    """Estimate a case with mitransient in this process."""
    from tofrender.runtime import backend

    backend.activate(variant)
    logging.getLogger().setLevel(logging.ERROR)
    mi.set_log_level(mi.LogLevel.Error)
    case = next(case for case in _table() if case.name == name)
    return _samples(lambda seed: _mitransient(case, seed), seeds)


def _cell(found: np.ndarray | str, weights: np.ndarray) -> str:
    """Format mean and standard error, for example as 0.0325(2)."""
    if isinstance(found, str):
        return found
    values = found @ weights if found.ndim > 1 else found
    return with_error(float(values.mean()), float(values.std(ddof=1) / math.sqrt(values.size)))


def with_error(mean: float, error: float) -> str:
    """Format a mean, with the standard error of its last digit in brackets.

    `with_error(0.032504, 0.0000012)` is `0.0325040(12)`.
    """
    if not math.isfinite(mean) or not math.isfinite(error):
        return f"{mean:g}({error:g})"
    if error <= 1e-6 * abs(mean):
        return f"{mean:.6g}"
    digits = max(1 - math.floor(math.log10(error)), 0)
    return f"{mean:.{digits}f}({error * 10**digits:.0f})"


def _mitransient(case: Any, seed: int) -> np.ndarray:
    """Differentiate the bins in forward mode, with mitransient's plugins and without a pulse."""
    # Does mitransient support the case?
    if not peers.has("mitransient"):
        raise RuntimeError("not run here: it is not installed")
    described = case.describe()
    integrator = described["integrator"]
    if integrator["type"] != "transient_path" or not hasattr(case.seen, "centers"):
        raise RuntimeError("not run: needs this package's plugins")
    if case.of_pulse:
        raise RuntimeError("has no pulse")

    # Load the scene
    kept = {k: v for k, v in integrator.items() if k in ("type", "max_depth", "rr_depth")}
    described = described | {"integrator": kept}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = _their_scene(described)

    # Differentiate
    parameters = mi.traverse(loaded)
    theta = mi.Float(case.theta)
    dr.enable_grad(theta)
    case.set(parameters, theta)
    transient = mi.render(loaded, parameters, spp=case.spp, seed=mi.UInt32(seed))[1]
    dr.forward(theta)
    return case.mean(dr.grad(transient))


def _their_scene(described: dict[str, Any]) -> mi.Scene:
    """Load a scene with mitransient's plugins, then restore the plugins of this package."""
    import mitransient  # noqa: F401 (must be whole before its parts)
    from helpers.peer_scenes import give_names_back
    from mitransient.films.transient_hdr_film import TransientHDRFilm
    from mitransient.integrators.transientpath import TransientPath

    mi.register_integrator("transient_path", lambda props: TransientPath(props))
    mi.register_film("transient_hdr_film", lambda props: TransientHDRFilm(props))
    try:
        return peers.mitransient(described)
    finally:
        give_names_back()


def _misuka(seeds: int) -> str:
    """Return the table of misuka, or the reason why it is missing.

    misuka runs in a separate process, because it contains another Mitsuba.
    """
    if not peers.has("misuka"):
        return "misuka: not run here: it is not installed"
    script = Path(__file__).with_name("misuka_sphere.py")
    command = [sys.executable, str(script), "--seeds", str(seeds)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    if ran.returncode:
        return f"misuka: failed: {(ran.stderr.strip().splitlines() or ['without a word'])[-1]}"

    # Format the table
    table = ["| misuka | of | frequencies [Hz] | closed form | reverse |\n" + "|---" * 5 + "|"]
    for row in json.loads(ran.stdout):
        by = row["by"]
        of = row["of"]
        exact = f"{closed_form(by)[of]:.6g}"
        cells = by, of, row["frequencies"], exact, _cell(np.array(row["values"]), np.ones(1))
        table.append("| " + " | ".join(cells) + " |")
    return "\n".join(table)
