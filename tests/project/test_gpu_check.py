"""`python -m benchmarks.gpu` measures what it says, fails if something is wrong, and ends in time.

The tests run it on the CPU, with the smallest sizes.
"""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender
from benchmarks.gpu import (
    __main__ as command,
    commands,
    deposits,
    energies,
    gradients,
    limits,
    machine,
    times,
)
from benchmarks.gpu.part import SMALL, Part
from tofrender.runtime import memory

pytestmark = pytest.mark.filterwarnings("ignore:.* of the energy arrives outside")

ROOT = Path(__file__).parents[2]
TINY = replace(SMALL, timed_spp=(4,), compared_scenes=1, compared_cases=1, loaded_scenes=3)


def small_part(**sizes) -> Part:
    """A part with much time, for the active variant."""
    return Part(str(mi.variant()), replace(TINY, **sizes), seconds=600)


def test_the_machine_is_described():
    part = small_part()
    machine.machine(part)
    found = part.results
    assert found["variant"] == mi.variant()
    assert found["on_gpu"] == str(mi.variant()).startswith(("cuda", "metal"))
    assert found["versions"]["mitsuba"] == mi.__version__
    assert found["processor"]


@pytest.mark.slow
def test_times(monkeypatch):
    """Without mitransient, which would take the names of plugins from the tests that follow."""
    monkeypatch.setattr(times.peers, "has", lambda name: False)
    part = small_part()
    times.times(part)
    rows = part.results["Cornell box"]
    assert set(rows) == {"path", "one light point", "ours", "mitransient"}
    assert not isinstance(rows["mitransient"], dict)
    assert rows["path"]["4"]["over_path"] == 1
    assert rows["ours"]["4"]["over_path"] > 1
    for program in ("path", "one light point", "ours"):
        for when in ("first", "later"):
            split = rows[program]["4"][when]
            total = split["tracing_s"] + split["compiling_s"] + split["running_s"]
            assert total == pytest.approx(split["wall_s"])
            assert split["running_s"] > 0
            assert split["launches"] > 0
    assert part.failed == []


def test_what_the_time_of_a_render_is_spent_on():
    """A kernel is compiled once, and runs each time."""
    number = np.random.default_rng().uniform()  # Not in Dr.Jit's cache of kernels

    def render():
        values = dr.arange(mi.Float, 1 << 20)
        for _ in range(50):
            values = dr.sin(values) + number
        dr.eval(values)

    first, later = times.split(render), times.split(render)
    assert first["launches"] == later["launches"] == 1
    assert first["compiling_s"] > 5 * later["compiling_s"]
    assert first["running_s"] > 0
    assert later["running_s"] > 0


def row(over_path: float, wall_s: float, running_s: float) -> dict:
    return {"over_path": over_path, "later": {"wall_s": wall_s, "running_s": running_s}}


def test_targets():
    results = {
        "a": {"one light point": {"64": row(1.2, 0, 1)}, "ours": {"64": row(2, 1.1, 1)}},
        "b": {"one light point": {"64": row(1.3, 0, 1)}, "ours": {"64": row(3, 1.1, 1)}},
    }
    found = times._targets(results, [64])
    assert [(each["target"], each["value"], each["met"]) for each in found] == [
        (1.4, 1.3, True),
        (2.5, 3, False),
        (1.2, 1.1, True),
    ]


@pytest.mark.slow
def test_energies():
    part = small_part()
    energies.energies(part)
    assert set(part.results) == {"Cornell box", "tofbench plane"}
    assert part.results["Cornell box"]["energy"]["over LLVM"] == pytest.approx(1, abs=0.2)
    assert part.results["tofbench plane"]["backend"] in mi.variant()
    assert part.failed == []


@pytest.mark.parametrize(
    ("factor", "problem"),
    [
        ((1.0, 1.0), []),
        ((1.05, 1.0), ["Cornell box: energy -"]),
        ((1.0, 0.95), ["Cornell box: mean length +"]),
    ],
)
def test_another_energy_fails(monkeypatch, factor, problem):
    noise = np.random.default_rng(5)

    def readings(part, name, variant, first_seed):
        exact = factor if first_seed else (1.0, 1.0)
        return noise.normal(exact, 0.005, size=(part.sizes.seeds, 2))

    monkeypatch.setattr(energies, "_readings", readings)
    part = small_part(seeds=8)
    energies._compare_scene(part, "Cornell box")
    assert [line[: len(start)] for line, start in zip(part.failed, problem, strict=True)] == problem


@pytest.mark.statistical
def test_z_is_normal():
    """With few runs, t exceeds 2 in 6 % of the cases, and z in 4.6 %."""
    random = np.random.default_rng(7)
    count = 4000
    draws = random.normal(5, 1, size=(count, 2, 8))
    outside = sum(abs(energies.z_of(ours, theirs)) > 2 for ours, theirs in draws)
    expected = 0.0455 * count
    assert abs(outside - expected) < 4 * expected**0.5  # One in 16,000
    assert energies.z_of(np.full(8, 2.0), np.full(8, 2.0)) == 0


def test_deposits():
    part = small_part()
    deposits.deposits(part)
    assert len(part.results) == 6
    assert all(row["median_s"] > 0 for row in part.results.values())
    assert part.failed == []


def test_lost_deposits_fail(monkeypatch):
    monkeypatch.setattr(deposits, "_deposited", lambda film, *_: film)
    part = small_part()
    deposits.deposits(part)
    assert len(part.failed) == 6
    assert part.failed[0] == "deposits, single, Auto: the sum is off by 1.0e+00"


@pytest.mark.slow
def test_gradients():
    part = small_part(depths=(8, 64))
    gradients.gradients(part)
    assert list(part.results) == ["max_depth 8", "max_depth 64"]
    assert part.results["max_depth 64"]["forward"] > part.results["max_depth 8"]["forward"] > 0
    assert part.failed == []


