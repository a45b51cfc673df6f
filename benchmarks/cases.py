"""Cases of `python -m benchmarks`. Each case returns rows of name, value and target."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

import tofrender

from .case_derivatives import derivatives
from .case_first_film import first_film
from .case_fog import fog, gates_in_fog
from .case_gradients import gradients
from .case_lights import camera_connections, light_samples, lights
from .case_motion import motion
from .case_nlos import nlos
from .case_photons import photons
from .case_polarized import polarized
from .case_reconstruction import reconstruction
from .case_warps import warps
from .timing import Row, in_turn, noise, trace


def _transient(size: int, bins: int, spp: int, **integrator: Any) -> mi.Scene:
    """Load the Cornell box of tofrender with its own plugins."""
    scene = tofrender.cornell_box(width=size, height=size, temporal_bins=bins, spp=spp)
    scene["integrator"] |= integrator
    return tofrender.load_scene(scene)


def _peer(size: int, bins: int) -> mi.Scene | None:
    """Load the Cornell box of mitransient; None if mitransient is not installed."""
    try:
        import mitransient
    except ImportError:
        return None
    scene = mitransient.cornell_box()
    scene["sensor"]["film"] |= {"width": size, "height": size, "temporal_bins": bins}
    return mi.load_dict(scene)


def _path(size: int, spp: int) -> mi.Scene:
    """Load the steady Cornell box for Mitsuba's `path`."""
    scene = tofrender.cornell_box_steady_state(width=size, height=size, spp=spp)
    scene["sensor"]["sampler"] = {"type": "independent", "sample_count": spp}
    return mi.load_dict(scene)


def speed(runs: int, quick: bool) -> list[Row]:
    """Compare the time of the transient render with Mitsuba's `path`, at equal samples and rays."""
    size, spp = (64, 16) if quick else (256, 64)
    functions = {"path": trace(_path(size, spp), spp)}
    functions["tofrender"] = trace(_transient(size, 300, spp, light_samples=1), spp)
    peer = _peer(size, 300)
    if peer is not None:
        functions["mitransient"] = trace(peer, spp)
    times = in_turn(functions, runs)
    what = f"{size}x{size} x 300 bins, {spp} spp, over path"
    rows: list[Row] = []
    for name in list(functions)[1:]:
        target = 1.25 if name == "tofrender" else None
        rows += times[name].rows(times["path"], f"{name}, {what}", target, target)
    return rows


def bins(runs: int, quick: bool) -> list[Row]:
    """Compare the time with `path`, with few and many bins."""
    size, spp = (32, 16) if quick else (64, 256)
    counts = (30, 300, 3000)
    functions = {"path": trace(_path(size, spp), spp)}
    functions |= {str(n): trace(_transient(size, n, spp, light_samples=1), spp) for n in counts}
    times = in_turn(functions, runs)
    rows: list[Row] = []
    for n in counts:
        what = f"{size}x{size} x {n} bins, {spp} spp, over path"
        rows += times[str(n)].rows(times["path"], what)

    # How much do many bins cost?
    flat = [times[str(n)].cpu / times[str(counts[0])].cpu for n in counts]
    worst = max(float(np.median(ratio)) for ratio in flat)
    return [*rows, (f"slowest over {counts[0]} bins: cpu", worst, 1.2)]


def error(runs: int, quick: bool) -> list[Row]:
    """Compare variance times time of all bins between mitransient and `render`, with defaults."""
    size, spp, seeds = (16, 16, 4) if quick else (64, 256, 8)
    ours = _transient(size, 300, spp)
    peer = _peer(size, 300)
    if peer is None:
        return []

    # Collect the bins of all seeds
    cubes: dict[str, list[np.ndarray]] = {"tofrender": [], "mitransient": []}
    counter = iter(range(1, 1 << 20))

    def draw_ours() -> None:
        dataset = tofrender.render(ours, spp=spp, seed=next(counter), progress=False)
        cubes["tofrender"].append(dataset["transient"].values)

    def draw_peer() -> None:
        _, transient = mi.render(peer, spp=spp, seed=next(counter))
        cubes["mitransient"].append(np.array(transient))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        times = in_turn({"tofrender": draw_ours, "mitransient": draw_peer}, max(runs, seeds))

    # Compare the variances
    variance = {
        name: float(np.var(stack[1:], axis=0, ddof=1).mean()) for name, stack in cubes.items()
    }
    gain = variance["mitransient"] / variance["tofrender"]
    what = f"{size}x{size} x 300 bins, {spp} spp: variance"
    rows = times["mitransient"].rows(times["tofrender"], f"{what} x time", 30.0, 30.0, gain)
    return [(f"{what} of mitransient over ours", gain, None), *rows]


