"""Runs adapters in processes of their own and judges what they render."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .cases import Case
from .verdicts import Verdict, judge, readings_of, threshold

WORKER = Path(__file__).with_name("worker.py")
ADAPTERS = sorted(
    path.stem
    for path in (WORKER.parent / "adapters").glob("*.py")
    if path.stem not in ("__init__", "mitsuba_scenes")
)
CASE_LIMIT_S = 600


@dataclass
class Renderer:
    """An adapter, and the Python that has its renderer.

    Attributes:
        name: The adapter's name, or the path of its file.
        python: The interpreter.
        version: What runs, None if it is not installed.
        abilities: What it declares.
        install: How it is installed.
    """

    name: str
    python: str
    version: str | None
    abilities: frozenset[str]
    install: str


def describe(name: str, python: str = sys.executable) -> Renderer:
    """Ask an adapter for its version and abilities."""
    done = subprocess.run([python, WORKER, name], capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise RuntimeError(f"{name}: adapter does not start: {last}")
    told = json.loads(done.stdout.splitlines()[-1])
    return Renderer(name, python, told["version"], frozenset(told["abilities"]), told["install"])


def run(
    renderer: Renderer,
    cases: Sequence[Case],
    runs: int = 16,
    samples: float = 1.0,
    progress: Callable[[str], None] = lambda line: None,
    among: Sequence[Case] = (),
) -> dict[str, Verdict]:
    """Verdicts by case.

    Args:
        renderer: What renders.
        cases: What it renders.
        runs: Independent runs of each case, at least 2.
        samples: Multiplies each case's samples per pixel.
        progress: Gets a line for each case.
        among: All cases that share the false-alarm rate; `cases` by default.
    """
    forms = {case.name: case.form_for(renderer.abilities) for case in cases}
    found = {
        case.name: Verdict(
            "not supported", note=", ".join(sorted(case.missing(renderer.abilities)))
        )
        for case in cases
        if forms[case.name] is None
    }
    todo = [form for form in forms.values() if form is not None]
    allowed = threshold(sum(len(readings_of(case)) for case in among or cases))
    with tempfile.TemporaryDirectory() as folder:
        for name, result in rendered(renderer, todo, runs, samples, Path(folder)):
            case = forms[name]
            if isinstance(result, str):
                found[name] = Verdict("error", case.bins["quantity"], note=result)
            else:
                found[name] = judge(case, *result, allowed)
            verdict = found[name]
            bias = "" if verdict.bias is None else f" {verdict.bias:+.1f} sigma"
            progress(f"{renderer.name:16s} {name:24s} {verdict.status}{bias} {verdict.note}")
    return {case.name: found[case.name] for case in cases}


def rendered(renderer: Renderer, cases: list[Case], runs: int, samples: float, folder: Path):
    """(name, (runs, processor time)) or (name, error) of each case; crashes end one case only."""
    left = {case.name: case for case in cases}
    while left:
        # Polarised light needs another variant of Mitsuba, which takes a process of its own
        polarised = next(iter(left.values())).bins["quantity"] == "stokes"
        now = [c for c in left.values() if (c.bins["quantity"] == "stokes") == polarised]
        described = [case.request(runs, samples) for case in now]
        (folder / "cases.json").write_text(json.dumps(described))
        command = [renderer.python, WORKER, renderer.name, folder]
        try:
            limit = CASE_LIMIT_S * len(now)
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=limit, env=_env()
            )
            last = (done.stderr.strip().splitlines() or [""])[-1]
        except subprocess.TimeoutExpired:
            last = f"no answer within {limit} s"
        ended = []
        for name in (case.name for case in now):
            if (folder / f"{name}.npz").exists():
                with np.load(folder / f"{name}.npz") as file:
                    yield name, (file["runs"], float(file["cpu_s"]))
                ended.append(name)
            elif (folder / f"{name}.txt").exists():
                yield name, (folder / f"{name}.txt").read_text().splitlines()[0][:300]
                ended.append(name)
        if len(ended) < len(now):  # The process ended in this case
            at = folder / "now.txt"
            name = at.read_text() if at.exists() else now[0].name
            name = name if name in left and name not in ended else now[len(ended)].name
            yield name, f"the process ended: {last[:200]}"
            ended.append(name)
        left = {name: case for name, case in left.items() if name not in ended}


def _env() -> Mapping[str, str]:
    return os.environ | {"PYTHONWARNINGS": "ignore"}