@pytest.mark.parametrize(
    ("forward", "reverse", "problem"),
    [(1.0, 1.01, "1.0 forward, 1.01 in reverse"), (0.0, 0.0, "gives 0.0 more light")],
)
def test_other_gradients_fail(monkeypatch, forward, reverse, problem):
    values = {False: (forward, 0.1), True: (reverse, 0.1)}
    monkeypatch.setattr(gradients, "_derivative", lambda part, depth, reverse: values[reverse])
    part = small_part(depths=(8,))
    gradients.gradients(part)
    (line,) = part.failed
    assert problem in line


def test_films_that_do_not_fit_are_refused():
    part = small_part()
    measured = memory.free_on_host
    limits.film(part)
    assert set(part.results) == {"40 GB", "12 GB"}
    assert part.failed == []
    assert memory.free_on_host is measured


def test_a_film_that_is_not_refused_fails(monkeypatch):
    monkeypatch.setattr(tofrender, "render", lambda described, **options: None)
    part = small_part()
    limits.film(part)
    assert part.failed == ["film of 40 GB: was not refused", "film of 12 GB: was not refused"]


@pytest.mark.parametrize(("leaked_kib", "failed"), [(0, 0), (300, 1)])
def test_memory_that_grows_with_each_scene_fails(monkeypatch, leaked_kib, failed):
    rendered = []

    class Process:
        def memory_info(self):
            return self

        @property
        def rss(self):
            return (200 << 20) + leaked_kib * 1024 * len(rendered)

    monkeypatch.setattr(tofrender, "render", lambda described, **options: rendered.append(1))
    monkeypatch.setattr(limits.psutil, "Process", Process)
    part = small_part(loaded_scenes=110)
    limits.scenes(part)
    assert len(rendered) == 110
    assert part.results["host_kib_per_scene"] == pytest.approx(leaked_kib, abs=1e-3)
    assert len(part.failed) == failed


def test_scenes_are_loaded():
    part = small_part()
    limits.scenes(part)
    assert part.results["scenes"] == [1, 2, 3]
    assert part.skipped == ["growth of memory: fewer than 100 scenes"]


@pytest.mark.parametrize(
    ("variant", "lines", "failed"),
    [
        ("llvm_ad_rgb", 0, 0),
        ("llvm_ad_rgb", 1, 1),
        ("cuda_ad_rgb", 1, 0),
        ("cuda_ad_rgb", 0, 1),
        ("cuda_ad_rgb", 2, 1),
    ],
)
def test_without_optix_one_line_names_the_reason(monkeypatch, variant, lines, failed):
    def run(part, arguments, environment):
        if arguments[0] == "render":
            folder = Path(arguments[-1])
            for number in range(30):
                (folder / f"frame_{number:04}.exr").touch()
            (folder / "video.mp4").touch()
        reasons = [commands.ON_THE_CPU] * lines if environment else []
        return {"status": 0, "seconds": 0.0, "output": reasons}

    monkeypatch.setattr(commands, "_command", run)
    part = replace(small_part(), variant=variant)
    commands.commands(part)
    assert len(part.failed) == failed


def test_commands_are_run():
    found = commands._command(small_part(), ["--version"], {})
    assert found["status"] == 0
    assert tofrender.__version__ in found["output"][0]
    assert commands._command(small_part(), ["rendr"], {})["status"] == 2


def test_a_part_stops_when_its_time_is_over(monkeypatch):
    part = Part("llvm_ad_rgb", SMALL, seconds=100)
    left = iter([100, 100, 5])
    monkeypatch.setattr(part, "left", lambda: next(left))
    clock = iter([0, 2, 2, 12])  # The second item takes 10 s
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    assert list(part.each(["a", "b", "c", "d"])) == ["a", "b"]
    assert part.skipped == ["c, d: no time left"]


def check(*arguments: str) -> subprocess.CompletedProcess:
    line = [sys.executable, "-m", "benchmarks.gpu", *arguments]
    return subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_command_writes_what_it_has_found(tmp_path):
    out = tmp_path / "folder" / "gpu.json"
    done = check("--small", "--part", "film", "--out", str(out))
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(out.read_text())
    assert report["small"] is True
    assert report["passed"] is True
    assert report["machine"]["on_gpu"] == report["machine"]["variant"].startswith(("cuda", "metal"))
    assert list(report["parts"]) == ["film"]
    assert set(report["parts"]["film"]["results"]) == {"40 GB", "12 GB"}
    assert done.stdout.splitlines()[-1] == f"passed; all results: {out}"


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--minutes", "0"], "0: must be above 0 and at most 60"),
        (["--part", "tims"], "invalid choice: 'tims'"),
    ],
)
def test_bad_arguments(arguments, problem):
    done = check(*arguments)
    assert done.returncode == 2
    assert problem in done.stderr


@pytest.mark.parametrize(
    ("variant", "seconds", "failed", "skipped"),
    [
        ("llvm_ad_none", 60, "status 1: ValueError: variant = 'llvm_ad_none': ", ""),
        ("llvm_ad_rgb", 0.01, "", "the remaining part: it was ended, because its time was over"),
        ("llvm_ad_rgb", -1, "", "all: no time left"),
    ],
)
def test_a_part_that_fails_or_takes_too_long(
    monkeypatch, tmp_path, variant, seconds, failed, skipped
):
    monkeypatch.setattr(command, "GRACE_S", 0.0)
    part = command._run("machine", variant, "small", seconds, tmp_path / "part.json")
    assert failed in "".join(part["failed"])
    assert bool(part["failed"]) == bool(failed)
    assert part["skipped"] == ([skipped] if skipped else [])