_MEMORY = """
import resource, sys, warnings
from pathlib import Path
warnings.simplefilter("ignore")
import tofrender
size, bins, spp = map(int, sys.argv[1:])
scene = tofrender.cornell_box(width=size, height=size, temporal_bins=bins)
dataset = tofrender.render(scene, spp=spp, progress=False)
status = Path("/proc/self/status")
if status.exists():  # ru_maxrss counts what the parent took before it started this process
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    peak = int(lines["VmHWM"].split()[0]) * 1024
else:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(peak / 2**20, dataset["transient"].nbytes / 2**20)
"""


def memory(runs: int, quick: bool) -> list[Row]:
    """Measure the peak memory of a process that renders, minus twice the result [MiB]."""
    rows: list[Row] = []
    for size, bins_, spp in [(64, 300, 4)] if quick else [(256, 300, 64), (128, 3000, 64)]:
        command = [sys.executable, "-c", _MEMORY, str(size), str(bins_), str(spp)]
        output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        peak, result = map(float, output.split())
        name = f"{size}x{size} x {bins_} bins: peak less 2 x result of {result:.0f} MiB [MiB]"
        rows.append((name, peak - 2 * result, 300.0))
    return rows


_IMPORT = """
import time
start = time.perf_counter()
{statement}
print(time.perf_counter() - start)
"""


def importing(runs: int, quick: bool) -> list[Row]:
    """Measure the time of `import tofrender` minus the import of Mitsuba [s]."""
    mitsuba = f"import mitsuba; mitsuba.set_variant({mi.variant()!r})"
    statements = (mitsuba, "import tofrender")
    seconds: list[list[float]] = [[], []]
    for _ in range(max(runs, 3)):
        for statement, taken in zip(statements, seconds, strict=True):
            command = [sys.executable, "-c", _IMPORT.format(statement=statement)]
            output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            taken.append(float(output))
    extra = np.median(np.array(seconds[1]) - np.array(seconds[0]))
    return [("import tofrender, beyond Mitsuba [s]", float(extra), 0.3)]


def phasors(runs: int, quick: bool) -> list[Row]:
    """Compare the time of phasors at eight frequencies with the steady `path`."""
    size, spp = (64, 16) if quick else (256, 64)
    scene = _transient(size, 1, spp)
    frequencies = [10e6 * k for k in range(1, 9)]
    functions = {"path": trace(_path(size, spp), spp)}
    functions["phasors"] = lambda: tofrender.render_amcw_phasor(
        scene, scene.sensors()[0], frequencies, spp
    )
    times = in_turn(functions, runs)
    what = f"{size}x{size}, 8 frequencies, {spp} spp, over path"
    return times["phasors"].rows(times["path"], what, 1.3, 1.3)


def _plain_gate(size: int, spp: int, opl: float) -> Callable[[int], np.ndarray]:
    """Return a function that renders a gate as in the course: a pulse, evaluated on plain paths."""
    described = tofrender.cornell_box(width=size, height=size, temporal_bins=1, spp=spp)
    described["integrator"]["type"] = "tofrender_time_gated_transient_path"
    described["sensor"]["sampler"]["type"] = "independent"
    film = described["sensor"]["film"]
    film["start_opl"] = opl - film["bin_width_opl"] / 2
    scene = tofrender.load_scene(described)
    return lambda seed: np.array(mi.render(scene, spp=spp, seed=seed)[1])[:, :, 0]


def gates(runs: int, quick: bool) -> list[Row]:
    """Compare 300 gates of one trace with one trace per gate, by variance times time.

    The time of the loop over gates is 300 times the time of one of its traces.
    """
    size, spp = (32, 16) if quick else (256, 64)
    scene = _transient(size, 1, spp)
    sensor = scene.sensors()[0]
    integrator = mi.load_dict({"type": "tofrender_time_gated_transient_path"})
    window = {"temporal_bins": 300, "start_opl": 3.5, "bin_width_opl": 0.02}
    k = 120  # The gate at 5.91 m

    def one_trace(seed: int) -> np.ndarray:
        return tofrender.render_transient(scene, integrator, sensor, window, spp, seed)[:, :, k]

    # Measure one gate of the loop
    functions = {"one trace": one_trace, "loop": _plain_gate(size, spp, 5.91)}
    variance, times = noise(functions, runs)
    gain = 300 * variance["loop"] / variance["one trace"]
    what = f"{size}x{size}, 300 gates, {spp} spp: loop over one trace"
    rows = times["loop"].rows(times["one trace"], f"{what}, time", factor=300)[:1]
    both = f"{what}, variance x time"
    return rows + times["loop"].rows(times["one trace"], both, 200.0, 200.0, gain)


def one_gate(runs: int, quick: bool) -> list[Row]:
    """Compare a single gate of `render_at_time` with plain evaluation, by variance times time."""
    size, spp = (32, 16) if quick else (256, 64)
    scene = _transient(size, 1, spp)
    sensor = scene.sensors()[0]
    integrator = mi.load_dict({"type": "tofrender_time_gated_transient_path"})
    rows: list[Row] = []
    for opl in (5.2, 5.9, 6.7, 8.0):
        ours = partial(tofrender.render_at_time, scene, integrator, sensor, opl, spp)
        variance, times = noise({"plain": _plain_gate(size, spp, opl), "ours": ours}, runs)
        gain = variance["plain"] / variance["ours"]
        what = f"{size}x{size}, gate at {opl} m, {spp} spp: plain over ours, variance x time"
        rows += times["plain"].rows(times["ours"], what, 10.0, 10.0, gain)
    return rows


def path_tracers(runs: int, quick: bool) -> list[Row]:
    """Compare the time of the path tracers of the course with `path`, at equal samples."""
    size, spp = ((32, 24), 16) if quick else ((256, 192), 64)
    names = {
        "path": ("path", {}),
        "mats": ("path_tracer_mats", {}),
        "nee": ("path_tracer_nee", {}),
        "mis": ("path_tracer_mis", {}),
        "mis, one sample": ("path_tracer_mis", {"technique": "one_sample"}),
    }
    functions = {}
    for name, (plugin, parameters) in names.items():
        scene = tofrender.veach(width=size[0], height=size[1], spp=spp, integrator=plugin)
        scene["integrator"] |= parameters
        if name == "path":
            scene["sensor"]["sampler"]["type"] = "independent"
        functions[name] = trace(tofrender.load_scene(scene), spp)
    times = in_turn(functions, runs)
    what = f"Veach's plates, {size[0]}x{size[1]}, {spp} spp, over path"
    rows: list[Row] = []
    for name in list(functions)[1:]:
        rows += times[name].rows(times["path"], f"{what}: {name}", wall=1.3)
    return rows


CASES = {
    "speed": speed,
    "bins": bins,
    "error": error,
    "memory": memory,
    "import": importing,
    "phasors": phasors,
    "gates": gates,
    "one-gate": one_gate,
    "path-tracers": path_tracers,
    "lights": lights,
    "light-samples": light_samples,
    "camera-connections": camera_connections,
    "first-film": first_film,
    "fog": fog,
    "gates-in-fog": gates_in_fog,
    "polarized": polarized,
    "derivatives": derivatives,
    "nlos": nlos,
    "reconstruction": reconstruction,
    "photons": photons,
    "motion": motion,
    "warps": warps,
    "gradients": gradients,
}
